"""The collocation library: exact at its points, exact on the ground between them, and
whole in every direction.

Two libraries: `made` has the kinematic gait's motion, an independent source, on the
library's mesh; `solved` has two trajectories of the optimisation, on a coarse mesh,
with impacts and rolling feet.
"""

import dataclasses
import io
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gaits import around, rate, require_mirror_images, sample
from hypothesis import given, settings
from hypothesis import strategies as st

from bp2_rl.base import serialization as config
from bp2_rl.base.errors import UserError
from bp2_rl.optimiser.collocation import solve
from bp2_rl.optimiser.problem import Problem
from bp2_rl.reference.kinematic_trot import KinematicGait
from bp2_rl.reference.library.file import (
    ARRAYS,
    MotionLibrary,
    load_library,
    save_library,
)
from bp2_rl.reference.library.trot import CollocationGait
from bp2_rl.reference.stepping import TROT
from bp2_rl.robot import bp2, conventions, kinematics
from bp2_rl.robot.hardware import IDEAL

# m, of a leaning leg's sole
SOLE_CLEARANCE = bp2.FOOT_RADIUS * (1.0 - np.cos(bp2.STAND_HIP))
POINTS = 25
SPEEDS = np.arange(0.5, 13.1, 0.5)
KINEMATIC = KinematicGait()
# Corners, the neighbourhood of standing, backwards, beyond the greatest speed, and
# draws from the box.
_EDGES = np.meshgrid(
    [-1.0, 0.0, 1e-3, 0.1, 0.4, 0.7, 5.0, 13.0, 15.0],
    [-0.5, 0.0, 0.5],
    [-1.0, 0.0, 1.0],
)
_DRAWN = np.random.default_rng(0).uniform(
    (-0.5, -0.5, -1.0), (13.5, 0.5, 1.0), (119, 3)
)
COMMANDS = np.concatenate([np.reshape(_EDGES, (3, -1)).T, _DRAWN])  # 200
WITHIN = COMMANDS[(COMMANDS[:, 0] <= SPEEDS[-1])]  # of what the library has
PHASES = np.random.default_rng(1).uniform(-3.0, 3.0, (30, 1))


# one test below holds float32 to the same answers
pytestmark = pytest.mark.usefixtures("double_precision")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("libraries")


@pytest.fixture(scope="module")
def made(folder):
    """Return a library's gait in which the centres of the feet are where the kinematic
    gait has its soles."""
    return CollocationGait(save(folder / "made.npz", **kinematic_arrays()))


@pytest.fixture(scope="module")
def solved(folder):
    """Return a library's gait of two solved trots, at 9.5 and 10 m/s on 6 intervals a
    segment."""
    fast = solve(Problem(speed=10.0, intervals=6)).motion
    slow = solve(Problem(speed=9.5, intervals=6), fast).motion
    names = ("durations", "q", "v", "a", "tau", "force", "impulse")
    arrays = {
        name: np.stack([getattr(slow, name), getattr(fast, name)]) for name in names
    }
    return CollocationGait(
        save(folder / "solved.npz", speeds=np.array([9.5, 10.0]), **arrays)
    )


def save(path, **arrays):
    """Write a library file; returns its path as the config has it."""
    contents = {name: np.asarray(array, np.float32) for name, array in arrays.items()}
    save_library(path, MotionLibrary(**contents, provenance={"made": "by a test"}))
    return str(path)


def kinematic_arrays():
    """Return a library's arrays of the kinematic gait's straight running, with rates by
    automatic differentiation."""
    durations, q, v = (
        np.asarray(part)
        for part in jax.jit(jax.vmap(_kinematic_motion))(jnp.asarray(SPEEDS))
    )
    tau = np.random.default_rng(5).uniform(-50.0, 50.0, (len(SPEEDS), 2, POINTS, 8))
    nothing = np.zeros_like(tau)
    motion = {"durations": durations, "q": q, "v": v, "a": np.zeros_like(v), "tau": tau}
    return {"speeds": SPEEDS, **motion, "force": nothing, "impulse": nothing[:, :, 0]}


