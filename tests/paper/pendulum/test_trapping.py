"""Self-trapping, against the specification's own script and the law for small
swings."""

import numpy as np
import pytest

from bp2_rl.paper.pendulum.trapping import are_trapped, thresholds


def test_from_sixty_degrees_a_beam_of_20_exchanges_and_one_of_22_traps():
    trapped = are_trapped(np.pi / 3.0, np.array([5.0, 20.0, 22.0]), 100.0)
    assert trapped.tolist() == [False, False, True]


def test_the_threshold_is_between_what_exchanges_and_what_traps_and_below_the_law():
    (threshold,) = thresholds([1.4])
    assert threshold.law == pytest.approx(32.0 / 1.96)
    assert threshold.exchanges < threshold.traps < 1.02 * threshold.exchanges
    ratios = np.array([threshold.exchanges, threshold.traps])
    assert are_trapped(1.4, ratios, 40.0).tolist() == [False, True]
    assert threshold.off_law < 1.0
