"""BP2 on rails: can its motors follow the reference, and does the reference carry the
robot?

In C MuJoCo the trunk is led along the reference while the joints follow by the PD law
and the torque-speed envelope, with an offset to their targets that is learnt from
stride to stride, as a policy would learn it. What remains is the reference's own merit:
how closely it can be followed, with what torque, and the force that the ground gives
back, whose mean should be the robot's weight upwards and nothing forwards.
"""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from bp2_rl.reference.interface import Reference
from bp2_rl.reference.kinematic_trot import KinematicGait
from bp2_rl.robot import actuator, bp2, conventions, model

GAIN, RATE_GAIN = 0.12, 0.04  # of the correction, per rad and per rad/s of error
LEAD = 10  # physics steps by which a correction precedes the error that it answers
STRIDES, MEASURED = 60, 10  # in a run, and of these at its end
LEGS = np.setdiff1d(np.arange(12), [0, 3, 6, 9])  # hips and knees


@dataclasses.dataclass(frozen=True)
class Run:
    """Means and peaks over the last strides of one run; joints are hips and knees."""

    position_error: float  # rad, root mean square
    velocity_error: float  # rad/s, likewise
    fastest: float  # rad/s
    saturated: float  # share of the time that a joint is at its envelope
    compression: float  # m, peak
    lift: float  # mean vertical force over the weight
    thrust: float  # mean forward force over the weight


def run_on_rails(gait: KinematicGait, speed: float) -> Run:
    """Run straight ahead at `speed` (m/s)."""
    robot = model.load_model(gait.hardware)
    robot.opt.iterations, robot.opt.ls_iterations = 30, 20
    data = mujoco.MjData(robot)
    motors = actuator.Actuator.from_hardware(gait.hardware)
    reference = sample_stride(gait, speed, conventions.PHYSICS_STEP)
    q_ref, qd_ref = reference.joint_position, reference.joint_velocity
    steps = len(q_ref)

    data.qpos[3] = 1.0
    data.qpos[model.MOTOR_QPOS], data.qvel[model.MOTOR_QVEL] = q_ref[0], qd_ref[0]
    data.qpos[model.SPRING_QPOS] = reference.spring_compression[0]
    offset, torque, target, rows = np.zeros((steps, 12)), np.zeros(12), q_ref[0], []
    for stride in range(STRIDES):
        error, error_rate = np.zeros((steps, 12)), np.zeros((steps, 12))
        for k in range(steps):
            along, height = speed * data.time, reference.height[k]
            data.qpos[:7] = along, 0.0, height, 1.0, 0.0, 0.0, 0.0
            data.qvel[:6] = speed, 0.0, reference.height_velocity[k], 0.0, 0.0, 0.0
            q, qd = data.qpos[model.MOTOR_QPOS], data.qvel[model.MOTOR_QVEL]
            error[k], error_rate[k] = q_ref[k] - q, qd_ref[k] - qd
            if k % conventions.SUBSTEPS == 0:
                target, target_rate = q_ref[k] + offset[k], qd_ref[k]
            torque = actuator.joint_torque(
                motors, torque, q, qd, target, target_rate, conventions.PHYSICS_STEP
            )
            data.ctrl[:] = torque
            mujoco.mj_step(robot, data)
            if stride >= STRIDES - MEASURED:
                springs = data.qpos[model.SPRING_QPOS]
                ground = data.qfrc_constraint[:3].copy()
                rows.append((error[k], error_rate[k], qd, torque, springs, ground))
        correction = np.roll(GAIN * (error + RATE_GAIN * error_rate), -LEAD, axis=0)
        offset = _smooth(0.995 * offset + correction)

    e, ed, qd, tau, spring, force = (
        np.array(column) for column in zip(*rows, strict=True)
    )
    lower, upper = actuator.torque_limits(motors, qd)
    at_limit = (tau <= lower + 1e-9) | (tau >= upper - 1e-9)
    weight = float(np.sum(robot.body_mass)) * conventions.GRAVITY
    thrust, _, lift = np.mean(force, axis=0) / weight
    return Run(
        position_error=_rms(e[:, LEGS]),
        velocity_error=_rms(ed[:, LEGS]),
        fastest=float(np.abs(qd[:, LEGS]).max()),
        saturated=float(at_limit[:, LEGS].mean()),
        compression=float(spring.max()),
        lift=lift,
        thrust=thrust,
    )


def sample_stride(gait: KinematicGait, speed: float, step: float) -> Reference:
    """Return the reference over one stride straight ahead, sampled about every `step`
    seconds: a whole number of samples."""
    command = jnp.array([speed, 0.0, 0.0])
    samples = round(1.0 / float(gait.phase_rate(command)) / step)
    stride = jax.jit(gait)(
        jnp.broadcast_to(command, (samples, 3)), jnp.arange(samples) / samples
    )
    return jax.tree.map(lambda leaf: np.asarray(leaf, float), stride)


def _rms(x):
    return float(np.sqrt(np.mean(x**2)))


def _smooth(offset):
    """Return a stride's offsets without what is faster than a few milliseconds."""
    for _ in range(4):
        offset = 0.5 * offset + 0.25 * (
            np.roll(offset, 1, axis=0) + np.roll(offset, -1, axis=0)
        )
    return offset


@pytest.mark.parametrize("speed", [6.0, 10.0])
def test_the_motors_can_follow_and_the_ground_bears_the_weight(speed):
    """Bounds are twice what was found: 5 mrad, 0.9 rad/s, 0.03 % at the envelope, 2 %
    of lift, 3 % of thrust."""
    run = run_on_rails(KinematicGait(), speed)
    assert run.position_error < 0.01
    assert run.velocity_error < 1.8
    assert run.saturated < 0.001
    assert run.fastest < bp2.NO_LOAD_SPEED
    assert run.compression < bp2.SPRING_TRAVEL
    assert run.lift == pytest.approx(1.0, abs=0.04)
    assert run.thrust == pytest.approx(0.0, abs=0.06)
