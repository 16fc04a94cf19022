"""Solve a smooth family of trajectories over speed: the library that serves as
reference motion.

At each speed alone, neighbouring optima can differ by a lot: below 9 m/s several
families of nearly equal cost exist, with other postures, periods and springs that
bounce in swing. The library follows one of them. It begins with the best trajectory at
the anchor's speed and walks from there to both ends, each step from its neighbour and,
by a term beside the cost, near to it. What that costs is in the provenance: `cost` is
without the term.

A fast trot slowed down like that goes on flying: at 0.5 m/s it hopped on straight legs
with its feet at its belly. So the slow end is asked for the form of a slow trot as
well, by limits that grow tighter from a speed on downwards.

The motions leave feedback something to work with: a tenth of the motors' torque and
speed, and some friction.

`reference.library.file` writes and reads library files; this module converts a family
to arrays and provenance, and back.
"""

import concurrent.futures
import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float, Int

from bp2_rl.base import serialization as config
from bp2_rl.base.bounds import Bounded, Range, Within, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.base.processes import spawned
from bp2_rl.optimiser.cycle import center_of_mass
from bp2_rl.optimiser.links import hip_of, leg_of
from bp2_rl.optimiser.problem import (
    MOST_SPEEDS,
    PER_LEG,
    SOLVE_TIME,
    TRUNK,
    Form,
    Intervals,
    Problem,
    Speed,
    SpeedStep,
    Starts,
    per_leg,
)
from bp2_rl.optimiser.solution import (
    ARRAYS,
    Motion,
    NotSolved,
    Solution,
    SolveStatistics,
    array_specs,
    is_saved,
    load_solution,
    save_solution,
    speed_name,
    versions,
)
from bp2_rl.robot import bp2
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.hardware import IDEAL, HardwareSpec, times

MOST_IMPACT = 0.16
"""Most of the weight's impulse that landings may bear in the library of a robot other
than BP2: as in BP2's own at 15 m/s. A model without soft ground would let rigid legs
run on impacts alone, which cost nothing."""
MESH = 24
"""Intervals of each segment in another robot's library, with which its energy closes to
some 1e-4."""
LIMIT_TIME = 40.0
"""Time limit of a solve, s, where nobody knows what the robot can; from a neighbour's
solution a few seconds are enough."""


def reserved(hardware: HardwareSpec) -> HardwareSpec:
    """Return a robot without the torque and friction that a library leaves to feedback;
    the speed margin is in `FamilyConfig.problem`."""
    friction = round(hardware.friction * 0.7 / 0.9, 9)
    return dataclasses.replace(
        hardware, peak_torque=times(0.9, hardware.peak_torque), friction=friction
    )


@dataclasses.dataclass(frozen=True)
class Limits(Form):
    """Limits on a trot at one speed; numbers are for BP2 and scale with the robot's
    size."""

    # these three as the problem's, if they are tighter
    pitch_limit: Annotated[float, Within(0.001, 1.5)] = 1.5
    speed_margin: Annotated[float, Within(0.01, 10.0)] = 10.0
    torque_rate: Annotated[float, Within(1.0, 1e9)] = 1e9

    def on(self, problem: Problem) -> Problem:
        """Return a problem with these limits, scaled to its robot's size."""
        hardware, size = problem.hardware, problem.hardware.size
        # of a changed BP2, too, whose size is 1
        length = hardware.anatomy.leg_length / bp2.THIGH_LENGTH
        form = Form(
            least_duty=self.least_duty,
            longest_period=size.time * self.longest_period,
            highest_trunk=length * self.highest_trunk,
            highest_step=length * self.highest_step,
            hardest_landing=size.speed * self.hardest_landing,
            fastest_release=size.speed * self.fastest_release,
            greatest_share=min(self.greatest_share + _uneven(hardware), 1.0),
            greatest_impact=min(self.greatest_impact, problem.form.greatest_impact),
        )
        rate = size.torque / size.time * self.torque_rate
        if not hardware.anatomy.sprung:
            rate = math.inf
        return dataclasses.replace(
            problem,
            form=form,
            pitch_limit=min(self.pitch_limit, problem.pitch_limit),
            speed_margin=min(self.speed_margin, problem.speed_margin),
            torque_rate=min(rate, problem.torque_rate),
        )


