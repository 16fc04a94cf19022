"""`bp2 identify`: find the numbers of a robot's motors from a recording of the robot."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.base.errors import UserError
from bp2_rl.cli.app import Command


@dataclasses.dataclass(frozen=True)
class IdentifyConfig:
    """Find torque scale, no-load speed, friction and delay of a robot's motors from a log
    of the real robot, with intervals and errors on rows that the fit has not seen.

    A log is an .npz or .csv file with the columns time, q.JOINT and q_target.JOINT; of a
    robot that moves also up.x ..., omega.x ... and contact.LEG (docs/howto/identify.md).
    Without a log, write the targets that a hanging robot should follow.

    For example: bp2 identify log.csv --robot my_robot.toml
    """

    log: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")] = (
        None
    )
    """the recording; without one, targets.csv is written to DIR"""
    robot: Annotated[str, tyro.conf.arg(metavar="NAME|FILE")] = "go1"
    """the robot file whose numbers are tried, with the loop's [gains]"""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("identified")
    """folder of the robot file, the numbers and the picture"""


def run_identify(config: IdentifyConfig) -> None:
    """Print and write what a log says of a robot's motors."""
    from bp2_rl.cli import runtime  # noqa: F401  # isort: skip  # before all that imports MuJoCo

    from bp2_rl.base.files import write_text
    from bp2_rl.base.folders import make_folder
    from bp2_rl.base.metric import rows_of, table_of
    from bp2_rl.base.plotting import save_figure
    from bp2_rl.base.serialization import save_config
    from bp2_rl.cli.printing import print_table
    from bp2_rl.robot.named import find_robot_file, shipped_files
    from bp2_rl.tools.identify import outcome
    from bp2_rl.tools.identify.excite import DURATION, excitation_text
    from bp2_rl.tools.identify.log import describe_log, read_log

    robot = find_robot_file(config.robot)
    if robot.gains is None:
        raise UserError(
            f"--robot {config.robot}: its robot file has no [gains]; give stiffness and damping of the position loop"
        )
    if config.log is None:
        make_folder(config.out)
        write_text(
            config.out / "targets.csv", excitation_text(robot.hardware, robot.gains)
        )
        print(
            f"targets of a hanging robot, for {DURATION:g} s: {config.out / 'targets.csv'}"
        )
        return
    log = read_log(config.log, robot.anatomy)
    for row in rows_of(describe_log(log)):
        print(f"{row.label}: {row.value} ({row.meaning})")
    found = outcome.identify(log, robot)
    make_folder(config.out)
    source = shipped_files().get(config.robot, Path(config.robot))
    write_text(
        config.out / "robot.toml",
        outcome.identified_file(found, robot, source, config.out),
    )
    save_config(config.out / "identified.json", found)
    save_figure(outcome.identification_figure(found), config.out / "errors.png")
    print_table(table_of("Numbers, with 90 % intervals", found.numbers, words=True))
    print_table(
        table_of(
            f"RMS error after {1e3 * found.window:.0f} ms on held-out rows",
            found.errors,
        )
    )
    print(f"robot file, numbers, picture: {config.out}")


main = Command("bp2 identify", IdentifyConfig, run_identify)
