"""The three cycles of a run's gait that figures show."""

import numpy as np

from bp2_rl.base.errors import UserError
from bp2_rl.robot.specs import LEGS
from bp2_rl.simulation.gait import contacts, touchdowns
from bp2_rl.simulation.trajectory import Trajectory
from bp2_rl.simulation.windows import best_window

CYCLES = 3
LEG = LEGS.index("RR")  # whose touchdown begins a cycle, as in the paper


def cycles(run: Trajectory) -> Trajectory:
    """The last three cycles that begin within the best second, from touchdown to touchdown; else the run's last.

    Raises:
        UserError: there are no three.
    """
    landed = touchdowns(contacts(run)[:, LEG])
    best = best_window(run, 1.0)
    if best is not None:
        until = np.searchsorted(run.time[landed], best.start + 1.0)
        landed = landed[: max(int(until), CYCLES + 1)]
    if len(landed) <= CYCLES:
        raise UserError(f"the run has {max(len(landed) - 1, 0)} whole strides, {CYCLES} are drawn: name a longer one")
    first, last = landed[-CYCLES - 1], landed[-1]
    return run.between(float(run.time[first]), float(run.time[last]))
