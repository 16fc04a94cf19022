"""`bp2 trajopt verify`: the judge's verdict."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.cli import app
from bp2_rl.cli.trajopt import output
from bp2_rl.cli.trajopt.solutions import load_solutions


@dataclasses.dataclass(frozen=True)
class VerifyArguments:
    """Judge solutions by a model that shares no code with the one they were found with."""

    path: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="SOLUTION_OR_LIBRARY")] = None
    """a solution's .json or .npz, a folder of solutions, or a library; by default the library that ships"""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: _verify(app.parse(VerifyArguments, argv, "bp2 trajopt verify")))


def _verify(arguments: VerifyArguments) -> None:
    """Print every figure and its limit; a figure beyond its limit is a user's mistake like any other."""
    solutions = load_solutions(arguments.path)

    from bp2_rl.optimiser.verify import verify

    checked = []
    with output.progress() as progress:
        for solution in progress.track(solutions, description="verifying"):
            checked.append(dataclasses.replace(solution, checks=verify(solution)))
    output.describe(checked)
    output.judge(checked, strict=True)
