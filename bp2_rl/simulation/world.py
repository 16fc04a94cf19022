"""The world of a run: slopes, rough ground, pushes, sensors on a slope, and robots with
random properties."""

import dataclasses
import functools
import math
from typing import Annotated

import jax
import mujoco
import numpy as np
from jaxtyping import Float

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.env import randomization
from bp2_rl.env.randomization import Randomization
from bp2_rl.robot import conventions
from bp2_rl.robot.ground import (
    BREADTH,
    HALF,
    LENGTH,
    Grid,
    Ground,
    HeightField,
    Stairs,
    draw_heights,
)
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.kinematics import yaw_of
from bp2_rl.robot.model import foot_geom_ids
from bp2_rl.settings.env import RandomizationConfig
from bp2_rl.settings.terrain import Terrain

BEHIND = 5.0  # m, from where ground that is not flat begins to the start
EVEN = 1.0  # m, around the start: there it is even


@dataclasses.dataclass(frozen=True)
class Push(Bounded, path="push."):
    """A sudden change of the robot's velocity at `time` (s): forward and left in its
    heading's frame (m/s), and yaw rate (rad/s)."""

    time: Annotated[float, Within(0.0, 3600.0)]  # s
    forward: Annotated[float, Within(-10.0, 10.0)]  # m/s
    left: Annotated[float, Within(-10.0, 10.0)]  # m/s
    turn: Annotated[float, Within(-10.0, 10.0)] = 0.0  # rad/s, to the left

    @property
    def step(self) -> int:
        """The physics step at which the push is due."""
        return round(self.time / conventions.PHYSICS_STEP)


@dataclasses.dataclass(frozen=True)
class World(Bounded, path="world."):
    """Ground and pushes of a run; by default a level, even floor without pushes.

    On a slope the floor stays the plane z = 0 and gravity tilts: heights, falls and
    speeds are relative to the slope, and sensors measure the true vertical. Rough
    ground and waves are fields of heights, 240 m long and 12 m wide, and stairs are
    boxes of this width; a run on them ends before the ground does.
    """

    terrain: Terrain = Terrain()
    pushes: tuple[Push, ...] = ()

    @property
    def ground(self) -> Ground | None:
        """The ground that is not flat, if the world has one."""
        return _laid_out(self.terrain) if self.terrain.size else None

    @property
    def end(self) -> float:
        """Distance ahead at which a run ends, m: a metre before the end of the
        ground."""
        return LENGTH - BEHIND - 1.0 if self.terrain.size else math.inf

    def lay(self, spec: mujoco.MjSpec) -> None:
        """Lay the ground in a MuJoCo scene, and tilt its gravity, which stands for the
        slope."""
        if self.ground:
            self.ground.lay(spec)
        if slope := self.terrain.slope:
            spec.option.gravity = conventions.GRAVITY * np.array(
                [-np.sin(slope), 0.0, -np.cos(slope)]
            )


LEVEL = World()


@functools.lru_cache(maxsize=16)
def _laid_out(terrain: Terrain) -> Ground:
    """Return the ground of a run, even around the start."""
    cell = terrain.cell
    if terrain.kind == "stairs":  # from the middle of a lower landing
        return Stairs(terrain.size, cell, float(HALF))
    behind, right = round(BEHIND / cell), round(BREADTH / 2 / cell)
    columns, rows = round(LENGTH / cell) + 1, 2 * right + 1
    heights = draw_heights(terrain.kind, terrain.seed, rows, columns)
    y, x = (
        cell * np.abs(np.arange(n) - at) for n, at in ((rows, right), (columns, behind))
    )
    heights[(y[:, None] <= EVEN) & (x <= EVEN)] = 0.0
    return HeightField(Grid(heights), terrain.size, cell, float(behind), float(right))


def shove(
    qpos: Float[np.ndarray, " nq"],
    qvel: Float[np.ndarray, " nv"],
    forward: float,
    left: float,
    turn: float = 0.0,
) -> None:
    """Change the velocity `qvel` of a robot at `qpos` in the frame of its heading
    (m/s), and its yaw rate (rad/s), at once."""
    yaw = yaw_of(qpos[3:7])
    cos, sin = np.cos(yaw), np.sin(yaw)
    qvel[:2] += (cos * forward - sin * left, sin * forward + cos * left)
    if turn:
        to_trunk = np.zeros(4)
        spin = np.zeros(3)
        mujoco.mju_negQuat(to_trunk, qpos[3:7])
        mujoco.mju_rotVecQuat(spin, np.array([0.0, 0.0, turn]), to_trunk)
        qvel[3:6] += spin


