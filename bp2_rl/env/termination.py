"""The conditions of a fall, in training and in benchmarks."""

import functools
import operator
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from jaxtyping import Bool, Float

from bp2_rl.base.arrays import Array
from bp2_rl.env.observations import PrivilegedInputs, own_number
from bp2_rl.robot.clearance import clearance
from bp2_rl.robot.coordinates import compressions, joint_positions
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.settings.env import EnvConfig, TerminationConfig
from bp2_rl.settings.task import TerminationTerm


class Fall(NamedTuple):
    """The reasons why a robot has fallen, one flag each; NumPy or JAX, with the batch
    axes of the states."""

    exploded: Bool[Array, "..."]  # its state is no longer that of a robot
    too_low: Bool[Array, "..."]
    tilted: Bool[Array, "..."]
    # a leg overlaps another leg or the trunk; None if this is not checked
    self_collision: Bool[Array, "..."] | None = None
    # the terminations of the task, by name
    own: Mapping[str, Bool[Array, "..."]] | None = None

    @property
    def reasons(self) -> dict[str, Bool[Array, "..."]]:
        """The checked reasons by name, the gravest first; if several hold at once, the
        first one counts."""
        reasons = {
            "exploded": self.exploded,
            "too_low": self.too_low,
            "tilted": self.tilted,
            "self_collision": self.self_collision,
            **{f"task/{name}": own for name, own in (self.own or {}).items()},
        }
        return {name: holds for name, holds in reasons.items() if holds is not None}

    @property
    def happened(self) -> Bool[Array, "..."]:
        """Return whether the robot has fallen for any reason."""
        return functools.reduce(operator.or_, self.reasons.values())


def fall(
    qpos: Float[Array, "... nq"],
    qvel: Float[Array, "... nv"],
    config: TerminationConfig,
) -> Fall:
    """Return the reasons of a fall for a state in MuJoCo's coordinates, of NumPy or
    JAX."""
    xp = qpos.__array_namespace__()
    # Every comparison is one that NaN fails.
    sound = xp.all(xp.isfinite(qpos), axis=-1) & xp.all(
        xp.abs(qvel) <= config.max_speed, axis=-1
    )
    # vertical part of the trunk's z axis
    up = 1.0 - 2.0 * (qpos[..., 4] ** 2 + qpos[..., 5] ** 2)
    return Fall(~sound, ~(qpos[..., 2] >= config.min_height), ~(up >= config.min_up))


def fall_in_training(
    qpos: Float[Array, "... nq"],
    qvel: Float[Array, "... nv"],
    torque: Float[Array, "... 12"],
    action: Float[Array, "... 12"],
    config: EnvConfig,
) -> Fall:
    """Return the reasons why an episode ends after this action: `fall`, a number that
    is not finite, self-collision."""
    xp = qpos.__array_namespace__()
    state = fall(qpos, qvel, config.termination)
    finite = xp.all(xp.isfinite(action), axis=-1) & xp.all(xp.isfinite(torque), axis=-1)
    collision = self_collision(qpos, config.termination, config.hardware)
    return Fall(state.exploded | ~finite, state.too_low, state.tilted, collision)


def own_falls(
    terminations: Iterable[TerminationTerm], now: PrivilegedInputs
) -> dict[str, Bool[Array, ""]]:
    """Return for each termination of a task, by name, whether it ends a robot's
    episode.

    Raises:
        UserError: a termination fails, or returns more than one number.
    """
    return {
        termination.name: own_number(
            f"termination {termination.name}", termination.read, now
        )
        > 0
        for termination in terminations
    }


def self_collision(
    qpos: Float[Array, "... nq"], config: TerminationConfig, hardware: HardwareSpec
) -> Bool[Array, "..."] | None:
    """Return whether a leg overlaps another leg or the trunk by more than the limit;
    None if legs are not solid.

    Training has no contacts between legs, and ends the episode instead; C MuJoCo
    simulates these contacts.
    """
    if not hardware.solid_legs:
        return None
    joints = joint_positions(qpos).reshape(*qpos.shape[:-1], 4, 3)
    return ~(
        clearance(joints, compressions(qpos), hardware).least >= -config.max_overlap
    )
