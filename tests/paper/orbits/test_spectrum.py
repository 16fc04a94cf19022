import numpy as np
import pytest

from bp2_rl.paper.orbits.spectrum import spectrum


def clock_of(cycles=20.3, samples=6000, start=0.4):
    return start + cycles * np.arange(samples) / samples


def test_a_signals_variance_is_shared_among_its_harmonics():
    clock = clock_of()
    turn = 2.0 * np.pi * clock
    found = spectrum(
        3.0
        + 2.0 * np.sin(2 * turn)
        + 1.0 * np.cos(turn)
        + 0.5 * np.cos(3 * turn + 1.0),
        clock,
    )
    # Variances 2, 1/2 and 1/8. Interpolation between 300 samples a cycle takes 1e-3 off
    # the third harmonic at most.
    total = 2.0 + 0.5 + 0.125
    assert found.peak == pytest.approx(2.0)
    assert found.even == pytest.approx(2.0 / total, abs=1e-3)
    assert found.odd == pytest.approx(0.625 / total, abs=1e-3)
    assert found.between < 1e-5
    assert found.leakage("even") == pytest.approx(0.625 / total, abs=1e-3)
    assert found.leakage("odd") == pytest.approx(2.0 / total, abs=1e-3)
    assert np.sum(found.power) == pytest.approx(1.0)


def test_what_repeats_every_other_cycle_lies_between_the_harmonics():
    clock = clock_of(cycles=21.0, start=0.0)
    found = spectrum(np.sin(2.0 * np.pi * clock) + np.sin(np.pi * clock), clock)
    assert found.cycles == 20
    assert found.between == pytest.approx(0.5, abs=1e-3)
    assert found.odd == pytest.approx(0.5, abs=1e-3)


def test_a_clock_that_hurries_does_not_smear_the_lines():
    at = np.linspace(0.0, 1.0, 8000)
    clock = 20.0 * at + 4.0 * at**2
    found = spectrum(np.cos(4.0 * np.pi * clock), clock)
    assert found.even > 0.9999


def test_noise_is_as_strong_everywhere():
    clock = clock_of(cycles=200.5, samples=200 * 256)
    found = spectrum(np.random.default_rng(0).standard_normal(len(clock)), clock)
    # of 200 lines from one harmonic to the next one is on a harmonic
    assert found.between > 0.98


def test_without_a_whole_cycle_there_is_none():
    with pytest.raises(ValueError, match="whole cycle"):
        spectrum(np.zeros(10), np.linspace(0.1, 0.9, 10))
