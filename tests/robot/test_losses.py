"""Losses of air, gears, joints and spring slides, and the power bus, against closed
forms."""

import dataclasses
import math

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from bp2_rl.robot import conventions, losses
from bp2_rl.robot.actuator import (
    Actuator,
    bus_power,
    bus_voltage,
    copper_loss,
    joint_torque,
    stall_torque,
    torque_limits,
)
from bp2_rl.robot.hardware import BUILT, IDEAL, HardwareSpec, Losses
from bp2_rl.robot.losses import Resistance, generalized, loss
from bp2_rl.robot.model import SPRING_QVEL, load_model

STANDING = np.r_[0.0, 0.0, 0.6, 1.0, 0.0, 0.0, 0.0, np.tile([0.0, 0.6, -1.2, 0.01], 4)]
STILL, NO_TORQUE = np.zeros(22), np.zeros(12)


def resist(losses: Losses, rebound_damping: float = 0.0) -> Resistance:
    resistance = Resistance.from_hardware(
        HardwareSpec(losses=losses, rebound_damping=rebound_damping)
    )
    assert resistance is not None
    return resistance


def joint_rates(qd: np.ndarray, slides: float = 0.0) -> np.ndarray:
    qvel = STILL.copy()
    qvel[6:] = np.concatenate(
        [qd.reshape(4, 3), np.full((4, 1), slides)], axis=1
    ).ravel()
    return qvel


def test_nothing_resists_the_ideal_robot_and_its_bus_gives_everything():
    assert Resistance.from_hardware(IDEAL) is None
    # there is nothing to blow at
    for nothing in (Losses(headwind=5.0), Losses(joint_friction=(0.0, 0.0, 0.0))):
        assert Resistance.from_hardware(HardwareSpec(losses=nothing)) is None
    assert Actuator.from_hardware(IDEAL).bus is None
    assert Resistance.from_hardware(BUILT) is not None
    assert Actuator.from_hardware(BUILT).bus is not None


def test_drag_is_half_rho_cda_v_squared_against_the_relative_wind():
    air = resist(Losses(drag_area=0.2, headwind=3.0))
    qvel = STILL.copy()
    qvel[:3] = 10.0, 4.0, -2.0
    found = loss(air, STANDING, qvel, NO_TORQUE).air
    speed = math.hypot(13.0, 4.0)
    np.testing.assert_allclose(
        found, [-0.12 * speed * 13.0, -0.12 * speed * 4.0, 0.0], rtol=1e-12
    )
    assert generalized(loss(air, STANDING, qvel, NO_TORQUE), qvel)[:3] == pytest.approx(
        found
    )


@pytest.mark.parametrize(
    ("friction", "viscosity"), [(2.0, 0.05), ((1.0, 2.0, 3.0), (0.0, 0.2, 1.0))]
)
def test_joints_rub_by_coulomb_and_viscosity_against_their_motion(friction, viscosity):
    """Every joint by the robot's number, or by its own."""
    rub = resist(Losses(joint_friction=friction, joint_viscosity=viscosity))
    qd = np.linspace(-20.0, 20.0, 12)
    dry, viscous = (np.resize(x, 12) for x in (friction, viscosity))
    expected = -dry * np.sign(qd) - viscous * qd
    state = STANDING, joint_rates(qd), NO_TORQUE
    np.testing.assert_allclose(loss(rub, *state).joint, expected, rtol=1e-12)
    in_jax = loss(rub, *map(jnp.asarray, state)).joint
    np.testing.assert_allclose(in_jax, expected, rtol=1e-6)  # float32


@pytest.mark.parametrize("speed", [-0.05, -1e-4, 0.0, 1e-4, 0.05])
def test_friction_never_turns_a_rotor_round_within_a_step(speed):
    """Nothing a joint moves is lighter than its rotor."""
    rub = resist(Losses(joint_friction=50.0, gear_efficiency=0.5))
    found = loss(rub, STANDING, joint_rates(np.full(12, speed)), np.full(12, 100.0))
    after = (
        speed
        + conventions.PHYSICS_STEP
        * (found.joint + found.gear)
        / IDEAL.reflected_inertia
    )
    assert np.all(after * speed >= -1e-12)
    assert np.all(np.abs(after) <= abs(speed))


def test_a_gear_passes_its_efficiency_when_driving_and_holds_back_when_braking():
    gear = resist(Losses(gear_efficiency=0.92))
    torque, qd = np.tile([100.0, -100.0], 6), np.full(12, 10.0)
    found = loss(gear, STANDING, joint_rates(qd), torque)
    at_joint = torque + found.gear
    np.testing.assert_allclose(at_joint[::2], 0.92 * 100.0, rtol=1e-12)  # driving
    # braking: the motor gets 1 / 1.08 of it
    np.testing.assert_allclose(at_joint[1::2], -1.08 * 100.0, rtol=1e-12)
    assert np.all(found.joint == 0.0)


