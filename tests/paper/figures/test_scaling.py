import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.paper.figures.scaling import (
    ScalingNumbers,
    compare_robots,
    count_band,
    shipped,
)
from bp2_rl.paper.figures.settings import ScalingFigureSettings
from bp2_rl.paper.published import PublishedRobot


@pytest.fixture(scope="module")
def numbers() -> ScalingNumbers:
    return compare_robots(ScalingFigureSettings())


@pytest.fixture
def leave_topspeed(make_run, leave_report):
    """Leave a topspeed report of a run whose best second is known."""

    def leave(speed=15.26, benchmark="topspeed", **more):
        results = {benchmark: {"best_speed": speed}}
        run = make_run(duration=0.1, mass=35.8)
        return leave_report(run, benchmark, results=results, **more)

    return leave


def test_robots_have_the_shares_of_the_law_that_the_specification_has(numbers):
    for name, share in {
        "BP2": 0.65,
        "WildCat": 0.51,
        "KAIST Hound": 0.38,
        "MIT Cheetah II": 0.39,
        "BlackPanther": 0.39,
        "DeepRobotics Lite3": 0.37,
        "Unitree Go1": 0.37,
    }.items():
        robot = next(robot for robot in numbers.robots if robot.name == name)
        assert robot.share == pytest.approx(share, abs=0.005), name
    assert numbers.treadmill.share == pytest.approx(0.80, abs=0.005)


def test_the_papers_band_holds_ten_of_26(numbers):
    spread = numbers.spread
    assert (len(spread.within), spread.number) == (10, 26)
    # The 13th and 14th of 26 are BlackPanther, 10 x 9.8 x 5 / (18 x 42), and Spot, 32.5
    # x 9.8 x 5.2 / (98 x 25.56).
    assert spread.median == pytest.approx(0.5 * (490.0 / 756.0 + 1656.2 / 2504.88))


def test_the_ends_of_the_band_are_in_it():
    def robot(demand):
        return PublishedRobot(
            f"{demand}", 1.0, 9.8, 1.0, demand, wheels=False, source="made up"
        )

    spread = count_band([robot(demand) for demand in (0.59, 0.6, 0.7, 0.8, 0.81)])
    assert spread.within == ("0.6", "0.7", "0.8")
    assert spread.median == pytest.approx(0.7)
    assert spread.quartiles == pytest.approx((0.6, 0.8))


def test_the_policy_that_ships_is_in_the_figure_as_its_card_has_it(numbers):
    (card,) = shipped()
    (placed,) = numbers.simulated
    assert placed.top_speed == card.top_speed > 10.0
    assert placed.demand == pytest.approx(35.8 * 9.81 * card.top_speed / (120 * 21.4))
    assert "built" in placed.name


def test_reports_take_its_place(leave_topspeed):
    folders = (
        leave_topspeed(),
        leave_topspeed(robot="built: with losses", speed=13.49, name="other"),
    )
    ideal, built = compare_robots(ScalingFigureSettings(runs=folders)).simulated
    assert (ideal.name, built.name) == (
        "simulated, ideal robot",
        "simulated, built robot",
    )
    assert ideal.share == pytest.approx(0.92, abs=0.005)
    assert ideal.demand == pytest.approx(2.087, abs=5e-4)


@pytest.mark.parametrize(
    ("first", "other", "names"),
    [
        (
            {"trained on": "built: with losses"},
            {"trained on": "ideal: no losses"},
            ["built policy on the ideal robot", "ideal robot"],
        ),
        ({}, {}, ["ideal robot, {}", "ideal robot, {}"]),
    ],
    ids=["another robot than its own", "told apart by folders"],
)
def test_runs_are_named(leave_topspeed, first, other, names):
    folders = leave_topspeed(**first), leave_topspeed(**other, name="other")
    found = compare_robots(ScalingFigureSettings(runs=folders)).simulated
    assert [robot.name for robot in found] == [
        f"simulated, {name.format(folder)}"
        for name, folder in zip(names, folders, strict=True)
    ]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"benchmark": "sprint"}, "--benchmark topspeed"),
        ({"speed": None}, "no whole second"),
    ],
)
def test_a_report_of_something_else_is_refused(leave_topspeed, changes, says):
    with pytest.raises(UserError, match=says):
        compare_robots(ScalingFigureSettings(runs=(leave_topspeed(**changes),)))


def test_a_users_mammals_are_weighed_against_the_law(tmp_path):
    path = tmp_path / "mammals.csv"
    path.write_text(
        "species,mass [kg],top speed [km/h]\nlawful,36,59.748\nslow,36,29.874\n"
    )
    numbers = compare_robots(ScalingFigureSettings(mammals=path))
    # 5 digits above
    assert [species.share for species in numbers.mammals] == pytest.approx(
        [1.0, 0.5], abs=1e-4
    )
