"""How reliably a trajectory is found: many speeds from cold starts, and one trot by each
scheme on finer and finer meshes, judged by `verify`."""

import concurrent.futures
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import get_args

from bp2_rl.base.metric import metric
from bp2_rl.base.processes import spawned
from bp2_rl.optimiser.problem import Problem, Scheme
from bp2_rl.optimiser.solution import Motion, NotSolved, Solution, resample
from bp2_rl.optimiser.verify import StrideSummary, summarise, verify

# --- Cold starts ----------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Attempt:
    """Result of a single solve at one speed from a cold start."""

    speed: float  # m/s
    start: int  # 0 is the cold guess itself, others are varied
    seconds: float  # wall time of the solve
    why: str = ""  # if not solved


def sweep_speeds(
    problem: Problem, speeds: Sequence[float], starts: int, workers: int = 2
) -> Iterator[Attempt]:
    """Solve from every cold start at every speed; yield each attempt as it ends."""
    with spawned(workers) as pool:
        attempts = [
            pool.submit(_attempt, problem.at(speed), start)
            for speed in speeds
            for start in range(starts)
        ]
        for attempt in concurrent.futures.as_completed(attempts):
            yield attempt.result()


def _attempt(problem: Problem, start: int) -> Attempt:
    """Solve a problem from one cold start, and return the attempt."""
    from bp2_rl.optimiser.collocation import cold_guess, solve

    try:
        solution = solve(problem, cold_guess(problem, seed=start or None))
    except NotSolved as failure:
        return Attempt(problem.speed, start, 0.0, str(failure))
    return Attempt(problem.speed, start, solution.seconds)


# --- Schemes --------------------------------------------------------------------------

SCHEMES: tuple[Scheme, ...] = get_args(Scheme)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SchemeRow(StrideSummary):
    """Gait and errors of a solution by one discretisation scheme on one mesh."""

    scheme: Scheme = metric("Scheme", form="s")
    intervals: int = metric("Intervals", form="d")  # of each segment
    # of the positive motor work
    energy_residual: float = metric("Energy residual", form=".2%")
    position_error: float = metric("Position error", "m, rad", ".1e")
    velocity_error: float = metric("Velocity error", "m/s, rad/s", ".1e")


def compare_schemes(
    solve: Callable[[Problem, Motion | None], Solution],
    problem: Problem,
    meshes: Sequence[int] = (8, 16, 32, 64),
    schemes: Sequence[Scheme] = SCHEMES,
) -> Iterator[SchemeRow]:
    """Yield a row for each scheme on each mesh, as soon as it is solved.

    Args:
        solve: such as `collocation.solve`: a problem and a start on its mesh, None for
            a cold one.
        problem: what is asked for; its own scheme and mesh do not matter.
        meshes: intervals a segment, coarsest first: each solve but the first starts
            from the one before.
        schemes: discretisations.

    Raises:
        NotSolved: as `solve` does.
    """
    for scheme in schemes:
        solution = None
        for intervals in meshes:
            on_mesh = dataclasses.replace(problem, scheme=scheme, intervals=intervals)
            start = (
                None
                if solution is None
                else resample(solution.problem, solution.motion, on_mesh)
            )
            solution = solve(on_mesh, start)
            judged = verify(solution)
            yield SchemeRow(
                scheme=scheme,
                intervals=intervals,
                energy_residual=judged["energy_residual"],
                position_error=judged["position_error"],
                velocity_error=judged["velocity_error"],
                **vars(summarise(solution)),
            )
