"""`bp2 trajopt figures`: the paper's figures."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.bounds import check_bounds
from bp2_rl.cli import app
from bp2_rl.cli.trajopt.arguments import OUT, Folder
from bp2_rl.cli.trajopt.solutions import load_solutions
from bp2_rl.errors import UserError
from bp2_rl.folders import make_folder
from bp2_rl.trajopt.problem import Speed


@dataclasses.dataclass(frozen=True)
class Arguments:
    """Draw the paper's figures of a family of trajectories: force decomposition, one stride, the family over speed."""

    path: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="SWEEP_OR_LIBRARY")] = None
    """a folder of solutions or a library; by default the library that ships"""
    speed: Speed = 10.0
    """of the stride that is drawn, m/s"""
    out: Folder = OUT / "figures"

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self)


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: _figures(app.parse(Arguments, argv, "bp2 trajopt figures")))


def _figures(arguments: Arguments) -> None:
    """Draw them and print what the decomposition says."""
    solutions = load_solutions(arguments.path)
    shown = min(solutions, key=lambda solution: abs(solution.problem.speed - arguments.speed))
    if abs(shown.problem.speed - arguments.speed) > 0.01:
        speeds = ", ".join(f"{solution.problem.speed:g}" for solution in solutions)
        raise UserError(f"--speed {arguments.speed:g}: there are only {speeds} m/s")
    make_folder(arguments.out)

    from bp2_rl.plotting import save_figure
    from bp2_rl.trajopt import decomposition
    from bp2_rl.trajopt.figures.decomposition import decomposition_figure
    from bp2_rl.trajopt.figures.family import family_figure
    from bp2_rl.trajopt.figures.trajectory import trajectory_figure

    terms, trends = decomposition.decompose(shown), decomposition.find_trends(solutions)
    for name, figure in (
        ("decomposition", decomposition_figure(terms, trends)),
        ("trajectory", trajectory_figure(shown)),
        ("family", family_figure(solutions)),
    ):
        save_figure(figure, arguments.out / f"{name}.png")
    print(f"at {shown.problem.speed:g} m/s, closure of the equations of motion: {terms.closure:.1e} N or Nm")
    print(f"C_z / (m g) at its peak: {decomposition.peak_velocity_force(terms):.2f}")
    coupling = decomposition.coupling_opposes(terms)
    print(
        f"coupled inertia opposes main inertia at {coupling.opposing:.0%} of the hips' peaks and covers "
        f"{coupling.covered:.0%} of it"
    )
    for line in decomposition.remarks(trends):
        print(line)
    print(f"figures: {arguments.out}")
