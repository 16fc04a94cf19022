"""Maps with known multipliers: of a matrix, of a driven oscillator, and of a hopper on
a spring."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from bp2_rl.paper.orbits import returns

RNG = np.random.default_rng(0)
KNOWN = np.array([0.8 * np.exp(0.7j), 0.8 * np.exp(-0.7j), -0.5, 0.3, 0.0])


def linear() -> np.ndarray:
    """Return a matrix with the eigenvalues `KNOWN` in skew coordinates."""
    turn = 0.8 * np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    matrix = np.zeros((5, 5))
    matrix[:2, :2] = turn
    matrix[2:, 2:] = np.diag([-0.5, 0.3, 0.0])
    skew = np.random.default_rng(5).standard_normal((5, 5))
    return skew @ matrix @ np.linalg.inv(skew)


def test_a_fit_finds_the_multipliers_of_a_linear_map():
    matrix, at = linear(), np.arange(5.0)
    before = at + RNG.standard_normal((40, 5))
    fitted = returns.fit(before, before @ matrix.T + 1.0)
    np.testing.assert_allclose(fitted.matrix, matrix, atol=1e-10)
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(fitted.matrix)),
        np.sort_complex(KNOWN),
        atol=1e-10,
    )
    np.testing.assert_allclose(fitted.offset, np.ones(5), atol=1e-9)
    assert fitted.unexplained < 1e-20
    assert fitted.radius == pytest.approx(0.8, rel=1e-9)


def test_the_interval_holds_the_truth_as_often_as_it_says():
    """Noisy strides of the linear map itself: 40 experiments, of which 95 % are 38, and
    4 deviations less 32."""
    matrix, holds, wide = linear(), 0, []
    rng = np.random.default_rng(1)
    for experiment in range(40):
        states = np.zeros((201, 5))
        for k in range(200):
            states[k + 1] = matrix @ states[k] + rng.standard_normal(5)
        before, after = states[:-1], states[1:]
        radius = returns.fit(before, after).radius
        low, high = returns.interval(
            radius, returns.bootstrap(before, after, 60, experiment)
        )
        holds += low <= 0.8 <= high
        wide.append(high - low)
    assert holds >= 32
    assert np.median(wide) < 0.25  # and it says something


def test_a_driven_oscillator_has_the_multipliers_of_its_exponential():
    """x'' + 2 d x' + w^2 x = cos(2 pi t), strobed by the drive: exp(A), whose
    determinant is exp(-2 d)."""
    d, w = 0.3, 2.0
    a = np.array([[0.0, 1.0], [-(w**2), -2.0 * d]])

    def strobe(states):
        def rate(t, y):
            x = y.reshape(-1, 2)
            return (x @ a.T + np.array([0.0, 1.0]) * np.cos(2.0 * np.pi * t)).ravel()

        ends = solve_ivp(rate, (0.0, 1.0), states.ravel(), rtol=1e-11, atol=1e-12).y[
            :, -1
        ]
        return ends.reshape(-1, 2)

    before = np.array([0.2, -0.1]) + RNG.standard_normal((6, 2))
    found = returns.fit(before, strobe(before))
    np.testing.assert_allclose(found.matrix, expm(a), atol=1e-8)
    assert found.radius == pytest.approx(np.exp(-d), abs=1e-8)
    assert np.linalg.det(found.matrix) == pytest.approx(np.exp(-2.0 * d), abs=1e-8)


class Hopper:
    """A mass that hops on a spring, as a map from apex to apex; speed v goes along.

    Landing leaves a share r of the energy of falling, and a share rho of the speed (and
    kappa of what the apex is too high). Where the spring is shortest, by d, its rest
    length jumps by b: with H the apex over the landing height,

        d = (m g + sqrt((m g)^2 + 2 k m g r H)) / k,      m g H' = r m g H + k b d + k b^2 / 2
        v' = rho v + kappa (H - H0)

    so that the multipliers are dH'/dH = r (1 + k b / sqrt((m g)^2 + 2 k m g r H)) and
    rho.
    """

    m, k, g, r, b, rho, kappa, length = 36.0, 12e3, 9.81, 0.7, 0.02, 0.6, 0.9, 0.5

    @property
    def height(self) -> float:
        """Apex height of the periodic hop, H0, by bisection of the energy balance."""
        low, high = 1e-6, 5.0
        for _ in range(200):
            h = 0.5 * (low + high)
            gain = self.k * self.b * self.compression(h) + 0.5 * self.k * self.b**2
            low, high = (
                (h, high) if gain > (1.0 - self.r) * self.m * self.g * h else (low, h)
            )
        return low

    def compression(self, h: float) -> float:
        return (self.m * self.g + self.root(h)) / self.k

    def root(self, h: float) -> float:
        return np.sqrt(
            (self.m * self.g) ** 2 + 2.0 * self.k * self.m * self.g * self.r * h
        )

    def multipliers(self) -> list[float]:
        return [self.r * (1.0 + self.k * self.b / self.root(self.height)), self.rho]

    def hop(self, states):
        return np.stack([self.one_hop(*state) for state in states])

    def one_hop(self, h: float, v: float) -> tuple[float, float]:
        """Return height and speed after one simulated hop: fall, stance in two halves,
        flight."""
        speed = -np.sqrt(self.r * 2.0 * self.g * h)
        bottom = self.stance(self.length, speed, self.length, lambda _, y: y[1])
        lift = self.stance(
            bottom[0],
            0.0,
            self.length + self.b,
            lambda _, y: y[0] - self.length - self.b,
        )
        # In flight the leg takes back what it was lengthened by; the apex counts from
        # the landing height.
        apex = lift[0] + lift[1] ** 2 / (2.0 * self.g) - self.length
        return apex, self.rho * v + self.kappa * (h - self.height)

    def stance(self, z, speed, rest, event):
        event.terminal, event.direction = True, 1.0

        def rate(_, y):
            return [y[1], self.k * (rest - y[0]) / self.m - self.g]

        return solve_ivp(
            rate, (0.0, 2.0), [z, speed], events=event, rtol=1e-10, atol=1e-12
        ).y_events[0][0]


def test_a_hopper_on_a_spring_has_the_multipliers_of_its_energy():
    hopper = Hopper()
    at = np.array([hopper.height, 0.0])
    # it hops on and on
    np.testing.assert_allclose(hopper.hop(at[None])[0], at, atol=1e-8)
    off = 1e-3 * np.random.default_rng(2).standard_normal((20, 2))
    fitted = returns.fit(off, hopper.hop(at + off) - at)
    # The map bends: deviations of 1e-3 m see 1e-3 / .1 m of it.
    np.testing.assert_allclose(
        np.sort(np.abs(np.linalg.eigvals(fitted.matrix))),
        sorted(hopper.multipliers()),
        atol=0.01,
    )
    assert 0.7 < fitted.radius < 1.0


def test_what_cannot_be_fitted_is_refused():
    with pytest.raises(ValueError, match="5 states do not determine"):
        returns.fit(np.zeros((5, 5)), np.zeros((5, 5)))
