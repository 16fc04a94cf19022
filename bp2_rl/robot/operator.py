"""Limits and steering of a velocity command, from an operator to a policy.

The *asked* command comes from a person, a schedule or a random target of training; the
*told* command is the one that the policy observes. Training, the judge, play and the
robot's own computer take the same three steps:

    asked = approach(told, target, rise, fall)    # no faster than a person would ask
    asked = HEADING_HOLD.steer(asked, y, yaw)     # back to the line, on a straight run
    told = law.tell(told, asked)                  # no faster than the robot can follow

Functions take numbers of NumPy or JAX and import neither JAX nor jaxtyping, so that a
robot's own computer shares them.
"""

import dataclasses
import math
from typing import Annotated

import numpy as np

from bp2_rl.base.arrays import ArrayT, Number
from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.robot.conventions import CONTROL_STEP

COMMAND_ACCELERATION = 2.4  # m/s2, at which commands rise; the paper's launch has 2.38
EASE = 0.5
"""m/s: in `stopping_time` a forward command falls by its size plus this speed, so that
it comes to rest."""
Limit = Annotated[float, Within(0.1, 1e9, infinite=True)]
"""A positive limit; infinity means no limit."""


def approach(
    now: ArrayT, target: ArrayT, rise: Number, fall: Number | None = None
) -> ArrayT:
    """Move a command toward its target, by at most `rise` up and `fall` (or `rise`)
    down."""
    xp = now.__array_namespace__()
    return now + xp.clip(target - now, -(rise if fall is None else fall), rise)


@dataclasses.dataclass(frozen=True, kw_only=True)
class LaunchLaw:
    """Limit on how fast a forward command v rises: dv/dt = launching (1 - v /
    launching_speed)."""

    launching: Limit = math.inf
    """m/s2, fastest rise from a stand of the forward command that the policy observes:
    a robot far behind its command accelerates more slowly"""
    launching_speed: Limit = math.inf
    """m/s, command at which this limit reaches zero: the rate falls linearly from
    `launching`"""

    def launch_rate(self, speed: ArrayT) -> ArrayT:
        """Return the fastest rise of the forward command, m/s2, where the command is
        `speed`, m/s."""
        xp = speed.__array_namespace__()
        return self.launching * xp.clip(1.0 - speed / self.launching_speed, 0.0, 1.0)

    def rise_time(self, speed: float, acceleration: float) -> float:
        """Return the time, s, in which a command that should rise at `acceleration`
        (m/s2) gets from rest to `speed` (m/s)."""
        rate, knee = self._knee(acceleration)
        if speed <= knee:
            return speed / rate
        left = (self.launching_speed - speed) / (self.launching_speed - knee)
        return knee / rate - math.log(left) * (self.launching_speed / self.launching)

    def share_risen(self, time: float, speed: float, acceleration: float) -> float:
        """Return the share of `speed` (m/s) that a command rising from rest has reached
        at a time before `rise_time`."""
        rate, knee = self._knee(acceleration)
        since = time - knee / rate
        if since <= 0.0:
            return time / (speed / rate)
        decay = math.exp(-since / (self.launching_speed / self.launching))
        left = (self.launching_speed - knee) * decay
        return (self.launching_speed - left) / speed

    def _knee(self, acceleration: float) -> tuple[float, float]:
        """Return the first rate of rise (m/s2), and the speed (m/s) from which the
        launch law makes the rise slower."""
        rate = min(acceleration, self.launching)
        if math.inf in (self.launching, self.launching_speed):
            return rate, math.inf
        return rate, self.launching_speed * (1.0 - rate / self.launching)


@dataclasses.dataclass(frozen=True, kw_only=True)
class CommandLaw(LaunchLaw):
    """Limits on how fast the forward command that a policy observes rises and falls."""

    braking: Limit = math.inf
    """m/s2, fastest fall of the forward command that the policy observes"""
    stopping_time: Annotated[float, Within(0.0, 1000.0)] = 0.0
    """s, least time in which that command falls by its own size and 0.5 m/s: a robot
    that stops its legs while its trunk still moves falls over"""

    def tell(self, told: ArrayT, asked: ArrayT) -> ArrayT:
        """Return the command (3) that the policy observes a control step after the
        command `told`, within the limits.

        The result is `asked`, except that a forward command rises and falls no faster
        than the limits.
        """
        xp, before, forward = told.__array_namespace__(), told[0], asked[0]
        if self.launching < math.inf:
            risen = CONTROL_STEP * self.launch_rate(before)
            forward = xp.minimum(forward, xp.maximum(before, 0.0) + risen)
        if self.braking < math.inf or self.stopping_time:
            rate = self.braking
            if self.stopping_time:
                rate = xp.minimum(rate, (before + EASE) / self.stopping_time)
            least = xp.maximum(before - CONTROL_STEP * rate, 0.0)
            forward = xp.where(before > 0.0, xp.maximum(forward, least), forward)
        return xp.concat([xp.reshape(forward, (1,)), asked[1:]])


COMMAND_LIMITS = tuple(field.name for field in dataclasses.fields(CommandLaw))
"""Names of the fields of `CommandLaw`, in settings and on a robot's computer."""


def wish_rates(
    law: CommandLaw, turning: float, braking: float = 1.5
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rates at which the asked command rises and falls toward a person's
    wish: m/s2 forward and to the left, rad/s2.

    Args:
        law: of the controller; if it limits launches, the asked command takes a forward
            wish at once.
        turning: the lateral and the yaw rate.
        braking: m/s2, rate of fall if the controller has no `stopping_time`.
    """
    return (
        np.array(
            [
                math.inf if law.launching < math.inf else COMMAND_ACCELERATION,
                turning,
                turning,
            ]
        ),
        np.array(
            [COMMAND_ACCELERATION if law.stopping_time else braking, turning, turning]
        ),
    )


@dataclasses.dataclass(frozen=True)
class HeadingHold(Bounded, path="--operator."):
    """Steers a robot along the line through its start, because a policy observes
    neither its position nor its heading.

    yaw-rate command = -heading_gain x yaw - lane_gain x y, clipped; y is the distance
    to the left of the line. Added only to commands that ask for straight running (no
    lateral and no yaw part).
    """

    heading_gain: Annotated[float, Within(-1000.0, 1000.0)] = 4.0
    """yaw rate commanded for each radian of wrong heading, 1/s"""
    lane_gain: Annotated[float, Within(-1000.0, 1000.0)] = 0.4
    """yaw rate commanded for each metre beside the line, 1/(m s); heading_gain^2 / (4
    v) is critical damping at a speed v"""
    limit: Annotated[float, Within(0.0, 1000.0)] = 0.5
    """largest yaw rate commanded, rad/s; 0: no steering"""

    def steer(self, command: ArrayT, y: Number, yaw: Number) -> ArrayT:
        """Add a correcting yaw rate to a straight command ("... 3"), from the distance
        `y` (m) left of the line and the yaw (rad)."""
        xp = command.__array_namespace__()
        rate = xp.clip(
            -self.heading_gain * yaw - self.lane_gain * y, -self.limit, self.limit
        )
        straight = (command[..., 1] == 0.0) & (command[..., 2] == 0.0)
        return command + xp.where(straight, rate, 0.0)[..., None] * xp.asarray(
            [0.0, 0.0, 1.0], dtype=command.dtype
        )


HEADING_HOLD = HeadingHold()
