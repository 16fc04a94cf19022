"""Quadrupeds drawn at random, and random states of any quadruped."""

import dataclasses
import math

import mujoco
import numpy as np

from bp2_rl.robot.anatomy import Anatomy, Leg, Link
from bp2_rl.robot.conventions import GRAVITY
from bp2_rl.robot.coordinates import motor_indices
from bp2_rl.robot.hardware import HardwareSpec, Losses
from bp2_rl.robot.model import foot_geom_ids, load_model
from bp2_rl.robot.robot_file import mirrored


def random_robot(seed: int) -> HardwareSpec:
    """Return a quadruped of 0.1 to 0.6 m long segments, fore and hind legs drawn apart;
    an even seed gives springs.

    Inertias are full, centres of mass and joints lie off the axes, knees bend either
    way, and all stand level.
    """
    rng = np.random.default_rng(seed)
    length = 10.0 ** rng.uniform(-1.0, -0.2)
    # about the robot's, as a horse's and a mouse's
    mass = 100.0 * length**2.5 * rng.uniform(0.5, 2.0)
    fore, hind = (
        _leg(rng, length, mass, front, sprung=seed % 2 == 0) for front in (1.0, -1.0)
    )
    x, y, z = hind.anchor
    hind = dataclasses.replace(hind, anchor=(x, y, z + _drop(hind) - _drop(fore)))
    anatomy = Anatomy.of_parts(
        _link(rng, 0.3 * mass, 2.0 * length, rng.uniform(-0.2, 0.2, 3) * length),
        (mirrored(fore), fore, mirrored(hind), hind),
        (1.2 * length, 0.4 * length, 0.3 * length),
        name=f"random {seed}",
        stand=tuple(
            angle
            for leg in (fore, fore, hind, hind)
            for angle in (0.0, -0.7 * leg.bend, 1.4 * leg.bend)
        ),
        thigh_radius=0.05 * length,
        lower_radius=0.03 * length,
    )
    torque, stiffness = mass * GRAVITY * length, mass * GRAVITY / length
    return HardwareSpec(
        body=anatomy,
        gear_ratio=1.0,
        rotor_inertia=tuple(mass * length**2 * 10.0 ** rng.uniform(-3.0, -2.0, 3)),
        peak_torque=tuple(torque * rng.uniform(1.0, 3.0, 3)),
        corner_speed=15.0,
        no_load_speed=30.0,
        spring_stiffness=10.0 * stiffness,
        spring_damping=mass * rng.uniform(0.0, 2.0),
        spring_travel=0.3 * length,
        spring_stop_stiffness=100.0 * stiffness,
        rebound_stiffness=float(rng.choice([50.0, 100.0])) * stiffness,
        joint_stop_time=float(rng.choice([0.005, 0.02])),
        friction=rng.uniform(0.3, 1.2),
        contact_time=float(rng.choice([0.003, 0.005])),
        losses=Losses(
            joint_friction=0.05 * torque * rng.uniform(),
            joint_viscosity=0.002 * torque * rng.uniform(),
        ),
    )


def compiled(hardware: HardwareSpec, *, damping: int | None = None) -> mujoco.MjModel:
    """Return the model of training; `damping` is the seed of random damping of the
    joints."""
    model = load_model(hardware, visual=False, feet_only=True)
    if damping is not None:
        scale = hardware.anatomy.mass * hardware.anatomy.leg_length**2
        model.dof_damping[motor_indices(model.nv)] = scale * np.random.default_rng(
            damping
        ).uniform(0.01, 0.05, 12)
    return model


