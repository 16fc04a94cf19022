"""`bp2 robot`: write a robot file from an MJCF or URDF model, and check one."""

import dataclasses
import functools
import os
from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.base.errors import UserError
from bp2_rl.cli.app import Command, choose, entries


@dataclasses.dataclass(frozen=True)
class NewConfig(Bounded, path="--"):
    """Write a robot file, filled in from an MJCF or URDF, with CONFIRM beside each
    number that you must confirm.

    The model must have a trunk and four legs with abduction, hip and knee joints, which
    are found by their axes and positions. Meshes may be missing.

    For example: bp2 robot new my_robot.xml
    """

    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL.xml")]
    """An MJCF or URDF file; it stays where it is, and the robot file points at it."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="ROBOT.toml")] = None
    """The robot file; by default beside the model, with the model's name. An existing
    file is not replaced."""
    numbers: bool = False
    """Write all numbers, those of the left legs for both sides, instead of a link to the
    model."""
    joints: Annotated[tuple[str, ...], tyro.conf.arg(metavar="JOINT ...")] = ()
    """The twelve leg joints, FR FL RR RL x abad hip knee, if they are not found
    automatically; all other joints are welded."""
    feet: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """A geom, site or body in each foot, FR FL RR RL; by default the farthest sphere or
    capsule end of the leg."""
    foot_radius: Annotated[float | None, Within(0.0, 1.0, open_below=True)] = None
    """Radius of the feet, m, if they are not spheres."""


@dataclasses.dataclass(frozen=True)
class CheckConfig:
    """Print a robot's data sheet, with problems marked by "!", and draw the robot after
    5 s of standing in C MuJoCo.

    For example: bp2 robot check my_robot.toml
    """

    robot: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME_OR_FILE")]
    """Name of a shipped robot, or a robot file."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="PICTURE.png")] = None
    """The picture; by default ROBOT.png in the current folder."""


def new(config: NewConfig) -> None:
    """Write a robot file from an MJCF or URDF model."""
    from bp2_rl.base.files import require_name, write_text

    out = config.model.with_suffix(".toml") if config.out is None else config.out
    require_name(out)
    if out.exists():
        raise UserError(
            f"{out} exists already: remove it, or choose another name with --out"
        )
    if out.suffix != ".toml" or not out.parent.is_dir():
        raise UserError(
            f"--out {out} must be a name that ends in .toml, in a folder that exists"
        )
    from bp2_rl.robot.reading import read_mjcf
    from bp2_rl.robot.robot_file import robot_text

    reading = read_mjcf(
        config.model,
        joints=config.joints,
        feet=config.feet,
        foot_radius=config.foot_radius,
    )
    mjcf = None if config.numbers else os.path.relpath(config.model, out.parent)
    write_text(
        out,
        robot_text(
            reading,
            mjcf,
            joints=config.joints,
            feet=config.feet,
            foot_radius=config.foot_radius,
        ),
    )
    print(f"{out}: confirm the numbers marked CONFIRM, then: bp2 robot check {out}")


def check(config: CheckConfig) -> None:
    """Print a robot's data sheet and save a drawing of the robot."""
    from bp2_rl.base.files import require_name

    out = Path(f"{Path(config.robot).stem}.png") if config.out is None else config.out
    require_name(out)
    if (
        out.suffix not in (".png", ".pdf", ".svg")
        or not out.parent.is_dir()
        or out.is_dir()
    ):
        raise UserError(
            f"--out {out} must be a name that ends in .png, .pdf or .svg, in a folder that exists"
        )
    from bp2_rl.robot.named import find_robot_file

    robot = find_robot_file(config.robot)
    from bp2_rl.base.plotting import save_figure
    from bp2_rl.robot.sheet import draw_robot, sheet, stand

    print(sheet(robot, stand(robot)))
    save_figure(draw_robot(robot.hardware), out)
    print(f"picture: {out}")


COMMANDS = {
    "new": Command("bp2 robot new", NewConfig, new),
    "check": Command("bp2 robot check", CheckConfig, check),
}

main = functools.partial(choose, "bp2 robot", entries(COMMANDS))
