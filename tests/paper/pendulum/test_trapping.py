"""Self-trapping, against the specification's own script and the law for small
swings."""

import numpy as np
import pytest

from bp2_rl.paper.pendulum import exact
from bp2_rl.paper.pendulum.trapping import sweep_ratios, thresholds


def test_from_sixty_degrees_a_beam_of_20_exchanges_and_one_of_22_traps():
    sweep = sweep_ratios(np.pi / 3.0, np.array([5.0, 20.0, 22.0]), 100.0)
    assert sweep.trapped == (False, False, True)
    assert sweep.greatest[1] > 0.95  # the one that hung gets all there is
    assert sweep.greatest[2] < 0.5
    # Where they exchange, each has the same in the long run, whatever the mass ratio.
    assert sweep.mean[0] == pytest.approx(sweep.mean[0][::-1], abs=0.02)
    totals = [
        sum(mean) + beam for mean, beam in zip(sweep.mean, sweep.mean_beam, strict=True)
    ]
    # the energy is kept to 1e-8 a step
    assert totals == pytest.approx([1.0, 1.0, 1.0], abs=1e-4)


def test_the_threshold_is_between_what_exchanges_and_what_traps_and_below_the_law():
    (threshold,) = thresholds([1.4])
    assert threshold.law == exact.trapping_ratio(1.4) == pytest.approx(32.0 / 1.96)
    assert threshold.exchanges < threshold.traps < 1.02 * threshold.exchanges
    sweep = sweep_ratios(1.4, np.array([threshold.exchanges, threshold.traps]), 40.0)
    assert sweep.trapped == (False, True)
    assert threshold.off_law < 1.0
