"""The schedule of a run: a velocity command over time."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from bp2_rl.base.bounds import Bounded, Positive, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.robot.operator import COMMAND_ACCELERATION, CommandLaw, LaunchLaw

Command = tuple[float, float, float]  # m/s forward, m/s to the left, rad/s


@runtime_checkable
class Schedule(Protocol):
    """A velocity command over time."""

    @property
    def duration(self) -> float:
        """Length of the run, s."""
        ...

    @property
    def steady_from(self) -> float:
        """Time from which the command no longer changes, s."""
        ...

    def command(self, time: float) -> Float[np.ndarray, "3"]:
        """Forward and leftward velocity (m/s) and yaw rate (rad/s) at a time."""
        ...


@dataclasses.dataclass(frozen=True)
class Ramp(LaunchLaw):
    """A command that rises from rest to `to` (m/s, or forward, left and yaw rate) at
    `acceleration` (m/s2), then stays for `hold` (s).

    If a controller limits launches by a `LaunchLaw`, the speed rises by that law.
    """

    to: float | Sequence[float]  # m/s forward, or a whole command
    acceleration: Positive = COMMAND_ACCELERATION  # m/s2, along the target's direction
    hold: Positive = 20.0  # s

    def __post_init__(self) -> None:
        """Raise UserError for a target that is malformed or can never be reached."""
        if isinstance(self.to, np.ndarray):
            object.__setattr__(self, "to", tuple(map(float, self.to)))
        check_bounds(self, "ramp.")
        if isinstance(self.to, Sequence) and len(self.to) != 3:
            raise UserError(
                f"ramp.to takes a speed, or three numbers (forward, left, yaw rate); got {self.to}"
            )
        if self._speed >= self.launching_speed:
            raise UserError(
                f"{self._speed:g} m/s is never reached: the policy's control.launching_speed is "
                f"{self.launching_speed:g} m/s"
            )

    def under(self, control: CommandLaw) -> "Ramp":
        """Return this ramp with the launch limits of a controller, as the policy
        observes the ramp."""
        return dataclasses.replace(
            self, launching=control.launching, launching_speed=control.launching_speed
        )

    @property
    def target(self) -> Command:
        """The command in the hold phase: m/s forward, m/s to the left, rad/s."""
        forward, left, turn = (
            self.to if isinstance(self.to, Sequence) else (self.to, 0.0, 0.0)
        )
        return forward, left, turn

    @property
    def steady_from(self) -> float:
        """Time at which the command reaches the target, s; 0 for a pure turn."""
        return self.rise_time(self._speed, self.acceleration)

    @property
    def duration(self) -> float:
        """Length of ramp and hold together, s."""
        return self.steady_from + self.hold

    def command(self, time: float) -> Float[np.ndarray, "3"]:
        """The command at a time (s): m/s forward, m/s to the left, rad/s."""
        if time >= self.steady_from:
            return np.array(self.target)
        share = self.share_risen(time, self._speed, self.acceleration)
        return share * np.array(self.target)

    @property
    def _speed(self) -> float:
        """Magnitude of the target's velocity, m/s."""
        return math.hypot(*self.target[:2])


@dataclasses.dataclass(frozen=True)
class CourseLeg(Bounded, path="leg."):
    """A part of a course, in which the command changes linearly to `command`."""

    command: Command
    seconds: Positive


@dataclasses.dataclass(frozen=True)
class Course(Bounded, path="course."):
    """A schedule that starts at rest and leads through several commands: launch, hold,
    brake, turn.

    Examples:
        >>> Course().to((5.0, 0.0, 0.0), 3.0).hold(4.0).to((0.0, 0.0, 0.0), 2.0)  # launch, run, stop: in 3 s, 4 s, 2 s
    """

    legs: tuple[CourseLeg, ...] = ()

    def to(self, command: Command, seconds: float) -> "Course":
        """Return this course with a leg more, which reaches `command` after `seconds`."""
        if np.shape(command) != (3,):
            raise UserError(
                f"a course leads to three numbers (forward, left, yaw rate); got {command}"
            )
        forward, left, turn = command
        return Course((*self.legs, CourseLeg((forward, left, turn), seconds)))

    def hold(self, seconds: float) -> "Course":
        """Return this course with its last command held for `seconds` more."""
        return self.to(self._commands[-1], seconds)

    @property
    def duration(self) -> float:
        """Length of all legs together, s."""
        return self._times[-1]

    @property
    def steady_from(self) -> float:
        """Time at which the last command is reached, s."""
        last = len(self.legs)
        while last > 0 and self._commands[last - 1] == self._commands[-1]:
            last -= 1
        return self._times[last]

    def command(self, time: float) -> Float[np.ndarray, "3"]:
        """The command at a time (s): m/s forward, m/s to the left, rad/s."""
        return np.array(
            [
                np.interp(time, self._times, part)
                for part in zip(*self._commands, strict=True)
            ]
        )

    @property
    def _commands(self) -> tuple[Command, ...]:
        return (0.0, 0.0, 0.0), *(leg.command for leg in self.legs)

    @property
    def _times(self) -> tuple[float, ...]:
        return tuple(
            sum(leg.seconds for leg in self.legs[:k]) for k in range(len(self.legs) + 1)
        )
