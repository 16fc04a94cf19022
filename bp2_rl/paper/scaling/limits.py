"""The greatest speed of a robot's trot by the optimiser, and how far each limit holds
it back."""

import concurrent.futures
import contextlib
import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np

from bp2_rl.base.processes import spawned
from bp2_rl.optimiser.collocation import fastest, solve_best
from bp2_rl.optimiser.family import LIMIT_TIME, MOST_IMPACT, family_of
from bp2_rl.optimiser.problem import Form, Problem
from bp2_rl.optimiser.solution import NotSolved, Solution, resample
from bp2_rl.optimiser.verify import failures, verify
from bp2_rl.paper.trajectories.shadow_prices import (
    Change,
    find_shadow_prices,
    times_fields,
)
from bp2_rl.reference.library.file import load_library
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.settings.reference import CollocationConfig

STARTS = 4.0, 2.5, 1.5
"""Speeds of the trots from which the greatest speed is searched, m/s at BP2's size."""
ENOUGH = 2
"""Number of starting trots that are used, the first that are found."""
COARSE = 8
"""Intervals a segment, at most, of the mesh on which starting trots are solved."""
SPRUNG = 3
"""Factor on the mesh's intervals for robots whose toes swing on springs."""
RISE = bp2.PEAK_TORQUE / Problem().torque_rate
"""Shortest time in which a motor reaches its peak torque, s: BP2's, for every robot."""
CHANGES: dict[str, Change] = {
    "joint speed": times_fields("hardware.corner_speed", "hardware.no_load_speed"),
    "torque": times_fields("hardware.peak_torque"),
    "torque rate": times_fields("torque_rate"),
    "friction": times_fields("hardware.friction"),
    "landing impact": times_fields("form.greatest_impact"),
}
"""Limits that may bind, by name: each a change that multiplies the limit by a
factor."""


@dataclasses.dataclass(frozen=True)
class SpeedLimit:
    """A robot's fastest trot by the optimiser, and how much more each limit would
    gain."""

    speed: float  # m/s
    gains: dict[str, float]  # by limit: d ln speed / d ln limit
    unsound: tuple[str, ...]  # what the verifier objects to

    @property
    def binds(self) -> str:
        """Name of the limit of which 1 % more raises the speed most."""
        return max(self.gains, key=lambda name: self.gains[name])


@dataclasses.dataclass(frozen=True)
class Rules:
    """Mesh and greatest landing impact of the search for robots' greatest speeds."""

    intervals: int = 16  # a segment; `SPRUNG` times as many where there are springs
    greatest_impact: float = MOST_IMPACT  # of the weight, that landings bear

    def problem(self, hardware: HardwareSpec) -> Problem:
        """Return the problem of a robot's trot that may use all that its motors and the
        ground give, and keeps no reserve for feedback."""
        problem = Problem(
            intervals=self.intervals * (SPRUNG if hardware.anatomy.sprung else 1)
        ).sized(hardware)
        rate = float(np.max(hardware.joint_peak_torque)) / RISE
        return dataclasses.replace(
            problem, torque_rate=rate, form=Form(greatest_impact=self.greatest_impact)
        )


@dataclasses.dataclass(frozen=True)
class LimitSearch:
    """A search for the speed limits of robots, by name."""

    robots: dict[str, HardwareSpec]
    rules: Rules


@dataclasses.dataclass(frozen=True)
class SpeedLimits:
    """The speed limits that the optimiser found, by robot; None where it found no
    trot."""

    rules: Rules
    limits: dict[str, SpeedLimit | None]


def search_limits(
    search: LimitSearch, workers: int, begun: SpeedLimits | None = None
) -> Iterator[SpeedLimits]:
    """Search for robots' speed limits in `workers` processes, and yield all limits
    found yet after each new one.

    Limits in `begun` are kept: the same search found them before it was interrupted.
    """
    before = begun.limits if begun else {}
    found = {name: before.get(name) for name in search.robots}
    left = {name: search.robots[name] for name in found if found[name] is None}
    yield SpeedLimits(search.rules, found)
    for name, limit in find_limits(left, search.rules, workers):
        found = found | {name: limit}
        yield SpeedLimits(search.rules, found)


def find_limits(
    robots: Mapping[str, HardwareSpec], rules: Rules, workers: int
) -> Iterator[tuple[str, SpeedLimit]]:
    """Yield robots' names and fastest trots as they are found; a robot without any trot
    is left out."""
    with spawned(workers) as pool:
        searches = {
            pool.submit(find_limit, robot, rules): name
            for name, robot in robots.items()
        }
        for search in concurrent.futures.as_completed(searches):
            with contextlib.suppress(NotSolved):
                yield searches[search], search.result()


def find_limit(hardware: HardwareSpec, rules: Rules) -> SpeedLimit:
    """Return the fastest trot of a robot: the fastest that several starts lead to.

    Raises:
        NotSolved: no start led to a trot.
    """
    problem = rules.problem(hardware)
    coarse = problem.on_mesh(min(COARSE, rules.intervals))
    found = (
        [_fastest_of_library()]
        if hardware.anatomy.sprung
        else _fastest_from_cold(coarse)
    )
    for start in sorted(found, key=lambda solution: -solution.problem.speed):
        with contextlib.suppress(NotSolved):
            return _refine(start, problem.at(start.problem.speed))
    raise NotSolved(f"{hardware.anatomy.name}: no trot was found at any speed")


def _fastest_from_cold(problem: Problem) -> list[Solution]:
    """Return the fastest trots found from trots at several speeds, solved from cold
    starts."""
    found: list[Solution] = []
    for speed in STARTS:
        if len(found) < ENOUGH:
            with contextlib.suppress(NotSolved):
                start = solve_best(
                    problem.at(problem.hardware.size.speed * speed),
                    starts=1,
                    time_limit=LIMIT_TIME,
                )
                found.append(fastest(start))
    return found


def _fastest_of_library() -> Solution:
    """Return the fastest trot of BP2's library, which a search on springs would take
    long to find."""
    library = load_library(CollocationConfig().file)
    return family_of(library.arrays, library.provenance)[-1]


def _refine(start: Solution, problem: Problem) -> SpeedLimit:
    """Return the fastest trot on the mesh of `problem`, searched from the solution
    `start`."""
    near = dataclasses.replace(
        start, problem=problem, motion=resample(start.problem, start.motion, problem)
    )
    priced = find_shadow_prices(near, CHANGES, greatest=True)
    speed = priced.solution.problem.speed
    return SpeedLimit(
        speed,
        gains={name: price / speed for name, price in priced.prices.items()},
        unsound=tuple(failures(verify(priced.solution), exact=False)),
    )
