"""What a robot is asked to do: a velocity command over time."""

import dataclasses
import math
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from bp2_rl.bounds import Positive, check_bounds

ACCELERATION = 2.4  # m/s2, at which commands rise; the paper's launch has 2.38
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
class Ramp:
    """From rest to a target at constant acceleration, then hold."""

    target: Command
    acceleration: Positive = ACCELERATION  # m/s2, along the target's direction
    hold: Positive = 20.0  # s

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        check_bounds(self, "ramp.")

    @property
    def steady_from(self) -> float:
        """When the target is reached, s; a pure turn has no ramp."""
        return math.hypot(*self.target[:2]) / self.acceleration

    @property
    def duration(self) -> float:
        """Ramp and hold, s."""
        return self.steady_from + self.hold

    def command(self, time: float) -> Float[np.ndarray, "3"]:
        """The command at a time."""
        share = min(time / self.steady_from, 1.0) if self.steady_from > 0 else 1.0
        return share * np.array(self.target)


@dataclasses.dataclass(frozen=True)
class Leg:
    """A part of a course: to a command, in a straight line from the one before."""

    command: Command
    seconds: Positive

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        check_bounds(self, "leg.")


@dataclasses.dataclass(frozen=True)
class Course:
    """From rest through one command after the other: launch, hold, brake, turn."""

    legs: tuple[Leg, ...] = ()

    def to(self, command: Command, seconds: float) -> "Course":
        """The same, and then to a command in so many seconds."""
        return Course((*self.legs, Leg(command, seconds)))

    def hold(self, seconds: float) -> "Course":
        """The same, and then the last command for so many seconds more."""
        return self.to(self._commands[-1], seconds)

    @property
    def duration(self) -> float:
        """All legs, s."""
        return self._times[-1]

    @property
    def steady_from(self) -> float:
        """When the last command is reached, s."""
        last = len(self.legs)
        while last > 0 and self._commands[last - 1] == self._commands[-1]:
            last -= 1
        return self._times[last]

    def command(self, time: float) -> Float[np.ndarray, "3"]:
        """The command at a time."""
        return np.array([np.interp(time, self._times, part) for part in zip(*self._commands, strict=True)])

    @property
    def _commands(self) -> tuple[Command, ...]:
        return (0.0, 0.0, 0.0), *(leg.command for leg in self.legs)

    @property
    def _times(self) -> tuple[float, ...]:
        return tuple(sum(leg.seconds for leg in self.legs[:k]) for k in range(len(self.legs) + 1))
