"""Robots by name: BP2's two, those that ship as robot files, and any other robot by the path of its file."""

from pathlib import Path

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError
from bp2_rl.robot.hardware import ROBOTS, HardwareSpec


def shipped_files() -> dict[str, Path]:
    """Return the robot files that ship, by the robots' names."""
    return {path.stem: path for path in sorted(asset_path("robots").glob("*.toml"))}


def robot_names() -> tuple[str, ...]:
    """Return the names that `find_robot` takes."""
    return (*ROBOTS, *shipped_files())


def find_robot(name: str) -> HardwareSpec:
    """Return the robot of this name, or of the robot file at this path.

    Raises:
        UserError: there is no such robot, or its file is broken.
    """
    found = next((hardware for known, hardware in ROBOTS.items() if known == name), None)
    if found is not None:
        return found
    path = shipped_files().get(name, Path(name))
    if path.suffix != ".toml":
        known = ", ".join(robot_names())
        raise UserError(f"there is no robot '{name}': choose one of {known}, or name a robot file, ROBOT.toml")
    from bp2_rl.robot.robot_file import load_robot

    return load_robot(path).hardware
