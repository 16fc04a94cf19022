"""A trot by each discretisation scheme on finer and finer meshes, judged by
`verify`."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import get_args

from bp2_rl.base.metric import metric
from bp2_rl.optimiser.problem import Problem, Scheme
from bp2_rl.optimiser.solution import Motion, Solution, resample
from bp2_rl.optimiser.verify import StrideSummary, summarise, verify

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