def _uneven(hardware: HardwareSpec) -> float:
    """Return the share of the weight, beyond a half, that the fore or the hind legs
    bear when they hang straight."""
    fore, hind = (hip_of(leg_of(hardware.anatomy, end))[0] for end in ("F", "H"))
    coordinates = np.zeros(TRUNK + per_leg(hardware) * len(LEGS))
    return abs(
        float(center_of_mass(coordinates, LEGS, hardware)[0]) - (fore + hind) / 2.0
    ) / (fore - hind)


@dataclasses.dataclass(frozen=True)
class SlowEnd(Bounded, path="slow."):
    """Limits on the form of slow trots, along straight lines between two speeds; faster
    trots have none.

    All ASSUMED: at the upper speed nearly what the motion there has anyway; at the
    lower one and below, a trot that a robot can fall into from standing at 0.56 m with
    its feet below its hips.
    """

    speeds: Annotated[Range, Within(0.01, 100.0)] = (1.0, 5.0)  # m/s
    lower: Limits = Limits(
        least_duty=0.48,  # a file's strides have a flight: 10 ms of it
        longest_period=0.44,
        highest_trunk=0.57,
        highest_step=0.10,
        hardest_landing=1.0,
        greatest_share=0.54,
        pitch_limit=0.02,
        speed_margin=0.5,
        torque_rate=1e3,  # legs at leisure swing their toes to and fro on the springs
    )
    upper: Limits = Limits(
        least_duty=0.26,
        longest_period=0.384,
        highest_trunk=0.629,
        highest_step=0.355,
        hardest_landing=5.6,
        greatest_share=0.56,
        pitch_limit=0.033,
        speed_margin=0.9,
        torque_rate=6e3,
    )
    # as the family's, of trots that have to change
    proximity: Annotated[float, Within(0.0, 1e6)] = 1.0

    def holds(self, problem: Problem) -> bool:
        """Return whether a problem asks for a slow trot."""
        return problem.speed < problem.hardware.size.speed * self.speeds[1]

    def limit(self, problem: Problem) -> Problem:
        """Return a problem with the limits on form at its speed."""
        if not self.holds(problem):
            return problem
        speed = problem.speed / problem.hardware.size.speed
        limits = {
            name: float(
                np.interp(speed, self.speeds, (slow, getattr(self.upper, name)))
            )
            for name, slow in vars(self.lower).items()
        }
        return Limits(**limits).on(problem)


