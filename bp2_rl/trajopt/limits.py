"""The greatest speed that the model has a trajectory for, and what it hangs on."""

import concurrent.futures
import dataclasses
from collections.abc import Iterator
from typing import Any

from bp2_rl.trajopt.problem import Problem
from bp2_rl.trajopt.solution import NotSolved, Solution
from bp2_rl.workers import spawned

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


@dataclasses.dataclass(frozen=True)
class Limit:
    """The greatest speed of one variant; None where IPOPT found none."""

    variant: str
    solution: Solution | None


def greatest_speeds(problem: Problem, workers: int = 2) -> Iterator[Limit]:
    """Of the problem's robot, and with one thing changed at a time, as they are found.

    Each is the better of two searches: from the problem's own solution and from one of another speed.
    """
    variants = {name: problem.on(**change) for name, change in CHANGES.items()}
    variants[NO_SPEED_LIMIT] = dataclasses.replace(problem, speed_margin=2.0)
    with spawned(workers) as pool:
        searches = {pool.submit(_search, variant): name for name, variant in variants.items()}
        for search in concurrent.futures.as_completed(searches):
            yield Limit(searches[search], search.result())


def _search(problem: Problem) -> Solution | None:
    from bp2_rl.trajopt.collocation import fastest, solve

    found = []
    for speed in (problem.speed, 0.8 * problem.speed):
        try:
            found.append(fastest(solve(problem.at(speed))))
        except NotSolved:
            continue
    return max(found, key=lambda solution: solution.problem.speed, default=None)