def _kinematic_motion(speed):
    command = jnp.stack([speed, 0.0 * speed, 0.0 * speed])
    rate = KINEMATIC.phase_rate(command)
    stance, half = 1.0 / rate - KINEMATIC.swing_time, 0.5 / rate
    edge = 1e-9  # s: which side of a touchdown or lift-off is meant
    t = jnp.concatenate(
        [
            jnp.linspace(edge, stance - edge, POINTS),
            jnp.linspace(stance + edge, half - edge, POINTS),
        ]
    )

    def coordinates(t):
        reference = KINEMATIC(jnp.broadcast_to(command, (*t.shape, 3)), t * rate)
        joints, spring = _as_centres(reference)
        legs = jnp.concatenate([joints[..., 1:], spring[..., None]], axis=-1).reshape(
            *t.shape, 12
        )
        height = reference.height - SOLE_CLEARANCE + bp2.FOOT_RADIUS
        return jnp.concatenate(
            [jnp.stack([speed * t, height, 0.0 * t], axis=-1), legs], axis=-1
        )

    q, v = jax.jvp(coordinates, (t,), (jnp.ones_like(t),))
    return (
        jnp.stack([stance, half - stance]),
        q.reshape(2, POINTS, 15),
        v.reshape(2, POINTS, 15),
    )


def _as_centres(reference):
    """Return joint angles that put the centres of the feet where the kinematic gait has
    its soles, and spring compressions."""
    joints, spring = (
        reference.joint_position.reshape(*reference.height.shape, 4, 3),
        reference.spring_compression,
    )
    soles = kinematics.foot_position(joints, spring)
    return kinematics.joint_angles(soles, spring + bp2.FOOT_RADIUS), spring


def centres(reference, hardware=IDEAL):
    """Return the centres of the feet from the trunk's centre in the heading frame,
    m."""
    p = kinematics.foot_position(
        reference.joint_position,
        reference.spring_compression + bp2.FOOT_RADIUS,
        hardware,
    )
    c, s = np.cos(reference.pitch)[..., None], np.sin(reference.pitch)[..., None]
    return np.stack(
        [c * p[..., 0] + s * p[..., 2], p[..., 1], c * p[..., 2] - s * p[..., 0]],
        axis=-1,
    )


def clearance(reference):
    """Return the height of every foot above the ground, m."""
    return centres(reference)[..., 2] + reference.height[..., None] - bp2.FOOT_RADIUS


# --- What the library says ------------------------------------------------------------


@pytest.mark.parametrize("speed", [9.5, 10.0])
def test_at_its_points_the_motion_is_the_librarys(solved, speed):
    """To 1e-9 and a rounding of the phase; also mirrored, half a cycle later. Ends are
    left to the jumps there."""
    library = load_library(Path(solved.path))
    i = list(library.speeds).index(speed)
    durations = library.durations[i].astype(float)
    points = np.linspace(0.0, 1.0, library.q.shape[2])[1:-1]
    for segment, begin in enumerate((0.0, durations[0])):
        phase = (begin + durations[segment] * points) / (2.0 * durations.sum())
        q, v, tau = (
            x[i, segment, 1:-1].astype(float)
            for x in (library.q, library.v, library.tau)
        )
        for legs, later in (([0, 1, 2, 3], 0.0), ([1, 0, 3, 2], 0.5)):
            found = sample(solved, [speed, 0.0, 0.0], phase + later)
            leg_q, leg_v = (x[:, 3:].reshape(-1, 4, 3)[:, legs] for x in (q, v))
            leg_tau = tau.reshape(-1, 4, 2)[:, legs]
            for ours, theirs, tolerance in (
                (found.joint_position[..., 1:], leg_q[..., :2], 1e-9),
                (found.joint_position[..., 0], 0.0, 1e-12),
                (found.joint_velocity[..., 1:], leg_v[..., :2], 1e-7),
                (found.spring_compression, leg_q[..., 2], 1e-9),
                (found.spring_velocity, leg_v[..., 2], 1e-7),
                (found.torque[..., 1:], leg_tau, 1e-7),
                (found.height, q[:, 1], 1e-9),
                (found.pitch, q[:, 2], 1e-9),
                (found.velocity[:, 0], v[:, 0], 1e-7),
                (found.height_velocity, v[:, 1], 1e-7),
                (found.pitch_rate, v[:, 2], 1e-7),
                (found.up[:, 0], np.sin(q[:, 2]), 1e-9),
            ):
                np.testing.assert_allclose(ours, theirs, atol=tolerance)
            stands = np.isin(legs, [1, 2]) & (segment == 0)
            np.testing.assert_array_equal(found.contact, np.tile(stands, (11, 1)))