def test_a_gear_loses_the_same_share_of_the_work_over_a_cycle():
    """A joint swings under a torque of its own phase: what is lost is (1 - e) of the
    integral of |torque x speed|."""
    gear = resist(Losses(gear_efficiency=0.92))
    phase = np.linspace(0.0, 2.0 * math.pi, 1001)
    qd, torque = 15.0 * np.sin(phase), 80.0 * np.sin(phase + 0.7)
    found = np.array(
        [
            loss(gear, STANDING, joint_rates(np.full(12, w)), np.full(12, t)).gear[0]
            for w, t in zip(qd, torque, strict=True)
        ]
    )
    lost = -np.trapezoid(found * qd, phase)
    # The integral of |sin x sin (x + d)| over a turn is 2 (sin d + (pi/2 - d) cos d).
    expected = (
        0.08 * 15.0 * 80.0 * 2.0 * (math.sin(0.7) + (math.pi / 2 - 0.7) * math.cos(0.7))
    )
    # friction sets in over the first tenth of a rad/s
    assert lost == pytest.approx(expected, rel=2e-3)


def test_slides_rub_and_the_rebound_stop_damps_only_where_it_is_met():
    slide = resist(Losses(spring_friction=20.0), rebound_damping=100.0)
    qpos = STANDING.copy()
    qpos[[10, 14]] = 0.02, -0.01
    found = loss(slide, qpos, joint_rates(NO_TORQUE, slides=-3.0), NO_TORQUE)
    np.testing.assert_allclose(found.slide, 20.0, rtol=1e-12)
    np.testing.assert_allclose(found.rebound[:2], [0.0, 300.0], rtol=1e-12)


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"mass_scale": 0.9},
        {"toe_mass": 0.05},
        {"toe_mass": 1.0},
        {"toe_mass": 3.0},
        {"thigh_mass": 0.1},
    ],
    ids=str,
)
def test_a_slide_at_rest_stays_at_rest_whatever_hangs_on_it(change):
    """Without gravity, from a rate of 0.05 m/s in every leg; the legs' postures are
    drawn over the joints' ranges."""
    hardware = BUILT.changed(**change)
    resistance = Resistance.from_hardware(hardware)
    assert resistance is not None
    model = load_model(hardware, visual=False)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(200):
        data.qpos[:] = STANDING
        data.qpos[7:].reshape(4, 4)[:, :3] = rng.uniform(
            [-0.7, -1.4, -2.6], [0.7, 2.4, -0.1], (4, 3)
        )
        mujoco.mj_forward(model, data)
        unit = np.zeros((4, 22))
        unit[np.arange(4), SPRING_QVEL] = 1.0
        answer = np.empty_like(unit)
        mujoco.mj_solveM(model, data, answer, unit)
        mobility = answer[np.arange(4), SPRING_QVEL]
        # Half of what would turn it round for ever: a step that is stable, with every
        # slide rubbing at once.
        assert np.all(
            resistance.spring_hold * conventions.PHYSICS_STEP * mobility < 1.5
        )


def test_numpy_and_jax_lose_the_same():
    rng = np.random.default_rng(0)
    qpos, qvel = np.tile(STANDING, (7, 1)), rng.normal(0.0, 8.0, (7, 22))
    qpos[:, 7:] += rng.normal(0.0, 0.02, (7, 16))
    state = qpos, qvel, rng.normal(0.0, 60.0, (7, 12))
    resistance = Resistance.from_hardware(BUILT)
    assert resistance is not None
    ours = generalized(loss(resistance, *state), qvel)
    in_jax = loss(resistance, *map(jnp.asarray, state))
    theirs = generalized(in_jax, jnp.asarray(qvel))
    np.testing.assert_allclose(theirs, ours, rtol=1e-4, atol=1e-3)  # float32
    assert np.all(np.sum(ours * qvel, axis=-1) < 0.0)  # all of it against the motion


# --- The bus --------------------------------------------------------------------------


def motors(**changes: float) -> Actuator:
    return Actuator.from_hardware(
        HardwareSpec(losses=Losses(**changes)), stiffness=1e6, damping=0.0
    )


def ask(motor: Actuator, qd: np.ndarray, torque: float, xp=np):
    """Return the torques of motors at the speeds `qd` that are asked for far more than
    they give, with the sign of `torque`."""
    far = np.sign(torque) * np.ones(12)
    return joint_torque(
        motor,
        *(xp.asarray(x) for x in (NO_TORQUE, NO_TORQUE, qd, far, NO_TORQUE)),
        dt=1e-3,
    )


def test_power_is_mechanical_and_copper():
    motor, torque, qd = motors(bus_power_out=1e6), np.full(12, 50.0), np.full(12, 10.0)
    stall = stall_torque(120.0, 14.7, 21.4)
    heat = 50.0**2 * 21.4 / stall
    assert bus_power(motor, torque, qd) == pytest.approx(12 * (500.0 + heat))
    assert np.sum(copper_loss(torque, 21.4, stall)) == pytest.approx(12 * heat)


