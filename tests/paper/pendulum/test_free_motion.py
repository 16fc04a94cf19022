"""Free motion of pendulums, against conserved quantities, closed forms and
quadratures."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicHermiteSpline
from scipy.special import ellipk

from bp2_rl.paper.pendulum import beam
from bp2_rl.paper.pendulum.beam import NATURAL_PERIOD, SwingMotion, swing
from bp2_rl.paper.pendulum.exchange import exchanges

EXACT = 1e-13  # tolerance of the integration where a period is wanted to 1e-9


def over(periods: float, samples: int) -> np.ndarray:
    """Return times over `periods` natural periods, with `samples` in each."""
    return np.linspace(0.0, periods * NATURAL_PERIOD, round(periods * samples) + 1)


def in_phase_frequency(mass_ratio: float) -> float:
    """Return the frequency, over w0, of two small swings in phase. In antiphase it is
    1, and the beam rests."""
    return math.sqrt(1.0 + 2.0 / mass_ratio)


def period(motion: SwingMotion) -> np.ndarray:
    """Return the mean period of each system of pendulums, by its last pendulum's
    passages to the left."""
    periods = []
    for system in range(len(motion.mass_ratio)):
        angle = CubicHermiteSpline(
            motion.time, motion.theta[:, system, -1], motion.rate[:, system, -1]
        )
        passages = angle.roots(extrapolate=False)
        passages = passages[angle(passages, 1) < 0.0]
        periods.append((passages[-1] - passages[0]) / (len(passages) - 1))
    return np.array(periods)


def small_swing(amplitude: float, time: np.ndarray, mass_ratio: float) -> np.ndarray:
    """Return the angles of two pendulums after one is released at a small angle."""
    slow, fast = np.cos(time), np.cos(in_phase_frequency(mass_ratio) * time)
    return np.stack((fast + slow, fast - slow), axis=-1) * amplitude / 2.0


def antiphase_period(amplitude: float) -> float:
    """Return the period, in 1 / w0, of two pendulums in antiphase at any amplitude: the
    beam rests."""
    return 4.0 * float(ellipk(math.sin(amplitude / 2.0) ** 2))


def in_phase_period(amplitude: float, mass_ratio: float, pendulums: int = 2) -> float:
    """Return the period, in 1 / w0, of pendulums that swing as one at any amplitude, by
    quadrature.

    Energy and momentum leave th'^2 = 2 (cos th - cos A) / (1 - n cos^2 th / (R + n));
    with sin(th/2) = k sin(psi) and k = sin(A/2) the time over a quarter is an integral
    of a smooth function.
    """
    k = math.sin(amplitude / 2.0)

    def slowness(psi: float) -> float:
        half = (k * math.sin(psi)) ** 2  # sin^2(th / 2)
        return math.sqrt(
            (1.0 - pendulums * (1.0 - 2.0 * half) ** 2 / (mass_ratio + pendulums))
            / (1.0 - half)
        )

    return 4.0 * quad(slowness, 0.0, math.pi / 2.0, epsabs=1e-13, epsrel=1e-13)[0]


def test_energy_and_momentum_are_kept_for_forty_periods():
    released = np.array(
        [(np.pi / 3.0, 0.0), (np.pi / 3.0, 0.0), (1.0, -0.4), (2.0, 1.5), (2.0, 1.5)]
    )
    motion = swing(released, np.array([1.0, 50.0, 5.0, 1.0, 5.0]), over(40.0, 20))
    energies = motion.energies
    kept = energies.pendulums.sum(axis=-1) + energies.beam
    np.testing.assert_allclose(kept, np.broadcast_to(kept[0], kept.shape), atol=1e-9)
    momentum = beam.momentum(
        motion.theta, motion.rate, motion.beam_rate, motion.mass_ratio
    )
    np.testing.assert_allclose(momentum, 0.0, atol=1e-9)
    # So the centre of mass stays where it was.
    place = (motion.mass_ratio + 2.0) * motion.beam_position + np.sin(motion.theta).sum(
        axis=-1
    )
    np.testing.assert_allclose(place, np.broadcast_to(place[0], place.shape), atol=1e-9)


def test_in_antiphase_the_beam_rests_and_the_period_is_a_pendulums():
    amplitude = np.array([0.1, 1.0, 2.5, 1.0])
    motion = swing(
        amplitude[:, None] * (-1.0, 1.0),
        np.array([1.0, 1.0, 1.0, 50.0]),
        over(8.0, 500),
        EXACT,
    )
    np.testing.assert_allclose(motion.beam_position, 0.0, atol=1e-12)
    # Cubics between samples are right to 1e-9, and the mean is over six periods.
    np.testing.assert_allclose(
        period(motion), [antiphase_period(one) for one in amplitude], atol=1e-9
    )


def test_in_phase_the_period_is_that_of_the_quadrature():
    amplitude, mass_ratio = (
        np.array([0.1, 1.0, 2.5, 1.0]),
        np.array([1.0, 1.0, 5.0, 50.0]),
    )
    motion = swing(
        np.repeat(amplitude[:, None], 2, axis=1), mass_ratio, over(8.0, 2000), EXACT
    )
    expected = [
        in_phase_period(*one) for one in zip(amplitude, mass_ratio, strict=True)
    ]
    np.testing.assert_allclose(period(motion), expected, atol=1e-9)


def test_four_in_phase_keep_the_period_of_their_quadrature():
    motion = swing(np.full((1, 4), 0.8), np.array([8.8]), over(8.0, 2000), EXACT)
    np.testing.assert_allclose(
        period(motion), in_phase_period(0.8, 8.8, pendulums=4), atol=1e-9
    )


def test_small_swings_are_the_two_modes():
    # what the closed form leaves out is of the order of A^2 a radian: 2e-7 over 40
    # periods
    small = 3e-5
    ratios = np.array([0.5, 1.0, 10.0])
    motion = swing(np.tile((small, 0.0), (3, 1)), ratios, over(40.0, 20), EXACT)
    expected = np.stack(
        [small_swing(small, motion.time, ratio) for ratio in ratios], axis=1
    )
    np.testing.assert_allclose(motion.theta / small, expected / small, atol=1e-6)


def test_a_beam_too_heavy_to_move_leaves_pendulums_alone():
    motion = swing(np.array([1.0, 0.0]), np.array(1e9), over(10.0, 20))
    np.testing.assert_allclose(motion.theta[:, 1], 0.0, atol=1e-6)


# --- Who has the energy ---------------------------------------------------------------


def test_long_averages_of_small_swings_are_the_closed_form():
    # The fast mode is twice or three times as fast as the slow one, so that whole
    # periods average exactly.
    ratios = (2.0 / 3.0, 0.25)
    assert [in_phase_frequency(ratio) for ratio in ratios] == pytest.approx([2.0, 3.0])
    for ratio, run in zip(ratios, exchanges(1e-3, ratios, periods=10.0), strict=True):
        of_beam = 1.0 / (2.0 * (ratio + 2.0))
        pendulum = 0.5 * (1.0 - of_beam)
        shares = (
            np.array([*run.sharing.mean, run.sharing.mean_beam]) / run.sharing.energy
        )
        # What the closed form leaves out is of the order of A^2.
        np.testing.assert_allclose(shares, [pendulum, pendulum, of_beam], atol=1e-6)


def test_from_sixty_degrees_the_means_are_those_of_another_program():
    printed = {
        1.0: ((0.225, 0.225), 0.050, 2.8),
        2.0: ((0.228, 0.232), 0.040, 4.4),
        5.0: ((0.238, 0.240), 0.022, 9.6),
        10.0: ((0.232, 0.257), 0.011, 19.0),
    }
    for run in exchanges(np.pi / 3.0, list(printed), periods=40.0):
        sharing = run.sharing
        means, of_beam, even_after = printed[sharing.mass_ratio]
        # To the digits that it printed.
        assert sharing.mean == pytest.approx(means, abs=6e-4)
        assert sharing.mean_beam == pytest.approx(of_beam, abs=6e-4)
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
