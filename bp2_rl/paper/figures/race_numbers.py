"""100 m of athletes, of BP2 as the paper has it, and of policies: splits, starts,
fading, and what does not fit."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.optimize import root_scalar

from bp2_rl.evaluation import races
from bp2_rl.evaluation.races import LAUNCH_DISTANCE, TRACK
from bp2_rl.paper import published_races
from bp2_rl.paper.figures.drawn import Comparison
from bp2_rl.paper.figures.settings import RaceSettings
from bp2_rl.paper.published_races import Athlete, read_standards
from bp2_rl.robot import bp2
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.trajectory import Trajectory

BENCHMARK = "sprint"
WINDOW = 0.5  # s, of the start's best mean acceleration
HELD = 60.0  # m, from where on speed should be held
STEP = 1e-3  # s, of profiles drawn from formulas


class Profile(NamedTuple):
    """A start from a stand, and what follows."""

    time: Float[np.ndarray, " N"]  # s, since the first push, or since the command
    distance: Float[np.ndarray, " N"]  # m
    speed: Float[np.ndarray, " N"]  # m/s


@dataclasses.dataclass(frozen=True)
class Start:
    """The first `LAUNCH_DISTANCE` metres: the paper's "mean acceleration" has no
    definition, these are four."""

    time: float  # s
    speed: float  # m/s, on reaching the mark
    over_time: float  # m/s2, speed / time: the mean over time
    over_distance: float  # m/s2, speed^2 / (2 distance): the mean over distance
    constant: float  # m/s2, 2 distance / time^2: the constant one that takes as long
    best: float  # m/s2, greatest gain of speed within `WINDOW`, over that


@dataclasses.dataclass(frozen=True)
class Racer:
    """One of those who run."""

    name: str
    # s over 100 m, from the gun, or since the command; None if it did not arrive
    time: float | None
    reaction: float | None  # s; None where it is not published, 0 of a robot
    male_level: int | None  # of Table S2, that the time meets; None: none
    female_level: int | None
    said_acceleration: float | None  # m/s2, the paper's "mean" over 5 m
    distances: tuple[float, ...]  # m, of the splits; empty where none are published
    splits: tuple[float, ...]  # s, on the clock of `time`
    means: tuple[float, ...]  # m/s, from split to split
    # m/s, gained from 60 to 100 m by a straight line through these means
    fade: float | None
    start: Start | None

    @property
    def moving_time(self) -> float | None:
        """Without the reaction, where that is known, s."""
        return (
            None
            if self.time is None or self.reaction is None
            else self.time - self.reaction
        )


@dataclasses.dataclass(frozen=True)
class PaperRace:
    """Whether 10.74 m/s, 12.2 s and 2.38 m/s2 are of one race."""

    time_constant: float  # s, of v = 10.74 (1 - exp(-t / T)) over 100 m in 12.2 s
    first_acceleration: float  # m/s2, of that
    arrival_speed: float  # m/s, of that
    start: Start  # of that
    time_at_said: float  # s over 100 m: at 2.38 m/s2 to 10.74 m/s, then on
    constant_needed: float  # m/s2, in place of 2.38 there, for 12.2 s
    # s for 5 m at the accelerations that the paper says, constant
    constant_times: dict[str, float]
    # s, of BP2 on the trained sprinter by these: the most of any reading, if both start
    # alike
    deficit: float
    finish_gap: float  # s, between the two at 100 m


@dataclasses.dataclass(frozen=True)
class RaceNumbers:
    """All that the figure shows."""

    racers: tuple[Racer, ...]
    runs: tuple[Racer, ...]  # simulated
    paper: PaperRace

    def find(self, name: str) -> Racer:
        """The racer of a name."""
        return next(racer for racer in (*self.racers, *self.runs) if racer.name == name)


# --- Who runs -------------------------------------------------------------------------


def published() -> tuple[Athlete, ...]:
    """Return the athletes that the paper names, with what is published of them."""
    return (
        Athlete(
            races.BOLT,
            races.BOLT_SPLITS[-1],
            published_races.BOLT_REACTION,
            races.MARKS,
            races.BOLT_SPLITS,
        ),
        Athlete(
            races.LYLES, published_races.LYLES_TIME, published_races.LYLES_REACTION
        ),
        Athlete(races.TRAINED, races.TRAINED_TIME, None),
        Athlete(races.PAPER_BP2, bp2.SPRINT_100M_TIME, None),
        Athlete(races.UNTRAINED, races.UNTRAINED_TIME, None),
    )


def read(settings: RaceSettings) -> tuple[tuple[Athlete, ...], dict[str, Profile]]:
    """Who runs, and the profiles of all whose splits are known: of one named twice, the
    user's."""
    more = published_races.read_athletes(settings.athletes) if settings.athletes else ()
    athletes = {athlete.name: athlete for athlete in (*published(), *more)}
    profiles = {
        name: fit(athlete) for name, athlete in athletes.items() if athlete.splits
    }
    return tuple(athletes.values()), profiles