@pytest.mark.parametrize(
    ("speeds", "tolerance"), [(SPEEDS, 2e-5), (SPEEDS[2:] - 0.25, 8e-3)]
)
def test_between_its_points_and_speeds_the_motion_is_that_which_was_sampled(
    made, speeds, tolerance
):
    """The kinematic gait: by cubics at the library's speeds (7e-6 rad found), blended
    between them (4e-3 rad)."""
    command = np.stack([speeds, 0.0 * speeds, 0.0 * speeds], axis=-1)
    original, found = (sample(gait, command, PHASES) for gait in (KINEMATIC, made))
    np.testing.assert_allclose(
        rate(made, command), rate(KINEMATIC, command), rtol=tolerance / 5
    )
    joints, spring = _as_centres(original)
    height = original.height - SOLE_CLEARANCE + bp2.FOOT_RADIUS
    for ours, theirs, share in (
        (found.joint_position, joints, 1),
        (found.spring_compression, spring, 10),
        (found.height, height, 20),
    ):
        np.testing.assert_allclose(ours, theirs, atol=tolerance / share)
    on_mesh = np.isin(speeds, SPEEDS)
    np.testing.assert_array_equal(
        found.contact[:, on_mesh], original.contact[:, on_mesh]
    )


def test_torque_is_linear_between_its_points(made):
    """At the middle of an interval it is the mean of the ends."""
    library = load_library(Path(made.path))
    stance, flight = library.durations[4].astype(float)
    middle = (np.arange(POINTS - 1) + 0.5) / (POINTS - 1)
    reference = sample(
        made,
        [SPEEDS[4], 0.0, 0.0],
        (stance + flight * middle) / (2.0 * (stance + flight)),
    )
    mean = (library.tau[4, 1, 1:].astype(float) + library.tau[4, 1, :-1]) / 2.0
    np.testing.assert_allclose(
        reference.torque[..., 1:].reshape(-1, 8), mean, atol=1e-6
    )
    np.testing.assert_array_equal(reference.torque[..., 0], 0.0)


def test_the_mean_speed_is_that_commanded(made, solved):
    """Over a cycle, between the library's speeds and below them too; float32 and the
    sum leave 1e-5 m/s."""
    phase = ((np.arange(4000) + 0.5) / 4000)[:, None]
    for gait, speeds in (
        (made, [0.1, 0.3, 0.5, 0.6, 5.0, 7.77, 13.0]),
        (solved, [9.5, 9.6, 9.9, 10.0]),
    ):
        command = np.array([[speed, 0.0, 0.0] for speed in speeds])
        np.testing.assert_allclose(
            sample(gait, command, phase).velocity[..., 0].mean(axis=0),
            speeds,
            atol=1e-5,
        )


def test_beyond_the_greatest_speed_the_motion_stays(made):
    at, beyond = (
        sample(made, [speed, 0.0, 0.0], PHASES[:, 0]) for speed in (SPEEDS[-1], 20.0)
    )
    jax.tree.map(np.testing.assert_array_equal, at, beyond)


# --- On the ground --------------------------------------------------------------------


@pytest.mark.parametrize(
    "robot", [IDEAL, IDEAL.changed(fore_track=0.45, hind_track=0.24)]
)
def test_a_stance_foot_moves_with_the_ground(made, robot):
    """p' = -v - omega x p whatever the command, to the 4e-4 m/s by which blended
    strides vary in speed."""
    now, before, after = around(
        dataclasses.replace(made, hardware=robot), WITHIN, PHASES
    )
    foot, velocity = (
        centres(now, robot),
        (centres(after, robot) - centres(before, robot)) / 2e-6,
    )
    vx, vy, yaw_rate = now.velocity[..., :1], WITHIN[:, 1:2], WITHIN[:, 2:]
    ground = np.stack(
        [-vx + yaw_rate * foot[..., 1], -vy - yaw_rate * foot[..., 0]], axis=-1
    )
    # slower, every foot counts as standing
    stepping = np.hypot(*WITHIN[:, :2].T) > made.stepping_speed
    stands = np.stack([r.contact[:, stepping] for r in (now, before, after)]).all(
        axis=0
    )
    assert stands.sum() > 1000
    np.testing.assert_allclose(
        velocity[:, stepping][stands][:, :2], ground[:, stepping][stands], atol=1e-3
    )


