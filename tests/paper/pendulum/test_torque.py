"""Torques of a prescribed motion, against closed forms and against the specification's
own script."""

import numpy as np
import pytest

from bp2_rl.paper.pendulum import exact
from bp2_rl.paper.pendulum.gaits import GAITS, gait_torques, order_parameter
from bp2_rl.paper.pendulum.reduction import SMALL, peak_ratio, reduction_maps
from bp2_rl.paper.pendulum.settings import (
    LEG_LENGTH,
    MASS_RATIO,
    STRIDE_FREQUENCY,
    reduced_frequency,
)
from bp2_rl.paper.pendulum.torque import drive, peak, prescribe, root_mean_square

# amplitude, frequency, mass ratio
SOME = [np.array(value) for value in (1.3, 2.2, 0.7)]


def test_a_peak_between_samples_is_found():
    angle = np.arange(256) * (2.0 * np.pi / 256)
    wave = np.sin(angle + 0.01) + 0.3 * np.sin(3.0 * angle - 1.0)
    fine = np.linspace(0.0, 2.0 * np.pi, 2_000_001)
    expected = np.max(np.abs(np.sin(fine + 0.01) + 0.3 * np.sin(3.0 * fine - 1.0)))
    assert peak(-wave[:, None]) == pytest.approx(expected, rel=1e-7)
    assert peak(np.full((16, 1), -2.0)) == [2.0]


@pytest.mark.parametrize("amplitude", [0.1, 1.0, 3.0])
def test_in_antiphase_coupling_asks_for_nothing(amplitude: float):
    for mass_ratio in (0.05, 1.0, 100.0):
        for frequency in (0.3, 1.0, 30.0):
            some = [np.array(value) for value in (amplitude, frequency, mass_ratio)]
            cycle = drive(np.array([0.4, 0.4 + np.pi]), *some)
            np.testing.assert_allclose(
                cycle.coupled, 0.0, atol=1e-14 * amplitude * (1.0 + frequency**2)
            )


@pytest.mark.parametrize("frequency", [0.4, 0.9, 1.1, 1.4, 3.8, 1e3])
@pytest.mark.parametrize("mass_ratio", [0.5, 1.0, 8.8])
def test_small_swings_have_the_torque_of_the_closed_form(
    frequency: float, mass_ratio: float
):
    phases = np.linspace(0.0, 2.0 * np.pi, 13)
    some = [np.array(value) for value in (SMALL, frequency, mass_ratio)]
    law = exact.small_torque_ratio(phases, *some[1:])
    np.testing.assert_allclose(peak_ratio(phases, *some), law, atol=1e-6)


def test_the_limit_of_fast_swings():
    phases, ratio = np.linspace(0.0, np.pi, 7), 3.0
    limit = np.sqrt(
        1.0 - 2.0 * (1.0 + np.cos(phases)) * (ratio + 1.0) / (ratio + 2.0) ** 2
    )
    np.testing.assert_allclose(
        exact.small_torque_ratio(phases, np.array(1e6), np.array(ratio)),
        limit,
        atol=1e-9,
    )
    assert limit[0] == pytest.approx(ratio / (ratio + 2.0))


@pytest.mark.parametrize("mass_ratio", [0.5, 1.0, 4.0, MASS_RATIO])
def test_a_free_beam_helps_small_swings_above_one_frequency_whatever_their_phase(
    mass_ratio: float,
):
    reduction = reduction_maps(mass_ratio, 10.0).reduction
    assert reduction.boundary**2 == pytest.approx(
        (mass_ratio + 2.0) / (mass_ratio + 1.0), rel=1e-14
    )
    np.testing.assert_allclose(
        np.square(reduction.boundary_measured), reduction.boundary**2, atol=1e-6
    )
    assert reduction.boundary_error < 1e-6
    assert reduction.small_swing_error < 1e-6


