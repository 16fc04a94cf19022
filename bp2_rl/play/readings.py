"""What a page or window says of a session: names and values, a line each."""

import math

from bp2_rl.evaluation.races import PAPER_BP2, TIMES, TRACK
from bp2_rl.play.pace import Pace
from bp2_rl.play.session import Session

PAPER = f"; the paper's robot: {TIMES[PAPER_BP2]:g} s"


def readings(session: Session, pace: Pace) -> dict[str, str]:
    """Return what the robot does and is told, how its sprint goes, and how well the
    time is kept."""
    (forward, left, turn), told = session.velocity, session.command
    paper = PAPER if session.hardware.is_bp2 else ""
    fallen = "" if session.down_since is None else "fell; "
    return {
        "speed": f"{forward:z.2f} m/s, told {told[0]:z.2f}",
        "sideways": f"{left:z.2f} m/s, told {told[1]:z.2f}",
        "turn": f"{turn:z.2f} rad/s, told {told[2]:z.2f}",
        f"{TRACK:g} m": sprint(session),
        "best": f"{f'{session.best:.2f} s' if math.isfinite(session.best) else 'none yet'}{paper}",
        "run": f"{fallen}{session.distance:.0f} m in {session.time:.1f} s; falls: {session.falls}",
        "pace": str(pace),
    }


def sprint(session: Session) -> str:
    """Return how the sprint goes."""
    if session.sprint == 0.0:
        return "ready"
    if session.finished:
        return f"{session.sprint:.2f} s; reset for another"
    return f"{session.sprint:.2f} s, {max(TRACK - session.qpos[0], 0.0):.0f} m left"
