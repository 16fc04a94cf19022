"""Who has the energy, against closed forms and against the specification's own
script."""

import numpy as np
import pytest

from bp2_rl.paper.pendulum import exact
from bp2_rl.paper.pendulum.exchange import exchanges


def test_long_averages_of_small_swings_are_the_closed_form():
    # The fast mode is twice or three times as fast as the slow one, so that whole
    # periods average exactly.
    ratios = (2.0 / 3.0, 0.25)
    assert [exact.in_phase_frequency(ratio) for ratio in ratios] == pytest.approx(
        [2.0, 3.0]
    )
    for ratio, run in zip(ratios, exchanges(1e-3, ratios, periods=10.0), strict=True):
        pendulum, beam = exact.shares(ratio)
        shares = (
            np.array([*run.sharing.mean, run.sharing.mean_beam]) / run.sharing.energy
        )
        # What the closed form leaves out is of the order of A^2.
        np.testing.assert_allclose(shares, [pendulum, pendulum, beam], atol=1e-6)
        assert 2.0 * pendulum + beam == pytest.approx(1.0, rel=1e-14)


def test_from_sixty_degrees_the_means_are_those_of_another_program():
    printed = {
        1.0: ((0.225, 0.225), 0.050, 2.8),
        2.0: ((0.228, 0.232), 0.040, 4.4),
        5.0: ((0.238, 0.240), 0.022, 9.6),
        10.0: ((0.232, 0.257), 0.011, 19.0),
    }
    for run in exchanges(np.pi / 3.0, list(printed), periods=40.0):
        sharing = run.sharing
        means, beam, even_after = printed[sharing.mass_ratio]
        # To the digits that it printed.
        assert sharing.mean == pytest.approx(means, abs=6e-4)
        assert sharing.mean_beam == pytest.approx(beam, abs=6e-4)
        assert sharing.even_after == pytest.approx(even_after, abs=0.06)
        assert sharing.energy_drift < 1e-9
        assert sharing.momentum_drift < 1e-9


def test_means_run_from_the_release_and_add_up():
    (run,) = exchanges(1.0, [2.0], periods=8.0)
    total = run.means.pendulums.sum(axis=-1) + run.means.beam
    # the mean of what is kept
    np.testing.assert_allclose(total, run.sharing.energy, atol=1e-9)
    middle = len(run.time) // 2
    # both ends count whole: off by a sample in 400
    crude = run.energies.pendulums[: middle + 1].mean(axis=0)
    np.testing.assert_allclose(run.means.pendulums[middle], crude, atol=2e-3)


def test_means_that_never_get_even_say_so():
    assert exchanges(1.0, [500.0], periods=5.0)[0].sharing.even_after is None