@pytest.mark.parametrize("xp", [np, jnp])
def test_saturated_motors_share_what_the_bus_gives_by_a_common_factor(xp):
    motor, qd = motors(bus_power_out=8e3), np.linspace(2.0, 14.0, 12)
    torque = np.asarray(ask(motor, qd, 1.0, xp))
    # s^2 sum r 120^2 + s sum 120 w = 8 kW
    copper, mechanical = (
        12 * 120.0**2 * 21.4 / stall_torque(120.0, 14.7, 21.4),
        120.0 * np.sum(qd),
    )
    share = (-mechanical + math.sqrt(mechanical**2 + 4.0 * copper * 8e3)) / (
        2.0 * copper
    )
    assert share < 0.9
    np.testing.assert_allclose(torque, 120.0 * share, rtol=1e-5)  # float32
    assert bus_power(motor, torque.astype(float), qd) == pytest.approx(8e3, rel=1e-5)


# the second beyond the no-load speed, where the back EMF alone brakes with 7.4 kW
@pytest.mark.parametrize(("speed", "taken"), [(15.0, 3e3), (23.0, 12e3)])
def test_braking_motors_share_what_the_bus_takes(speed, taken):
    motor, qd = motors(bus_power_in=taken), np.full(12, speed)
    torque = ask(motor, qd, -1.0)
    assert np.ptp(torque) == pytest.approx(0.0, abs=1e-9)
    assert -120.0 < torque[0] < 0.0
    assert bus_power(motor, torque, qd) == pytest.approx(-taken, rel=1e-9)


def test_a_bus_that_suffices_changes_nothing():
    qd = np.linspace(-25.0, 25.0, 12)
    for torque in (1.0, -1.0):
        np.testing.assert_array_equal(
            ask(motors(bus_power_out=1e6), qd, torque), ask(motors(), qd, torque)
        )


def test_what_flows_back_beyond_the_no_load_speed_is_not_scaled():
    """The back EMF brakes by itself there: a common factor would leave the envelope."""
    motor, qd = motors(bus_power_in=10.0), np.full(12, 23.0)
    torque = ask(motor, qd, 1.0)
    np.testing.assert_allclose(torque, torque_limits(motor, qd)[1], rtol=1e-12)
    assert torque[0] < 0.0


def test_voltage_sags_with_the_power_and_shifts_the_line():
    """1.25 % a kW at 8 kW: a tenth less voltage is 2.14 rad/s less at no load, and
    nothing less at rest."""
    motor = motors(bus_sag=0.0125)
    qd = np.full(12, 10.0)
    per_motor = 8e3 / 12
    r = 21.4 / stall_torque(120.0, 14.7, 21.4)
    torque = np.full(12, (-10.0 + math.sqrt(100.0 + 4.0 * r * per_motor)) / (2.0 * r))
    voltage = bus_voltage(motor, torque, qd)
    np.testing.assert_allclose(voltage, [0.9], rtol=1e-12)
    at = np.array([0.0, 14.7 - 2.14, 21.4 - 2.14])
    np.testing.assert_allclose(
        torque_limits(motor, at, voltage)[1], [120.0, 120.0, 0.0], atol=1e-9
    )
    # braking recharges: it does not rise either
    assert bus_voltage(motor, -torque, qd) == 1.0


# --- Braking --------------------------------------------------------------------------


def test_braking_is_flat_or_falls_on_a_line_of_its_own():
    qd = np.array([10.0, 18.0, 20.0, 25.0])
    lower, _ = torque_limits(Actuator.from_hardware(IDEAL), qd)
    np.testing.assert_allclose(lower, -120.0)
    mirrored = Actuator.from_hardware(dataclasses.replace(IDEAL, braking_speed=21.4))
    lower, upper = torque_limits(mirrored, qd)
    _, driving = torque_limits(Actuator.from_hardware(IDEAL), qd)
    np.testing.assert_allclose(lower[:3], -driving[:3], rtol=1e-12)
    # beyond no load only the back EMF brakes
    assert lower[3] == upper[3] == driving[3] < 0.0
    other_way = torque_limits(mirrored, -qd)
    np.testing.assert_allclose(other_way[1], -lower, rtol=1e-12)
    np.testing.assert_allclose(other_way[0], -upper, rtol=1e-12)


def test_every_loss_has_a_law():
    """Each field of Losses changes something in the engines."""
    for field in dataclasses.fields(Losses):
        value = {
            "gear_efficiency": 0.9,
            "latency": 0.005,
            "current_lag": 0.002,
            "headwind": 2.0,
        }.get(field.name, 1.0)
        changed = Losses(
            **({"drag_area": 0.1} if field.name == "headwind" else {}),
            **{field.name: value},
        )
        hardware = HardwareSpec(losses=changed)
        same_motor = Actuator.from_hardware(hardware) == Actuator.from_hardware(IDEAL)
        same_body = Resistance.from_hardware(hardware) is None
        # of the controller's targets
        assert not (same_motor and same_body) or field.name == "latency", field.name
    assert losses.Loss.__dataclass_fields__.keys() == {
        "air",
        "gear",
        "joint",
        "slide",
        "rebound",
    }
