"""The kinematic gait: exact where it says so, within reach everywhere, smooth in time
and in the command."""

import dataclasses

import gaits
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from extension import leg_extension
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bp2_rl.base.errors import UserError
from bp2_rl.reference.kinematic_trot import AXIAL_SHARE, KinematicGait
from bp2_rl.reference.stepping import TROT
from bp2_rl.robot import bp2, conventions, kinematics
from bp2_rl.robot.hardware import IDEAL

# m, of a leaning leg's sole
SOLE_CLEARANCE = bp2.FOOT_RADIUS * (1.0 - np.cos(bp2.STAND_HIP))
GAIT = KinematicGait()

commands = st.tuples(st.floats(-2.0, 13.2), st.floats(-1.0, 1.0), st.floats(-2.0, 2.0))
phases = st.floats(-50.0, 50.0)
# Corners and the neighbourhood of standing are where a gait breaks, and uniform draws
# seldom go there.
_EDGES = np.meshgrid(
    [-2.0, 0.0, 1e-3, 0.05, 0.2, 1.0, 3.0, 13.2], [-1.0, 0.0, 1.0], [-2.0, 0.0, 2.0]
)
_DRAWN = np.random.default_rng(0).uniform(
    (-2.0, -1.0, -2.0), (13.2, 1.0, 2.0), (128, 3)
)
COMMANDS = np.concatenate([np.reshape(_EDGES, (3, -1)).T, _DRAWN])  # 200


# one test below holds float32 to the same answers
pytestmark = pytest.mark.usefixtures("double_precision")


def sample(command, phase, gait=GAIT):
    return gaits.sample(gait, command, phase)


def rate(command, gait=GAIT):
    return gaits.rate(gait, command)


def soles(reference, hardware=IDEAL):
    return kinematics.foot_position(
        reference.joint_position, reference.spring_compression, hardware
    )


def stance_time(command, gait=GAIT):
    return 1.0 / rate(command, gait) - gait.swing_time


# --- Stance ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "gait",
    [
        GAIT,
        KinematicGait(hardware=IDEAL.changed(leg_length=0.42)),
        KinematicGait(hardware=IDEAL.changed(fore_track=0.45, hind_track=0.24)),
        KinematicGait(hardware=dataclasses.replace(IDEAL, spring_stiffness=3000.0)),
    ],
)
def test_a_stance_foot_moves_with_the_ground(gait):
    """p' = -v - omega x p to 1e-6 m/s (required: 1e-3), by central differences of
    FK(q_ref) over 2 us."""
    for leg in range(4):
        share = np.linspace(0.02, 0.98, 7)[:, None]
        phase = share * stance_time(COMMANDS, gait) * rate(COMMANDS, gait) - TROT[leg]
        now, before, after = gaits.around(gait, COMMANDS, phase)
        assert (now.contact[..., leg] == 1).all()
        sole, was, will_be = (
            soles(at, gait.hardware)[..., leg, :] for at in (now, before, after)
        )
        vx, vy, yaw_rate = COMMANDS.T
        ground = np.stack(
            [
                -vx + yaw_rate * sole[..., 1],
                -vy - yaw_rate * sole[..., 0],
                -now.height_velocity,
            ],
            axis=-1,
        )
        np.testing.assert_allclose((will_be - was) / 2e-6, ground, rtol=0, atol=1e-6)


def test_a_stance_sole_stays_on_the_ground_that_the_height_is_measured_from():
    """And no sole ever goes below it, at any command and phase of the grid."""
    reference = sample(COMMANDS, np.linspace(0.0, 1.0, 201)[:, None])
    clearance = soles(reference)[..., 2] + reference.height[..., None] - SOLE_CLEARANCE
    assert clearance.min() > -1e-12
    moving = np.abs(COMMANDS).max(axis=1) > 0.2  # slower, every foot counts as standing
    np.testing.assert_allclose(
        clearance[:, moving][reference.contact[:, moving] == 1], 0.0, atol=1e-12
    )


def test_feet_pass_below_the_hips_in_the_middle_of_stance():
    for leg in range(4):
        middle = 0.5 * stance_time(COMMANDS) * rate(COMMANDS) - TROT[leg]
        sole = soles(sample(COMMANDS, middle))[:, leg]
        nominal = kinematics.leg_origins()[leg] + np.array(
            [0.0, IDEAL.anatomy.geometry.lateral[leg], 0.0]
        )
        np.testing.assert_allclose(
            sole[:, :2], np.tile(nominal[:2], (len(sole), 1)), atol=1e-9
        )