def measure(
    athletes: tuple[Athlete, ...],
    profiles: dict[str, Profile],
    runs: tuple[tuple[Athlete, Profile], ...],
) -> RaceNumbers:
    """Everything that the figure shows of them."""
    racers = tuple(judge(athlete, profiles.get(athlete.name)) for athlete in athletes)
    return RaceNumbers(racers, tuple(judge(*run) for run in runs), check_paper())


def judge(athlete: Athlete, profile: Profile | None) -> Racer:
    """A racer's splits, start and level."""
    distances, splits = (
        np.array((0.0, *athlete.distances)),
        np.array((0.0, *athlete.splits)),
    )
    means = np.diff(distances) / np.diff(splits)
    arrived = math.isfinite(athlete.time)
    return Racer(
        athlete.name,
        athlete.time if arrived else None,
        athlete.reaction,
        *(
            published_races.best_level(athlete.time, category)
            for category in ("male", "female")
        ),
        said_acceleration=published_races.PUBLISHED_ACCELERATIONS.get(athlete.name),
        distances=athlete.distances,
        splits=athlete.splits,
        means=tuple(map(float, means)),
        fade=fading(distances, means),
        start=measure_start(profile) if profile is not None else None,
    )


def fading(
    distances: Float[np.ndarray, " n"], means: Float[np.ndarray, " n-1"]
) -> float | None:
    """How much speed is gained over the last 40 m by a line through the means there,
    m/s; None with one mean or none.

    Args:
        distances: m, of the splits, with 0 first.
        means: m/s, between them.
    """
    there = distances[:-1] >= HELD
    if there.sum() < 2:
        return None
    middles = 0.5 * (distances[1:] + distances[:-1])
    return float(np.polyfit(middles[there], means[there], 1)[0] * (TRACK - HELD))


def fit(athlete: Athlete) -> Profile:
    """The smoothest curve from a stand through an athlete's splits: a cubic spline,
    straight at its end."""
    clock = np.array((0.0, *athlete.splits)) - np.array(
        (0.0, *[athlete.reaction or 0.0] * len(athlete.splits))
    )
    ends: Any = ((1, 0.0), (2, 0.0))  # the first derivative there, the second here
    curve = CubicSpline(clock, (0.0, *athlete.distances), bc_type=ends)
    time = np.arange(0.0, clock[-1], STEP)
    return Profile(time, curve(time), curve(time, 1))


def measure_start(profile: Profile) -> Start | None:
    """The first metres; None if the profile ends before."""
    if profile.distance[-1] < LAUNCH_DISTANCE:
        return None
    there = int(np.argmax(profile.distance >= LAUNCH_DISTANCE))
    before = [there - 1, there]
    time = float(
        np.interp(LAUNCH_DISTANCE, profile.distance[before], profile.time[before])
    )
    speed = float(np.interp(time, profile.time, profile.speed))
    until = profile.time <= profile.time[-1] - WINDOW
    gain = (
        np.interp(profile.time[until] + WINDOW, profile.time, profile.speed)
        - profile.speed[until]
    )
    best = float(np.max(gain, initial=0.0)) / WINDOW
    return Start(
        time,
        speed,
        speed / time,
        speed**2 / (2.0 * LAUNCH_DISTANCE),
        2.0 * LAUNCH_DISTANCE / time**2,
        best,
    )


