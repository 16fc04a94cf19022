"""The pictures of trajectories: they draw without a warning, say what they show, and
show what was solved."""

import dataclasses

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from bp2_rl.optimiser.collocation import cold_guess
from bp2_rl.optimiser.figure import trajectory_figure
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.solution import Solution
from bp2_rl.paper.trajectories.decomposition import (
    Decomposition,
    Trends,
    decompose,
    find_trends,
)
from bp2_rl.paper.trajectories.figures import (
    coupling_figure,
    decomposition_figure,
)


def at_speed(solution: Solution, speed: float) -> Solution:
    return dataclasses.replace(
        solution, problem=dataclasses.replace(solution.problem, speed=speed)
    )


@pytest.fixture(scope="module")
def family(trot) -> list[Solution]:
    """Return one motion under three speeds: enough to draw."""
    return [at_speed(trot, speed) for speed in (12.0, 8.0, 10.0)]


@pytest.fixture(scope="module")
def terms(trot) -> Decomposition:
    return decompose(trot)


@pytest.fixture(scope="module")
def trends(family) -> Trends:
    return find_trends(family)


@pytest.fixture(scope="module")
def figures(trot, terms, trends) -> dict[str, Figure]:
    return {
        "decomposition": decomposition_figure(terms, trends),
        "trajectory": trajectory_figure(trot),
        "coupling": coupling_figure(terms),
    }


def panel(figure: Figure, letter: str) -> Axes:
    return next(
        axes
        for axes in figure.axes
        if axes.get_title(loc="left").startswith(f"{letter} ")
    )


@pytest.mark.parametrize(
    ("name", "letter"),
    [*(("decomposition", letter) for letter in "ABC"), ("coupling", "A")],
)
def test_what_stands_above_the_line_balances_what_hangs_below(name, letter, figures):
    areas = [
        area
        for area in panel(figures[name], letter).collections
        if isinstance(area, PolyCollection)
    ]
    heights = np.concatenate(
        [np.asarray(path.vertices)[:, 1] for area in areas for path in area.get_paths()]
    )
    # The terms balance at the mesh points to 1e-6, and so do their straight lines in
    # between.
    assert np.max(heights) == pytest.approx(-np.min(heights), abs=1e-5)
    assert np.max(heights) > 50.0


def test_half_a_robot_on_two_legs_is_drawn_too():
    problem = Problem(gait="two-leg", intervals=4)
    guess = Solution(
        problem=problem,
        motion=cold_guess(problem),
        cost=0.0,
        violation=0.0,
        iterations=0,
        seconds=0.0,
    )
    FigureCanvasAgg(trajectory_figure(guess)).draw()
    figure = decomposition_figure(
        decompose(guess), find_trends([guess, at_speed(guess, 8.0)])
    )
    assert "H" in panel(figure, "B").get_title(loc="left")
    FigureCanvasAgg(figure).draw()
