import contextlib
import dataclasses
import random
from typing import Annotated

import pytest

from bp2_rl.base.assets import asset_path
from bp2_rl.base.bounds import Within
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import BadFileError
from bp2_rl.paper.published import TABLE_S1, PublishedRobot
from bp2_rl.paper.published_tables import LARGEST, ColumnHeading, read_table


@dataclasses.dataclass(frozen=True)
class Boat:
    name: str
    length: Annotated[
        float, Within(0.0, 500.0, open_below=True), ColumnHeading("length [m]")
    ]
    masts: Annotated[int | None, Within(0, 9)]
    afloat: bool


@pytest.fixture
def table(tmp_path):
    def write(text, encoding="utf-8"):
        path = tmp_path / "boats.csv"
        path.write_bytes(text.encode(encoding))
        return path

    return write


GOOD = "name,length [m],masts,afloat\nFram,39,3,yes\n"


def test_cells_become_what_their_columns_hold(table):
    assert read_table(table(GOOD + '"Vasa, the",69.5,,no\n'), Boat) == (
        Boat("Fram", 39.0, 3, afloat=True),
        Boat("Vasa, the", 69.5, None, afloat=False),
    )


@pytest.mark.parametrize(
    "text",
    [
        # any order, more columns, spaces
        "afloat,masts,name,length [m],builder\nyes, 3 ,Fram,39,Archer\n",
        # as spreadsheets begin files, and end lines and tables
        "\ufeff" + GOOD,
        GOOD.replace("\n", "\r\n") + "\r\n,,,\r\n",
    ],
)
def test_a_table_may_be_laid_out_in_other_ways(table, text):
    assert read_table(table(text), Boat) == (Boat("Fram", 39.0, 3, afloat=True),)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "holds no table"),
        ("name,length [m],masts,afloat\n", "holds no table"),
        # of which unit?
        ("name,length,masts,afloat\nFram,39,3,yes\n", "needs one column 'length [m]'"),
        (
            "name,name,length [m],masts,afloat\nFram,Fram,39,3,yes\n",
            "needs one column 'name'",
        ),
        (GOOD + "Gjoa,21\n", "line 3 has 2 cells, the line of headings 4"),
        (GOOD + "Gjoa,long,1,yes\n", "line 3: length [m] takes a number, got 'long'"),
        (GOOD + "Gjoa,21,1.5,yes\n", "line 3: masts takes a whole number, got '1.5'"),
        (GOOD + "Gjoa,21,1,maybe\n", "line 3: afloat takes yes or no, got 'maybe'"),
        (GOOD + ",21,1,yes\n", "line 3: name takes some text, got ''"),
        (GOOD + "Gjoa,,1,yes\n", "line 3: length [m] takes a number, got ''"),
        (GOOD + "Gjoa,nan,1,yes\n", "line 3: length must be above 0"),
        (GOOD + "Gjoa,1e999,1,yes\n", "line 3: length must be"),
        (GOOD + "Gjoa,-21,1,yes\n", "line 3: length must be"),
        (GOOD + "Gjoa,21,10,yes\n", "line 3: masts must be from 0 to 9, got 10"),
        (GOOD + '"Gjoa,21,1,yes\n', "is no CSV file"),
    ],
)
def test_a_bad_table_is_refused_in_one_line_that_says_where(table, text, says):
    path = table(text)
    with pytest.raises(BadFileError) as refused:
        read_table(path, Boat)
    line = str(refused.value).replace("positive", "above 0")
    assert says in line
    assert line.startswith(str(path))
    assert "\n" not in line


def test_what_is_no_text_is_refused(table, tmp_path):
    with pytest.raises(BadFileError, match="no CSV file in UTF-8"):
        read_table(table(GOOD + "Gjøa,21,1,yes\n", "latin-1"), Boat)
    with pytest.raises(BadFileError, match="at most are read"):
        read_table(table(GOOD + "\n" * LARGEST), Boat)
    with pytest.raises(BadFileError, match="folder"):
        read_table(tmp_path, Boat)


@pytest.mark.attack
def test_a_damaged_table_is_read_or_refused(tmp_path):
    whole, path, chance = (
        asset_path(TABLE_S1).read_bytes(),
        tmp_path / "robots.csv",
        random.Random(0),
    )
    for _ in range(500):
        damaged = bytearray(whole[: chance.randrange(1, len(whole))])
        for _ in range(chance.randrange(4)):
            damaged[chance.randrange(len(damaged))] = chance.randrange(256)
        path.write_bytes(bytes(damaged))
        # anything else would end the command with a traceback
        with contextlib.suppress(UserError):
            assert read_table(path, PublishedRobot)