# --- Simulated runs -------------------------------------------------------------------


def read_reports(folders: Sequence[Path]) -> tuple[tuple[Athlete, Profile], ...]:
    """The races in reports of sprints, their clocks and speeds as those reports';
    raises UserError for others."""
    # slow to import, and mostly not needed
    from bp2_rl.paper.figures.runs import read_runs

    return tuple(follow(name, run) for name, _, run in read_runs(folders, BENCHMARK))


def follow(name: str, run: Trajectory) -> tuple[Athlete, Profile]:
    """A run's race, by the measures of the sprint benchmark: splits, and speeds as
    means over `RIPPLE` around."""
    from bp2_rl.evaluation.benchmarks.sprint import measure_splits, track_position

    splits, along = measure_splits(run), track_position(run)[0]
    ends = np.clip(
        (run.time - RIPPLE / 2, run.time + RIPPLE / 2), run.time[0], run.time[-1]
    )
    behind, ahead = np.interp(ends, run.time, along)
    distances, times = (
        tuple(split.distance for split in splits),
        tuple(split.time for split in splits),
    )
    arrived = bool(splits) and splits[-1].distance == TRACK
    athlete = Athlete(name, times[-1] if arrived else math.inf, 0.0, distances, times)
    return athlete, Profile(run.time, along, (ahead - behind) / (ends[1] - ends[0]))


# --- The paper's race -----------------------------------------------------------------


def exponential(time_constant: float, speed: float, duration: float) -> Profile:
    """v = speed (1 - exp(-t / T)) for a duration, s."""
    time = np.linspace(0.0, duration, round(duration / STEP) + 1)
    risen = -np.expm1(-time / time_constant)
    return Profile(time, speed * (time - time_constant * risen), speed * risen)


def paper_profile() -> Profile:
    """BP2's race by the paper's speed and time alone: an exponential rise to 10.74 m/s,
    and 100 m after 12.2 s."""
    return exponential(
        solve_time_constant(), bp2.OUTDOOR_TOP_SPEED, bp2.SPRINT_100M_TIME
    )


def solve_time_constant() -> float:
    """Return the time constant, s, of an exponential rise to 10.74 m/s that covers 100
    m in 12.2 s."""
    speed, time = bp2.OUTDOOR_TOP_SPEED, bp2.SPRINT_100M_TIME

    def missing(time_constant: float) -> float:
        return (
            speed * (time + time_constant * math.expm1(-time / time_constant)) - TRACK
        )

    return float(root_scalar(missing, bracket=(0.01, 100.0), xtol=1e-12).root)


def check_paper() -> PaperRace:
    """What the paper's numbers of the race say together."""
    speed, time, said = (
        bp2.OUTDOOR_TOP_SPEED,
        bp2.SPRINT_100M_TIME,
        bp2.LAUNCH_ACCELERATION,
    )
    profile, time_constant = paper_profile(), solve_time_constant()
    start = measure_start(profile)
    assert start is not None  # it goes on to 100 m
    constant = {
        name: math.sqrt(2.0 * LAUNCH_DISTANCE / acceleration)
        for name, acceleration in published_races.PUBLISHED_ACCELERATIONS.items()
    }
    return PaperRace(
        time_constant=time_constant,
        first_acceleration=speed / time_constant,
        arrival_speed=float(profile.speed[-1]),
        start=start,
        time_at_said=TRACK / speed + 0.5 * speed / said,
        constant_needed=0.5 * speed / (time - TRACK / speed),
        constant_times=constant,
        deficit=constant[races.PAPER_BP2] - constant[races.TRAINED],
        finish_gap=time - races.TRAINED_TIME,
    )


# --- What comes of the paper's statements ---------------------------------------------


FAST = 12.0  # m/s, which the paper has Bolt and Lyles exceed


