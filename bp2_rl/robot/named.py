"""Robots by name: BP2's own, those that ship as robot files, and any other robot by the
path of its file."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError, require_one_of
from bp2_rl.robot.hardware import ROBOTS, HardwareSpec

if TYPE_CHECKING:
    from bp2_rl.robot.robot_file import RobotFile


def shipped_files() -> dict[str, Path]:
    """Return the robot files that ship, by the robots' names."""
    return {path.stem: path for path in sorted(asset_path("robots").glob("*.toml"))}


def robot_names() -> tuple[str, ...]:
    """Return the names that `find_robot` takes."""
    return (*ROBOTS, *shipped_files())


def find_robot(name: str) -> HardwareSpec:
    """Return the hardware of the robot of this name, or of the robot file at this path.

    Raises:
        UserError: there is no such robot, or its file is broken.
    """
    return ROBOTS[name] if name in ROBOTS else find_robot_file(name).hardware


def find_robot_file(name: str) -> "RobotFile":
    """Return the content of the robot file of this name, or at this path; of BP2's own
    robots, their hardware alone.

    Raises:
        UserError: as `find_robot`.
    """
    path = shipped_files().get(name, Path(name))
    if path.suffix != ".toml" and name not in ROBOTS:
        if os.path.isfile(path):  # which takes names that no file can have
            raise UserError(
                f"{name} is no robot file: its name must end in .toml; bp2 robot new MODEL.xml writes one"
            )
        require_one_of(
            "robot", name, (*robot_names(), "a robot file such as ROBOT.toml")
        )
    from bp2_rl.robot.robot_file import RobotFile, load_robot

    return RobotFile(ROBOTS[name]) if name in ROBOTS else load_robot(path)