def test_wide_swings_gain_less_and_can_lose():
    # To the digits that another program printed, at the limit of fast swings.
    phases, fast, even = (
        np.pi * np.array([0.0, 0.75, 1.0]),
        np.array(1e4),
        np.array(1.0),
    )
    small = peak_ratio(phases, np.array(SMALL), fast, even)
    assert small[0] == pytest.approx(1.0 / 3.0, abs=1e-6)
    wide = peak_ratio(phases, np.array(1.0), fast, even)
    assert wide[:2] == pytest.approx((0.80, 1.06), abs=6e-3)
    assert wide[2] == pytest.approx(1.0, abs=1e-12)


def test_the_papers_motion_needs_three_quarters_of_the_peak_at_any_length():
    case = prescribe(1.0, 1.0, np.pi / 4.0, 5.0, 1.0)
    # To the digits that another program printed.
    expected = {
        1.0: (10.03, 0.746),
        LEG_LENGTH: (5.93, 0.742),
        np.inf: (np.inf, 0.748),
    }
    assert [row.length for row in case.rows] == list(expected)
    for row in case.rows:
        frequency, ratio = expected[row.length]
        assert row.frequency == pytest.approx(frequency, abs=6e-3)
        assert row.peak == pytest.approx((ratio, ratio), abs=6e-4)
        # both alike; to how well a peak is found
        assert row.peak[0] == pytest.approx(row.peak[1], abs=1e-7)
        assert all(0.70 <= ratio <= 0.71 for ratio in row.root_mean_square)
    shown = case.rows[0].peak
    ratio = peak(case.cycle.free) / peak(case.cycle.fixed)
    np.testing.assert_allclose(ratio, shown, rtol=1e-12)


def test_a_length_asked_for_twice_is_shown_once():
    assert [row.length for row in prescribe(1.0, 1.0, 0.5, 5.0, LEG_LENGTH).rows] == [
        LEG_LENGTH,
        np.inf,
    ]


def test_gaits_of_antiphase_pairs_leave_the_beam_at_rest():
    for name in ("trot", "pace", "bound", "walk", "gallop"):
        phases = 2.0 * np.pi * np.array(GAITS[name])
        cycle = drive(phases, *SOME)
        np.testing.assert_allclose(
            cycle.coupled, 0.0, atol=1e-12 * np.max(np.abs(cycle.fixed))
        )
        assert order_parameter(np.array(GAITS[name])) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(
    ("mass_ratio", "half_bound", "pronk"),
    [(MASS_RATIO, (0.99, 1.01), 0.77), (1.0, (0.98, 1.03), 0.42)],
)
def test_other_gaits_gain_what_another_program_found(mass_ratio, half_bound, pronk):
    found = {gait.gait: gait for gait in gait_torques(mass_ratio, 0.6, 3.8)}
    # To the digits that it printed.
    assert (found["half-bound"].least_peak, found["half-bound"].peak) == pytest.approx(
        half_bound, abs=6e-3
    )
    assert found["pronk"].peak == pytest.approx(pronk, abs=6e-3)
    assert found["trot"].peak == pytest.approx(1.0, abs=1e-12)


def test_of_small_swings_the_order_parameter_alone_decides():
    phases = np.random.default_rng(3).random((50, 4))
    frequency, mass_ratio = 3.8, 1.0
    cycle = drive(
        2.0 * np.pi * phases,
        *(np.array(value) for value in (SMALL, frequency, mass_ratio)),
    )
    free, fixed = (
        np.linalg.norm(root_mean_square(torque), axis=-1)
        for torque in (cycle.free, cycle.fixed)
    )
    law = exact.small_gait_ratio(order_parameter(phases), frequency, mass_ratio, legs=4)
    np.testing.assert_allclose(free / fixed, law, atol=1e-6)
    # Two legs are the pendulums of before.
    two = exact.small_gait_ratio(np.array(np.cos(0.35)), frequency, mass_ratio, legs=2)
    assert two == pytest.approx(
        float(exact.small_torque_ratio(*map(np.array, (0.7, frequency, mass_ratio))))
    )


def test_bp2_is_its_trunk_over_its_leg():
    assert pytest.approx(24.6 / 2.8) == MASS_RATIO
    assert reduced_frequency(STRIDE_FREQUENCY, LEG_LENGTH) == pytest.approx(
        3.8, abs=0.01
    )
