"""Ease a forward command: a policy is told no faster rise or fall than the robot can
follow.

Functions take numbers of NumPy or JAX and import neither, so that training, judging and
the robot's own computer share them.
"""

import math
from typing import Any, Protocol, runtime_checkable

from bp2_rl.base.arrays import ArrayT
from bp2_rl.robot.conventions import CONTROL_STEP

COMMAND_LIMITS = ("braking", "stopping_time", "launching", "launching_speed")
"""The names of the limits in settings and on a robot's computer."""
EASE = 0.5
"""m/s: a forward command that falls towards minus so much, in `stopping_time`, comes to
rest."""


@runtime_checkable
class CommandLimits(Protocol):
    """How fast a forward command rises and falls at most; `ControlConfig` explains each
    limit."""

    @property
    def braking(self) -> float: ...  # noqa: D102
    @property
    def stopping_time(self) -> float: ...  # noqa: D102
    @property
    def launching(self) -> float: ...  # noqa: D102
    @property
    def launching_speed(self) -> float: ...  # noqa: D102


def launch_rate(speed: Any, limits: CommandLimits, xp: Any) -> Any:
    """Return how fast the forward command rises at most where it is `speed` (m/s),
    m/s2; `xp` is NumPy or JAX's."""
    return limits.launching * xp.clip(1.0 - speed / limits.launching_speed, 0.0, 1.0)


def eased(told: ArrayT, asked: ArrayT, limits: CommandLimits) -> ArrayT:
    """Return the command (3) that a policy is told a control step after `told`, where
    `asked` is asked for.

    It is the command asked for, but that a robot on its way forward gathers and loses
    speed no faster than its limits.
    """
    xp, before, forward = told.__array_namespace__(), told[0], asked[0]
    if limits.launching < math.inf:
        forward = xp.minimum(
            forward,
            xp.maximum(before, 0.0) + CONTROL_STEP * launch_rate(before, limits, xp),
        )
    if limits.braking < math.inf or limits.stopping_time:
        rate = limits.braking
        if limits.stopping_time:
            rate = xp.minimum(rate, (before + EASE) / limits.stopping_time)
        least = xp.maximum(before - CONTROL_STEP * rate, 0.0)
        forward = xp.where(before > 0.0, xp.maximum(forward, least), forward)
    return xp.concat([xp.reshape(forward, (1,)), asked[1:]])
