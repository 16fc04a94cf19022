"""The motors: nothing leaves the torque-speed envelope, and NumPy and JAX are the same
motor."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bp2_rl.robot import actuator as act
from bp2_rl.robot import bp2
from bp2_rl.robot.actuator import Actuator
from bp2_rl.robot.hardware import HardwareSpec, Losses

BP2_MOTOR = Actuator.from_hardware()
STRAIGHT_LINE = Actuator.from_hardware(HardwareSpec(corner_speed=0.0))

# no deadline: the first JAX call compiles
anything = settings(max_examples=1000, deadline=None)
finite = st.floats(-1e6, 1e6)
speeds = st.one_of(st.floats(-60.0, 60.0), finite)


@st.composite
def actuators(draw) -> Actuator:
    """Draw any motor: any gains, corner below no-load speed, strength, lag and rate,
    and no limit on the rate either."""
    no_load = draw(st.floats(1.0, 60.0))
    return Actuator(
        stiffness=draw(st.floats(0.0, 2000.0)),
        damping=draw(st.floats(0.0, 100.0)),
        peak_torque=draw(st.floats(1.0, 500.0)),
        corner_speed=no_load * draw(st.floats(0.0, 0.99)),
        no_load_speed=no_load,
        strength=draw(st.floats(0.1, 2.0)),
        current_lag=draw(st.floats(0.0, 0.1)),
        torque_rate=draw(st.one_of(st.floats(1.0, 1e6), st.just(float("inf")))),
    )


def envelope(motor: Actuator, w: float) -> tuple[float, float]:
    """Return the torque limits read off the envelope's drawing, region by region, for
    one joint at speed w >= 0 or below."""
    peak = motor.strength * motor.peak_torque
    corner, no_load = (
        float(np.asarray(x)) for x in (motor.corner_speed, motor.no_load_speed)
    )
    speed = abs(w)
    driving = peak if speed <= corner else peak * (no_load - speed) / (no_load - corner)
    driving = max(driving, -peak)
    return (-peak, driving) if w >= 0 else (-driving, peak)


@anything
@given(
    motor=actuators(),
    q=finite,
    qd=speeds,
    q_target=finite,
    qd_target=finite,
    previous=finite,
)
def test_torque_never_leaves_the_envelope(motor, q, qd, q_target, qd_target, previous):
    q, qd, q_target, qd_target, previous = (
        np.array([x]) for x in (q, qd, q_target, qd_target, previous)
    )
    torque = float(
        act.joint_torque(motor, previous, q, qd, q_target, qd_target, 1e-3)[0]
    )
    lowest, highest = envelope(motor, float(qd[0]))
    rounding = 1e-9 * motor.strength * motor.peak_torque * (1.0 + abs(float(qd[0])))
    assert lowest - rounding <= torque <= highest + rounding


@anything
@given(motor=actuators(), qd=speeds)
def test_limits_are_the_envelope_and_in_order(motor, qd):
    lower, upper = act.torque_limits(motor, np.array([qd]))
    rounding = 1e-9 * motor.strength * motor.peak_torque * (1.0 + abs(qd))
    assert (lower[0], upper[0]) == pytest.approx(envelope(motor, qd), abs=rounding)
    assert lower[0] <= upper[0]


def test_limits_at_the_points_that_define_them():
    lower, upper = act.torque_limits(
        BP2_MOTOR, np.array([0.0, 14.7, 18.05, 21.4, 30.0, -14.7, -21.4])
    )
    np.testing.assert_allclose(
        upper, [120.0, 120.0, 60.0, 0.0, -120.0, 120.0, 120.0], atol=1e-9
    )
    np.testing.assert_allclose(
        lower, [-120.0, -120.0, -120.0, -120.0, -120.0, -120.0, 0.0], atol=1e-9
    )


@pytest.mark.parametrize(
    ("motor", "power"),
    [(BP2_MOTOR, 1765.0), (STRAIGHT_LINE, 642.0)],
    ids=["corner at 14.7 rad/s: Fig. 5E", "straight back-EMF line"],
)
def test_peak_power(motor, power):
    w = np.linspace(0.0, bp2.NO_LOAD_SPEED, 20001)
    _, upper = act.torque_limits(motor, w)
    # the paper rounds the corner to 14.7
    assert np.max(upper * w) == pytest.approx(power, rel=1e-3)


def test_gear_trades_speed_for_torque():
    motor = Actuator.from_hardware(HardwareSpec(gear_ratio=2 * bp2.GEAR_RATIO))
    assert motor.peak_torque == pytest.approx(240.0)
    assert (motor.corner_speed, motor.no_load_speed) == pytest.approx((7.35, 10.7))


@settings(max_examples=200, deadline=None)
@given(motor=actuators(), data=st.data())
def test_numpy_and_jax_are_the_same_motor(motor, data):
    rows = st.lists(st.floats(-30.0, 30.0, width=32), min_size=12, max_size=12)
    q, qd, q_target, qd_target, previous = (
        np.array(data.draw(rows), np.float32) for _ in range(5)
    )
    on_numpy = act.joint_torque(motor, previous, q, qd, q_target, qd_target, 1e-3)
    on_device = [jnp.asarray(x) for x in (previous, q, qd, q_target, qd_target)]
    on_jax = act.joint_torque(motor, *on_device, dt=1e-3)
    assert on_numpy.dtype == np.float32
    asked = (
        motor.stiffness * (abs(q) + abs(q_target))
        + motor.damping * (abs(qd) + abs(qd_target))
        + abs(previous)
    )
    stall = (
        motor.strength
        * motor.peak_torque
        / (1.0 - motor.corner_speed / motor.no_load_speed)
    )
    # a few float32 roundings of each term
    rounding = 4e-7 * (asked + stall * (1.0 + abs(qd) / motor.no_load_speed))
    np.testing.assert_array_less(abs(on_numpy - np.asarray(on_jax)), rounding + 1e-30)


def test_without_lag_or_limits_the_motor_is_its_pd_law():
    q, qd, previous = (
        np.array([0.1, -0.2]),
        np.array([1.0, -2.0]),
        np.array([50.0, -70.0]),
    )
    torque = act.joint_torque(
        BP2_MOTOR, previous, q, qd, np.array([0.3, -0.3]), np.array([2.0, 0.5]), 1e-3
    )
    np.testing.assert_allclose(
        torque, [250.0 * 0.2 + 3.0 * 1.0, 250.0 * -0.1 + 3.0 * 2.5]
    )


def test_current_lag_is_first_order():
    """A step of 50 Nm reaches 1 - 1/e of itself after one time constant, whatever the
    step size."""
    motor = Actuator.from_hardware(
        HardwareSpec(losses=Losses(current_lag=0.02)), damping=0.0
    )
    zero, target, torque = np.zeros(1), np.full(1, 0.2), np.zeros(1)
    dt = 1e-4
    for _ in range(200):
        torque = act.joint_torque(motor, torque, zero, zero, target, zero, dt)
    # implicit Euler: dt / (2 lag) of error
    assert torque[0] == pytest.approx(50.0 * (1.0 - np.exp(-1.0)), rel=3e-3)


def test_torque_rate_is_limited_both_ways():
    motor = Actuator.from_hardware(torque_rate=5000.0)
    zero = np.zeros(2)
    torque = act.joint_torque(
        motor, zero, zero, zero, np.array([1.0, -1.0]), zero, 1e-3
    )
    np.testing.assert_allclose(torque, [5.0, -5.0])


def test_the_envelope_wins_over_the_rate_limit():
    """A joint that outruns its motor loses its torque at once: the supply has no
    voltage left."""
    motor = Actuator.from_hardware(torque_rate=1000.0)
    fast = np.array([bp2.NO_LOAD_SPEED])
    torque = act.joint_torque(
        motor, np.array([120.0]), np.zeros(1), fast, np.array([1.0]), fast, 1e-3
    )
    np.testing.assert_allclose(torque, 0.0, atol=1e-9)


def test_parameters_broadcast_over_robots_and_joints():
    strength = np.linspace(0.5, 1.0, 3)[:, None]
    gains = np.linspace(100.0, 300.0, 12)
    motor = Actuator.from_hardware(strength=strength, stiffness=gains, damping=0.0)
    zero = np.zeros((3, 12))
    torque = act.joint_torque(
        motor, zero, zero, zero, np.full((3, 12), 1.0), zero, 1e-3
    )
    np.testing.assert_allclose(torque, np.minimum(gains, 120.0 * strength))
