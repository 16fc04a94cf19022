"""Fig. 6 B to D of the paper: speed over distance of athletes, of BP2 as the paper has
it, and of policies; and the times beside Table S2."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.interpolate import CubicSpline
from scipy.optimize import root_scalar

from bp2_rl.base.metric import metric, table_of
from bp2_rl.base.plotting import FALL, FRONT, INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.evaluation import races
from bp2_rl.evaluation.races import LAUNCH_DISTANCE, TRACK
from bp2_rl.paper import published
from bp2_rl.paper.figures.drawn import DASHES, Drawn
from bp2_rl.paper.figures.settings import RaceFigureSettings
from bp2_rl.paper.published import Athlete
from bp2_rl.robot import bp2
from bp2_rl.simulation.measuring import track_position
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.trajectory import Trajectory

BENCHMARK = "sprint"
HELD = 60.0  # m, from where on speed should be held
STEP = 1e-3  # s, of profiles drawn from formulas
DOTS = (0, (1.2, 1.2))
RUNS = FRONT, LEG_COLORS["RR"], LEG_COLORS["RL"], LEG_COLORS["FL"]  # of policies
ATHLETES = INK, QUIET, LEG_COLORS["FL"], LEG_COLORS["RL"]


class Profile(NamedTuple):
    """Time, distance and speed along a run from a stand."""

    time: Float[np.ndarray, " N"]  # s, since the first push, or since the command
    distance: Float[np.ndarray, " N"]  # m
    speed: Float[np.ndarray, " N"]  # m/s


@dataclasses.dataclass(frozen=True, kw_only=True)
class Racer:
    """One race over 100 m, of an athlete, of BP2 or of a policy."""

    name: str = metric("100 m", form="s")
    # s over 100 m, from the gun, or since the command; None if it did not arrive
    time: float | None = metric("From the gun", "s")
    # s; None where it is not published, 0 of a robot
    reaction: float | None = metric("Reaction", "s", ".3f")
    # of Table S2, that the time meets; None: none
    male_level: int | None = metric("Men's level", form="d")
    female_level: int | None = metric("Women's level", form="d")
    # m/s2, the paper's "mean" over 5 m
    said_acceleration: float | None = metric("Paper's first 5 m", "m/s²", "g")
    distances: tuple[float, ...]  # m, of the splits; empty where none are published
    splits: tuple[float, ...]  # s, on the clock of `time`
    means: tuple[float, ...]  # m/s, from split to split
    # gained from 60 to 100 m by a straight line through these means
    fade: float | None = metric("60 to 100 m", "m/s", "+.2f")


@dataclasses.dataclass(frozen=True)
class PaperRace:
    """Times over the first 5 m that the paper's accelerations imply, and the gap at the
    finish."""

    # s for 5 m at the accelerations that the paper says, constant
    constant_times: dict[str, float]
    # s, of BP2 on the trained sprinter by these: the most of any reading, if both start
    # alike
    deficit: float
    finish_gap: float  # s, between the two at 100 m


@dataclasses.dataclass(frozen=True)
class RaceNumbers:
    """All races that the figure shows."""

    racers: tuple[Racer, ...]
    runs: tuple[Racer, ...]  # simulated
    paper: PaperRace


def race(settings: RaceFigureSettings) -> Drawn:
    """Draw the races, and tabulate their times."""
    more = published.read_athletes(settings.athletes) if settings.athletes else ()
    # of one named twice, the user's
    athletes = {athlete.name: athlete for athlete in (*published_athletes(), *more)}
    splits = [athlete for athlete in athletes.values() if athlete.splits]
    profiles = {athlete.name: fit_profile(athlete) for athlete in splits}
    runs = read_reports(settings.runs)
    numbers = RaceNumbers(
        tuple(map(describe_race, athletes.values())),
        tuple(describe_race(athlete) for athlete, _ in runs),
        check_paper(),
    )
    ranked = sorted((*numbers.racers, *numbers.runs), key=lambda r: r.time or np.inf)
    title = (
        "Times; a robot's clock starts with the command; -: not published, or no level"
    )
    simulated = {athlete.name: profile for athlete, profile in runs}
    picture = race_figure(profiles, simulated)
    return Drawn(numbers, (table_of(title, ranked),), {"race": picture})


# --- Who runs -------------------------------------------------------------------------


def published_athletes() -> tuple[Athlete, ...]:
    """Return the athletes that the paper names, with their published times."""
    reaction, lyles = published.BOLT_REACTION, published.LYLES_REACTION
    bolt = races.BOLT_SPLITS[-1], reaction, races.MARKS, races.BOLT_SPLITS
    return (
        Athlete(races.BOLT, *bolt),
        Athlete(races.LYLES, published.LYLES_TIME, lyles),
        Athlete(races.TRAINED, races.TRAINED_TIME, None),
        Athlete(races.PAPER_BP2, bp2.SPRINT_100M_TIME, None),
        Athlete(races.UNTRAINED, races.UNTRAINED_TIME, None),
    )


def describe_race(athlete: Athlete) -> Racer:
    """Return an athlete's or policy's race: splits, mean speeds, fading and levels by
    Table S2."""
    distances = np.array((0.0, *athlete.distances))
    means = np.diff(distances) / np.diff(np.array((0.0, *athlete.splits)))
    return Racer(
        name=athlete.name,
        time=athlete.time if math.isfinite(athlete.time) else None,
        reaction=athlete.reaction,
        male_level=published.best_level(athlete.time, "male"),
        female_level=published.best_level(athlete.time, "female"),
        said_acceleration=published.PUBLISHED_ACCELERATIONS.get(athlete.name),
        distances=athlete.distances,
        splits=athlete.splits,
        means=tuple(map(float, means)),
        fade=fading(distances, means),
    )


def fading(
    distances: Float[np.ndarray, " n"], means: Float[np.ndarray, " n-1"]
) -> float | None:
    """Return the speed gained over the last 40 m, m/s, by a line through the mean
    speeds there; None with fewer than two.

    Args:
        distances: m, of the splits, with 0 first.
        means: m/s, between them.
    """
    there = distances[:-1] >= HELD
    if there.sum() < 2:
        return None
    middles = 0.5 * (distances[1:] + distances[:-1])
    return float(np.polyfit(middles[there], means[there], 1)[0] * (TRACK - HELD))


def fit_profile(athlete: Athlete) -> Profile:
    """Return the smoothest curve from a stand through an athlete's splits: a cubic
    spline, straight at its end."""
    clock = np.array((0.0, *(s - (athlete.reaction or 0.0) for s in athlete.splits)))
    # the first derivative at the start, the second at the end
    ends: Any = ((1, 0.0), (2, 0.0))
    curve = CubicSpline(clock, (0.0, *athlete.distances), bc_type=ends)
    time = np.arange(0.0, clock[-1], STEP)
    return Profile(time, curve(time), curve(time, 1))


# --- Simulated runs -------------------------------------------------------------------


def read_reports(folders: Sequence[Path]) -> tuple[tuple[Athlete, Profile], ...]:
    """Read the races in reports of the sprint benchmark; raises UserError for other
    reports."""
    # slow to import, and mostly not needed
    from bp2_rl.paper.figures.runs import read_runs

    return tuple(
        follow_run(name, run) for name, _, run in read_runs(folders, BENCHMARK)
    )


def follow_run(name: str, run: Trajectory) -> tuple[Athlete, Profile]:
    """Return a simulated run as a race: its splits, and its speed as a running mean
    over `RIPPLE` s."""
    from bp2_rl.evaluation.benchmarks.run import measure_splits

    splits = measure_splits(run)
    along = track_position(run)[0]
    ends = np.clip(
        (run.time - RIPPLE / 2, run.time + RIPPLE / 2), run.time[0], run.time[-1]
    )
    behind, ahead = np.interp(ends, run.time, along)
    distances = tuple(split.distance for split in splits)
    times = tuple(split.time for split in splits)
    arrived = bool(splits) and splits[-1].distance == TRACK
    athlete = Athlete(name, times[-1] if arrived else math.inf, 0.0, distances, times)
    return athlete, Profile(run.time, along, (ahead - behind) / (ends[1] - ends[0]))


# --- The paper's race -----------------------------------------------------------------


def paper_profile() -> Profile:
    """Return BP2's race by the paper's speed and time alone: an exponential rise to
    10.74 m/s, and 100 m after 12.2 s."""
    speed, duration = bp2.OUTDOOR_TOP_SPEED, bp2.SPRINT_100M_TIME

    def missing(T: float) -> float:
        return speed * (duration + T * math.expm1(-duration / T)) - TRACK

    T = float(root_scalar(missing, bracket=(0.01, 100.0), xtol=1e-12).root)
    time = np.linspace(0.0, duration, round(duration / STEP) + 1)
    risen = -np.expm1(-time / T)
    return Profile(time, speed * (time - T * risen), speed * risen)


def check_paper() -> PaperRace:
    """Return the times over the first 5 m that the paper's accelerations imply."""
    constant = {
        name: math.sqrt(2.0 * LAUNCH_DISTANCE / acceleration)
        for name, acceleration in published.PUBLISHED_ACCELERATIONS.items()
    }
    return PaperRace(
        constant_times=constant,
        deficit=constant[races.PAPER_BP2] - constant[races.TRAINED],
        finish_gap=bp2.SPRINT_100M_TIME - races.TRAINED_TIME,
    )


