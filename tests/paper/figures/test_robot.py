"""The model's drawing: its dimensions are measured, and its parts are where the model
has them."""

import mujoco
import numpy as np
import pytest

from bp2_rl.paper.figures.robot import extent, measure_robot, outlines, robot
from bp2_rl.paper.figures.settings import RobotFigureSettings
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.hardware import BUILT
from bp2_rl.robot.model import load_model
from bp2_rl.simulation import simulator


@pytest.fixture(autouse=True)
def settled_soon(monkeypatch):
    """Shorten the time in which the robot settles; what is left of its sway is less
    than a cm."""
    monkeypatch.setattr(simulator, "SETTLING_TIME", 0.3)


def test_the_dimensions_are_the_papers():
    drawn = robot(RobotFigureSettings())
    assert drawn.results.standing_height == pytest.approx(0.55, abs=0.02)
    assert (drawn.results.length, drawn.results.width) == pytest.approx(
        (0.80, 0.44), abs=1e-3
    )
    assert drawn.results.mass == pytest.approx(4 * (6.15 + 2.2 + 0.1 + 0.5))
    assert drawn.results.parameters["m_1"] == 2.2
    assert {line[0] for line in drawn.tables[0].lines} >= {
        "m_0",
        "I_3",
        "L_3",
        "l_3",
        "k_d",
    }


def test_a_wider_robot_is_measured_to_be_wider():
    wide = measure_robot(BUILT.changed(fore_track=BUILT.bp2.fore_track + 0.06))
    assert wide.width == pytest.approx(0.50, abs=1e-3)


@pytest.mark.parametrize(
    ("plane", "near"), [((0, 2), {"FR", "RR"}), ((1, 2), {"FR", "FL", "trunk"})]
)
def test_what_is_nearest_is_drawn_last(plane, near):
    """From the right (y < 0) the right legs, from the front (x > 0) the fore legs and
    the visor."""
    model = load_model(BUILT)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    parts = outlines(model, data, plane)
    assert {part.name for part in parts} == {"trunk", *LEGS}
    assert {part.name for part in parts[-5:]} <= near
    low, high = extent(parts)
    # Straight legs of 0.7 m, the keyframe aside, from the trunk at 0.55 m; hull points
    # lie on the shapes themselves.
    feet = data.geom_xpos[[model.geom(f"{leg}_foot").id for leg in LEGS]][:, plane]
    assert low[1] == pytest.approx(feet[:, 1].min() - 0.02, abs=2e-3)
    assert np.all((feet >= low) & (feet <= high))
