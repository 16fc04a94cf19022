"""The figure of what the paper's numbers leave of what was assumed."""

import numpy as np
import pytest

from bp2_rl.evaluation.plausible import read_assumptions
from bp2_rl.paper.figures import identifiability as module
from bp2_rl.paper.figures.identifiability import identifiability
from bp2_rl.paper.figures.settings import IdentifiabilityFigureSettings
from bp2_rl.paper.posterior.runs import RobotRun, fill_ranges, write_rows
from bp2_rl.robot import bp2

ROBOTS = 32


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Draw the figure for a world in which spring damping alone slows robots."""
    assumptions = read_assumptions()
    places = fill_ranges(ROBOTS, len(assumptions))
    damping = places[:, list(assumptions).index("spring_damping")]
    speed = bp2.TREADMILL_TOP_SPEED * np.exp(0.6 * (0.5 - damping))
    runs = [
        {
            "policy": policy,
            "belt": v,
            "road": v,
            "time_100m": 150.0 / v,
            "hip": 1700.0,
            "knee": 1600.0,
        }
        for v in map(float, speed)
        for policy in ("built", "gentle")
    ]
    path = tmp_path_factory.mktemp("posterior") / "runs.csv"
    write_rows(path, runs)
    assert RobotRun(**runs[0])
    return identifiability(IdentifiabilityFigureSettings(path, draws=2000))


def test_the_only_assumption_that_matters_is_found(drawn):
    left = {one.name: one.left for one in drawn.results.assumptions}
    assert left["spring_damping"] == min(left.values())
    assert left["spring_damping"] < 0.6
    assert left["friction"] == pytest.approx(1.0, abs=0.1)
    (parts, _), *_ = drawn.results.combinations
    assert abs(parts["spring_damping"]) > 0.95


def test_the_tables_have_a_line_for_each_number_and_each_assumption(drawn):
    numbers, assumptions, _ = drawn.tables
    assert [line[0] for line in numbers.lines] == [
        "belt",
        "lesser power",
        "road",
        "100 m",
    ]
    assert len(assumptions.lines) == len(read_assumptions())
    belt, _, road, _ = drawn.results.numbers
    assert belt.coverage is None
    assert 0.7 <= road.coverage <= 1.0


def test_the_picture_has_a_bar_for_each_assumption(drawn):
    left, right = drawn.pictures["identifiability"].axes
    assert len(left.get_yticklabels()) == len(read_assumptions())
    assert right.get_yticklabels()[-1].get_text() == "belt\n13.2 m/s"
    assert module.KINDS.keys() == {"prior", "predicted", "posterior"}