# --- The figure -----------------------------------------------------------------------


@styled
def race_figure(profiles: dict[str, Profile], runs: dict[str, Profile]) -> Figure:
    """Draw speed over distance of BP2 beside the fastest, a trained and untrained
    athletes."""
    figure = Figure(figsize=(1.6 * WIDTH, 4.4), layout="constrained")
    panels = fastest, trained, untrained = figure.subplots(1, 3).tolist()
    ours = paper_profile()
    curves = [
        *((*run, color, "-") for run, color in zip(runs.items(), RUNS, strict=False)),
        ("BP2: exponential, 10.74 m/s, 12.2 s", ours, FALL, DASHES),
    ]
    top = 1.06 * max(p.speed.max() for p in (*profiles.values(), *runs.values(), ours))
    for axes in panels:
        for name, profile, color, dashes in curves:
            (line,) = axes.plot(profile.distance, profile.speed, label=name)
            line.set(color=color, linestyle=dashes, linewidth=1.8)
        axes.set(xlabel="Distance [m]", ylabel="Speed [m/s]", ylim=(0.0, top))
        axes.set_xlim(0.0, TRACK)
    for (name, profile), color in zip(profiles.items(), ATHLETES, strict=False):
        fastest.plot(profile.distance, profile.speed, color=color, label=name)
    _draw_mean(trained, races.TRAINED, races.TRAINED_TIME)
    _draw_mean(untrained, races.UNTRAINED, races.UNTRAINED_TIME)
    titles = (
        "B   Beside the fastest",
        "C   Beside a trained sprinter",
        "D   Beside untrained adults",
    )
    for axes, title in zip(panels, titles, strict=True):
        axes.set_title(title)
        axes.legend(loc="lower right", fontsize=8)
    return figure


def _draw_mean(axes: Axes, name: str, time: float) -> None:
    """Draw the mean speed of a racer without splits."""
    mean = TRACK / time
    label = f"{name}: mean of 100 m, {mean:.2f} m/s"
    axes.axhline(mean, color=INK, linewidth=1.2, linestyle=DOTS, label=label)