def compare(numbers: RaceNumbers) -> tuple[Comparison, ...]:
    """What the paper says of the figure, and what the numbers say."""
    bolt, lyles, ours = (
        numbers.find(name) for name in (races.BOLT, races.LYLES, races.PAPER_BP2)
    )
    paper = numbers.paper
    return (
        _greatest(bolt),
        _greatest(lyles),
        Comparison(
            "Bolt slows down measurably over the final 20 to 30 m",
            f"{bolt.means[-4]:.2f} m/s from 60 to 70 m, {bolt.means[-1]:.2f} from 90 to 100 m: "
            f"{bolt.means[-1] / bolt.means[-4] - 1.0:+.1%}",
            "same",
        ),
        Comparison(
            f"{bp2.SPRINT_100M_TIME:g} s meets China's National Level II",
            f"Table S2's level 2 is {_standard('male', 2):g} s of men and {_standard('female', 2):g} s of women: "
            f"{bp2.SPRINT_100M_TIME:g} s is {levels(ours)}",
            "differs",
            "of men it misses level 2 by "
            f"{bp2.SPRINT_100M_TIME - _standard('male', 2):.2f} s; of women it meets more than level 2",
        ),
        Comparison(
            "mean accelerations over 5 m: 2.38, trained 4.8, untrained 2.8 m/s²; so a deficit of nearly 1 s at 5 m",
            f"constant, they take {paper.constant_times[races.PAPER_BP2]:.2f}, "
            f"{paper.constant_times[races.TRAINED]:.2f} and {paper.constant_times[races.UNTRAINED]:.2f} s: "
            f"{paper.deficit:.2f} s behind the trained sprinter",
            "differs",
            "no definition is given; as v/t or v²/2d of two starts of one shape it is less still; "
            f"the gap at the finish is {paper.finish_gap:.1f} s",
        ),
        Comparison(
            "10.74 m/s, held to the end; 100 m in 12.2 s; 2.38 m/s² over the first 5 m",
            f"at a constant 2.38 to 10.74 m/s 100 m take {paper.time_at_said:.2f} s, and 12.2 s need "
            f"{paper.constant_needed:.2f} m/s²; an exponential rise needs T = {paper.time_constant:.2f} s, from "
            f"{paper.first_acceleration:.2f} m/s² on, and 5 m then take {paper.start.time:.2f} s: v/t "
            f"{paper.start.over_time:.2f}, 2d/t² {paper.start.constant:.2f}, v²/2d {paper.start.over_distance:.2f} "
            "m/s²",
            "not comparable",
            "the profile is not published; of the readings of this rise v²/2d, the mean over distance, is nearest",
        ),
        Comparison(
            "trained and untrained profiles (panels C and D)",
            "times, mean speeds and constant starts alone",
            "not comparable",
            "their splits are not published",
        ),
        *(_ours(run, ours) for run in numbers.runs),
    )


def levels(racer: Racer) -> str:
    """The standards of Table S2 that a time meets."""
    men, women = (
        f"{level}" if level else "none"
        for level in (racer.male_level, racer.female_level)
    )
    return f"level {men} of men, {women} of women".replace("level none", "no level")


def _greatest(racer: Racer) -> Comparison:
    said = f"{racer.name} exceeds {FAST:g} m/s"
    if not racer.means:
        return Comparison(
            said,
            "not known",
            "not comparable",
            "no citable splits ship here: see --athletes",
        )
    fastest = max(racer.means)
    found = f"{fastest:.2f} m/s in the mean of the fastest split"
    if fastest > FAST:
        return Comparison(said, found, "same")
    return Comparison(
        said,
        found,
        "not comparable",
        "between splits the greatest speed is above their mean",
    )


def _standard(category: str, level: int) -> float:
    return next(
        s.time for s in read_standards() if (s.category, s.level) == (category, level)
    )


def _ours(run: Racer, published: Racer) -> Comparison:
    said = f"BP2: {published.time:g} s, {published.said_acceleration:g} m/s² over 5 m, minimal decay"
    if run.time is None or run.start is None or run.fade is None:
        return Comparison(
            said, f"{run.name}: did not arrive", "differs", "it fell, or was too slow"
        )
    return Comparison(
        said,
        f"{run.name}: {run.time:.2f} s ({levels(run)}), 5 m in {run.start.time:.2f} s with v/t "
        f"{run.start.over_time:.2f} m/s², {run.fade:+.2f} m/s over the last 40 m",
        "differs",
        "it is simulated: what its robot leaves out is in the report of the run",
    )
