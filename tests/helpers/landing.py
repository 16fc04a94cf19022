"""Random states and landings of robots, and the simulators' motions from them; shared
by the tests of the model and of its dynamics."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from bp2_rl.robot import actuator as act
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.actuator import Actuator
from bp2_rl.robot.hardware import IDEAL
from bp2_rl.robot.kinematics import joint_angles, leg_origins
from bp2_rl.robot.model import (
    MOTOR_QPOS,
    MOTOR_QVEL,
    NQ,
    NV,
    SPRING_QPOS,
    foot_geom_ids,
    load_model,
)

MOTOR = Actuator.from_hardware(stiffness=250.0, damping=3.0)
DT = conventions.PHYSICS_STEP


def converged(model: mujoco.MjModel) -> mujoco.MjModel:
    model.opt.iterations, model.opt.ls_iterations = 50, 50
    return model


def random_states(
    rng: np.random.Generator, number: int, *, thrown: float = 0.1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return states (qpos, qvel, torque) about standing, near and far, the lowest foot
    from 8 mm in the floor to 8 mm above.

    Springs are anywhere in their travel and beyond. Some states have one leg lifted,
    some a knee beyond its limit, and in the share `thrown` the legs are thrown up and
    it is the trunk that meets the floor.
    """
    model = load_model(visual=False)
    data = mujoco.MjData(model)
    qpos = np.zeros((number, NQ))
    qvel = rng.normal(size=(number, NV)) * [5, 1, 1, 2, 2, 2, *(3, 8, 8, 2) * 4]
    for q in qpos:
        # rad: from all four feet level to all over the place
        spread = 10.0 ** rng.uniform(-3.0, -0.5)
        roll, pitch = spread * rng.normal(size=2) / 4
        q[3:7] = np.array([1.0, roll / 2, pitch / 2, 0.0]) / np.linalg.norm(
            [1.0, roll / 2, pitch / 2]
        )
        q[MOTOR_QPOS] = bp2.STAND_JOINTS + spread * rng.normal(size=12)
        q[SPRING_QPOS] = rng.uniform(-0.005, 0.14) + spread * rng.uniform(
            -0.02, 0.02, 4
        )
        if rng.random() < 0.3:
            q[rng.choice(MOTOR_QPOS[2::3])] -= 0.3
        if rng.random() < 0.2:
            q[rng.choice(MOTOR_QPOS[2::3])] = bp2.KNEE_RANGE[1] + 0.05
        if rng.random() < thrown:
            q[MOTOR_QPOS[1::3]], q[MOTOR_QPOS[2::3]] = 2.2, -0.3
        data.qpos = q
        mujoco.mj_kinematics(model, data)
        # 0.07: the trunk's capsules
        lowest = min(
            *(data.geom_xpos[foot_geom_ids(model), 2] - bp2.FOOT_RADIUS), -0.07
        )
        q[2] = rng.uniform(-0.008, 0.008) - lowest
    return qpos, qvel, rng.uniform(-120.0, 120.0, (number, 12))