def test_feet_that_stand_are_on_the_ground_and_no_others_below_it(made):
    """At any command within reach; 2e-6 m is what float32 and cubics leave of the
    kinematic gait's own level ground."""
    reference = sample(made, COMMANDS, PHASES)
    stepping = np.abs(COMMANDS).max(axis=1) > made.stepping_speed
    height, stands = clearance(reference), reference.contact == 1
    assert height.min() > -1e-6
    np.testing.assert_allclose(height[:, stepping][stands[:, stepping]], 0.0, atol=4e-6)


@pytest.mark.parametrize("speed", [9.5, 9.75, 10.0])
def test_rolling_feet_stand_still(solved, speed):
    """On six intervals to 0.2 % of the speed and 1.1 mm off the ground, and no worse
    between two speeds."""
    now, before, after = around(
        solved, [speed, 0.0, 0.0], np.linspace(0.0, 1.0, 2002)[1:-1]
    )

    def rolled(reference):
        lower_leg = (
            reference.pitch[:, None]
            + reference.joint_position[..., 1]
            + reference.joint_position[..., 2]
        )
        return centres(reference)[..., 0] - bp2.FOOT_RADIUS * lower_leg

    slip = (rolled(after) - rolled(before)) / 2e-6 + now.velocity[:, :1]
    stands = np.stack([r.contact for r in (now, before, after)]).all(axis=0)
    assert np.abs(slip[stands]).max() < 0.03
    assert clearance(now)[stands].max() < 2e-3
    assert clearance(now).min() > -1e-5


def test_sideways_and_turning_add_the_same_to_a_rolling_foot(solved):
    """The ground's motion under the straight run's feet, to |omega| times the 2 cm by
    which those roll and sway."""
    command = np.array([[9.8, 0.3, 0.0], [9.8, 0.0, 0.5], [9.6, -0.2, -0.5]])
    straight = command * [1.0, 0.0, 0.0]
    (now, before, after), (_, start, end) = (
        around(solved, command, PHASES),
        around(solved, straight, PHASES),
    )
    velocity, own = (
        (centres(b) - centres(a)) / 2e-6 for a, b in ((before, after), (start, end))
    )
    foot, yaw_rate = centres(now), command[:, 2:]
    ground = np.stack(
        [yaw_rate * foot[..., 1], -command[:, 1:2] - yaw_rate * foot[..., 0]], axis=-1
    )
    # a straight leg cannot follow
    bent = (now.joint_position[..., 2] < -0.15) & (now.contact == 1)
    assert bent.sum() > 20
    np.testing.assert_allclose(
        (velocity - own)[bent][:, :2], ground[bent], atol=0.5 * 0.02
    )


def test_a_leg_without_reach_left_is_not_jerked_straight(solved):
    """Sideways at 10 m/s it lands all but straight: 1 mm above the ground, at 26 rad/s
    where it would at 21.4."""
    command = np.array([[9.8, 0.5, 0.0], [10.0, -0.5, 0.3], [9.5, 0.5, -0.3]])
    phase = np.linspace(0.0, 1.0, 2001)[:, None]
    reference, straight = (
        sample(solved, command, phase),
        sample(solved, command * [1.0, 0.0, 0.0], phase),
    )
    straightest = np.maximum(straight.joint_position[..., 2], bp2.KNEE_RANGE[1])
    assert (reference.joint_position[..., 2] <= straightest + 1e-4).all()
    stands = reference.contact == 1
    assert (
        -1e-5
        < clearance(reference)[stands].min()
        < clearance(reference)[stands].max()
        < 2e-3
    )
    assert (
        np.abs(reference.joint_velocity).max()
        < 1.35 * np.abs(straight.joint_velocity).max()
    )


