"""The pictures of trajectories: they draw without a warning, say what they show, and
show what was solved."""

import dataclasses
import io
from itertools import combinations

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from PIL import Image

from bp2_rl.base.plotting import QUIET
from bp2_rl.optimiser.collocation import cold_guess
from bp2_rl.optimiser.figure import LEFT, RIGHT, trajectory_figure
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.solution import Solution
from bp2_rl.paper.trajectories.coupling import account_family, split_sources
from bp2_rl.paper.trajectories.decomposition import (
    TERMS,
    Decomposition,
    Trends,
    decompose,
    find_trends,
)
from bp2_rl.paper.trajectories.figures import (
    TERM_COLORS,
    coupling_figure,
    decomposition_figure,
)

PANELS = {"decomposition": 12, "trajectory": 9, "coupling": 6}


def at_speed(solution: Solution, speed: float) -> Solution:
    return dataclasses.replace(
        solution, problem=dataclasses.replace(solution.problem, speed=speed)
    )


@pytest.fixture(scope="module")
def family(trot) -> list[Solution]:
    """One motion under three names: enough to draw."""
    return [at_speed(trot, speed) for speed in (12.0, 8.0, 10.0)]


@pytest.fixture(scope="module")
def terms(trot) -> Decomposition:
    return decompose(trot)


@pytest.fixture(scope="module")
def trends(family) -> Trends:
    return find_trends(family)


@pytest.fixture(scope="module")
def figures(trot, terms, trends, family) -> dict[str, Figure]:
    return {
        "decomposition": decomposition_figure(terms, trends),
        "trajectory": trajectory_figure(trot),
        "coupling": coupling_figure(split_sources(trot), account_family(family)),
    }


def panel(figure: Figure, letter: str) -> Axes:
    return next(
        axes
        for axes in figure.axes
        if axes.get_title(loc="left").startswith(f"{letter} ")
    )


def curves(axes: Axes, color: str) -> list[np.ndarray]:
    return [
        np.asarray(line.get_ydata())
        for line in axes.lines
        if to_rgba(line.get_color()) == to_rgba(color)
    ]


def pixels(figure: Figure) -> np.ndarray:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return np.asarray(Image.open(buffer).convert("RGB")).astype(int)


@pytest.mark.parametrize("name", PANELS)
def test_every_panel_has_its_letter_and_a_page_can_hold_them(name, figures):
    figure = figures[name]
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert [title.split()[0] for title in titles] == list(
        "ABCDEFGHIJKL"[: PANELS[name]]
    )
    assert all(len(title.split()) > 1 for title in titles)
    height, width, _ = pixels(figure).shape
    assert 1200 <= width < height <= 1700


@pytest.mark.parametrize("name", PANELS)
def test_no_title_label_or_legend_covers_another(name, figures):
    figure = figures[name]
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    texts = [axes.title for axes in figure.axes] + [
        axes._left_title for axes in figure.axes
    ]
    texts += [
        label
        for axes in figure.axes
        if axes.axison
        for label in (axes.xaxis.label, axes.yaxis.label)
    ]
    texts += [text for axes in figure.axes for text in axes.texts]
    boxes = [
        text.get_window_extent(canvas.get_renderer())
        for text in texts
        if text.get_text()
    ]
    boxes += [
        legend.get_window_extent(canvas.get_renderer()) for legend in figure.legends
    ]
    assert len(boxes) > PANELS[name]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    width, height = canvas.get_width_height()
    assert all(
        box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height
        for box in boxes
    )


def test_drawing_leaves_matplotlib_as_it_was(terms, trends):
    before = dict(mpl.rcParams)
    decomposition_figure(terms, trends)
    assert dict(mpl.rcParams) == before


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


def test_bars_by_source_end_where_all_that_is_coupled_stands(figures, family):
    axes = panel(figures["coupling"], "D")
    (dots,) = (
        np.asarray(line.get_ydata()) for line in axes.lines if line.get_marker() == "o"
    )
    np.testing.assert_allclose(
        dots, [account.covered for account in account_family(family)], rtol=1e-12
    )
    bars = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    ends = [
        sum(
            bar.get_height()
            for bar in bars
            if abs(bar.get_x() + bar.get_width() / 2 - x) < 1e-9
        )
        for x in (8, 10, 12)
    ]
    np.testing.assert_allclose(ends, dots, rtol=1e-9)


def test_trends_are_drawn_in_the_terms_colours(figures, trends):
    axes = panel(figures["decomposition"], "F")
    for term in ("gravity", "ground reaction", "centrifugal"):
        (curve,) = curves(axes, TERM_COLORS[term])
        np.testing.assert_array_equal(curve, trends.average[:, TERMS.index(term), 1])
    assert not curves(axes, TERM_COLORS["active"])  # no motor pushes the trunk
    assert len(set(TERM_COLORS.values())) == len(TERMS)


def test_the_centre_of_mass_runs_at_the_commanded_speed(figures, trot):
    (speed,) = curves(panel(figures["trajectory"], "B"), "#1F2328")
    assert np.mean(speed) == pytest.approx(trot.problem.speed, abs=0.1)
    (rise,) = curves(panel(figures["trajectory"], "C"), "#1F2328")
    assert np.min(rise) < 0.0 < np.max(rise)


def test_left_is_blue_and_right_is_red(figures, trot):
    axes = panel(figures["trajectory"], "G")
    left, right = (
        np.nanmax(np.concatenate(curves(axes, color))) for color in (LEFT, RIGHT)
    )
    assert left == pytest.approx(right, rel=1e-9)  # mirror images
    first = trot.motion.force[0]
    assert np.max(first[:, 3]) > 0.0  # FL, with RR
    half = np.size(axes.lines[0].get_ydata()) // 2
    drawn = {
        color: [np.any(np.isfinite(curve[:half])) for curve in curves(axes, color)]
        for color in (LEFT, RIGHT)
    }
    assert drawn == {LEFT: [True, False], RIGHT: [False, True]}


@pytest.mark.parametrize(("letter", "joint"), [("H", 0), ("I", 1)])
def test_torque_stays_between_its_dashed_limits(letter, joint, figures, trot):
    limits = curves(panel(figures["trajectory"], letter), QUIET)
    low, high = sorted(limits, key=np.mean)
    torque = curves(panel(figures["trajectory"], letter), LEFT)[-1]  # RL, drawn last
    assert np.all(low <= high)
    # The solver holds them at the mesh points; what the polynomials on six intervals do
    # in between is not much.
    assert np.mean((torque < low - 1.0) | (torque > high + 1.0)) < 0.1
    assert np.max(high) == pytest.approx(120.0)


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
    assert pixels(trajectory_figure(guess)).size > 0
    figure = decomposition_figure(
        decompose(guess), find_trends([guess, at_speed(guess, 8.0)])
    )
    assert "H" in panel(figure, "B").get_title(loc="left")
    assert pixels(figure).size > 0
