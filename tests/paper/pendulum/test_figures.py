"""The pendulums' pictures: nothing covers anything else, and all texts and curves show
what was found."""

import numpy as np
import pytest
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


def drawn(figure: Figure) -> list[np.ndarray]:
    return [np.asarray(line.get_ydata()) for axes in figure.axes for line in axes.lines]


def shows(figure: Figure, values: np.ndarray) -> bool:
    return any(
        len(line) == len(values) and np.array_equal(line, values)
        for line in drawn(figure)
    )


def test_the_curves_in_the_pictures_are_those_of_the_report(found, figures):
    for run in found["exchange"]:
        for values in (
            run.means.pendulums[:, 1],
            run.means.beam,
            run.energies.beam,
        ):
            assert shows(figures["exchange"], values)
    for section in found["sections"]:
        assert shows(figures["sections"], section.rate[:, 1])
    torque = found["torque"]
    assert shows(
        figures["torque"], np.append(torque.cycle.free[:, 1], torque.cycle.free[0, 1])
    )
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