# --- Time -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["made", "solved"])
def test_velocities_are_the_derivatives_of_positions(name, request):
    """Central differences over 2 us away from touchdown, where velocities jump;
    rounding leaves 1e-7."""
    gait = request.getfixturevalue(name)
    phase = PHASES[np.abs(2.0 * PHASES - np.round(2.0 * PHASES)) > 1e-3][:, None]
    now, before, after = around(gait, COMMANDS, phase)
    for position, velocity in (
        ("joint_position", "joint_velocity"),
        ("spring_compression", "spring_velocity"),
        ("height", "height_velocity"),
        ("pitch", "pitch_rate"),
    ):
        slope = (getattr(after, position) - getattr(before, position)) / 2e-6
        np.testing.assert_allclose(getattr(now, velocity), slope, rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(now.velocity[..., 2], now.height_velocity)


def test_between_touchdowns_nothing_jumps(solved):
    """Not at lift-off either: joint angles and speeds of a displaced, blended motion
    just before and after."""
    command = np.array([[speed, 0.3, 0.5] for speed in (9.5, 9.6, 9.9)])
    stance, flight = (
        np.interp(command[:, 0], [9.5, 10.0], part)
        for part in load_library(Path(solved.path)).durations.T
    )
    # to 1e-5 between the speeds, where the weights are not linear
    lift_off = stance / (2.0 * (stance + flight))
    close, everywhere = (
        np.linspace(*ends, 201)[:, None] for ends in ((-1e-4, 1e-4), (0.001, 0.499))
    )
    phases = np.concatenate([lift_off + close, np.repeat(everywhere, 3, axis=1)])
    before, after = (sample(solved, command, phases + shift) for shift in (-1e-8, 1e-8))
    assert (before.contact != after.contact).sum() < 5
    np.testing.assert_allclose(after.joint_position, before.joint_position, atol=1e-6)
    np.testing.assert_allclose(after.joint_velocity, before.joint_velocity, atol=1e-3)


@settings(deadline=None)
@given(
    phase=st.floats(-50.0, 50.0),
    cycles=st.integers(-40, 40),
    speed=st.floats(0.0, 13.0),
)
def test_the_motion_repeats_every_cycle(made, phase, cycles, speed):
    # which side of a touchdown is rounding
    phase = phase if abs(2.0 * phase - round(2.0 * phase)) > 1e-9 else 0.1
    one, other = (
        sample(made, [speed, 0.2, 0.4], phase + later) for later in (0, cycles)
    )
    np.testing.assert_allclose(other.joint_position, one.joint_position, atol=1e-9)
    np.testing.assert_allclose(other.height, one.height, atol=1e-9)


@pytest.mark.parametrize("name", ["made", "solved"])
def test_a_mirrored_command_gives_the_mirrored_motion_half_a_cycle_later(name, request):
    gait = request.getfixturevalue(name)
    right = sample(gait, COMMANDS, PHASES)
    left = sample(gait, COMMANDS * [1.0, -1.0, -1.0], PHASES + 0.5)
    require_mirror_images(left, right, rates=1e-6)
    np.testing.assert_array_equal(left.contact, right.contact[..., [1, 0, 3, 2]])


def test_fl_and_rr_land_at_phase_0(solved):
    """The phases of `TROT`: FR and RL half a cycle later; each stands for the library's
    stance."""
    durations = load_library(Path(solved.path)).durations[1].astype(float)
    duty = durations[0] / (2.0 * durations.sum())
    for leg, ahead in enumerate(TROT):
        phase = np.array([-1e-6, 1e-6, duty - 1e-6, duty + 1e-6]) - ahead
        assert sample(solved, [10.0, 0.0, 0.0], phase).contact[:, leg].tolist() == [
            0.0,
            1.0,
            1.0,
            0.0,
        ]


# --- Commands -------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["made", "solved"])
def test_no_command_gives_nan_or_leaves_the_joints_ranges(name, request):
    gait = request.getfixturevalue(name)
    command = COMMANDS if name == "made" else COMMANDS[COMMANDS[:, 0] > 9.0]
    reference = sample(gait, command, np.linspace(0.0, 1.0, 101)[:, None])
    for field, leaf in vars(reference).items():
        assert np.isfinite(leaf).all(), field
    for joint, (low, high) in enumerate(
        (bp2.ABAD_RANGE, bp2.HIP_RANGE, bp2.KNEE_RANGE)
    ):
        angle = reference.joint_position[..., joint]
        # between coarse points the trajectory itself exceeds its range
        beyond = 0.02 if name == "solved" else 0.0
        assert low < angle.min() <= angle.max() < high + beyond
    assert set(np.unique(reference.contact)) <= {0.0, 1.0}


def test_at_zero_command_the_robot_stands(made):
    reference = sample(made, [0.0, 0.0, 0.0], PHASES[:, 0])
    stand = np.reshape(bp2.STAND_JOINTS, (4, 3))
    np.testing.assert_allclose(
        reference.joint_position,
        np.broadcast_to(stand, (len(PHASES), 4, 3)),
        atol=1e-12,
    )
    for name in (
        "joint_velocity",
        "spring_velocity",
        "velocity",
        "height_velocity",
        "pitch",
        "pitch_rate",
    ):
        np.testing.assert_allclose(getattr(reference, name), 0.0, atol=1e-12)
    np.testing.assert_array_equal(reference.contact, 1.0)
    np.testing.assert_allclose(clearance(reference), 0.0, atol=1e-12)


def test_standing_is_in_balance(made):
    """Springs bear their share of the weight and torques the moments of the ground's
    forces, by virtual work."""
    reference = sample(made, [0.0, 0.0, 0.0], 0.0)
    load = bp2.TOTAL_MASS * conventions.GRAVITY / 4.0

    def heights(joints, spring):
        return kinematics.foot_position(joints, spring + bp2.FOOT_RADIUS)[..., 2]

    by_joint, by_spring = jax.jacobian(heights, (0, 1))(
        jnp.asarray(reference.joint_position), jnp.asarray(reference.spring_compression)
    )
    np.testing.assert_allclose(
        reference.torque[..., 1:], -load * np.sum(by_joint, axis=0)[..., 1:], atol=1e-9
    )
    np.testing.assert_allclose(
        bp2.SPRING_STIFFNESS * reference.spring_compression,
        load * np.sum(by_spring, axis=0),
        rtol=1e-12,
    )


def test_steps_grow_smoothly_out_of_standing(made):
    """Lift by the square of the speed at first and without a fall; joint angles with a
    bounded, continuous slope."""
    speed = np.array([0.0, 0.01, 0.02, 0.04, 0.1, 0.2, 0.3, 0.4, 0.5])
    for direction in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]):
        reference = sample(
            made, speed[:, None] * direction, np.linspace(0.0, 1.0, 401)[:, None]
        )
        lift = clearance(reference).max(axis=(0, 2))
        np.testing.assert_allclose(
            lift[1:4] / speed[1:4] ** 2, lift[1] / speed[1] ** 2, rtol=0.05
        )
        assert (np.diff(lift[:-1]) > 0).all()
    slope = jax.jit(jax.vmap(jax.jacfwd(lambda c, p: made(c, p).joint_position)))
    phase = jnp.linspace(0.0, 1.0, 40)
    for here, there in (
        (0.0, 1e-4),
        (made.stepping_speed - 1e-4, made.stepping_speed + 1e-4),
    ):
        at, near = (
            np.asarray(slope(jnp.tile(jnp.array([v, 0.0, 0.0]), (40, 1)), phase))
            for v in (here, there)
        )
        assert np.abs(at).max() < 4.0
        assert np.abs(near - at).max() < 0.02


