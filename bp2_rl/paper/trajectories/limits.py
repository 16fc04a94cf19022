"""The greatest speed that the model has a trajectory for, and what it hangs on."""

import concurrent.futures
import dataclasses
from collections.abc import Iterator
from typing import Any

from bp2_rl.base.errors import UserError
from bp2_rl.base.workers import spawned
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.solution import NotSolved, Solution
from bp2_rl.robot.specs import IDEAL, HardwareSpec
from bp2_rl.robot.variants import differing, with_parts

CHANGES: dict[str, dict[str, Any]] = {
    "BP2 as specified": {},
    "straight-line envelope (corner at 0)": {"corner_speed": 0.0},
    "corner at 18 rad/s": {"corner_speed": 18.0},
    "peak torque 100 Nm": {"peak_torque": 100.0},
    "rotor inertia halved": {"rotor_inertia": 1e-4},
    "rotor inertia doubled": {"rotor_inertia": 4e-4},
    "friction 0.6": {"friction": 0.6},
    "friction 1.2": {"friction": 1.2},
    "stops half as stiff": {"spring_stop_stiffness": 15e3, "rebound_stiffness": 15e3},
    "spring travel 0.10 m": {"spring_travel": 0.10},
}  # of the hardware, one at a time
NO_SPEED_LIMIT = "joints faster than no-load"
KNOWN = (
    *("air", "gears", "joint friction", "spring slides", "bus power", "bus sag", "braking limit", "rebound stop"),
    "ground friction",
)
"""The parts of a robot that the model knows."""


@dataclasses.dataclass(frozen=True)
class FastestVariant:
    """A variant at its greatest speed, and the variant it is compared with; None where IPOPT found no trajectory."""

    variant: str
    base: str
    solution: Solution | None


@dataclasses.dataclass(frozen=True)
class GreatestSpeeds:
    """What is left of a search: greatest speed by variant, m/s; None where IPOPT found none."""

    problem: Problem
    speeds: dict[str, float | None]


def greatest_speeds(problem: Problem, workers: int = 2) -> Iterator[FastestVariant]:
    """Yield the greatest speed of the problem's robot, and of robots with one thing changed, as they are found.

    Each is the better of two searches: from the problem's own solution and from one of another speed.
    """
    variants = {name: problem.on(**change) for name, change in CHANGES.items()}
    variants[NO_SPEED_LIMIT] = dataclasses.replace(problem, speed_margin=2.0)
    base = next(iter(variants))
    with spawned(workers) as pool:
        searches = {pool.submit(_search, variant): name for name, variant in variants.items()}
        for search in concurrent.futures.as_completed(searches):
            yield FastestVariant(searches[search], base, _best(search.result()))


def loss_variants(robot: HardwareSpec) -> dict[str, tuple[str, HardwareSpec]]:
    """The robot without any of its losses, that with each alone, the robot itself, and that without each: by name, with
    the name of what to compare it with.

    Raises:
        UserError: the robot loses nothing that the model knows.
    """
    lost = [part for part in differing(robot, IDEAL) if part in KNOWN]
    if not lost:
        raise UserError("--losses: this robot has none; choose --robot built, or set some of --hardware.losses")
    ideal = with_parts(robot, IDEAL, KNOWN)
    alone = {f"ideal + {part}": ("ideal", with_parts(ideal, robot, [part])) for part in lost}
    others = {f"built - {part}": ("built", with_parts(robot, IDEAL, [part])) for part in lost}
    return {"ideal": ("ideal", ideal), **alone, "built": ("ideal", robot), **others}


def losses_one_at_a_time(problem: Problem, workers: int = 2) -> Iterator[FastestVariant]:
    """The greatest speeds of `loss_variants` of the problem's robot, as they are found.

    Of the robot with none and with all of its losses each is the best of several searches; of the others the better of
    two that start from the one of these which is next to them: from its greatest speed and from its first solution.
    """
    variants = {
        name: (base, dataclasses.replace(problem, hardware=robot))
        for name, (base, robot) in loss_variants(problem.hardware).items()
    }
    with spawned(workers) as pool:
        first = {name: pool.submit(_search, variants[name][1]) for name in ("ideal", "built")}
        found = {name: search.result() for name, search in first.items()}
        found["built"] += _spurt(variants["built"][1], _starts(found["ideal"]))
        for name, solutions in found.items():
            yield FastestVariant(name, variants[name][0], _best(solutions))
        searches = {
            pool.submit(_spurt, variant, _starts(found[base])): (name, base)
            for name, (base, variant) in variants.items()
            if name not in found
        }
        for search in concurrent.futures.as_completed(searches):
            yield FastestVariant(*searches[search], _best(search.result()))


def _search(problem: Problem) -> list[Solution]:
    """The fastest solutions that those at two speeds lead to, each followed by the one it came from."""
    from bp2_rl.optimiser.collocation import fastest, solve

    found = []
    for speed in (problem.speed, 0.8 * problem.speed):
        try:
            cruise = solve(problem.at(speed))
            found += [fastest(cruise), cruise]
        except NotSolved:
            continue
    return found


def _spurt(problem: Problem, starts: list[Solution]) -> list[Solution]:
    """The fastest solutions that others' motions lead to."""
    from bp2_rl.optimiser.collocation import fastest

    found = []
    for start in starts:
        try:
            found.append(fastest(dataclasses.replace(start, problem=problem.at(start.problem.speed))))
        except NotSolved:
            continue
    return found


def _starts(found: list[Solution]) -> list[Solution]:
    """The fastest of what `_search` found, and what its first came from."""
    best = _best(found)
    return [] if best is None else [best, *found[1:2]]


def _best(found: list[Solution]) -> Solution | None:
    return max(found, key=lambda solution: solution.problem.speed, default=None)
