import dataclasses
import math

import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.paper.published import (
    PAPER_GRAVITY,
    best_level,
    power_demand,
    read_athletes,
    read_robots,
    read_standards,
    speed_law,
)
from bp2_rl.robot import bp2


def test_the_law_is_that_of_the_source():
    # By hand with the paper's formula, in km/h: 25.5 x 2.53886 x 0.92288 and 25.5 x
    # 3.70472 x 0.65744.
    assert speed_law(36.0) == pytest.approx(16.60, abs=0.005)
    assert speed_law(154.0) == pytest.approx(17.25, abs=0.005)


def test_the_law_peaks_where_its_slope_is_zero():
    mass = np.geomspace(1.0, 1e4, 200_001)
    peak = float(mass[np.argmax(speed_law(mass))])
    # d ln v / d m = 0: 0.26 (e^y - 1) = 0.6 y with y = 22 m^-0.6
    y = 22.0 * peak**-0.6
    # the grid is 5e-5 fine
    assert 0.26 * math.expm1(y) == pytest.approx(0.6 * y, rel=1e-3)


def test_table_s1_is_whole():
    robots = read_robots()
    # Sums of the columns of the paper's table.
    assert len(robots) == 28
    assert sum(r.mass for r in robots) == pytest.approx(910.5)
    assert sum(r.peak_torque or 0.0 for r in robots) == pytest.approx(1964.1)
    assert sum(r.no_load_speed or 0.0 for r in robots) == pytest.approx(801.12)
    assert sum(r.top_speed for r in robots) == pytest.approx(121.26)
    assert [r.robot for r in robots if r.wheels] == [
        "Unitree Go2-W",
        "Unitree B2-W",
        "DeepRobotics Lynx M20",
    ]
    assert [r.robot for r in robots if r.demand() is None] == ["WildCat"]
    assert all(r.source.startswith("paper, Table S1") for r in robots)


def test_bp2_is_the_one_that_is_built_here():
    published = next(robot for robot in read_robots() if robot.robot == "BP2")
    assert published.mass == bp2.TOTAL_MASS
    assert (published.peak_torque, published.no_load_speed) == (
        bp2.PEAK_TORQUE,
        bp2.NO_LOAD_SPEED,
    )
    assert published.top_speed == bp2.OUTDOOR_TOP_SPEED


def test_the_papers_ratio_needs_its_own_gravity():
    bp2 = next(robot for robot in read_robots() if robot.robot == "BP2")
    assert bp2.demand(PAPER_GRAVITY) == pytest.approx(1.475, abs=5e-4)  # as printed
    assert bp2.demand() == pytest.approx(1.477, abs=5e-4)
    assert dataclasses.replace(bp2, mass=35.8).demand() == pytest.approx(
        1.469, abs=5e-4
    )
    assert power_demand(2.0, 10.0, 3.0, 4.0 * 5.0) == 3.0


# --- Races ----------------------------------------------------------------------------

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