def test_gradients_by_command_and_phase_are_finite(made):
    """Forward and backward, at the library's points and speeds, standing, and beyond
    both ends."""
    command = np.concatenate([COMMANDS, [[speed, 0.0, 0.0] for speed in SPEEDS]])
    phase = np.tile([0.0, 0.25, 0.5, 1.0], len(command))[: len(command)]
    rng = np.random.default_rng(4)
    x, weights = np.column_stack([command, phase]), jnp.asarray(rng.normal(size=58))
    along = rng.normal(size=x.shape)

    def weighted(x):
        return weights @ jnp.concatenate(
            [jnp.ravel(leaf) for leaf in jax.tree.leaves(made(x[:3], x[3]))]
        )

    backward = jax.jit(jax.vmap(jax.grad(weighted)))(x)
    forward = jax.jit(jax.vmap(lambda x, along: jax.jvp(weighted, (x,), (along,))[1]))(
        x, along
    )
    assert np.isfinite(backward).all()
    np.testing.assert_allclose(
        forward, np.sum(backward * along, axis=1), rtol=1e-6, atol=1e-6
    )


def test_single_precision_gives_the_same_motion(made, solved):
    """What training uses. A knee that is almost straight tells least: 1e-7 m of foot
    are 1e-5 rad at 0.1 rad."""
    command = np.stack(
        [np.linspace(9.5, 10.0, 40), np.zeros(40), np.zeros(40)], axis=-1
    ).astype(np.float32)
    phase = np.random.default_rng(3).uniform(0.0, 1.0, (50, 1)).astype(np.float32)
    for gait in (made, solved):
        exact = sample(gait, command, phase)
        with jax.enable_x64(False):
            single = sample(gait, command, phase, np.float32)
        assert {leaf.dtype for leaf in jax.tree.leaves(single)} == {np.dtype("float32")}
        np.testing.assert_allclose(
            single.joint_position, exact.joint_position, atol=2e-5
        )
        np.testing.assert_allclose(
            single.joint_velocity, exact.joint_velocity, atol=2e-3
        )


