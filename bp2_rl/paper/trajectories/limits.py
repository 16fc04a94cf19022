"""The greatest speed at which a robot has a trajectory, and how it depends on hardware
and losses."""

import concurrent.futures
import contextlib
import dataclasses
from collections.abc import Iterator, Mapping

from bp2_rl.base.processes import spawned
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.solution import NotSolved, Solution
from bp2_rl.paper.trajectories.variants import ProblemVariant

FastestVariant = tuple[str, float | None]
"""Name and greatest speed of a variant, m/s; None where IPOPT found no trajectory."""


@dataclasses.dataclass(frozen=True)
class GreatestSpeeds:
    """The greatest speeds of all variants, m/s; None where IPOPT found none."""

    problem: Problem
    speeds: dict[str, float | None]


def greatest_speeds(
    variants: Mapping[str, ProblemVariant], workers: int = 2
) -> Iterator[FastestVariant]:
    """Yield the greatest speeds of variants as they are found.

    Each is the better of two searches: from the problem's own solution and from one of
    another speed.
    """
    with spawned(workers) as pool:
        searches = {
            pool.submit(_search, variant.problem): name
            for name, variant in variants.items()
        }
        for search in concurrent.futures.as_completed(searches):
            yield searches[search], _greatest(search.result())


def greatest_speeds_by_loss(
    variants: Mapping[str, ProblemVariant], workers: int = 2
) -> Iterator[FastestVariant]:
    """Yield the greatest speeds of `loss_variants`, as they are found.

    For the robot with none and with all of its losses each is the best of several
    searches; for the others it is the better of two that start from the one of these
    which is next to them: from its greatest speed and from its first solution.
    """
    with spawned(workers) as pool:
        first = {
            name: pool.submit(_search, variants[name].problem)
            for name in ("ideal", "built")
        }
        found = {name: search.result() for name, search in first.items()}
        found["built"] += _fastest_from(
            variants["built"].problem, _starts(found["ideal"])
        )
        for name, solutions in found.items():
            yield name, _greatest(solutions)
        searches = {
            pool.submit(
                _fastest_from, variant.problem, _starts(found[variant.base])
            ): name
            for name, variant in variants.items()
            if name not in found
        }
        for search in concurrent.futures.as_completed(searches):
            yield searches[search], _greatest(search.result())


def _search(problem: Problem) -> list[Solution]:
    """Return the fastest solutions found from solutions at two speeds, each followed by
    its start."""
    from bp2_rl.optimiser.collocation import fastest, solve

    found: list[Solution] = []
    for speed in (problem.speed, 0.8 * problem.speed):
        with contextlib.suppress(NotSolved):
            cruise = solve(problem.at(speed))
            found += [fastest(cruise), cruise]
    return found


def _fastest_from(problem: Problem, starts: list[Solution]) -> list[Solution]:
    """Return the fastest solutions of `problem` found from solutions of other
    problems."""
    from bp2_rl.optimiser.collocation import fastest

    found: list[Solution] = []
    for start in starts:
        with contextlib.suppress(NotSolved):
            found.append(
                fastest(
                    dataclasses.replace(start, problem=problem.at(start.problem.speed))
                )
            )
    return found


def _starts(found: list[Solution]) -> list[Solution]:
    """Return the fastest solution that `_search` found, and the start of its first."""
    fastest = sorted(found, key=lambda solution: -solution.problem.speed)[:1]
    return [*fastest, *found[1:2]]


def _greatest(found: list[Solution]) -> float | None:
    return max((solution.problem.speed for solution in found), default=None)
