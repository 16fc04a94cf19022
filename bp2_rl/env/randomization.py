"""Domain randomisation: draw random parameters of the ground and the robot, apply them
to model and motors, and push the robot."""

import dataclasses
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Float

from bp2_rl.base import arrays
from bp2_rl.base.bounds import Range
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator
from bp2_rl.robot.ground import HALF, Ground, HeightField, Stairs, shared_grid
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.losses import Resistance
from bp2_rl.settings.env import RandomizationConfig
from bp2_rl.settings.terrain import TerrainConfig

T = TypeVar("T")
LOSS_FACTORS = "air", "gear", "joints", "slides", "lag", "bus", "sag"
DESIGN_FACTORS = "no_load_speed", "armature", "spring_stiffness", "spring_damping"
"""Design parameters with a random factor for each robot; drawn only if their ranges are
set."""


class Randomization(struct.PyTreeNode):
    """Random parameters of a robot and its ground; the critic observes those in
    `PRIVILEGED`."""

    friction: Float[Array, "..."]
    mass: Float[Array, "... nbody"]  # factor
    com_offset: Float[Array, "... 3"]  # m, trunk
    strength: Float[Array, "... 12"]  # factor
    braking: Float[Array, "..."] | None
    """weakness of braking: the no-load speed over the speed at which the braking torque
    reaches zero; None: the hardware's"""
    stiffness: Float[Array, "... 12"]  # factor
    damping: Float[Array, "... 12"]  # factor
    latency: Float[Array, "..."]  # s
    losses: Float[Array, "... 7"]  # factors, in the order of `LOSS_FACTORS`
    # factors, in the order of `DESIGN_FACTORS`; None: the hardware's, without
    # computation
    no_load_speed: Float[Array, "..."] | None = None
    armature: Float[Array, "..."] | None = None
    spring_stiffness: Float[Array, "..."] | None = None
    spring_damping: Float[Array, "..."] | None = None
    ground: Ground | None = None  # None: the flat floor
    # m/s2, world's axes, on a slope; None: straight down
    gravity: Float[Array, "... 3"] | None = None


def nominal(num_bodies: int, hardware: HardwareSpec) -> Randomization:
    """Return the parameters of the robot as designed, in place of random ones."""
    ones = jnp.ones(12)
    return Randomization(
        friction=jnp.asarray(hardware.friction, jnp.float32),
        mass=jnp.ones(num_bodies),
        com_offset=jnp.zeros(3),
        strength=ones,
        braking=None,
        stiffness=ones,
        damping=ones,
        latency=jnp.asarray(hardware.losses.latency, jnp.float32),
        losses=jnp.ones(len(LOSS_FACTORS)),
    )


def draw(
    key: Array, config: RandomizationConfig, num_bodies: int, hardware: HardwareSpec
) -> Randomization:
    """Draw random parameters of a robot; return the nominal ones if randomisation is
    off."""
    if not config.enabled:
        return nominal(num_bodies, hardware)
    keys = jax.random.split(key, 7)

    def uniform(key: Array, shape: tuple[int, ...], bounds: Range) -> Array:
        return jax.random.uniform(key, shape, minval=bounds[0], maxval=bounds[1])

    design = {
        name: uniform(jax.random.fold_in(key, 9 + i), (), bounds)
        for i, name in enumerate(DESIGN_FACTORS)
        if (bounds := getattr(config, name)) is not None
    }
    drawn = Randomization(
        friction=hardware.friction * uniform(keys[0], (), config.friction),
        mass=uniform(keys[1], (num_bodies,), config.mass),
        com_offset=uniform(keys[2], (3,), (-config.com_offset, config.com_offset)),
        strength=uniform(keys[3], (12,), config.strength),
        stiffness=uniform(keys[4], (12,), config.gains),
        damping=uniform(keys[5], (12,), config.gains),
        latency=uniform(keys[6], (), config.latency),
        # Separate keys, so that older settings still draw the same robots: more splits
        # of the first key would change its draws.
        losses=uniform(jax.random.fold_in(key, 7), (len(LOSS_FACTORS),), config.losses),
        braking=uniform(jax.random.fold_in(key, 8), (), config.weak_braking)
        if config.weak_braking[1]
        else None,
    )
    return drawn.replace(**design)


