"""BP2 on rails: can its motors follow the reference, and does the reference carry the
robot?

In C MuJoCo the trunk is led along the reference while the joints follow by the PD law
and the torque-speed envelope, with an offset to their targets that is learnt from
stride to stride, as a policy would learn it. What remains is the reference's own merit:
how closely it can be followed, with what torque, and the force that the ground gives
back, whose mean should be the robot's weight upwards and nothing forwards.

    python tests/reference/test_on_rails.py      prints the table of docs/notes/kinematic_gait.md
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
from bp2_rl.robot.hardware import IDEAL

GAIN, RATE_GAIN = 0.12, 0.04  # of the correction, per rad and per rad/s of error
LEAD = 10  # physics steps by which a correction precedes the error that it answers
STRIDES, MEASURED = 60, 10  # in a run, and of these at its end
LEGS = np.setdiff1d(np.arange(12), [0, 3, 6, 9])  # hips and knees


@dataclasses.dataclass(frozen=True)
class Run:
    """Means and peaks over the last strides of one run; joints are hips and knees."""

    position_error: float  # rad, root mean square
    velocity_error: float  # rad/s, likewise
    hip_speed: float  # rad/s, peak
    knee_speed: float
    hip_torque: float  # Nm, peak
    knee_torque: float
    rms_torque: float  # Nm
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
            data.qpos[:7] = (
                speed * data.time,
                0.0,
                reference.height[k],
                1.0,
                0.0,
                0.0,
                0.0,
            )
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
                rows.append(
                    (
                        error[k],
                        error_rate[k],
                        qd,
                        torque,
                        data.qpos[model.SPRING_QPOS],
                        data.qfrc_constraint[:3].copy(),
                    )
                )
        correction = np.roll(GAIN * (error + RATE_GAIN * error_rate), -LEAD, axis=0)
        offset = _smooth(0.995 * offset + correction)

    e, ed, qd, tau, spring, force = (
        np.array(column) for column in zip(*rows, strict=True)
    )
    lower, upper = actuator.torque_limits(motors, qd)
    at_limit = (tau <= lower + 1e-9) | (tau >= upper - 1e-9)
    _, hip_speed, knee_speed = _peaks(qd)
    _, hip_torque, knee_torque = _peaks(tau)
    lift, thrust = force[:, 2].mean(), force[:, 0].mean()
    weight = float(np.sum(robot.body_mass)) * conventions.GRAVITY
    return Run(
        position_error=_rms(e[:, LEGS]),
        velocity_error=_rms(ed[:, LEGS]),
        hip_speed=hip_speed,
        knee_speed=knee_speed,
        hip_torque=hip_torque,
        knee_torque=knee_torque,
        rms_torque=_rms(tau[:, LEGS]),
        saturated=float(at_limit[:, LEGS].mean()),
        compression=float(spring.max()),
        lift=lift / weight,
        thrust=thrust / weight,
    )


def sample_stride(gait: KinematicGait, speed: float, step: float) -> Reference:
    """One stride straight ahead, sampled about every `step` seconds: a whole number of
    samples."""
    command = jnp.array([speed, 0.0, 0.0])
    samples = round(1.0 / float(gait.phase_rate(command)) / step)
    stride = jax.jit(gait)(
        jnp.broadcast_to(command, (samples, 3)), jnp.arange(samples) / samples
    )
    return jax.tree.map(lambda leaf: np.asarray(leaf, float), stride)


def _peaks(joints):
    """Largest size over time and legs, of abad, hip and knee."""
    return np.abs(joints).max(axis=0).reshape(4, 3).max(axis=0).tolist()


def _rms(x):
    return float(np.sqrt(np.mean(x**2)))


def _smooth(offset):
    """A stride's offsets without what is faster than a few milliseconds."""
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
    assert max(run.hip_speed, run.knee_speed) < bp2.NO_LOAD_SPEED
    assert run.compression < bp2.SPRING_TRAVEL
    assert run.lift == pytest.approx(1.0, abs=0.04)
    assert run.thrust == pytest.approx(0.0, abs=0.06)


def print_reference_speeds() -> None:
    rigid = dataclasses.replace(IDEAL, spring_stiffness=1e7)
    print(
        "| m/s | period s | duty | hip | knee | abad (turning 2 rad/s) | hip, gentle landing | hip, rigid leg |"
    )
    print("| ---: " * 8 + "|")
    for speed in (3.0, 6.0, 8.0, 10.0, 11.0, 13.0):
        gait = KinematicGait()
        stride, period = (
            sample_stride(gait, speed, 1e-4),
            1.0 / float(gait.phase_rate(jnp.array([speed, 0.0, 0.0]))),
        )
        _, hip, knee = _peaks(stride.joint_velocity)
        others = (KinematicGait(landing=0.0), KinematicGait(hardware=rigid))
        gentle, stiff = (
            _peaks(sample_stride(other, speed, 1e-4).joint_velocity)[1]
            for other in others
        )
        turning = gait(
            jnp.tile(jnp.array([speed, 0.0, 2.0]), (2000, 1)), jnp.arange(2000) / 2000
        )
        abad = _peaks(np.asarray(turning.joint_velocity))[0]
        print(
            f"| {speed:.0f} | {period:.3f} | {stride.contact.mean():.3f} | {hip:.1f} | {knee:.1f} "
            f"| {abad:.1f} | {gentle:.1f} | {stiff:.1f} |"
        )


def print_runs(gait: KinematicGait, speeds=(3.0, 6.0, 8.0, 10.0, 12.0)) -> None:
    print(
        "| m/s | q error | qd error | peak speed: hip, knee | peak torque | rms | at limit | spring | lift | thrust |"
    )
    print("| ---: " * 10 + "|")
    for speed in speeds:
        r = run_on_rails(gait, speed)
        print(
            f"| {speed:.0f} | {r.position_error:.3f} | {r.velocity_error:.2f} | {r.hip_speed:.1f}, {r.knee_speed:.1f} "
            f"| {r.hip_torque:.0f}, {r.knee_torque:.0f} | {r.rms_torque:.0f} | {100 * r.saturated:.1f} % "
            f"| {1000 * r.compression:.0f} mm | {r.lift:.2f} | {r.thrust:+.2f} |"
        )


if __name__ == "__main__":
    print_reference_speeds()
    for title, gait in {
        "the gait as it is": KinematicGait(),
        "whole bounce": KinematicGait(landing=1.0),
        "gentle landing": KinematicGait(landing=0.0),
        "shorter swing": KinematicGait(swing_time=0.24),
        "longer swing": KinematicGait(swing_time=0.32),
        "shorter sweep": KinematicGait(sweep=0.60),
        "longer sweep": KinematicGait(sweep=0.78),
    }.items():
        print(f"\n{title}")
        print_runs(gait)
