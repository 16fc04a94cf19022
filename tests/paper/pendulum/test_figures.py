"""The pictures of the pendulums: nothing covers anything else, and what they say and
show is what was found."""

from itertools import combinations

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bp2_rl.paper.pendulum.exchange import exchange_figure, exchanges
from bp2_rl.paper.pendulum.gaits import gait_torques, gaits_figure
from bp2_rl.paper.pendulum.reduction import reduction_figure, reduction_maps
from bp2_rl.paper.pendulum.sections import sections, sections_figure
from bp2_rl.paper.pendulum.settings import MASS_RATIO
from bp2_rl.paper.pendulum.torque import prescribe, torque_figure
from bp2_rl.paper.pendulum.trapping import thresholds, trapping_figure

A = 1.4
FIGURES = {
    "exchange": exchange_figure,
    "sections": sections_figure,
    "torque": torque_figure,
    "reduction": reduction_figure,
    "trapping": trapping_figure,
    "gaits": gaits_figure,
}


@pytest.fixture(scope="module")
def found() -> dict:
    ratios = 0.5, 1.0, 4.0, MASS_RATIO
    return {
        "exchange": exchanges(A, [5.0, 10.0], 8.0),
        "sections": sections(A, [5.0, 100.0], 20.0),
        "torque": prescribe(1.0, 1.0, np.pi / 4.0, 5.0, 1.0),
        "reduction": [reduction_maps(ratio, 10.0) for ratio in ratios],
        "trapping": list(thresholds([A])),
        "gaits": [gait_torques(ratio, 0.6, 3.8) for ratio in (MASS_RATIO, 1.0)],
    }


@pytest.fixture(scope="module")
def figures(found) -> dict[str, Figure]:
    return {name: draw(found[name]) for name, draw in FIGURES.items()}


@pytest.mark.parametrize("name", FIGURES)
def test_no_title_label_remark_or_legend_covers_another(name, figures):
    figure = figures[name]
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    texts = [text for axes in figure.axes for text in (axes.title, *axes.texts)]
    texts += [axes._left_title for axes in figure.axes]
    texts += [
        label
        for axes in figure.axes
        if axes.axison
        for label in (axes.xaxis.label, axes.yaxis.label)
    ]
    boxes = [
        text.get_window_extent(canvas.get_renderer())
        for text in texts
        if text.get_text()
    ]
    legends = [legend for part in (figure, *figure.subfigs) for legend in part.legends]
    legends += [axes.get_legend() for axes in figure.axes if axes.get_legend()]
    assert legends
    boxes += [legend.get_window_extent(canvas.get_renderer()) for legend in legends]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    width, height = canvas.get_width_height()
    assert all(
        box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height
        for box in boxes
    )


def test_drawing_leaves_matplotlib_as_it_was(found):
    before = dict(mpl.rcParams)
    gaits_figure(found["gaits"])
    assert dict(mpl.rcParams) == before


def said(figure: Figure) -> str:
    texts = [text for axes in figure.axes for text in axes.texts]
    texts += [
        text
        for axes in figure.axes
        if (legend := axes.get_legend())
        for text in legend.get_texts()
    ]
    return "\n".join(
        [axes.get_title(loc="left") for axes in figure.axes]
        + [text.get_text() for text in texts]
    )


def drawn(figure: Figure) -> list[np.ndarray]:
    return [np.asarray(line.get_ydata()) for axes in figure.axes for line in axes.lines]


def shows(figure: Figure, values: np.ndarray) -> bool:
    return any(
        len(line) == len(values) and np.array_equal(line, values)
        for line in drawn(figure)
    )


def test_the_numbers_in_the_pictures_are_those_of_the_report(found, figures):
    for run in found["exchange"]:
        one = run.sharing
        assert (
            f"means {one.mean[0]:.3f} / {one.mean[1]:.3f}, beam {one.mean_beam:.3f}"
            in said(figures["exchange"])
        )
    for section in found["sections"]:
        assert f"{section.path.apart:.2f} apart" in said(figures["sections"])
    torque, text = found["torque"], said(figures["torque"])
    assert f"peak {torque.rows[0].peak[0]:.3f}, r.m.s. " in text
    assert all(f"{max(row.peak):.3f}" in text for row in torque.rows)
    assert all(
        f"R = {one.reduction.mass_ratio:.3g}" in said(figures["reduction"])
        for one in found["reduction"]
    )
    (threshold,) = found["trapping"]
    middle = (threshold.exchanges + threshold.traps) / 2
    assert f"{middle:.1f}" in said(figures["trapping"])
    rows = [label.get_text() for label in figures["gaits"].axes[0].get_yticklabels()]
    assert rows == [f"{gait.gait}, {gait.order:.2f}" for gait in found["gaits"][0]]


def test_the_curves_in_the_pictures_are_those_of_the_report(found, figures):
    for run in found["exchange"]:
        for values in (
            run.means.pendulums[:, 1],
            run.means.beam,
            run.means.beam_frame[:, 0],
            run.energies.beam,
        ):
            assert shows(figures["exchange"], values)
    for section in found["sections"]:
        assert shows(figures["sections"], section.rate[:, 1])
    torque = found["torque"]
    assert shows(
        figures["torque"], np.append(torque.cycle.free[:, 1], torque.cycle.free[0, 1])
    )
    assert shows(figures["torque"], torque.root_mean_squares.max(axis=-1))
    for one in found["reduction"]:
        assert shows(figures["reduction"], np.full(2, one.reduction.boundary))
        images = [
            mesh.get_array()
            for axes in figures["reduction"].axes
            for mesh in axes.collections
        ]
        assert any(
            np.array_equal(np.ravel(image), one.over_amplitude.ravel())
            for image in images
            if image is not None
        )
    for axes, gaits in zip(figures["gaits"].axes, found["gaits"], strict=True):
        dots = [np.asarray(line.get_xdata()).tolist() for line in axes.lines]
        assert [gait.peak for gait in gaits] in dots
