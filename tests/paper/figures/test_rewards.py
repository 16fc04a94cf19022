"""Table S4 as a figure: the paper's coefficients, and what its schedule says to the
letter."""

import pytest

from bp2_rl.paper.figures.rewards import ROWS, rewards
from bp2_rl.paper.figures.settings import RewardsFigureSettings
from bp2_rl.settings.presets.rewards import PAPER


@pytest.fixture(scope="module")
def drawn():
    return rewards(RewardsFigureSettings())


def test_every_coefficient_of_the_table_has_a_row(drawn):
    paper = drawn.results.paper
    # As Table S4 prints them, imitation and relaxed.
    printed = {
        "Body height": (0.05, 0),
        "Body attitude": (0.05, 0),
        "Imitation, c_J": (0.6, 0.1),
        "Velocity tracking, c_V": (0.1, 0.4),
        "Torque": (0.1, 0.2),
        "Power": (0, 0.1),
        "Action smoothness": (0.1, 0.2),
        "Straight-running symmetry": (0, 0.1),
        "Terminal": (1, 1),
    }
    assert {
        row: (paper["imitation"][row], paper["relaxed"][row]) for row in ROWS
    } == printed
    # Coefficients beyond the table, ours and yours, count nothing in the paper's
    # columns.
    columns = [vars(config).items() for config in PAPER.values()]
    assert set(ROWS.values()) == {
        name
        for column in columns
        for name, value in column
        if isinstance(value, float) and value
    }


def test_to_the_letter_tracking_loses_weight_where_the_text_has_it_gain(drawn):
    literal, text = drawn.results.literal, drawn.results.text
    # c_v = beta c_V + (1 - beta) c_J with c_J = 0.6, c_V = 0.1 and beta = share^0.3;
    # float32 in between.
    half = 0.5**0.3
    assert (literal.at_rest, literal.at_half, literal.at_top) == pytest.approx(
        (0.6, 0.6 - 0.5 * half, 0.1), abs=1e-6
    )
    assert (text.at_rest, text.at_half, text.at_top) == pytest.approx(
        (0.1, 0.1 + 0.5 * half, 0.6), abs=1e-6
    )