# --- Configuration and files ----------------------------------------------------------


def test_the_config_is_its_fields_alone(made):
    """Equal, hashed and written without the table, which is read once."""
    sample(made, [1.0, 0.0, 0.0], 0.0)
    assert config.from_json(CollocationGait, config.to_json(made)) == made
    assert set(config.to_json(made)) == {"path", "stepping_speed", "hardware"}
    assert hash(dataclasses.replace(made)) == hash(made)
    assert made._table is dataclasses.replace(made, stepping_speed=0.3)._table


def test_the_height_is_the_least_that_the_motion_has_on_average(solved):
    """Of the speeds, as sampled over a cycle to 0.1 mm, and of standing."""
    phase = ((np.arange(500) + 0.5) / 500)[:, None]
    means = sample(
        solved, [[speed, 0.0, 0.0] for speed in (0.0, 9.5, 10.0)], phase
    ).height.mean(axis=0)
    assert solved._table.height == pytest.approx(means[1:].min(), abs=1e-4)
    assert solved.height == pytest.approx(means.min(), abs=1e-4)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_stepping_speeds_are_refused(value):
    with pytest.raises(UserError, match=r"library\.stepping_speed"):
        CollocationGait(stepping_speed=value)


def test_legs_of_another_length_are_refused(made):
    other = dataclasses.replace(made, hardware=IDEAL.changed(leg_length=0.36))
    with pytest.raises(
        UserError,
        match=r"off the ground with legs of 0.36 m.*bp2 trajopt library build",
    ):
        other.phase_rate(jnp.zeros(3))