def states_of(
    hardware: HardwareSpec, number: int, *, seed: int, stopped: float
) -> tuple[np.ndarray, ...]:
    """Return states (qpos, qvel, torque) about standing, near and far, at least one
    foot near the floor; float32.

    Each joint is in its stop with the probability `stopped`, up to 0.3 rad deep;
    springs are anywhere in their travel and beyond. Speeds scale as those of
    dynamically similar robots.
    """
    rng, model, anatomy = (
        np.random.default_rng(seed),
        load_model(hardware, visual=False),
        hardware.anatomy,
    )
    data, feet, joints = (
        mujoco.MjData(model),
        foot_geom_ids(model),
        motor_indices(model.nv),
    )
    length, rate = anatomy.leg_length, math.sqrt(GRAVITY / anatomy.leg_length)
    ranges = np.array([leg.ranges for leg in anatomy.legs]).reshape(12, 2)
    qpos, qvel = np.zeros((number, model.nq)), rng.normal(size=(number, model.nv))
    qvel[:, :3] *= np.array([2.0, 0.5, 0.5]) * length * rate
    qvel[:, 3:6] *= 0.4 * rate
    qvel[:, joints] *= np.tile([0.6, 1.6, 1.6], 4) * rate
    if anatomy.sprung:
        qvel[:, 9::4] *= 0.5 * length * rate
    for q in qpos:
        # rad: from all four feet level to all over the place
        spread = 10.0 ** rng.uniform(-3.0, -0.5)
        q[3:7] = [1.0, *(spread * rng.normal(size=2) / 8.0), 0.0]
        q[joints + 1] = np.array(anatomy.stand) + spread * rng.normal(size=12)
        for joint in np.flatnonzero(rng.random(12) < stopped):
            low, high = ranges[joint]
            q[joints[joint] + 1] = rng.choice(
                [low - rng.uniform(0.0, 0.3), high + rng.uniform(0.0, 0.3)]
            )
        if anatomy.sprung:
            q[10::4] = hardware.spring_travel * (
                rng.uniform(-0.05, 1.1) + spread * rng.uniform(-0.2, 0.2, 4)
            )
        mujoco.mju_normalize4(q[3:7])
        data.qpos = q
        mujoco.mj_kinematics(model, data)
        q[2] = rng.uniform(-0.03, 0.01) * length - min(
            data.geom_xpos[feet, 2] - model.geom_size[feet, 0]
        )
    torque = rng.uniform(-1.0, 1.0, (number, 12)) * hardware.joint_peak_torque
    return tuple(x.astype(np.float32) for x in (qpos, qvel, torque))


def _leg(
    rng: np.random.Generator, length: float, mass: float, front: float, *, sprung: bool
) -> Leg:
    """Return a left leg of random links, about `length` long, that weigh shares of
    `mass`."""
    bend = int(rng.choice([-1, 1]))
    thigh, lower = length * rng.uniform(0.8, 1.2, 2)

    def off(share: float) -> float:
        return share * length * rng.uniform(-1.0, 1.0)

    def link(share: float, hanging: float) -> Link:
        return _link(
            rng,
            share * mass,
            length,
            np.array([off(0.15), off(0.15), off(0.15) - hanging * length]),
        )

    return Leg(
        anchor=(
            front * length * rng.uniform(0.8, 1.2),
            length * rng.uniform(0.2, 0.5),
            off(0.2),
        ),
        hip=(off(0.2), length * rng.uniform(0.1, 0.4), off(0.2)),
        knee=(0.0, off(0.15), -thigh),
        foot=(0.0, off(0.1), -lower),
        foot_radius=length * rng.uniform(0.04, 0.12),
        abad=link(0.08, 0.0),
        thigh=link(0.1, 0.3),
        shank=link(0.03, 0.4),
        toe=link(0.02, 0.2) if sprung else None,
        seat=(0.0, off(0.1), -lower * rng.uniform(0.2, 0.8)),
        ranges=((-0.8, 0.9), (-1.8, 2.2), (-2.6, -0.3) if bend < 0 else (0.3, 2.6)),
        bend=-1 if bend < 0 else 1,
    )


def _drop(leg: Leg) -> float:
    """Return the distance of the standing leg's sole below the trunk's frame, m."""
    return (
        leg.foot_radius
        - (leg.foot[2] + leg.knee[2]) * math.cos(0.7)
        - leg.hip[2]
        - leg.anchor[2]
    )


def _link(rng: np.random.Generator, mass: float, size: float, com: np.ndarray) -> Link:
    """Return a link that is a box of random sides, turned at random."""
    x, y, z = rng.uniform(0.15, 0.5, 3) * size
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    inertia = (
        axes
        @ np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
        @ axes.T
        * mass
        / 3.0
    )
    entries = [
        float(inertia[i, j])
        for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    ]
    a, b, c, d, e, f = entries
    return Link(mass, (float(com[0]), float(com[1]), float(com[2])), (a, b, c, d, e, f))
