"""`bp2 identify`: find the numbers of a robot's motors from a recording of the robot."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.base.errors import UserError
from bp2_rl.cli.app import Command


@dataclasses.dataclass(frozen=True)
class IdentifyConfig:
    """Estimate torque scale, no-load speed, friction and delay of a robot's motors from
    a log of the real robot, with 90 % intervals and errors on held-out rows.

    A log is an .npz or .csv file with the columns time, q.JOINT and q_target.JOINT, and
    for a moving robot up.x ..., omega.x ... and contact.LEG (docs/howto/identify.md).
    Without a log, the command writes the joint targets of the recording's experiment.

    For example: bp2 identify log.csv --robot my_robot.toml
    """

    robot: Annotated[str, tyro.conf.arg(metavar="NAME|FILE")]
    """robot file with the numbers to start from and the position loop's [gains]"""
    log: Annotated[
        Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[LOG]")
    ] = None
    """the recording; without a recording, targets.csv is written to DIR"""
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
    from bp2_rl.tools.identify.log import read_log

    robot = find_robot_file(config.robot)
    source = shipped_files().get(config.robot, Path(config.robot))
    if robot.gains is None:
        raise UserError(
            f"--robot {config.robot}: give a robot file with [gains], those of the position loop (bp2 robot new)"
        )
    made = config.out / "robot.toml"
    if made.resolve() == source.resolve():
        raise UserError(
            f"--out {config.out}: {made} would be replaced; choose another folder"
        )
    log = config.log and read_log(config.log, robot.anatomy)
    make_folder(config.out)
    if log is None:
        targets = config.out / "targets.csv"
        write_text(targets, excitation_text(robot.hardware, robot.gains))
        print(
            f"targets for a hanging robot, {DURATION:g} s from the stand and back: {targets}"
        )
        return
    print(
        "the robot hangs"
        if log.hanging
        else "the robot runs: its legs in swing are fitted"
    )
    found = outcome.identify(log, robot, robot.gains)
    write_text(made, outcome.identified_file(found, robot, source, config.out))
    save_config(config.out / "identified.json", found)
    save_figure(outcome.identification_figure(found), config.out / "errors.png")
    for row in rows_of(found.log):
        print(f"{row.label}: {row.value} ({row.meaning})")
    print_table(table_of("Numbers, with 90 % intervals", found.numbers, words=True))
    ends = f"RMS error after {1e3 * found.window:.0f} ms, on rows that the fit has not seen"
    print_table(table_of(ends, found.errors))
    if not found.converged:
        print("the fit has not come to an end: take these numbers with care")
    print(f"robot file, numbers, picture: {config.out}")


main = Command("bp2 identify", IdentifyConfig, run_identify)
