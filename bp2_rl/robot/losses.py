"""Forces that resist motion: air drag, friction in joints and gears, friction in the
springs' slides.

Pure and batched; NumPy and JAX arrays alike, so that every engine applies the same
forces. They act for a physics step as they are at its beginning. Friction opposes
motion in full only where it cannot reverse it within the step; below that speed it is
as viscous as brings the lightest inertia it can meet to rest, which keeps a step
stable.

    air        -1/2 rho CdA |u| u,  u = v - wind                                   on the trunk, horizontal
    joint      -(c + (1 - e) |tau|) sigma(w) - b w                                 Coulomb, gear, viscous
    slide      -f sigma(s')                                                        on the spring's coordinate
    rebound    -d s'  where s < 0                                                  its stop's damping

The gear's efficiency e is that of the torque: driving, the joint gets e tau of the
motor's torque tau; braking, it feels (2 - e) tau, of which the motor gets the share 1 /
(2 - e).
"""

import dataclasses

import numpy as np

from bp2_rl.base.arrays import Array, Number
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.coordinates import (
    compression_rates,
    compressions,
    joint_velocities,
    with_legs,
)
from bp2_rl.robot.hardware import HardwareSpec, at_joints

SHARE_OF_SHANK = 0.25
"""share of a shank's inertia about the knee that a joint turns at the least, as the
shank gives way at its other end"""
LEAST_TOE = 0.2
"""kg: least effective mass of a spring's coordinate, as the knee's end gives way too;
0.22 over the joints' ranges. A lighter toe's is less, at least in proportion; of a
heavier toe the knee's end gives way the more."""


@dataclasses.dataclass(frozen=True)
class Resistance:
    """Coefficients of drag, friction and gear loss; numbers, or arrays over robots."""

    drag: Number  # N s2/m2, 1/2 rho CdA
    headwind: Number  # m/s, of air that blows towards -x
    gear_loss: Number  # share of the motor's torque
    joint_friction: Number  # Nm, this and the next one number, or one for each joint
    joint_viscosity: Number  # Nm s/rad
    spring_friction: Number  # N
    rebound_damping: Number  # N s/m
    joint_hold: Number  # Nm s/rad, friction per speed near rest
    spring_hold: Number  # N s/m, friction per speed near rest

    @classmethod
    def from_hardware(cls, hardware: HardwareSpec) -> "Resistance | None":
        """Return the resistance of a robot, or None if nothing resists its motion."""
        losses = hardware.losses
        toe = hardware.anatomy.legs[0].toe
        least_toe = LEAST_TOE * min(toe.mass / bp2.TOE_MASS, 1.0) if toe else 0.0
        resistance = cls(
            drag=0.5 * conventions.AIR_DENSITY * losses.drag_area,
            headwind=losses.headwind,
            gear_loss=1.0 - losses.gear_efficiency,
            joint_friction=at_joints(losses.joint_friction),
            joint_viscosity=at_joints(losses.joint_viscosity),
            spring_friction=losses.spring_friction,
            rebound_damping=hardware.rebound_damping,
            joint_hold=_least_inertia(hardware) / conventions.PHYSICS_STEP,
            spring_hold=hardware.mass_scale * least_toe / conventions.PHYSICS_STEP,
        )
        harmless = "headwind", "joint_hold", "spring_hold"  # without the others
        parts = [
            value for name, value in vars(resistance).items() if name not in harmless
        ]
        return resistance if any(np.any(part) for part in parts) else None


def _least_inertia(hardware: HardwareSpec) -> float:
    """Return the least inertia that a joint turns, kg m2: its rotor's, or a share of
    the shank's where rotors are lighter."""
    shanks = [leg.shank for leg in hardware.anatomy.legs]
    shank = min(
        link.inertia[1] + link.mass * (link.com[0] ** 2 + link.com[2] ** 2)
        for link in shanks
    )
    return max(
        float(np.min(hardware.reflected_inertia)),
        SHARE_OF_SHANK * hardware.mass_scale * shank,
    )


@dataclasses.dataclass(frozen=True)
class Loss:
    """Resisting forces by their cause: air, gear, joint, slide and rebound stop."""

    air: Array  # "... 3", N, world frame
    gear: Array  # "... 12", Nm
    joint: Array  # "... 12", Nm
    slide: Array  # "... 4", N
    rebound: Array  # "... 4", N


def loss(resistance: Resistance, qpos: Array, qvel: Array, torque: Array) -> Loss:
    """Return the forces that resist motion in a state (`qpos`, `qvel`) under the
    motors' torque ("... 12", Nm)."""
    r, xp = resistance, qvel.__array_namespace__()
    qd = joint_velocities(qvel)
    rate = compression_rates(qvel)
    compression = compressions(qpos)
    wind = qvel[..., :3] * xp.asarray([1.0, 1.0, 0.0], dtype=qvel.dtype)
    wind = wind + xp.asarray([1.0, 0.0, 0.0], dtype=qvel.dtype) * r.headwind
    air = -r.drag * xp.sqrt(xp.sum(wind * wind, axis=-1, keepdims=True)) * wind
    # Coulomb's and the gear's share what slows a joint near rest.
    geared = r.gear_loss * xp.abs(torque)
    most = r.joint_friction + geared
    friction = -xp.clip(r.joint_hold * qd, -most, most)
    share = geared / xp.where(most > 0.0, most, 1.0)
    return Loss(
        air=air,
        gear=share * friction,
        joint=(1.0 - share) * friction - r.joint_viscosity * qd,
        slide=-xp.clip(r.spring_hold * rate, -r.spring_friction, r.spring_friction),
        rebound=-r.rebound_damping * xp.where(compression < 0.0, rate, 0.0),
    )


def generalized(loss: Loss, qvel: Array) -> Array:
    """Return the resisting forces on the coordinates of `qvel`, N and Nm: MuJoCo's
    `qfrc_applied`."""
    xp = loss.air.__array_namespace__()
    trunk = xp.concat([loss.air, 0.0 * qvel[..., 3:]], axis=-1)
    return with_legs(trunk, loss.gear + loss.joint, loss.slide + loss.rebound)