@dataclasses.dataclass(frozen=True)
class FamilyConfig:
    """Speeds of a library's trots, and how they are solved, each from its neighbour."""

    slowest: Speed = 0.5  # m/s
    fastest: Speed | None = 15.0  # m/s; None: the robot's limit
    step: SpeedStep = 0.5  # m/s
    anchor: Speed = 10.0  # m/s, where the walk begins
    starts: Starts = 3  # guesses at the anchor
    coarse: Intervals = 8  # intervals a segment, for those
    # weight of staying near the neighbour
    proximity: Annotated[float, Within(0.0, 1e6)] = 10.0
    problem: Problem = Problem(intervals=40, hardware=reserved(IDEAL), speed_margin=0.9)
    """the problem at all speeds, but for `slow`"""
    slow: SlowEnd = SlowEnd()

    def __post_init__(self) -> None:
        """Refuse impossible values with a line that names the field."""
        check_bounds(self)
        if not self.slowest <= self.anchor <= self.ends[1]:
            raise UserError(
                f"slowest ({self.slowest}), anchor ({self.anchor}) and fastest ({self.fastest}) must be in this order"
            )
        if (self.ends[1] - self.slowest) / self.step > MOST_SPEEDS:
            raise UserError(
                f"step ({self.step}) makes more than {MOST_SPEEDS} speeds: choose a longer one"
            )
        if self.problem.stride.cycles != 0.5:
            raise UserError(
                "the library is of trots, as left and right change places after half a cycle"
            )

    @classmethod
    def on(cls, hardware: HardwareSpec) -> "FamilyConfig":
        """Return the settings of a robot's family: BP2's, or by dynamic similarity from
        slow trots to the robot's limit."""
        bp2s = cls()
        if hardware.is_bp2:
            return dataclasses.replace(
                bp2s,
                problem=dataclasses.replace(bp2s.problem, hardware=reserved(hardware)),
            )
        slowest, step, anchor = (
            round(hardware.size.speed * speed, 2) for speed in (bp2s.slowest, 0.4, 4.0)
        )
        problem = dataclasses.replace(
            bp2s.problem.sized(reserved(hardware)),
            intervals=MESH,
            form=Form(greatest_impact=MOST_IMPACT),
        )
        return dataclasses.replace(
            bp2s,
            slowest=slowest,
            fastest=None,
            step=step,
            anchor=anchor,
            problem=problem,
        )

    @property
    def to_limit(self) -> bool:
        """Return whether the family goes on to the fastest trot that is found."""
        return self.fastest is None

    @property
    def time_limit(self) -> float:
        """Time limit of a solve, s of a processor's time."""
        return LIMIT_TIME if self.to_limit else SOLVE_TIME

    def at(self, speed: float) -> Problem:
        """Return the trajectory problem at a speed, m/s."""
        return self.slow.limit(self.problem.at(speed))

    @property
    def ends(self) -> tuple[float, float]:
        """The speeds to which the walks from the anchor go, m/s; the upper one is the
        anchor's where the fastest is not known."""
        return self.slowest, self.anchor if self.fastest is None else self.fastest

    @property
    def speeds(self) -> list[float]:
        """All speeds that the settings ask for, ascending, m/s."""
        return sorted({speed for end in self.ends for speed in self.walk(end)})

    def walk(self, end: float) -> list[float]:
        """Return the speeds from the anchor to one end, both included, m/s."""
        # the last step may be shorter
        count = round(abs(end - self.anchor) / self.step + 0.4999)
        steps = [
            self.anchor + (1 if end > self.anchor else -1) * self.step * i
            for i in range(count)
        ]
        return [round(speed, 9) for speed in [*steps, end]]


# --- Building -------------------------------------------------------------------------


def build_family(
    settings: FamilyConfig,
    folder: Path,
    *,
    workers: int = 2,
    report: Callable[[int, int | None], None] | None = None,
) -> list[Solution]:
    """Solve and verify a family of trots, with a file for each speed in `folder`;
    speeds that are there already are kept.

    Args:
        settings: which family. With no fastest speed it ends where no faster trot is
            found, and has the trots alone that the verifier accepts.
        folder: of the solutions; made if need be. One that holds a family of other
            settings is refused.
        workers: processes; the two walks are independent, so a third has nothing to do.
        report: called with (speeds done, speeds in all, if that is known) now and then.

    Returns:
        The solutions, slowest first, each with verify's figures as its checks.

    Raises:
        NotSolved: IPOPT found no way on, even by smaller steps.
        UserError: the folder belongs to another family.
    """
    config.claim_folder(folder, "family.json", settings, "a family")
    asked = None if settings.to_limit else len(settings.speeds)
    with spawned(min(workers, 2)) as pool:
        _solve_anchor(settings, folder)
        walks = [
            pool.submit(_walk, settings, folder, settings.walk(end))
            for end in settings.ends
        ]
        if settings.to_limit:
            walks.append(pool.submit(_climb, settings, folder))
        while True:
            waiting = concurrent.futures.wait(
                walks, timeout=0.5, return_when="FIRST_EXCEPTION"
            )
            if report is not None:
                report(sum(1 for _ in folder.glob("speed-*.json")), asked)
            if not waiting.not_done or any(walk.exception() for walk in waiting.done):
                break
    found = {s.problem.speed: s for walk in walks for s in walk.result()}
    family = [found[speed] for speed in sorted(found)]
    return [s for s in family if _sound(s)] if settings.to_limit else family


