"""`bp2 paper trajectories codesign`: hardware and trajectory together."""

import dataclasses
from typing import Annotated

from bp2_rl.base.bounds import Bounded
from bp2_rl.base.folders import own_folder
from bp2_rl.cli.trajopt import OUT, Flat, Folder, Workers
from bp2_rl.paper.trajectories.codesign.settings import CodesignSettings


@dataclasses.dataclass(frozen=True)
class CodesignArguments(Bounded):
    """Find gear ratio, leg length and spring stiffness along with the trajectory, and
    scan each."""

    settings: Annotated[CodesignSettings, Flat] = CodesignSettings()
    workers: Workers = 2
    """processes"""
    out: Folder = OUT / "codesign"


def run_codesign(arguments: CodesignArguments) -> None:
    """Print the study and leave it with its picture; what was solved before is not
    solved again."""
    with own_folder(arguments.out):
        from bp2_rl.base.plotting import save_figure
        from bp2_rl.paper.trajectories.codesign.figure import codesign_figure
        from bp2_rl.paper.trajectories.codesign.study import study_codesign

        study = study_codesign(arguments.settings, arguments.out, arguments.workers)
        save_figure(codesign_figure(study), arguments.out / "codesign.png")
    print(f"study and picture: {arguments.out}")