def test_the_springs_carry_the_weight():
    """Mean spring force over a stride = weight x AXIAL_SHARE, to the 1 % that the soft
    limit at the stop takes."""
    for speed in (0.0, 3.0, 6.0, 10.0):
        phase = np.linspace(0.0, 1.0, 4000, endpoint=False)
        force = (
            bp2.SPRING_STIFFNESS
            * sample([speed, 0.0, 0.0], phase).spring_compression.sum(axis=1).mean()
        )
        assert force == pytest.approx(
            AXIAL_SHARE * bp2.TOTAL_MASS * conventions.GRAVITY, rel=0.01
        )


# --- Time -----------------------------------------------------------------------------


def test_velocities_are_the_derivatives_of_positions():
    """Central differences over 2 us at random phases; 1e-4 relative is required, 1e-6
    holds."""
    phase = np.random.default_rng(1).uniform(-3.0, 3.0, (40, 1))
    now, before, after = gaits.around(GAIT, COMMANDS, phase)
    # springs meet the ground with a jerk
    inside = (now.contact == before.contact) & (now.contact == after.contact)
    for position, velocity, where in (
        ("joint_position", "joint_velocity", ...),
        ("height", "height_velocity", ...),
        ("spring_compression", "spring_velocity", inside),
    ):
        slope = (getattr(after, position) - getattr(before, position))[where] / 2e-6
        found = getattr(now, velocity)[where]
        np.testing.assert_allclose(found, slope, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(now.velocity[..., 2], now.height_velocity)


@pytest.mark.parametrize("event", ["lift-off", "touchdown"])
def test_joint_velocity_is_continuous_where_a_foot_meets_or_leaves_the_ground(event):
    """One-sided differences of second order on either side, each against qd_ref on its
    side and on the other."""
    step = 1e-6
    for leg in range(4):
        phase = (
            stance_time(COMMANDS) * rate(COMMANDS) if event == "lift-off" else 0.0
        ) - TROT[leg]
        for side in (1.0, -1.0):
            at, near, far = (
                sample(
                    COMMANDS, phase + side * k * step * rate(COMMANDS)
                ).joint_position[:, leg]
                for k in range(3)
            )
            slope = side * (-3.0 * at + 4.0 * near - far) / (2.0 * step)
            for offset in (1e-9, -1e-9):  # cycles
                velocity = sample(COMMANDS, phase + offset).joint_velocity[:, leg]
                np.testing.assert_allclose(velocity, slope, rtol=1e-6, atol=1e-5)
        jump = [
            sample(COMMANDS, phase + offset).contact[:, leg] for offset in (-1e-9, 1e-9)
        ]
        standing = (COMMANDS[:, :2] ** 2).sum(axis=1) + (
            0.4 * COMMANDS[:, 2]
        ) ** 2 < 0.1**2
        assert (jump[0] != jump[1])[~standing].all()  # that is where the event is


@settings(deadline=None)
@given(command=commands, phase=phases, cycles=st.integers(-40, 40))
def test_the_motion_repeats_every_cycle(command, phase, cycles):
    one, other = sample(command, phase), sample(command, phase + cycles)
    np.testing.assert_allclose(other.joint_position, one.joint_position, atol=1e-9)
    np.testing.assert_allclose(other.height, one.height, atol=1e-9)


@pytest.mark.parametrize("speed", [3.0, 10.0])
def test_the_trunk_is_lowest_while_its_legs_push(speed):
    """Its mean is the configured height and it rises and falls twice a stride, by about
    a centimetre."""
    command = np.array([speed, 0.0, 0.0])
    middle = 0.5 * stance_time(command) * rate(command)
    reference = sample(command, middle + np.linspace(0.0, 1.0, 400, endpoint=False))
    assert reference.height.mean() == pytest.approx(GAIT.height, abs=1e-9)
    assert np.argmin(reference.height[:200]) == 0
    assert reference.height[100] == pytest.approx(reference.height.max())
    assert 0.005 < np.ptp(reference.height) / 2 < 0.02
    np.testing.assert_allclose(
        reference.height[:200], reference.height[200:], atol=1e-12
    )


def test_stance_time_follows_the_reach():
    """Slow: the time asked for. Fast: the sweep over the speed. Always less than
    either, falling with speed."""
    speed = np.linspace(0.0, 13.2, 200)
    stance = stance_time(np.stack([speed, 0 * speed, 0 * speed], axis=-1))
    assert stance[0] == pytest.approx(GAIT.slow_stance)
    assert (speed * stance < GAIT.sweep).all()
    assert speed[-1] * stance[-1] == pytest.approx(GAIT.sweep, rel=0.04)
    assert (np.diff(stance) < 0).all()


def test_diagonal_legs_move_together_half_a_cycle_from_the_others():
    reference = sample([4.0, 0.0, 0.0], np.array([0.0, 0.1, 0.3, 0.5, 0.6, 0.8]))
    fr, fl, rr, rl = np.moveaxis(np.asarray(reference.joint_position), 1, 0)
    np.testing.assert_allclose(fr, rl, atol=1e-12)
    np.testing.assert_allclose(fl, rr, atol=1e-12)
    np.testing.assert_allclose(fl[:3], fr[3:], atol=1e-12)
    # FL and RR touch down at phase 0
    assert reference.contact[0].tolist() == [0.0, 1.0, 1.0, 0.0]


# --- Commands -------------------------------------------------------------------------


@settings(max_examples=300, deadline=None)
@given(command=commands, phase=phases)
@example(command=(13.2, 1.0, 2.0), phase=0.0)
@example(command=(13.2, -1.0, -2.0), phase=-7.5)
@example(command=(-2.0, 1.0, 2.0), phase=0.25)
@example(command=(0.0, 0.0, 0.0), phase=0.0)
def test_no_command_exceeds_reach_or_ranges_or_gives_nan(command, phase):
    reference = sample(command, phase)
    for name, leaf in vars(reference).items():
        assert np.isfinite(leaf).all(), name
    for joint, (low, high) in enumerate(
        (bp2.ABAD_RANGE, bp2.HIP_RANGE, bp2.KNEE_RANGE)
    ):
        angle = reference.joint_position[:, joint]
        assert low < angle.min() <= angle.max() < high
    assert reference.spring_compression.min() >= 0.0
    assert reference.spring_compression.max() < bp2.SPRING_TRAVEL
    extension = leg_extension(soles(reference))
    for leg, compression in enumerate(reference.spring_compression):
        nearest, farthest = kinematics.reach(compression)
        assert nearest < extension[leg] < farthest
    assert (soles(reference)[:, 2] + reference.height - SOLE_CLEARANCE >= -1e-12).all()
    assert set(reference.contact) <= {0.0, 1.0}


@settings(deadline=None)
@given(command=commands, phase=phases)
def test_a_mirrored_command_gives_the_mirrored_motion_half_a_cycle_later(
    command, phase
):
    vx, vy, yaw_rate = command
    left = sample((vx, -vy, -yaw_rate), phase + 0.5)
    gaits.require_mirror_images(left, sample(command, phase))


@settings(deadline=None)
@given(phase=phases)
def test_at_zero_command_the_robot_stands(phase):
    reference = sample((0.0, 0.0, 0.0), phase)
    np.testing.assert_array_equal(reference.joint_velocity, 0.0)
    np.testing.assert_array_equal(reference.contact, 1.0)
    assert reference.height == pytest.approx(bp2.STANDING_HEIGHT, abs=1e-12)
    nominal = kinematics.foot_position(np.zeros((4, 3)))[:, :2]
    np.testing.assert_allclose(soles(reference)[:, :2], nominal, atol=1e-12)
    weight = bp2.TOTAL_MASS * conventions.GRAVITY
    np.testing.assert_allclose(
        4 * reference.spring_compression * bp2.SPRING_STIFFNESS,
        AXIAL_SHARE * weight,
        rtol=1e-12,
    )


def test_lift_grows_smoothly_out_of_standing():
    """Quadratically at first, never falling below 6 cm again once on the move."""
    speed = np.array(
        [0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 4.0, 8.0, 13.2]
    )
    reference = sample(
        np.stack([speed, 0 * speed, 0 * speed], axis=-1),
        np.linspace(0.0, 1.0, 401)[:, None],
    )
    lift = (
        soles(reference)[..., 2] + reference.height[..., None] - SOLE_CLEARANCE
    ).max(axis=(0, 2))
    assert lift[0] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(
        lift[1:4] / speed[1:4] ** 2, lift[1] / speed[1] ** 2, rtol=0.05
    )
    assert (np.diff(lift[:8]) > 0).all()
    assert lift[7:].min() > 0.06
    assert lift.max() < 0.35


def test_joint_angles_are_smooth_in_the_command():
    """Their derivative by the command is bounded and continuous, across lift-off and
    touchdown and at standing.

    The steepest and the most curved is the knee's flexion F s^2 / (s^2 + s0^2) with F =
    0.8 rad and s0 = 0.2 m/s: slope 0.65 F / s0 = 2.6 rad per m/s and curvature 2 F /
    s0^2 = 40; the sweep of the leg adds to it.
    """
    rng = np.random.default_rng(2)
    command = np.repeat(COMMANDS, 10, axis=0)
    phase = jnp.asarray(rng.uniform(0.0, 1.0, len(command)))
    jacobian = jax.jit(jax.vmap(jax.jacfwd(lambda c, p: GAIT(c, p).joint_position)))
    at = np.asarray(jacobian(jnp.asarray(command), phase))
    assert np.abs(at).max() < 4.0
    for size in (1e-3, 1e-4, 1e-5):
        step = rng.normal(size=command.shape)
        step *= size / np.linalg.norm(step, axis=1, keepdims=True)
        change = np.asarray(jacobian(jnp.asarray(command + step), phase)) - at
        assert np.abs(change).max() < 60.0 * size


def test_velocity_and_attitude_are_those_commanded():
    reference = sample(COMMANDS, 0.3)
    np.testing.assert_array_equal(reference.velocity[:, :2], COMMANDS[:, :2])
    np.testing.assert_array_equal(
        reference.up, np.tile([0.0, 0.0, 1.0], (len(COMMANDS), 1))
    )
    assert not reference.pitch.any()
    assert not reference.torque.any()


# --- What the motors are asked for ----------------------------------------------------


@pytest.mark.parametrize(
    ("speed", "hip", "knee"),
    [(3.0, 9.6, 9.6), (6.0, 12.8, 11.0), (8.0, 15.1, 11.6), (10.0, 19.2, 11.3)],
)
def test_joint_speeds_stay_inside_the_motors(speed, hip, knee):
    """Bounds just above what was found; the no-load speed is 21.4 rad/s."""
    peak = np.abs(
        sample([speed, 0.0, 0.0], np.linspace(0.0, 1.0, 2001)).joint_velocity
    ).max(axis=(0, 1))
    assert peak[0] < 1e-9
    assert peak[1] < hip < bp2.NO_LOAD_SPEED
    assert peak[2] < knee < bp2.NO_LOAD_SPEED


def test_single_precision_gives_the_same_motion():
    """What training uses. 2e-5 rad and 2e-3 rad/s are float32's resolution times the
    slopes of the motion."""
    phase = np.random.default_rng(3).uniform(0.0, 1.0, (50, 1)).astype(np.float32)
    command = COMMANDS.astype(np.float32)
    exact = sample(command, phase)
    with jax.enable_x64(False):
        single = gaits.sample(GAIT, command, phase, np.float32)
    assert single.joint_position.dtype == np.float32
    for name, tolerance in (
        ("joint_position", 2e-5),
        ("joint_velocity", 2e-3),
        ("spring_compression", 1e-6),
    ):
        found, wanted = getattr(single, name), getattr(exact, name)
        np.testing.assert_allclose(found, wanted, atol=tolerance)


@pytest.mark.parametrize(
    "change",
    [
        {"leg_length": 0.30},
        {"leg_length": 0.45},
        {"spring_stiffness": 3000.0},
        {"spring_stiffness": 20000.0},
        {"mass_scale": 0.7},
        {"mass_scale": 1.3},
    ],
)
def test_other_hardware_is_within_its_own_reach(change):
    hardware = IDEAL.changed(**change)
    gait = KinematicGait(hardware=hardware)
    reference = sample(COMMANDS, np.linspace(0.0, 1.0, 101)[:, None], gait)
    assert np.isfinite(reference.joint_velocity).all()
    assert reference.joint_position[..., 2].max() < bp2.KNEE_RANGE[1]
    assert reference.spring_compression.max() < 1.25 * hardware.spring_travel
    clearance = (
        soles(reference, hardware)[..., 2]
        + reference.height[..., None]
        - SOLE_CLEARANCE
    )
    assert clearance.min() > -1e-12


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("height", -0.5),
        ("height", 0.68),
        ("sweep", 0.0),
        ("sweep", float("nan")),
        ("swing_time", 0.0),
        ("slow_stance", float("inf")),
        ("flexion", -0.1),
        ("follow_through", 1),
        ("landing", 1.5),
    ],
)
def test_impossible_gaits_are_refused_by_name(field, value):
    with pytest.raises(UserError, match=f"gait.{field}"):
        KinematicGait(**{field: value})
