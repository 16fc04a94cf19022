"""Simulated time beside the wall's, and how well it keeps up."""

import math
import time
from collections.abc import Callable
from typing import Protocol, runtime_checkable

from bp2_rl.robot import conventions

FRAMES = 30.0  # a second, at most
SHOWING = 0.2  # share of the time that showing may take
# s behind the wall's clock, beyond which the rest is given up for lost: a jerk, but no
# chase
PATIENCE = 0.1


@runtime_checkable
class Stage(Protocol):
    """A page or a window."""

    def watched(self) -> bool:
        """Return whether anybody looks; where nobody does, wait a moment for somebody
        who comes."""
        ...

    def show(self, pace: "Pace") -> bool:
        """Show the session as it is now; return False once the stage has been shut."""
        ...


class Pace:
    """Keeps a session beside the wall's clock.

    Args:
        clock: seconds.
        sleep: waits so many seconds.
        work: seconds of processor time that this process has had.
    """

    def __init__(
        self,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
        work: Callable[[], float] = time.process_time,
    ):
        self._clock, self._sleep, self._work = clock, sleep, work
        self.slow = 1.0
        """How many times slower than the world the simulation is to go."""
        self._began = self._due = clock()
        self._worked_before = work()
        self._shown = self._idle = 0.0

    def wait(self, simulated: float) -> None:
        """Wait until the wall's clock has come as far as the simulation, which just
        went on by so many seconds."""
        self._due += simulated * self.slow
        self._shown += simulated * self.slow
        ahead = self._due - self._clock()
        if ahead > 0.0:
            self._sleep(ahead)
        elif ahead < -PATIENCE:
            self._due = self._clock()

    def idle(self, since: float) -> None:
        """Let the time from `since` (of `elapsed`) to now not count: nobody looked."""
        self._idle += self.elapsed - since
        self._due = self._clock()

    @property
    def elapsed(self) -> float:
        """Wall-clock time since the beginning, s."""
        return self._clock() - self._began

    @property
    def factor(self) -> float:
        """Real-time factor: seconds shown a second; in slow motion, of those that were
        asked for."""
        return self._shown / max(self.elapsed - self._idle, 1e-9)

    @property
    def load(self) -> float:
        """Seconds of processor time a second shown: where that is more than 1, one core
        is too few."""
        return (self._work() - self._worked_before) / max(self._shown, 1e-9)

    def __str__(self) -> str:
        """Return real-time factor and processor load in words."""
        if not self._shown:
            return "nobody looked"
        return f"real-time factor {self.factor:.2f}, {self.load:.2f} cores busy"


def play_on(
    tick: Callable[[], None], stage: Stage, pace: Pace, *, seconds: float = math.inf
) -> None:
    """Go on in real time until the stage is shut, or for so many seconds; stand still
    while nobody looks.

    On a machine that is too slow for it pictures get fewer, so that the robot gets the
    time.

    Args:
        tick: goes on by a control step.
        stage: shows it.
        pace: keeps the time.
        seconds: at most.
    """
    next_frame = 0.0
    while (now := pace.elapsed) < seconds:
        if not stage.watched():
            pace.idle(now)
            continue
        if now >= next_frame:
            if not stage.show(pace):
                break
            cost = pace.elapsed - now
            next_frame = max(next_frame + 1.0 / FRAMES, now + cost / SHOWING)
        tick()
        pace.wait(conventions.CONTROL_STEP)
