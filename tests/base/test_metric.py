import dataclasses
import math

from bp2_rl.base.metric import (
    Row,
    card_of,
    metric,
    rounded,
    rows_of,
    show_fall,
    table_of,
    table_of_rows,
)


@dataclasses.dataclass(frozen=True)
class Spring:
    name: str = metric("Spring", form="s")
    travel: float = metric("Travel", "mm", ".0f", "of {m.name}", card=True)
    slip: float | None = metric(
        "Slip", "m/s", meaning="median", card="slip_median", default=None
    )
    hits: int = metric(
        "Hits",
        form="d",
        meaning=lambda spring: f"{spring.hits} times",
        default=0,
        shown=lambda spring: spring.hits > 0,
    )


@dataclasses.dataclass(frozen=True)
class Run:
    fell_at: float | None = metric("Fall", form=show_fall)
    spring: Spring | None = None
    note: str = ""


def test_a_field_declares_its_row_its_column_and_its_place_on_the_card():
    run = Run(1.5, Spring("FR", 0.0314159))
    assert rows_of(run) == (
        Row("Fall", "at 1.50 s", ""),
        Row("Spring", "FR", ""),
        Row("Travel", "31 mm", "of FR"),
        Row("Slip", "-", "median"),
    )
    assert card_of(run) == {"travel": 0.03142, "slip_median": None}
    assert rows_of(Run(None)) == (Row("Fall", "none", ""),)
    hit = Spring("FL", 0.03, hits=2)
    assert rows_of(hit, "hits", "name") == (
        Row("Hits", "2", "2 times"),
        Row("Spring", "FL", ""),
    )
    assert card_of(run, "fell_at") == {}
    assert card_of(hit, "travel", "hits") == {"travel": 0.03}


def test_a_table_has_the_units_in_its_head():
    springs = [Spring("FR", 0.02, 0.5, 2), Spring("FL", 0.03)]
    table = table_of("Springs", springs)
    assert table.head == ["Spring", "Travel [mm]", "Slip [m/s]", "Hits"]
    assert table.lines == [["FR", "20", "0.50", "2"], ["FL", "30", "-", "0"]]
    assert table_of("Springs", springs, "name", "hits").head == ["Spring", "Hits"]


@dataclasses.dataclass(frozen=True)
class Lap:
    kept: bool = metric("Lane kept")
    seed: int = metric("Seed", form="d", card=True, shown=False)


def test_what_is_not_shown_is_still_on_the_card_and_a_truth_is_a_word():
    laps = [Lap(True, 7), Lap(False, 8)]
    assert [rows_of(lap) for lap in laps] == [
        (Row("Lane kept", "yes", ""),),
        (Row("Lane kept", "no", ""),),
    ]
    assert card_of(laps[0]) == {"seed": 7}
    assert table_of("Laps", laps).head == ["Lane kept"]
    assert table_of_rows("Measures", rows_of(laps[0])).lines == rows_of(laps[0])


def test_numbers_are_rounded_wherever_they_stand():
    assert rounded({"a": [1.23456, math.inf], "b": 7}) == {"a": [1.235, None], "b": 7}
