"""`bp2 trajopt library build`: the reference motions."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from bp2_rl.base.bounds import check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.base.folders import make_folder
from bp2_rl.cli import app
from bp2_rl.cli.trajopt import output
from bp2_rl.cli.trajopt.arguments import OUT, Flat, Folder, Workers
from bp2_rl.cli.trajopt.solutions import save_family
from bp2_rl.optimiser.family import FamilyConfig, build_family, steps_of


@dataclasses.dataclass(frozen=True)
class LibraryArguments:
    """Build the library of reference motions: solve the family, verify it, write the file.

    Interrupted, it goes on where it stopped when run again.
    """

    action: Annotated[Literal["build"], tyro.conf.Positional]
    family: Annotated[FamilyConfig, Flat] = FamilyConfig()
    workers: Workers = 2
    """processes; more than two do not help"""
    out: Folder = OUT / "library"
    """folder of the solutions"""
    to: Annotated[Path, tyro.conf.arg(metavar="FILE")] = OUT / "bp2_trot.npz"
    """the library"""

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self)
        if self.to.suffix != ".npz":
            raise UserError(f"--to {self.to}: a library is an .npz file")


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: _build(app.parse(LibraryArguments, argv, "bp2 trajopt library")))


def _build(arguments: LibraryArguments) -> None:
    """Leave the solutions in their folder and the library in its file."""
    with output.own_folder(arguments.out):
        make_folder(arguments.to.parent)
        with output.progress() as progress:
            task = progress.add_task("speeds", total=len(arguments.family.speeds))
            family = build_family(
                arguments.family,
                arguments.out,
                workers=arguments.workers,
                report=lambda done, total: progress.update(task, completed=done, total=total),
            )
    output.describe(family)
    steps = steps_of(family)
    print(
        f"largest step between neighbours: period {max(abs(step.period) for step in steps):.1%}, "
        f"joint angles {max(step.joints for step in steps):.3f} rad"
    )
    output.judge(family, strict=True)
    save_family(arguments.to, family, arguments.family)
    print(f"library: {arguments.to}")
