"""`bp2 paper scaling`: the speeds of many robots beside what their legs and motors
allow."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.base.errors import UserError
from bp2_rl.cli.app import Command
from bp2_rl.cli.trajopt import Workers
from bp2_rl.optimiser.family import MOST_IMPACT
from bp2_rl.optimiser.problem import Intervals
from bp2_rl.paper.cli.report import with_folder

Robot = TypeVar("Robot")
OUT = Path("reports/scaling")
FIGURE = "limits"
# of the optimiser: whose limits it looks for, and those found
SEARCH, LIMITS = "search.json", "limits.json"


@dataclasses.dataclass(frozen=True)
class LimitSettings(Bounded, path="--"):
    """Compare published and learned speeds of robots with the greatest speed that their
    legs and motors allow.

    Interrupted, a search goes on where it stopped when run again.

    For example: bp2 paper scaling --simulate --robots go1 spot
    """

    simulate: bool = False
    """find the limits again, by the optimiser"""
    robots: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WORD ...")] = ()
    """with --simulate: only robots whose names have one of these words; bp2: BP2 and
    its variants"""
    intervals: Annotated[Intervals, Within(2, 500)] = 16
    """with --simulate: of the optimiser's mesh, in each segment; three times as many
    where there are springs"""
    impact: Annotated[float, Within(0.0, 1.0)] = MOST_IMPACT
    """with --simulate: share of the weight that landings may bear"""
    workers: Workers = 2
    """with --simulate: processes"""


def _compare(arguments: Any) -> None:
    from bp2_rl.base.assets import asset_path
    from bp2_rl.base.files import require_name
    from bp2_rl.base.metric import table_of
    from bp2_rl.base.serialization import claim_folder, load_config, save_config
    from bp2_rl.cli.trajopt import progress_bar
    from bp2_rl.paper.cli.figures import open_figure_folder, show_and_leave
    from bp2_rl.paper.figures.drawn import Drawn
    from bp2_rl.paper.published import read_robots
    from bp2_rl.paper.scaling import study
    from bp2_rl.paper.scaling.limits import (
        LimitSearch,
        Rules,
        SpeedLimits,
        search_limits,
    )
    from bp2_rl.paper.scaling.robots import find_robots

    settings, out = arguments.settings, arguments.out
    require_name(out)
    if settings.robots and not settings.simulate:
        raise UserError("--robots chooses whose limits to find again: add --simulate")
    robots = choose_robots(find_robots(), settings.robots)
    if not (out / SEARCH).is_file():
        open_figure_folder(out, FIGURE)
    limits = load_config(SpeedLimits, asset_path(study.FOUND))
    if settings.simulate:
        search = LimitSearch(robots, Rules(settings.intervals, settings.impact))
        claim_folder(out, SEARCH, search, "a search")
        kept = out / LIMITS
        begun = load_config(SpeedLimits, kept) if kept.is_file() else None
        with progress_bar() as bar:
            found = search_limits(search, settings.workers, begun)
            for limits in bar.track(found, len(robots) + 1, description="limits"):
                save_config(kept, limits)  # as they are found
    compared = study.compare_limits(limits, read_robots(), study.read_learned())
    print(*study.refutations(compared), sep="\n")
    table = table_of("Robots beside their limits", compared.robots, words=True)
    drawn = Drawn(compared, (table,), {"scaling": study.draw_limits(compared)})
    show_and_leave(arguments, FIGURE, drawn)
    for what, names in (
        ("no trot was found of", compared.not_found),
        ("legs or motors not published", compared.left_out),
    ):
        if names:
            print(f"{what}: {', '.join(names)}")
    print(f"picture and numbers: {out}")


def choose_robots(
    robots: Mapping[str, Robot], words: Sequence[str]
) -> dict[str, Robot]:
    """Return the robots with one of these words in their names; without words, all
    robots.

    Raises:
        UserError: a word is in no name.
    """
    found: dict[str, Robot] = {}
    for shown in words:
        word = shown.replace("_", " ").casefold()
        named = {name: robots[name] for name in robots if word in name.casefold()}
        if not named:
            raise UserError(
                f"--robots: no robot's name has {shown!r}; there are {', '.join(robots)}"
            )
        found |= named
    return found or dict(robots)


main = Command("bp2 paper scaling", with_folder(LimitSettings, OUT), _compare)
