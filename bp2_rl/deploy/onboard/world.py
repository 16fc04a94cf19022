"""The world that a controller is rehearsed in: a robot in C MuJoCo, its operator, and
the links to both."""

import dataclasses
from pathlib import Path

import numpy as np

from bp2_rl.robot.operator import COMMAND_ACCELERATION, HeadingHold

from .contents import read_bundle
from .controller import DriveTargets, command_law
from .link import COMMAND, SENSORS, BadLink
from .robot import DT, SimulatedRobot

TICK = 5  # ms between two measurements
FAULTS = ("", "nan", "silence", "operator")


@dataclasses.dataclass(frozen=True)
class RehearsalPlan:
    """A rehearsal: the robot accelerates from a stand to a speed and holds it; a fault
    may occur on the way."""

    speed: float  # m/s
    acceleration: float = COMMAND_ACCELERATION  # m/s2
    hold: float = 20.0  # s
    loss: float = 0.05  # share of the datagrams that are lost, in each direction
    late: float = 0.005  # s, by which joint targets come into force late
    # nan: a joint's encoder says NaN; silence: no sensor says anything; operator: no
    # command comes
    fault: str = ""
    fault_at: float = 0.0  # s
    after: float = 4.0  # s, for which the robot is watched after a fault
    seed: int = 0

    @property
    def ramp(self) -> float:
        """Time at which the full speed is commanded first, s."""
        return self.speed / self.acceleration

    @property
    def duration(self) -> float:
        """Duration of the rehearsal, s."""
        return self.fault_at + self.after if self.fault else self.ramp + self.hold


class RehearsalWorld:
    """The simulated surroundings of a controller in one rehearsal, advanced millisecond
    by millisecond.

    Args:
        folder: the bundle.
        robot: one of its `robots`.
        plan: what is rehearsed.
    """

    def __init__(self, folder: Path | str, robot: str, plan: RehearsalPlan):
        settings, _ = read_bundle(folder)
        self.robot, self.plan = SimulatedRobot(folder, robot), plan
        self._operator = HeadingHold(**settings["operator"])
        control = settings["control"]
        self._out: BadLink[tuple[bytes, np.ndarray]] = BadLink(
            plan.loss, 0.0, plan.seed
        )
        self._in: BadLink[DriveTargets] = BadLink(plan.loss, plan.late, plan.seed + 1)
        self._targets = DriveTargets(np.array(control["stand"]), np.zeros(12))
        self.milliseconds = round(plan.duration / DT)
        # x, y (m), yaw (rad), forward speed (m/s)
        self.places = np.zeros((self.milliseconds, 4))
        self.targets = np.zeros((self.milliseconds, 12))  # rad, in force
        self.fell_at: float | None = None
        self._trim = 0.0
        self._law = command_law(settings)
        self._told = np.zeros(3)

    def says(self, k: int, now: float) -> list[tuple[bytes, np.ndarray]]:
        """The datagrams that leave in the millisecond k: every fifth the command and
        what the sensors report."""
        if k % TICK:
            return []
        fault = self.plan.fault if k * DT >= self.plan.fault_at else ""
        if fault != "operator":
            self._out.put((COMMAND, self._ask(k * DT)), now)
        if fault != "silence":
            sensors = self.robot.sensors()
            if fault == "nan":
                sensors[0] = np.nan
            self._out.put((SENSORS, sensors), now)
        return self._out.take(now)

    def hears(self, targets: DriveTargets, now: float) -> None:
        """Joint targets arrive at the drives' end of the link."""
        self._in.put(targets, now)

    def millisecond(self, k: int, now: float) -> None:
        """The drives follow the newest targets that have come through."""
        for targets in self._in.take(now):
            self._targets = targets
        self.places[k], self.targets[k] = self.robot.place, self._targets.position
        self.robot.millisecond(self._targets)
        if self.fell_at is None and self.robot.fallen:
            self.fell_at = round((k + 1) * DT, 6)

    def outcome(self) -> dict[str, float | None]:
        """What came of it: speeds over the part that the speed was held, m/s, and where
        the robot ended."""
        x, y, _, speed = self.places.T
        held = speed[round(self.plan.ramp / DT) :] if not self.plan.fault else speed[:0]
        return {
            "mean_speed": float(held.mean()) if len(held) else None,
            "least_second": _least_mean(held, 1000),
            "distance": float(x[-1]),
            "beside_line": float(np.abs(y).max()),
            "final_speed": float(speed[-500:].mean()),
            "fell_at": self.fell_at,
            "lost": float(self._out.lost + self._in.lost),
            "sent": float(self._out.put_in + self._in.put_in),
        }

    def _ask(self, time: float) -> np.ndarray:
        """Return the operator's command at a time: the plan's speed, trimmed until the
        robot runs it, and a yaw rate along the line."""
        _, y, yaw, speed = self.robot.place
        forward = min(self.plan.acceleration * time, self.plan.speed)
        # as the controller takes it
        self._told = self._law.tell(self._told, np.array([forward, 0.0, 0.0]))
        if self._told[0] >= self.plan.speed:
            self._trim += 0.5 * TICK * DT * (self.plan.speed - speed)
            self._trim = min(max(self._trim, -1.0), 1.0)
        asked = np.array([max(forward + self._trim, 0.0), 0.0, 0.0])
        return self._operator.steer(asked, y, yaw)


def _least_mean(values: np.ndarray, window: int) -> float | None:
    """Return the least mean over `window` successive values; None if there are fewer
    values."""
    if len(values) < window:
        return None
    sums = np.concatenate([[0.0], np.cumsum(values)])
    return float(np.min(sums[window:] - sums[:-window]) / window)
