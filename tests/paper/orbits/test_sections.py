import math

import numpy as np
import pytest
from scipy import stats

from bp2_rl.paper.orbits.sections import (
    CHI_SQUARE_95,
    TRIMMED,
    centroid_drift,
    inliers,
    jitter,
    mahalanobis,
    sample,
    whole_cycles,
)


def test_the_bound_is_that_of_the_chi_square_distribution():
    assert pytest.approx(stats.chi2.ppf(0.95, df=3), rel=1e-12) == CHI_SQUARE_95
    assert (
        pytest.approx(stats.chi2.cdf(CHI_SQUARE_95, df=5) / 0.95, rel=1e-12) == TRIMMED
    )


def test_the_drift_of_a_line_is_two_thirds_of_it():
    """Points 0 to 299 along one axis: thirds' means 49.5 and 249.5; scatter sqrt((n^2 -
    1) / 12)."""
    points = np.zeros((300, 3))
    points[:, 1] = np.arange(300)
    found = centroid_drift(points)
    assert found.moved == pytest.approx(200.0, rel=1e-12)
    assert found.scatter == pytest.approx(math.sqrt((300**2 - 1) / 12), rel=1e-12)
    assert found.over_scatter == pytest.approx(200.0 / found.scatter, rel=1e-12)


@pytest.mark.parametrize("count", [99, 300])
def test_independent_points_drift_by_the_floor_however_small_their_scatter(count):
    rng = np.random.default_rng(0)
    for scatter in (1e-6, 1.0):
        drifts = [
            centroid_drift(scatter * rng.standard_normal((count, 3)))
            for _ in range(400)
        ]
        squares = np.mean([drift.over_scatter**2 for drift in drifts])
        # 400 draws of a chi-square of three: 4 % in the mean square, 2 % in its root; 4
        # of these.
        assert math.sqrt(squares) == pytest.approx(drifts[0].floor, rel=0.08)
    assert drifts[0].floor == pytest.approx(math.sqrt(6.0 / count))


def test_still_points_do_not_drift_and_few_have_no_thirds():
    assert centroid_drift(np.ones((30, 3))).over_scatter == 0.0
    with pytest.raises(ValueError, match="5 points"):
        centroid_drift(np.ones((5, 3)))


def test_a_gaussian_has_95_percent_inliers_whatever_its_shape():
    rng = np.random.default_rng(1)
    shape = np.array([[1.0, 0.5, 0.0], [0.0, 2.0, 0.3], [0.0, 0.0, 1e-3]])
    found = inliers(rng.standard_normal((20_000, 3)) @ shape + 7.0)
    assert abs(found.share - 0.95) < 4.0 * found.error
    assert found.error == pytest.approx(math.sqrt(0.95 * 0.05 / 20_000))


def test_points_far_off_are_counted_and_pull_neither_mean_nor_bound():
    rng = np.random.default_rng(2)
    points = rng.standard_normal((1000, 3))
    points[:100] += 30.0
    assert inliers(points).share == pytest.approx(0.9 * 0.95, abs=0.03)
    # has no tails: all but its corners are inliers
    uniform = rng.uniform(-1.0, 1.0, (1000, 3))
    assert inliers(uniform).share > 0.97


def test_distances_are_those_of_scipy_and_directions_without_motion_do_not_count():
    rng = np.random.default_rng(3)
    points = rng.standard_normal((50, 3)) @ rng.standard_normal((3, 3))
    covariance = np.cov(points.T)
    from scipy.spatial.distance import mahalanobis as one

    inverse = np.linalg.inv(covariance)
    expected = [one(point, points[0], inverse) ** 2 for point in points]
    np.testing.assert_allclose(
        mahalanobis(points, points[0], covariance), expected, rtol=1e-8, atol=1e-12
    )
    flat = points * np.array([1.0, 1.0, 0.0])
    assert np.all(np.isfinite(mahalanobis(flat, flat[0], np.cov(flat.T))))


def test_a_clock_strikes_between_samples():
    clock = 0.3 + 0.07 * np.arange(100)
    at = whole_cycles(clock)
    np.testing.assert_allclose(
        np.interp(at, np.arange(100), clock), np.arange(1, 8), atol=1e-12
    )
    wave = np.stack([clock, 2.0 * clock], axis=-1)
    np.testing.assert_allclose(
        sample(wave, at),
        np.stack([np.arange(1, 8), 2 * np.arange(1, 8)], -1),
        atol=1e-12,
    )


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
