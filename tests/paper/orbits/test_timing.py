import numpy as np
import pytest

from bp2_rl.paper.orbits.timing import jitter


def test_jitter_is_the_deviation_from_the_clock_and_not_from_the_last_event():
    rng = np.random.default_rng(0)
    period, late = 0.3, 2e-3 * rng.standard_normal(4000)
    times = period * np.arange(4000) + 0.95 * period + late
    found = jitter(times, times / period, period, sampling=1e-3)
    assert found.phase == pytest.approx(0.95, abs=1e-3)
    assert found.jitter == pytest.approx(np.std(late), rel=1e-9)
    # An interval has the jitter of two events.
    assert found.variability == pytest.approx(np.sqrt(2.0) * 2e-3 / period, rel=0.05)


def test_sampling_alone_makes_the_floor():
    """1 ms in a stride of .28 s: a CV of .0015; root mean square over strides that end
    anywhere within a sample."""
    squares = []
    for period in 0.283 + 1e-3 * (np.arange(50) + 0.5) / 50:
        times = np.ceil((period * np.arange(2000)) / 1e-3) * 1e-3
        found = jitter(times, times / period, float(period), sampling=1e-3)
        assert found.floor == pytest.approx(0.0015, abs=1e-4)
        squares.append(found.variability**2)
    assert np.sqrt(np.mean(squares)) == pytest.approx(found.floor, rel=0.02)


def test_two_events_have_none():
    with pytest.raises(ValueError, match="2 events"):
        jitter(np.array([0.0, 1.0]), np.array([0.0, 1.0]), 1.0, 1e-3)