def _with_a_bit_changed(content):
    changed = bytearray(content)
    changed[len(content) // 2] ^= 0xFF
    return changed


def _foreign(_):
    array = io.BytesIO()
    np.save(array, np.zeros(3))
    return array.getvalue()


@pytest.mark.parametrize(
    "damage",
    [
        *(lambda content, keep=keep: content[:keep] for keep in (0, 3, 1000, 5000, -1)),
        _with_a_bit_changed,
        _foreign,
    ],
)
def test_a_damaged_or_foreign_file_is_refused(made, folder, damage):
    path = folder / "broken.npz"
    path.write_bytes(damage(Path(made.path).read_bytes()))
    with pytest.raises(
        UserError, match=r"is damaged or no \.npz file.*bp2 trajopt library build"
    ):
        load_library(path)
    path.unlink()
    with pytest.raises(
        UserError, match=r"cannot be read: No such file.*bp2 trajopt library build"
    ):
        load_library(path)


def _replaced(name, value):
    return lambda arrays: arrays | {name: value(arrays[name])}


def _moved(name, index, by):
    def change(array):
        array = array.copy()
        array[index] += by
        return array

    return _replaced(name, change)


def _large(array):
    """Return the array with one number that float64 holds, and the float32 of training
    does not."""
    array = array.astype(float)
    array.reshape(-1)[-1] = 1e300
    return array


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (
            lambda arrays: {
                name: array for name, array in arrays.items() if name != "tau"
            },
            "lacks the array tau",
        ),
        (
            _replaced("format", lambda _: np.array(2)),
            "has format 2, this version reads 1",
        ),
        (
            _replaced("provenance", lambda _: np.array("{")),
            "provenance that is not JSON",
        ),
        (
            _replaced("provenance", lambda _: np.array("[" * 100_000)),
            "provenance that is not JSON",
        ),
        (
            _replaced("provenance", lambda _: np.array('{"by": "\\ud800"}')),
            "provenance that is not JSON",
        ),
        (
            _replaced("provenance", lambda _: np.array("[]")),
            "provenance that is not a JSON object",
        ),
        (
            _replaced("provenance", lambda _: np.array(1.0)),
            "holds provenance as float64",
        ),
        (_replaced("q", lambda q: q.astype(int)), "holds q as int64"),
        (
            _replaced("v", lambda v: v[..., :14]),
            r"holds v as float32\[2, 2, 13, 14\], expected floating\[2, 2, 13, 15\]",
        ),
        (_replaced("q", lambda q: q[0]), r"holds q as float32\[2, 13, 15\]"),
        (
            lambda arrays: {name: x[:1] if x.ndim else x for name, x in arrays.items()},
            "needs two speeds",
        ),
        (_moved("force", (0, 0, 0, 0), np.nan), "numbers in force that are not finite"),
        (_moved("v", (1, 1, 3, 7), np.inf), "numbers in v that are not finite"),
        *(
            (
                _replaced(name, _large),
                f"numbers in {name} that are not finite, or beyond 1e.06",
            )
            for name in ARRAYS
        ),
        (_replaced("speeds", lambda v: v[::-1]), "do not ascend"),
        (_moved("durations", (0, 1), -1.0), "durations that are not above 0.0001 s"),
        (
            _replaced("durations", lambda x: x * np.array([1.0, 1e-30])),
            "durations that are not above 0.0001 s",
        ),
        (
            _moved("q", (1, 1, -1, 4), 1e-3),
            "at 10 m/s whose ends do not meet after half a cycle",
        ),
        (
            _moved("q", (0, 1, -1, 0), 1e-3),
            "at 9.5 m/s whose ends do not meet after half a cycle",
        ),
        (
            _moved("q", (0, 1, 0, 1), 1e-3),
            "at 9.5 m/s whose ends do not meet at lift-off",
        ),
    ],
)
@pytest.mark.attack
def test_a_wrong_library_is_refused_by_its_fault(solved, folder, change, fault):
    path = folder / "wrong.npz"
    with np.load(solved.path) as file:
        np.savez(path, **change({name: file[name] for name in file.files}))
    with pytest.raises(
        UserError, match=rf"{fault}.*: build it again with `bp2 trajopt library build`$"
    ):
        load_library(path)


def test_every_bit_flipped_in_a_library_is_one_line(solved, folder):
    """Headers of zip, deflate and NumPy, names and data: refused, or what it says is
    still a trot."""
    content, path = Path(solved.path).read_bytes(), folder / "flipped.npz"
    rng, lines = np.random.default_rng(0), []
    # headers are at both
    ends = np.concatenate([np.arange(300), len(content) - 1 - np.arange(900)])
    for place in np.concatenate(
        [rng.choice(ends, 150, replace=False), rng.integers(0, len(content), 50)]
    ):
        flipped = bytearray(content)
        flipped[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(flipped)
        try:
            load_library(path)
        except UserError as error:
            lines.append(str(error))
    assert len(lines) > 100
    assert not any("\n" in line for line in lines)


def test_a_librarys_arrays_are_the_ones_saved(solved, folder):
    library = load_library(Path(solved.path))
    save_library(folder / "deep" / "again.npz", library)
    again = load_library(folder / "deep" / "again.npz")
    assert again.provenance == library.provenance
    for name, array in library.arrays.items():
        np.testing.assert_array_equal(again.arrays[name], array)
