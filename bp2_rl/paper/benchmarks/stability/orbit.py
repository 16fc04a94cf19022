"""The return map of a policy's gait: from one cycle of its clock to the next, of robots
that begin side by side."""

import itertools
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bp2_rl.paper.benchmarks.stability.coordinates import Coordinates
from bp2_rl.paper.benchmarks.stability.group import GroupState, RobotGroup
from bp2_rl.robot import conventions
from bp2_rl.simulation.rollout import MOST

TICK = conventions.CONTROL_STEP
# m/s, by which a command may be lower to have a stride of whole control steps
REACH = 2.0
GRID = 0.05  # m/s, the slowest command that is looked at
POINTS = 81  # commands that are looked at, and then between two of them


def whole_strides(
    phase_rate: Callable[[Array], Array], speed: float
) -> tuple[float, int] | None:
    """The command (m/s) nearest to this one whose stride is a whole number of control
    steps, and that number.

    `phase_rate` is the clock's: cycles a second under a command (3). Only then is the
    closed loop periodic. None where there is none within `REACH`, as for a clock that
    stands still.
    """

    @jax.jit
    def ticks(commands: Array) -> Array:
        return 1.0 / (
            TICK
            * jax.vmap(phase_rate)(jnp.zeros((len(commands), 3)).at[:, 0].set(commands))
        )

    def found(commands: Float[np.ndarray, " N"]) -> list[tuple[float, float, int]]:
        """Between which commands, and how many control steps."""
        counts = np.asarray(ticks(jnp.asarray(commands, jnp.float32)), np.float64)
        ends = zip(
            itertools.pairwise(commands.tolist()),
            itertools.pairwise(counts.tolist()),
            strict=True,
        )
        return [
            (low, high, wanted)
            for (low, high), (first, last) in ends
            if first != last and math.isfinite(first) and math.isfinite(last)
            for wanted in range(
                math.ceil(min(first, last)), math.floor(max(first, last)) + 1
            )
        ]

    low, high, wanted = min(
        found(np.linspace(max(speed - REACH, GRID), speed + REACH, POINTS)),
        key=lambda one: abs(one[0] - speed),
        default=(0.0, 0.0, 0),
    )
    if wanted == 0:
        return None
    finer = [one for one in found(np.linspace(low, high, POINTS)) if one[2] == wanted]
    return (0.5 * (finer[0][0] + finer[0][1]) if finer else 0.5 * (low + high)), wanted


class Orbit:
    """The map from the clock's phase 0 to its next phase 0.

    Args:
        group: the robots, without noise.
        coordinates: of their states.
        speed: m/s, commanded.
        ticks: control steps a stride.
        base: one robot at phase 0; says all that coordinates leave out.
    """

    def __init__(
        self,
        group: RobotGroup,
        coordinates: Coordinates,
        speed: float,
        ticks: int,
        base: GroupState,
    ):
        self.group, self.coordinates, self.speed, self.ticks, self.base = (
            group,
            coordinates,
            speed,
            ticks,
            base,
        )

    @property
    def at(self) -> Float[np.ndarray, " D"]:
        """The base's coordinates."""
        return self.coordinates.read(self.base)[0]

    def commands(self, robots: int) -> Float[np.ndarray, "K N 3"]:
        """What they are told."""
        return np.tile(np.array([self.speed, 0.0, 0.0]), (self.ticks, robots, 1))

    def step(self, states: Float[np.ndarray, "N D"]) -> Float[np.ndarray, "N D"]:
        """A stride on; NaN for those that fell."""
        return self.follow(states, 1)[1]

    def follow(
        self, states: Float[np.ndarray, "N D"], strides: int
    ) -> Float[np.ndarray, "S N D"]:
        """Stride after stride, from the states themselves on; NaN from a fall on."""
        chunks = (states[first : first + MOST] for first in range(0, len(states), MOST))
        return np.concatenate(
            [self._follow(chunk, strides) for chunk in chunks], axis=1
        )

    def _follow(
        self, states: Float[np.ndarray, "N D"], strides: int
    ) -> Float[np.ndarray, "S N D"]:
        moment, fallen = (
            self.coordinates.write(states, self.base),
            np.zeros(len(states), bool),
        )
        passed = [states]
        for _ in range(strides):
            moment, fell, _ = self.group.run(moment, self.commands(len(states)))
            fallen |= fell
            passed.append(
                np.where(fallen[:, None], np.nan, self.coordinates.read(moment))
            )
        return np.stack(passed)
