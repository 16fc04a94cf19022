import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.paper.published_races import best_level, read_athletes, read_standards

HEAD = "athlete,distance [m],time [s],reaction [s]\n"


def test_table_s2_is_whole():
    standards = [(s.category, s.level, s.time) for s in read_standards()]
    assert standards == [
        ("male", 1, 10.93),
        ("male", 2, 11.74),
        ("male", 3, 12.64),
        ("female", 1, 12.33),
        ("female", 2, 13.04),
        ("female", 3, 14.04),
    ]


@pytest.mark.parametrize(
    ("time", "men", "women"),
    [
        (9.25, 1, 1),
        (10.05, 1, 1),
        (11.2, 2, 1),
        (11.74, 2, 1),
        (11.75, 3, 1),
        (12.2, 3, 1),
        (14.0, None, 3),
        (16.1, None, None),
    ],
)
def test_a_time_meets_the_levels_that_ask_for_no_less(time, men, women):
    assert (best_level(time, "male"), best_level(time, "female")) == (men, women)


def test_a_users_splits_become_races(tmp_path):
    path = tmp_path / "splits.csv"
    path.write_text(
        HEAD
        + "A,50,6,0.15\nB,30,4,\nA,80,8.5,0.15\nB,60,7,\nA,100,10.2,0.15\nB,100,11,\n"
    )
    first, second = read_athletes(path)
    assert (first.name, first.time, first.reaction) == ("A", 10.2, 0.15)
    assert (first.distances, first.splits) == ((50.0, 80.0, 100.0), (6.0, 8.5, 10.2))
    assert (second.reaction, second.time) == (None, 11.0)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ("A,50,6,\nA,100,11,\n", "three splits at least"),
        ("A,30,4,\nA,60,7,\nA,90,10,\n", "the last at 100 m"),
        ("A,30,4,\nA,60,4,\nA,100,11,\n", "must rise"),
        ("A,60,4,\nA,30,5,\nA,100,11,\n", "must rise"),
        ("A,30,4,0.1\nA,60,7,0.2\nA,100,11,0.1\n", "the same on each line"),
        ("A,1,0.5,0.6\nA,60,7,0.6\nA,100,11,0.6\n", "end before the first split"),
        ("A,30,4,\nA,60,7,\nA,101,11,\n", "line 4: distance must be"),
    ],
)
def test_splits_that_are_no_race_are_refused(tmp_path, rows, says):
    path = tmp_path / "splits.csv"
    path.write_text(HEAD + rows)
    with pytest.raises(UserError, match=says):
        read_athletes(path)
