import io

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.text import Text
from PIL import Image

from bp2_rl.base.plotting import NARROW, moving_mean
from bp2_rl.simulation.figures import FIGURES


def draw(name, run):
    buffer = io.BytesIO()
    FIGURES[name][0](run).savefig(buffer, format="png")
    return np.asarray(Image.open(buffer).convert("RGB")).astype(int)


@pytest.mark.parametrize("name", FIGURES)
def test_figures_show_the_run(name, make_run, busy_run):
    still_run = make_run(speed=1e-3, foot_force=np.zeros((8000, 4, 3)))
    busy, still = draw(name, busy_run), draw(name, still_run)
    assert busy.shape[1] >= 1200  # pixels: legible on a page
    assert busy.shape == still.shape
    assert np.mean(np.any(busy != still, axis=-1)) > 0.01
    # the shortest of falls can be drawn, too
    assert draw(name, make_run(duration=0.002, fell_at=0.002)).size > 0


def test_drawing_leaves_matplotlib_as_it_was(busy_run):
    before = dict(mpl.rcParams)
    FIGURES["speed"][0](busy_run)
    assert dict(mpl.rcParams) == before


def test_points_outside_the_envelope_would_be_seen(make_run):
    torque = np.zeros((8000, 12))
    torque[:, 1] = 150.0
    panel = FIGURES["torque_speed"][0](make_run(torque=torque)).axes[1]
    assert panel.get_ylim()[1] > 150.0


def test_the_moving_mean_of_a_line_is_the_line():
    line = np.linspace(0.0, 3.0, 50)
    # centred at the ends, too
    np.testing.assert_allclose(moving_mean(line, 11), line, atol=1e-14)
    pair = np.stack([line, -line], axis=-1)
    np.testing.assert_allclose(moving_mean(pair, 11), pair, atol=1e-14)


def test_the_moving_mean_takes_out_a_whole_period():
    wave = np.sin(2 * np.pi * np.arange(100) / 11)
    np.testing.assert_allclose(moving_mean(wave, 11)[5:-5], 0.0, atol=1e-14)


@pytest.mark.parametrize("name", FIGURES)
def test_letters_are_legible_on_a_telephone_and_axes_are_named_with_units(
    name, busy_run
):
    """Shown 350 pixels wide, the smallest are 8 pixels high or more, and no letter is
    beyond the edge."""
    figure = FIGURES[name][0](busy_run, NARROW)
    figure.draw_without_rendering()
    words = [
        text
        for text in figure.findobj(Text)
        if text.get_text().strip() and text.get_visible()
    ]
    scale = 350 / (72 * NARROW)
    assert min(float(text.get_fontsize()) for text in words) * scale >= 8.0
    drawn = figure.get_tightbbox()
    assert -0.01 < drawn.x0 < drawn.x1 < NARROW + 0.01
    labels = [
        label
        for axes in figure.axes
        for label in (axes.get_xlabel(), axes.get_ylabel())
        if label
    ]
    assert len(labels) >= 2
    assert all("[" in label for label in labels)
