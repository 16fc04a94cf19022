"""`bp2 paper scaling`: the speeds of many robots beside what their legs and motors allow."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.cli.dispatch import Command
from bp2_rl.cli.trajopt.arguments import Workers
from bp2_rl.optimiser.problem import Intervals
from bp2_rl.paper.cli.report import open_folder, with_folder

OUT = Path("reports/scaling")
LIMITS = "limits.json"  # what is left of the optimiser's search


@dataclasses.dataclass(frozen=True)
class LimitSettings(Bounded, path="--"):
    """Compare published and learned speeds of robots with the greatest speed that their legs and motors allow.

    Examples:
        bp2 paper scaling                              # from the limits that ship, in a moment
        bp2 paper scaling --simulate                   # finds the limits anew
        bp2 paper scaling --simulate --robots go1 spot
    """

    simulate: bool = False
    """find the limits anew, by the optimiser"""
    robots: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WORD ...")] = ()
    """with --simulate: only robots whose names have one of these words; bp2 has its variants"""
    intervals: Annotated[Intervals, Within(2, 500)] = 16
    """with --simulate: of the optimiser's mesh, in each segment"""
    workers: Workers = 2
    """with --simulate: processes"""


def _compare(arguments: Any) -> None:
    from bp2_rl.base.errors import UserError
    from bp2_rl.base.files import require_name
    from bp2_rl.base.serialization import load_config, save_config
    from bp2_rl.cli.trajopt.output import progress
    from bp2_rl.paper.cli.figures import FigureReport, leave, show
    from bp2_rl.paper.figures.drawn import Drawn
    from bp2_rl.paper.robots import read_robots
    from bp2_rl.paper.scaling import study
    from bp2_rl.paper.scaling.figure import draw_limits

    settings, out = arguments.settings, arguments.out
    require_name(out)
    if settings.robots and not settings.simulate:
        raise UserError("--robots chooses whose limits to find anew: add --simulate")
    robots, variants = study.choose_robots(settings.robots)
    open_folder(out, "limits", lambda metrics: load_config(FigureReport, metrics).figure)
    if settings.simulate:
        with progress() as bar:
            search = study.simulate(robots, variants, settings.intervals, settings.workers)
            for limits in bar.track(search, len(robots) + len(variants) + 1, description="limits"):
                save_config(out / LIMITS, limits)  # as they are found
    else:
        save_config(out / LIMITS, study.read_limits())
    limits = study.read_limits(out / LIMITS)
    found = study.compare_limits(limits, read_robots(), study.read_learned())
    print(*study.refutations(found), sep="\n")
    drawn = Drawn(found, study.tables(found), (), {"scaling": draw_limits(found)})
    show(drawn)
    print(*study.verdict(found), sep="\n")
    for what, names in (("no trot was found of", found.not_found), ("legs or motors not published", found.left_out)):
        if names:
            print(f"{what}: {', '.join(names)}")
    leave(arguments, "limits", drawn)
    print(f"picture, numbers and limits: {out}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command on `argv`, the process's arguments by default; return the exit status."""
    return Command("bp2 paper scaling", with_folder(LimitSettings, OUT), _compare)(argv)
