"""The scaling study: a limit that follows the motors, and speeds above a limit, which
are reported first."""

import dataclasses

import pytest

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import INTERRUPTED, OK, WRONG_INPUT, UserError
from bp2_rl.base.serialization import load_config
from bp2_rl.paper.cli import scaling
from bp2_rl.paper.cli.scaling import choose_robots
from bp2_rl.paper.published import read_robots
from bp2_rl.paper.scaling import limits as module
from bp2_rl.paper.scaling.limits import (
    LimitSearch,
    Rules,
    SpeedLimit,
    SpeedLimits,
    search_limits,
)
from bp2_rl.paper.scaling.robots import BP2, find_robots
from bp2_rl.paper.scaling.study import (
    FOUND,
    compare_limits,
    read_learned,
    refutations,
)
from bp2_rl.robot.hardware import times

A1, LITE = "Unitree A1", "DeepRobotics Lite3"


SLOWER = 0.8  # times the speed of A1's motors


@pytest.fixture(scope="module")
def found() -> dict[str, SpeedLimit]:
    """Return the speed limits of A1 and of A1 with slower motors, on a mesh that is
    solved in moments."""
    robot = find_robots()[A1]
    corner, no_load = (
        times(SLOWER, speed) for speed in (robot.corner_speed, robot.no_load_speed)
    )
    slow = dataclasses.replace(robot, corner_speed=corner, no_load_speed=no_load)
    search = LimitSearch({A1: robot, "slow": slow}, Rules(intervals=4))
    *_, found = search_limits(search, workers=1)
    return {name: limit for name, limit in found.limits.items() if limit}


@pytest.fixture(scope="module")
def a1(found) -> SpeedLimit:
    return found[A1]


def test_slower_motors_lower_the_limit(found, a1):
    # To first order by the price of joint speed, some 0.5; speed would go with the
    # motors' if nothing else bound.
    first_order = a1.speed * SLOWER ** a1.gains["joint speed"]
    assert found["slow"].speed == pytest.approx(first_order, rel=0.1)
    assert SLOWER * a1.speed < found["slow"].speed < 0.96 * a1.speed


def test_a_foot_is_no_faster_than_hip_and_knee_turn_it(a1):
    """In stance the foot rests, so the hip passes it no faster than all joints at their
    no-load speed allow."""
    robot = find_robots()[A1]
    length, speed = 2.0 * robot.anatomy.leg_length, 21.0  # rad/s, of hip and knee
    assert a1.speed < length * speed + 0.5 * length * speed
    assert a1.binds == "joint speed"


def test_a_speed_above_its_limit_is_said_first(a1):
    limits = SpeedLimits(Rules(4), {A1: a1})
    fine = compare_limits(limits, read_robots(), ())
    assert refutations(fine) == [
        "no speed of 1 robots, published or learned, is above the optimiser's limit"
    ]
    above = [
        dataclasses.replace(r, top_speed=9.0) if r.robot == A1 else r
        for r in read_robots()
    ]
    lines = refutations(compare_limits(limits, above, ()))
    assert lines == [
        f"{A1} runs 9.00 m/s (published), and its limit is {a1.speed:.2f} m/s: the model is wrong"
    ]


def test_without_any_limit_there_is_no_study():
    with pytest.raises(UserError, match=f"no trot was found of {A1}"):
        compare_limits(SpeedLimits(Rules(4), {A1: None}), read_robots(), ())


@pytest.fixture
def shipped() -> SpeedLimits:
    return load_config(SpeedLimits, asset_path(FOUND))


def test_what_ships_is_of_the_robots_that_there_are(shipped):
    assert shipped.limits.keys() == find_robots().keys()
    study = compare_limits(shipped, read_robots(), read_learned())
    assert {robot.robot for robot in study.robots if robot.learned} >= {
        BP2,
        "Unitree Go1",
        "Unitree B2",
    }
    assert "WildCat" in study.left_out
    assert not {BP2, "Unitree Go2-W"} & set(study.left_out)


def test_words_choose_robots():
    robots = find_robots()
    assert choose_robots(robots, ("mini_cheetah",)).keys() == {
        "MIT Mini Cheetah",
        "BP2, rigid legs of MIT Mini Cheetah",
    }
    of_bp2 = choose_robots(robots, ("bp2", "rigid"))
    assert set(of_bp2) == {name for name in robots if name.startswith(BP2)}
    assert choose_robots(robots, ()) == robots


def test_the_command_prints_refutations_first(shipped, tmp_path, capsys):
    assert scaling.main(["--out", str(tmp_path / "out")]) == OK
    first = capsys.readouterr().out.splitlines()[0]
    study = compare_limits(shipped, read_robots(), read_learned())
    assert first == refutations(study)[0]
    assert (tmp_path / "out" / "scaling.png").stat().st_size > 10_000


def test_an_interrupted_search_goes_on_where_it_stopped(a1, tmp_path, monkeypatch):
    """What a first search left in its folder is kept, and the rest is found; another
    search is refused."""
    asked: list[str] = []
    interrupts = iter([True, False])

    def find(robots, rules, workers):
        asked.extend(robots)
        for key in robots:
            yield key, a1
            if next(interrupts):
                raise KeyboardInterrupt

    monkeypatch.setattr(module, "find_limits", find)
    words = ["--simulate", "--robots", "a1", "lite", "--out", str(tmp_path / "out")]
    assert scaling.main(words) == INTERRUPTED
    assert scaling.main(words) == OK
    assert asked == [A1, LITE, LITE]
    kept = load_config(SpeedLimits, tmp_path / "out" / scaling.LIMITS)
    assert kept.limits == {A1: a1, LITE: a1}
    assert scaling.main([*words, "--intervals", "5"]) == WRONG_INPUT


@pytest.mark.attack
@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--simulate", "--robots", "unicorn"], "no robot's name has 'unicorn'"),
        (["--robots", "go1"], "add --simulate"),
        (["--intervals", "1"], "intervals"),
    ],
)
def test_mistakes_are_one_line(words, line, tmp_path, capsys):
    assert scaling.main([*words, "--out", str(tmp_path / "out")]) == WRONG_INPUT
    said = capsys.readouterr().err
    assert line in said
    assert len(said.splitlines()) == 1
    assert not (tmp_path / "out").exists()