def sensed_pose(
    qpos: Float[np.ndarray, " nq"], world: World, gyro_bias: float, time: float
) -> Float[np.ndarray, " nq"]:
    """Return the robot's positions as measured by its sensors: true vertical on a
    slope, heading with gyro drift.

    Args:
        qpos: the true one, in the frame of the ground.
        world: the ground.
        gyro_bias: rad/s, of the gyro that the heading is integrated from, since the
            start.
        time: s, since then.
    """
    if world.terrain.slope == 0.0 and gyro_bias == 0.0:
        return qpos
    sensed = qpos.copy()
    for axis, angle in (
        ((0.0, 1.0, 0.0), -world.terrain.slope),
        ((0.0, 0.0, 1.0), gyro_bias * time),
    ):
        turn = np.zeros(4)
        before = sensed[3:7].copy()
        mujoco.mju_axisAngle2Quat(turn, np.array(axis), angle)
        mujoco.mju_mulQuat(sensed[3:7], turn, before)
    return sensed


# --- What chance makes of a robot ---


@dataclasses.dataclass(frozen=True)
class Draw:
    """The random properties of a robot in a fleet, and of its run."""

    ranges: RandomizationConfig
    seed: int  # of the fleet
    number: int  # of the robot in it

    def values(self, hardware: HardwareSpec, bodies: int = 1) -> Randomization:
        """Return the robot's random values in NumPy, the same at every call.

        Args:
            hardware: the robot as it was designed.
            bodies: how many masses are drawn.
        """
        return _drawn(self, hardware, bodies)

    def change_model(self, model: mujoco.MjModel, hardware: HardwareSpec) -> None:
        """Set the drawn masses, inertias, trunk's centre of mass, friction, springs and
        rotors in a MuJoCo model."""
        drawn = self.values(hardware, model.nbody)
        model.body_mass *= drawn.mass
        model.body_inertia *= drawn.mass[:, None]
        model.body_ipos[model.body("trunk").id] += drawn.com_offset
        model.geom_friction[[model.geom("floor").id, *foot_geom_ids(model)], 0] = (
            drawn.friction
        )
        for field, factor in (
            (model.jnt_stiffness, drawn.spring_stiffness),
            (model.dof_damping, drawn.spring_damping),
            (model.dof_armature, drawn.armature),
        ):
            field[:] = randomization.as_drawn(field, factor)
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def pushes(self, duration: float) -> tuple[Push, ...]:
        """Draw the pushes of a run of `duration` s, as likely at every control step."""
        if not self.ranges.enabled or self.ranges.push_velocity == 0.0:
            return ()
        rng = np.random.default_rng((self.seed, self.number))
        steps = np.arange(1, round(duration / conventions.CONTROL_STEP))
        times = (
            conventions.CONTROL_STEP
            * steps[
                rng.uniform(size=len(steps))
                < conventions.CONTROL_STEP / self.ranges.push_interval
            ]
        )
        kicks = rng.uniform(
            -self.ranges.push_velocity, self.ranges.push_velocity, (len(times), 2)
        )
        return tuple(
            Push(float(time), *map(float, kick))
            for time, kick in zip(times, kicks, strict=True)
        )

    @property
    def noise_seed(self) -> int | None:
        """Seed of the sensor noise; None without randomisation."""
        if not self.ranges.enabled:
            return None
        return int(
            np.random.SeedSequence((self.seed, self.number)).generate_state(1)[0]
        )


@functools.lru_cache(maxsize=64)
def _drawn(draw: Draw, hardware: HardwareSpec, bodies: int) -> Randomization:
    with jax.default_device(jax.devices("cpu")[0]):
        key = jax.random.fold_in(jax.random.PRNGKey(draw.seed), draw.number)
        drawn = randomization.draw(key, draw.ranges, bodies, hardware)
    return jax.tree.map(lambda x: np.asarray(x, np.float64), drawn)
