"""Robots drawn as in training, around the one designed, and the pushes that each
meets."""

import dataclasses
import functools

import jax
import mujoco
import numpy as np

from bp2_rl.env import randomization
from bp2_rl.env.randomization import Randomization
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import foot_geom_ids
from bp2_rl.settings.env import RandomizationConfig
from bp2_rl.simulation.world import Push


@dataclasses.dataclass(frozen=True)
class Draw:
    """One robot of a fleet, and all that chance decides about its run."""

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
        """Give the model its masses, inertias, trunk's centre of mass, and friction of
        feet and ground."""
        drawn = self.values(hardware, model.nbody)
        model.body_mass *= drawn.mass
        model.body_inertia *= drawn.mass[:, None]
        model.body_ipos[model.body("trunk").id] += drawn.com_offset
        model.geom_friction[[model.geom("floor").id, *foot_geom_ids(model)], 0] = (
            drawn.friction
        )
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def motors(self, motors: Actuator, hardware: HardwareSpec) -> Actuator:
        """Return the motors with their strength, brakes, gains, lag and bus."""
        return randomization.randomize_actuator(motors, self.values(hardware))

    def resistance(self, resistance: Resistance, hardware: HardwareSpec) -> Resistance:
        """Return the losses with their factors."""
        changed = vars(
            randomization.randomize_resistance(resistance, self.values(hardware))
        )
        numbers = {name: np.asarray(value) for name, value in changed.items()}
        return Resistance(
            **{name: x.item() if x.size == 1 else x for name, x in numbers.items()}
        )

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
        """Seed of the sensors' noise; None where nothing is drawn."""
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
