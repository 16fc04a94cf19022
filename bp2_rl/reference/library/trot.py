"""The collocation gait: the motions of a library, between its speeds and beyond them, as a reference motion.

A library holds, for every speed, half a gait cycle: stance of FL and RR, then flight; left and right then change
places. Between its points the coordinates are the cubics through their values and rates, and torques are straight
lines. Between its speeds everything is blended at equal shares of a segment, so that touchdowns and lift-offs meet,
with weights that make the mean speed exactly the one commanded. Velocities jump at touchdown: that is the impact.

Beyond the library's greatest speed its motion stays what it is there. Below the least speed, backwards, sideways and
turning, the motion is that of the nearest speed with every foot displaced by what the ground moves otherwise in its
stance: p' = -v - omega x p, measured from mid-stance; a cubic brings the foot back during the swing. Around standing
still, steps shrink to nothing. All this happens to the centres of the spherical feet, with the trunk's pitch taken
out, so that no foot leaves the ground or enters it; only a leg that is all but straight cannot follow and stays above
it. Torques are those of straight running.
"""

import dataclasses
import functools
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bp2_rl.reference.interface import Reference
from bp2_rl.reference.library.table import load_table
from bp2_rl.reference.library_law import LibraryLaw, mix
from bp2_rl.reference.stepping import STANDING, foot_circle
from bp2_rl.robot import conventions, kinematics
from bp2_rl.robot.hardware import IDEAL, HardwareSpec
from bp2_rl.settings.reference import CollocationConfig


@dataclasses.dataclass(frozen=True)
class CollocationGait(CollocationConfig):
    """The `ReferenceMotion` that a motion library holds.

    The motion is that of the robot for which the library was made; of `hardware`, name and legs must be that robot's,
    and standing still takes mass and springs into account.
    """

    hardware: HardwareSpec = IDEAL

    @property
    def height(self) -> float:
        """Least over the speeds, standing included, of the trunk's mean height above the ground, m."""
        return min(load_table(self.file, self.hardware.anatomy).height, _stand(self.hardware).height)

    @property
    def law(self) -> LibraryLaw:
        """The gait as a law of numbers, with this robot's lengths."""
        return _law(self.file, self.hardware, self.stepping_speed)

    def phase_rate(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Cycles per second at this command."""
        return self.law.phase_rate(command)

    def stepping(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """0 when standing, 1 from `stepping_speed` on, with a continuous derivative."""
        return self.law.stepping(command)

    def __call__(self, command: Float[Array, "... 3"], phase: Float[Array, "..."]) -> Reference:
        """The reference at this command and phase (see `ReferenceMotion`)."""
        law, stand = self.law, _stand(self.hardware)
        q, qd, torque, stepping, stride, moment, rate, since_touchdown = law.motion(command, phase, jax.jvp)
        pitch, height_rate = stepping * moment.pitch, stepping * rate.height
        forward = law.forward(command) + stepping * (rate.x - stride.speed)
        standing = (since_touchdown < stride.stance[..., None]) | (stepping[..., None] < STANDING)
        return Reference(
            joint_position=q.reshape(*phase.shape, 12),
            joint_velocity=qd.reshape(*phase.shape, 12),
            spring_compression=mix(stepping[..., None], stand.sag, moment.spring),
            spring_velocity=stepping[..., None] * rate.spring,
            height=mix(stepping, stand.height, moment.height),
            height_velocity=height_rate,
            up=jnp.stack([jnp.sin(pitch), jnp.zeros_like(pitch), jnp.cos(pitch)], axis=-1),
            pitch=pitch,
            pitch_rate=stepping * rate.pitch,
            velocity=jnp.stack([forward, command[..., 1], height_rate], axis=-1),
            contact=standing.astype(q.dtype),
            torque=jnp.pad(torque, [(0, 0)] * phase.ndim + [(0, 0), (1, 0)]).reshape(*phase.shape, 12),
        )


@functools.lru_cache(maxsize=8)
def _law(library: Path, hardware: HardwareSpec, stepping_speed: float) -> LibraryLaw:
    table, stand = load_table(library, hardware.anatomy), _stand(hardware)
    low, high = np.transpose([leg.ranges[2] for leg in hardware.anatomy.legs])
    return LibraryLaw(
        strides=table.strides,
        cubics=table.cubics,
        legs=hardware.anatomy.geometry,
        straightest=np.clip(0.0, low, high),
        feet=stand.feet,
        sag=stand.sag,
        torque=stand.torque,
        circle=foot_circle(hardware),
        stepping_speed=stepping_speed,
    )


class _Stand(NamedTuple):
    """Standing still: the robot's pose on legs without mass, each of which bears a quarter of the weight."""

    feet: Float[np.ndarray, "4 3"]  # m, centres of the feet from the trunk's centre
    sag: Float[np.ndarray, "4"]  # m; zero of rigid shanks
    height: float  # m, of the trunk's centre
    torque: Float[np.ndarray, "4 2"]  # Nm, hip and knee


@functools.lru_cache(maxsize=8)
def _stand(hardware: HardwareSpec) -> _Stand:
    anatomy, legs = hardware.anatomy, hardware.anatomy.geometry
    load, angles = hardware.mass * conventions.GRAVITY / 4.0, np.reshape(anatomy.stand, (4, 3))
    hip, lean = angles[:, 1], angles[:, 1] + angles[:, 2]
    sag = load * np.cos(lean) / hardware.spring_stiffness if anatomy.sprung else np.zeros(4)
    lower = legs.lower - sag - legs.foot_radius
    feet = kinematics.foot_position(angles, sag + legs.foot_radius, hardware)
    # What the joints hold is how the feet's height goes with their angles.
    knee = -load * lower * np.sin(lean)
    torque = np.stack([knee - load * legs.thigh * np.sin(hip), knee], axis=-1)
    return _Stand(feet, sag, float(np.max(legs.foot_radius - feet[:, 2])), torque)
