"""Keep simulated time in step with wall-clock time, and measure the real-time
factor."""

import math
import time
from collections.abc import Callable

from bp2_rl.robot import conventions

FRAMES = 30.0  # a second, at most
SHOWING = 0.2  # share of the time that showing may take
# s behind the wall's clock, beyond which the rest is given up for lost: a jerk, but no
# chase
PATIENCE = 0.1


class Pace:
    """Keeps a simulation in step with the wall clock.

    Args:
        clock: seconds.
        sleep: waits so many seconds.
    """

    def __init__(
        self,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ):
        self._clock = clock
        self._sleep = sleep
        self.slow = 1.0
        """Slow-motion factor: wall-clock seconds for each simulated second."""
        self._began = self._due = clock()
        self._shown = self._idle = 0.0

    def wait(self, simulated: float) -> None:
        """Sleep until the wall clock has caught up with `simulated` further seconds of
        simulation."""
        self._due += simulated * self.slow
        self._shown += simulated * self.slow
        ahead = self._due - self._clock()
        if ahead > 0.0:
            self._sleep(ahead)
        elif ahead < -PATIENCE:
            self._due = self._clock()

    def idle(self, since: float) -> None:
        """Exclude the time from `since` (of `elapsed`) to now from the real-time
        factor."""
        self._idle += self.elapsed - since
        self._due = self._clock()

    @property
    def elapsed(self) -> float:
        """Wall-clock time since the beginning, s."""
        return self._clock() - self._began

    @property
    def factor(self) -> float:
        """Real-time factor: simulated over wall-clock time, scaled to 1 at full pace
        also in slow motion."""
        return self._shown / max(self.elapsed - self._idle, 1e-9)

    def __str__(self) -> str:
        """Return the real-time factor in words."""
        return (
            f"real-time factor {self.factor:.2f}"
            if self._shown
            else "no browser was open"
        )


def play_on(
    tick: Callable[[], None],
    watched: Callable[[], bool],
    show: Callable[[Pace], None],
    pace: Pace,
    *,
    seconds: float = math.inf,
) -> None:
    """Run a session in real time, and pause it while no browser shows it.

    On a slow machine fewer frames are shown, which leaves time for the simulation.

    Args:
        tick: advances the simulation by a control step.
        watched: returns whether a browser shows the page; if none does, waits a moment.
        show: shows the robot as it is now.
        pace: keeps the time.
        seconds: at most.
    """
    next_frame = 0.0
    while (now := pace.elapsed) < seconds:
        if not watched():
            pace.idle(now)
            continue
        if now >= next_frame:
            show(pace)
            cost = pace.elapsed - now
            next_frame = max(next_frame + 1.0 / FRAMES, now + cost / SHOWING)
        tick()
        pace.wait(conventions.CONTROL_STEP)
