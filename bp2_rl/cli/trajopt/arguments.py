"""What several of the commands are told."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro

from bp2_rl.base.bounds import Within
from bp2_rl.cli import app
from bp2_rl.robot.named import find_robot
from bp2_rl.settings.training import RobotChoice

Command = TypeVar("Command")

OUT = Path("reports/trajopt")
Flat = tyro.conf.arg(name="")
Folder = Annotated[Path, tyro.conf.arg(metavar="DIR")]
Workers = Annotated[int, Within(1, 256)]
Robot = Annotated[
    RobotChoice,
    tyro.conf.arg(
        help="whose hardware holds where no --hardware flag says otherwise; the model in the plane has no solid legs, "
        "no soft ground, no lag and no latency"
    ),
]


@dataclasses.dataclass(frozen=True)
class _Named:
    robot: Robot = "ideal"


def named_robot(argv: Sequence[str] | None, prog: str) -> str:
    """Return what `--robot` names, whatever else is on the command line."""
    return app.parse(_Named, argv, prog, part=True).robot


def parse_on_robot(
    arguments: type[Command], argv: Sequence[str] | None, prog: str
) -> Command:
    """The arguments of a command with a `problem`, on the robot that `--robot` names
    where no flag says otherwise."""
    default: Any = arguments()
    problem = default.problem.sized(find_robot(named_robot(argv, prog)))
    return app.parse(
        arguments, argv, prog, dataclasses.replace(default, problem=problem)
    )