def _kept(
    settings: FamilyConfig,
    folder: Path,
    speed: float,
    find: Callable[[], Solution],
    *,
    sound: bool = False,
) -> Solution:
    """Return a speed's solution in a folder; find, verify and save the solution first
    if need be.

    Raises:
        NotSolved: `find` does not solve it, or it is not sound and must be.
    """
    path = folder / speed_name(speed)
    if not is_saved(path):
        # MuJoCo only where something is verified
        from bp2_rl.optimiser.verify import verify

        solution = find()
        solution = dataclasses.replace(solution, checks=verify(solution))
        if sound and not _sound(solution):
            raise NotSolved(f"the trot of {speed} m/s is not sound")
        save_solution(path, solution)
    return load_solution(path, settings.at(speed))


def _solve_anchor(settings: FamilyConfig, folder: Path) -> Solution:
    """Return the solution at the anchor's speed, from which all others are reached: the
    best of several guesses."""

    def find() -> Solution:
        # CasADi only where something is solved
        from bp2_rl.optimiser.collocation import refine, solve_best
        from bp2_rl.optimiser.transcription import SolveOptions

        problem, limit = settings.at(settings.anchor), settings.time_limit
        near = SolveOptions(
            proximity=settings.proximity if settings.to_limit else 0.0, time_limit=limit
        )
        coarse = problem.on_mesh(min(settings.coarse, problem.intervals))
        best = solve_best(coarse, settings.starts, time_limit=limit)
        if settings.to_limit:
            # who knows how good the coarse mesh is for this robot
            best = refine(best, (coarse.intervals + problem.intervals) // 2, near)
        return refine(best, problem.intervals, near)

    return _kept(settings, folder, settings.anchor, find)


def _walk(settings: FamilyConfig, folder: Path, speeds: list[float]) -> list[Solution]:
    """Solve the trots of some speeds in turn, each from the one before, and return the
    solutions."""

    def step(here: Solution, speed: float, halvings: int) -> Solution:
        try:
            return _solve_from(settings, here, speed)
        except NotSolved:
            if halvings == 0:
                raise
        between = step(here, (here.problem.speed + speed) / 2.0, halvings - 1)
        return step(between, speed, halvings - 1)

    walked = [_solve_anchor(settings, folder)]
    for speed in speeds[1:]:
        onward = functools.partial(step, walked[-1], speed, halvings=2)
        walked.append(_kept(settings, folder, speed, onward))
    return walked


def _climb(settings: FamilyConfig, folder: Path) -> list[Solution]:
    """Solve faster and faster trots from the anchor on, by smaller steps in the end,
    until none is found; return them."""
    climbed, step = [_solve_anchor(settings, folder)], settings.step
    while step > settings.step / 5.0:
        speed = round(climbed[-1].problem.speed + step, 9)
        faster = functools.partial(_solve_from, settings, climbed[-1], speed)
        try:
            climbed.append(_kept(settings, folder, speed, faster, sound=True))
        except NotSolved:
            step /= 2.0
    return climbed


def _sound(solution: Solution) -> bool:
    from bp2_rl.optimiser.verify import failures

    return not failures(solution.checks, exact=False)


def _solve_from(settings: FamilyConfig, here: Solution, speed: float) -> Solution:
    """Solve the trot of a speed, starting from a neighbour's solution `here` and
    staying near to it."""
    from bp2_rl.optimiser.collocation import solve
    from bp2_rl.optimiser.transcription import SolveOptions

    problem = settings.at(speed)
    proximity = (
        settings.slow.proximity if settings.slow.holds(problem) else settings.proximity
    )
    options = SolveOptions(
        proximity=proximity,
        time_limit=settings.time_limit,
        perhaps_infeasible=settings.to_limit,
    )
    return solve(problem, here.motion, options)


# --- As arrays ------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Provenance:
    """Origin of a library: settings, robot, statistics of the solves, and versions."""

    settings: FamilyConfig
    robot: str = IDEAL.anatomy.name  # that of the libraries of BP2 that ship
    solutions: tuple[SolveStatistics, ...]  # by speed
    versions: dict[str, str]
    schema: str


def arrays_of(family: list[Solution]) -> dict[str, Float[np.ndarray, "..."]]:
    """Return a family as arrays: the speeds (m/s) and, with a first axis over speeds,
    the motions' arrays.

    Every leg has three coordinates: the spring of a rigid shank is zero.
    """
    motions = {
        name: np.stack([getattr(solution.motion, name) for solution in family])
        for name in ARRAYS
    }
    rigid = ~np.isin(
        np.arange(TRUNK + PER_LEG * len(LEGS)), _coordinates(family[0].problem)
    )
    for name in "qva":
        full = np.zeros((*motions[name].shape[:-1], len(rigid)))
        full[..., ~rigid] = motions[name]
        motions[name] = full
    return {
        "speeds": np.array([solution.problem.speed for solution in family]),
        **motions,
    }


def _coordinates(problem: Problem) -> Int[np.ndarray, " nq"]:
    """Return the indices of a problem's coordinates among a library's."""
    of_legs = TRUNK + np.arange(PER_LEG * len(LEGS)).reshape(len(LEGS), PER_LEG)
    had = of_legs[:, : problem.stride.per_leg].ravel()
    return np.concatenate([np.arange(TRUNK), had])


def provenance_of(family: list[Solution], settings: FamilyConfig) -> dict[str, Any]:
    """Return the origin of a family (settings, robot, statistics, versions) as a JSON
    object."""
    schema = (
        "axes: speed, segment of half a gait cycle, point (equally spaced in time), then coordinate. See "
        "bp2_rl/reference/library/file.py."
    )
    statistics = tuple(solution.statistics for solution in family)
    return config.to_json(
        _Provenance(
            settings=settings,
            robot=settings.problem.hardware.anatomy.name,
            solutions=statistics,
            versions=versions(),
            schema=schema,
        )
    )


def family_of(
    arrays: Mapping[str, Float[np.ndarray, "..."]], provenance: Any
) -> list[Solution]:
    """Return the family of solutions that a library's arrays and provenance describe.

    Raises:
        UserError: one line that says what does not fit.
    """
    origin = config.from_json(_Provenance, provenance)
    if len(origin.solutions) != len(arrays["speeds"]):
        raise UserError(
            f"{len(arrays['speeds'])} speeds, and statistics of {len(origin.solutions)}"
        )
    ours = _coordinates(origin.settings.problem)
    arrays = {
        name: array[..., ours] if name in ("q", "v", "a") else array
        for name, array in arrays.items()
    }
    for name, spec in array_specs(origin.settings.problem).items():
        if arrays[name].shape[1:] != spec.shape:
            raise UserError(
                f"{name} is {list(arrays[name].shape[1:])} at each speed, its settings say {spec.shape}"
            )
    return [
        Solution(
            problem=origin.settings.at(float(speed)),
            motion=Motion(**{name: arrays[name][i] for name in ARRAYS}),
            **vars(statistics),
        )
        for i, (speed, statistics) in enumerate(
            zip(arrays["speeds"], origin.solutions, strict=True)
        )
    ]


# --- How smooth it is -----------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Steps:
    """Difference between two neighbouring trots of a family."""

    speed: float  # m/s, of the faster
    period: float  # relative change
    joints: float  # rad, root mean square over phase, of the joint that changes most


def steps_of(family: list[Solution]) -> list[Steps]:
    """Measure how each trot of a family differs from the next slower one."""
    steps: list[Steps] = []
    for slower, faster in itertools.pairwise(family):
        away = (faster.motion.q - slower.motion.q)[..., slower.problem.stride.motors]
        durations = np.array([s.motion.durations for s in (slower, faster)])
        share = np.mean(durations / np.sum(durations, axis=1, keepdims=True), axis=0)
        joints = float(np.sqrt(np.max(np.mean(away**2, axis=1).T @ share)))
        period = faster.period / slower.period - 1.0
        steps.append(Steps(faster.problem.speed, period, joints))
    return steps
