"""The pictures of the pendulums: nothing covers anything else, and what they say and
show is what was found."""

from itertools import combinations

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bp2_rl.paper.pendulum import bp2
from bp2_rl.paper.pendulum.exchange import exchange_figure, exchanges
from bp2_rl.paper.pendulum.gaits import compare_gaits, gaits_figure
from bp2_rl.paper.pendulum.prescribed import prescribe, torque_figure
from bp2_rl.paper.pendulum.reduction import reduction_figure, reduction_maps
from bp2_rl.paper.pendulum.sections import sections, sections_figure
from bp2_rl.paper.pendulum.trapping import sweep_ratios, thresholds, trapping_figure

A = 1.4


@pytest.fixture(scope="module")
def found() -> dict:
    return {
        "exchange": exchanges(A, [5.0, 10.0], 8.0),
        "sections": sections(A, [5.0, 100.0], 20.0, "beam"),
        "torque": prescribe(1.0, 1.0, np.pi / 4.0, 5.0, 1.0),
        "reduction": [
            reduction_maps(ratio, 10.0) for ratio in (0.5, 1.0, 4.0, bp2.MASS_RATIO)
        ],
        "trapping": (
            [sweep_ratios(A, np.geomspace(1.0, 50.0, 4), 10.0)],
            list(thresholds([A])),
        ),
        "gaits": compare_gaits((bp2.MASS_RATIO, 1.0), 0.6, 3.8),
    }


@pytest.fixture(scope="module")
def figures(found) -> dict[str, Figure]:
    return {
        "exchange": exchange_figure(found["exchange"]),
        "sections": sections_figure(found["sections"], "beam"),
        "torque": torque_figure(found["torque"]),
        "reduction": reduction_figure(found["reduction"]),
        "trapping": trapping_figure(*found["trapping"]),
        "gaits": gaits_figure(found["gaits"]),
    }


NAMES = ("exchange", "sections", "torque", "reduction", "trapping", "gaits")


@pytest.mark.parametrize("name", NAMES)
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
    assert legends or name == "trapping"
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
    assert (
        f"peak {torque.shown.peak[0]:.3f}, r.m.s. {torque.shown.root_mean_square[0]:.3f}"
        in text
    )
    assert all(f"{max(row.peak):.3f}" in text for row in torque.rows)
    assert all(
        f"R = {one.reduction.mass_ratio:.3g}" in said(figures["reduction"])
        for one in found["reduction"]
    )
    (threshold,) = found["trapping"][1]
    assert f"{(threshold.exchanges + threshold.traps) / 2:.1f}" in said(
        figures["trapping"]
    )
    assert all(gait.gait in said(figures["gaits"]) for gait in found["gaits"].named[0])


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
    (sweep,) = found["trapping"][0]
    assert shows(figures["trapping"], np.array([mean[0] for mean in sweep.mean]))
    assert shows(figures["gaits"], found["gaits"].peak[1])
    assert shows(figures["gaits"], found["gaits"].law[0])