def with_terrain(
    key: Array, robot: Randomization, config: TerrainConfig, level: Float[Array, ""]
) -> Randomization:
    """Return the parameters with a random ground for a curriculum level; a slope rises
    in any direction."""
    key_size, key_cell, key_place, key_slope, key_way = jax.random.split(key, 5)

    def drawn(key: Array, bounds: Range) -> Array:
        least, most = bounds
        most = least + level * (most - least)
        return jax.random.uniform(key, minval=least, maxval=most)

    if config.slope[1]:
        way = jax.random.uniform(key_way, maxval=2.0 * jnp.pi)
        slope = drawn(key_slope, config.slope)
        ahead, beside = jnp.sin(slope) * jnp.cos(way), jnp.sin(slope) * jnp.sin(way)
        down = -conventions.GRAVITY * jnp.stack([ahead, beside, jnp.cos(slope)])
        robot = robot.replace(gravity=down)
    if config.kind == "flat":
        return robot
    size, (low, high) = drawn(key_size, config.size), config.cell
    cell = jax.random.uniform(key_cell, minval=low, maxval=high)
    place = jax.random.uniform(key_place, (2,))
    if config.kind == "stairs":
        # near the middle of an upper or a lower landing, so that all feet stand on it
        start = HALF * jnp.round(place[0]) + 2.0 * place[1] - 1.0
        return robot.replace(ground=Stairs(size, cell, start))
    grid = shared_grid(config.kind)
    column, row = len(grid.heights) * place
    return robot.replace(ground=HeightField(grid, size, cell, column, row))


def push(
    qvel: Float[Array, " nv"], config: RandomizationConfig, key: Array
) -> Float[Array, " nv"]:
    """Return the velocities after a control step, in which a random push may change the
    trunk's horizontal velocity."""
    if not config.enabled or config.push_velocity == 0.0:
        return qvel
    key_when, key_what = jax.random.split(key)
    now = jax.random.bernoulli(
        key_when, conventions.CONTROL_STEP / config.push_interval
    )
    kick = jax.random.uniform(
        key_what, (2,), minval=-config.push_velocity, maxval=config.push_velocity
    )
    return qvel.at[:2].add(jnp.where(now, kick, 0.0))


def as_drawn(numbers: T, factor: arrays.Array | None) -> T:
    """Multiply design parameters, an array or a tree of arrays, by a random factor;
    without a factor, return them unchanged."""
    if factor is None:
        return numbers
    return jax.tree.map(lambda x: x * factor, numbers)


def randomize_actuator(actuator: Actuator, randomization: Randomization) -> Actuator:
    """Return the motors with this robot's random strength, speeds, brakes, gains, lag
    and bus."""
    changed = dataclasses.replace(
        actuator,
        strength=actuator.strength * randomization.strength,
        stiffness=actuator.stiffness * randomization.stiffness,
        damping=actuator.damping * randomization.damping,
    )
    if randomization.no_load_speed is not None:
        names = ["corner_speed", "no_load_speed"]
        if np.any(np.isfinite(actuator.braking_speed)):
            names.append("braking_speed")
        speeds = {name: getattr(actuator, name) for name in names}
        factor = randomization.no_load_speed[..., None]
        changed = dataclasses.replace(changed, **as_drawn(speeds, factor))
    if randomization.braking is not None:
        weakest = jnp.maximum(
            actuator.no_load_speed / actuator.braking_speed,
            randomization.braking[..., None],
        )
        speed = changed.no_load_speed / jnp.maximum(weakest, 1e-6)
        changed = dataclasses.replace(changed, braking_speed=speed)
    lag, power, sag = (
        randomization.losses[..., LOSS_FACTORS.index(name)]
        for name in ("lag", "bus", "sag")
    )
    if actuator.current_lag != 0.0:
        changed = dataclasses.replace(
            changed, current_lag=actuator.current_lag * lag[..., None]
        )
    if (bus := actuator.bus) is not None:
        bus = dataclasses.replace(
            bus,
            power_out=bus.power_out * power,
            power_in=bus.power_in * power,
            sag=bus.sag * sag,
        )
        changed = dataclasses.replace(changed, bus=bus)
    return changed


def randomize_resistance(
    resistance: Resistance, randomization: Randomization
) -> Resistance:
    """Return the resistance with this robot's losses; each broadcasts against the
    robots' joints or legs.

    Friction acts less stiffly on a lighter rotor; otherwise friction would reverse the
    rotor's motion.
    """
    names = "air", "gear", "joints", "slides"
    air, gear, joints, slides = (
        randomization.losses[..., LOSS_FACTORS.index(name), None] for name in names
    )
    lighter = randomization.armature
    if lighter is not None:
        lighter = lighter.clip(max=1.0)[..., None]
    return dataclasses.replace(
        resistance,
        drag=resistance.drag * air,
        gear_loss=resistance.gear_loss * gear,
        joint_friction=resistance.joint_friction * joints,
        joint_viscosity=resistance.joint_viscosity * joints,
        spring_friction=resistance.spring_friction * slides,
        joint_hold=as_drawn(resistance.joint_hold, lighter),
    )
