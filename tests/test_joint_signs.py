"""The picture of the joints' signs: each joint turns the way its title says."""

import runpy
from pathlib import Path

import pytest
from matplotlib import pyplot as plt

SCRIPT = runpy.run_path(str(Path(__file__).parents[1] / "docs" / "joint_signs.py"))


@pytest.fixture
def panels():
    figure = SCRIPT["draw"]()
    yield figure.axes
    plt.close(figure)


def test_each_joint_moves_the_foot_the_way_its_title_says(panels):
    assert [panel.get_title() for panel in panels] == [
        view[0] for view in SCRIPT["VIEWS"]
    ]
    # The last lines drawn are a leg standing, and the leg turned; their last points are
    # the feet.
    (left, _), (back, _), (reach, down) = (
        (turned.get_xydata()[-1] - standing.get_xydata()[-1])
        for *_, standing, turned in (p.lines for p in panels)
    )
    assert left < 0.0  # from behind, left is left
    assert back < 0.0  # from the right, front is right
    assert down < 0.0
    assert abs(reach) > 0.0
