"""What a discretisation costs: one trot solved by each scheme on finer and finer
meshes, and judged by `verify`."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import get_args

from rich.table import Table

from bp2_rl.optimiser.problem import Problem, Scheme
from bp2_rl.optimiser.solution import Motion, Solution, resample
from bp2_rl.optimiser.verify import summarise, verify

SCHEMES: tuple[Scheme, ...] = get_args(Scheme)
COLUMNS = {
    "energy_residual": ("energy residual", "{:.2%}"),
    "position_error": ("position error [m, rad]", "{:.1e}"),
    "velocity_error": ("velocity error [m/s, rad/s]", "{:.1e}"),
    "period": ("period [s]", "{:.3f}"),
    "duty": ("duty", "{:.3f}"),
    "peak_torque": ("peak torque [Nm]", "{:.1f}"),
    "peak_force": ("peak force [N]", "{:.0f}"),
}  # figure -> its heading and format


@dataclasses.dataclass(frozen=True)
class SchemeRow:
    """One solve."""

    scheme: Scheme
    intervals: int  # of each segment
    figures: dict[str, float]  # of `verify` and `summarise`


def compare_schemes(
    solve: Callable[[Problem, Motion | None], Solution],
    problem: Problem,
    meshes: Sequence[int] = (8, 16, 32, 64),
    schemes: Sequence[Scheme] = SCHEMES,
) -> Iterator[SchemeRow]:
    """A row for each scheme on each mesh, as soon as it is solved.

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
            yield SchemeRow(
                scheme, intervals, verify(solution) | vars(summarise(solution))
            )


def tabulate_schemes(rows: Sequence[SchemeRow]) -> Table:
    """The rows for a console."""
    table = Table("scheme", "intervals", *(heading for heading, _ in COLUMNS.values()))
    for row in rows:
        figures = [
            form.format(row.figures[name]) for name, (_, form) in COLUMNS.items()
        ]
        table.add_row(row.scheme, str(row.intervals), *figures)
    return table
