"""Published races over 100 m, beside those of `evaluation.races`: the paper's Table S2,
and a user's own table."""

import dataclasses
import itertools
from pathlib import Path
from typing import Annotated

from bp2_rl.base.assets import asset_path
from bp2_rl.base.bounds import Within
from bp2_rl.base.errors import UserError
from bp2_rl.evaluation.races import PAPER_BP2, TRACK, TRAINED, UNTRAINED
from bp2_rl.paper.published_tables import ColumnHeading, read_table
from bp2_rl.robot import bp2

TABLE_S2 = "published/standards.csv"
BOLT_REACTION = 0.146  # s, reaction time; Berlin 2009
# s, Paris 2024 (World Athletics, results of the final)
LYLES_TIME, LYLES_REACTION = 9.784, 0.178
PUBLISHED_ACCELERATIONS = {
    TRAINED: 4.8,
    UNTRAINED: 2.8,
    PAPER_BP2: bp2.LAUNCH_ACCELERATION,
}
"""Mean acceleration over the first 5 m, m/s2; the paper gives the figures of the
people, too."""


@dataclasses.dataclass(frozen=True)
class Standard:
    """One row of the paper's Table S2: what a national level of China takes over 100
    m."""

    category: str
    level: Annotated[int, Within(1, 9)]  # 1 is the highest
    time: Annotated[float, Within(1.0, 100.0), ColumnHeading("time [s]")]
    source: str


@dataclasses.dataclass(frozen=True)
class SplitRow:
    """One row of a user's table of splits."""

    athlete: str
    distance: Annotated[
        float, Within(0.0, TRACK, open_below=True), ColumnHeading("distance [m]")
    ]
    # from the gun
    time: Annotated[
        float, Within(0.0, 1000.0, open_below=True), ColumnHeading("time [s]")
    ]
    reaction: Annotated[float | None, Within(0.0, 1.0), ColumnHeading("reaction [s]")]


@dataclasses.dataclass(frozen=True)
class Athlete:
    """Somebody's race, as far as it is published."""

    name: str
    time: float  # s over 100 m, from the gun
    reaction: float | None  # s, from the gun to the first push; None if not published
    distances: tuple[float, ...] = ()  # m, of the splits
    splits: tuple[float, ...] = ()  # s, from the gun


def read_standards() -> tuple[Standard, ...]:
    """The paper's Table S2, in its order."""
    return read_table(asset_path(TABLE_S2), Standard)


def best_level(time: float, category: str) -> int | None:
    """The highest level of a category that a time over 100 m (s) meets; None if it
    meets none."""
    met = [
        standard.level
        for standard in read_standards()
        if standard.category == category and time <= standard.time
    ]
    return min(met, default=None)


def read_athletes(path: Path) -> tuple[Athlete, ...]:
    """The races in a user's table of splits, in its order.

    Raises:
        UserError: as `read_table`, or where an athlete's splits are no race over 100 m.
    """
    rows = read_table(path, SplitRow)
    by_name: dict[str, list[SplitRow]] = {}
    for row in rows:
        by_name.setdefault(row.athlete, []).append(row)
    return tuple(
        _athlete(f"{path}: {name}", splits) for name, splits in by_name.items()
    )


def _athlete(place: str, rows: list[SplitRow]) -> Athlete:
    first, last = rows[0], rows[-1]
    if len(rows) < 3 or last.distance != TRACK:
        raise UserError(f"{place} needs three splits at least, the last at {TRACK:g} m")
    if any(
        after.distance <= row.distance or after.time <= row.time
        for row, after in itertools.pairwise(rows)
    ):
        raise UserError(f"{place}: distance and time must rise from split to split")
    if (
        any(row.reaction != first.reaction for row in rows)
        or (first.reaction or 0.0) >= first.time
    ):
        raise UserError(
            f"{place}: the reaction must be the same on each line, and end before the first split"
        )
    return Athlete(
        first.athlete,
        last.time,
        first.reaction,
        tuple(row.distance for row in rows),
        tuple(row.time for row in rows),
    )