def trot_targets(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return joint targets (steps, 12), rad and rad/s, of a trot whose feet sweep back
    at 10 m/s in stance."""
    speed, period, duty, height, lift = 10.0, 0.2, 0.35, 0.53, 0.12
    reach, swing = speed * period * duty / 2, speed * period * (1 - duty)

    def joints(time: np.ndarray) -> np.ndarray:
        phase = (time[:, None] / period + [0.0, 0.5, 0.5, 0.0]) % 1.0
        s = np.maximum(phase - duty, 0.0) / (1 - duty)
        # stance; then a cubic with the same speed at both ends
        back = reach - speed * period * phase
        forth = (4 * reach + 2 * swing) * (1.5 * s**2 - s**3) - swing * s - reach
        x = np.where(phase < duty, back, forth)
        y = np.broadcast_to(IDEAL.anatomy.geometry.lateral, x.shape)
        z = np.where(phase < duty, 0.0, lift * np.sin(np.pi * s) ** 2) - height
        return joint_angles(leg_origins() + np.stack([x, y, z], axis=-1)).reshape(
            -1, 12
        )

    time, e = np.arange(steps) * DT, 1e-6
    return joints(time), (joints(time + e) - joints(time - e)) / (2 * e)


class Landing(NamedTuple):
    """Robots that come down at 10 m/s, and the joint targets they follow for 150 ms."""

    qpos: np.ndarray  # (robots, nq)
    qvel: np.ndarray  # (robots, nv)
    targets: tuple[np.ndarray, np.ndarray]  # (steps, 12) each, rad and rad/s


def landing(robots: int) -> Landing:
    """Return robots at 10 m/s, falling at 0.7 m/s, each a little different, the first
    foot 2 mm above the floor."""
    targets = trot_targets(steps=150)
    rng, model = np.random.default_rng(0), load_model(visual=False)
    data = mujoco.MjData(model)
    qpos, qvel = np.zeros((robots, NQ)), np.zeros((robots, NV))
    qpos[:, 3], qvel[:, 0], qvel[:, 2] = 1.0, 10.0, -0.7
    qvel[:, 4] = 0.2 * rng.normal(size=robots)
    qpos[:, MOTOR_QPOS] = targets[0][0] + 0.02 * rng.normal(size=(robots, 12))
    qvel[:, MOTOR_QVEL] = targets[1][0]
    for q in qpos:
        data.qpos = q
        mujoco.mj_kinematics(model, data)
        q[2] = 0.002 + bp2.FOOT_RADIUS - data.geom_xpos[foot_geom_ids(model), 2].min()
    return Landing(qpos, qvel, targets)


def land_on_mujoco(model: mujoco.MjModel, start: Landing) -> np.ndarray:
    """Return the positions of trunk and four feet (robots, steps, 5, 3) in C MuJoCo,
    m."""
    places, feet = [], foot_geom_ids(model)
    for qpos, qvel in zip(start.qpos, start.qvel, strict=True):
        data, torque = mujoco.MjData(model), np.zeros(12)
        data.qpos, data.qvel = qpos, qvel
        for target, target_velocity in zip(*start.targets, strict=True):
            q, qd = data.qpos[MOTOR_QPOS], data.qvel[MOTOR_QVEL]
            torque = data.ctrl[:] = act.joint_torque(
                MOTOR, torque, q, qd, target, target_velocity, DT
            )
            mujoco.mj_step(model, data)
            mujoco.mj_kinematics(model, data)
            places.append(np.vstack([data.qpos[:3], data.geom_xpos[feet]]))
    return np.reshape(places, (len(start.qpos), -1, 5, 3))


def land_on_mjx(model: mujoco.MjModel, start: Landing) -> np.ndarray:
    """Return the positions of trunk and four feet, as `land_on_mujoco`, by MJX in
    float32."""
    device_model, feet = mjx.put_model(model), foot_geom_ids(model)
    blank = mjx.make_data(device_model)

    def step(carry, targets):
        (data, torque), (target, target_velocity) = carry, targets
        q, qd = data.qpos[MOTOR_QPOS], data.qvel[MOTOR_QVEL]
        torque = act.joint_torque(MOTOR, torque, q, qd, target, target_velocity, DT)
        data = mjx.step(device_model, data.replace(ctrl=torque))
        places = jnp.concatenate(
            [data.qpos[None, :3], mjx.kinematics(device_model, data).geom_xpos[feet]]
        )
        return (data, torque), places

    @jax.jit
    @jax.vmap
    def run(qpos, qvel):
        first = (blank.replace(qpos=qpos, qvel=qvel), jnp.zeros(12))
        return jax.lax.scan(step, first, tuple(map(jnp.asarray, start.targets)))[1]

    with jax.default_matmul_precision("highest"):
        return np.asarray(run(jnp.asarray(start.qpos), jnp.asarray(start.qvel)))
