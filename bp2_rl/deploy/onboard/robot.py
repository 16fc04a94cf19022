"""Simulate a robot in the place of the real one, with its operator and the links to
both.

The robot is C MuJoCo with the laws of BP2's motors and losses; the motors keep to their
envelope at the start of each millisecond.
"""

import dataclasses
from pathlib import Path

import mujoco
import numpy as np

from bp2_rl.base.errors import require_one_of
from bp2_rl.robot.actuator import Actuator, Bus, joint_torque
from bp2_rl.robot.conventions import GRAVITY
from bp2_rl.robot.height import height_over_ground
from bp2_rl.robot.losses import Resistance, generalized, loss
from bp2_rl.robot.operator import COMMAND_ACCELERATION, HeadingHold

from .contents import ROBOT_FOLDER, command_law, loading, read_bundle, with_infinity
from .controller import DriveTargets
from .link import COMMAND, SENSORS, BadLink

DT = 1e-3  # s
TICK = 5  # ms between two measurements
FAULTS = ("", "nan", "silence", "operator")


class SimulatedRobot:
    """A robot simulated in C MuJoCo on the bundle's ground, which starts standing at
    rest.

    Args:
        folder: the bundle.
        name: one of its `robots`.

    Raises:
        UserError: there is no such robot.
        BundleError: the bundle is damaged.
    """

    def __init__(self, folder: Path | str, name: str):
        self.settings, files = read_bundle(folder)
        require_one_of("robot", name, self.settings["robots"])
        with loading(folder):
            robot = self.settings["robots"][name]
            bus = Bus(**robot["bus"]) if robot["bus"] else None
            self.motors = Actuator(
                **self.settings["gains"], **with_infinity(robot["motors"]), bus=bus
            )
            losses = robot["losses"]
            self.resistance = Resistance(**with_infinity(losses)) if losses else None
            self._fall = self.settings["fall"]
            self.model = mujoco.MjModel.from_xml_string(
                files[f"{ROBOT_FOLDER}/{name}.xml"].decode()
            )
            self.model.opt.iterations, self.model.opt.ls_iterations = 100, 50
            self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
            self._up = self.model.opt.gravity / -GRAVITY  # tilted on a slope
            self.data = mujoco.MjData(self.model)
            joints = [self.model.joint(joint) for joint in self.settings["joints"]]
            self._q = np.array([joint.qposadr[0] for joint in joints])
            self._qd = np.array([joint.dofadr[0] for joint in joints])
            self.data.qpos[:] = robot["stand"]["qpos"]
            self.data.ctrl[:] = robot["stand"]["torque"]
            mujoco.mj_forward(self.model, self.data)

    @property
    def fallen(self) -> bool:
        """Return whether the robot has fallen, by its height over the ground and its
        tilt."""
        return not (
            height_over_ground(self.model, self.data) >= self._fall["height"]
            and self.data.xmat[1, 8] >= self._fall["up"]
        )

    @property
    def place(self) -> tuple[float, float, float, float]:
        """Pose and speed of the robot, as an operator sees them: x and y (m), yaw
        (rad), forward speed (m/s)."""
        to_world = self.data.xmat[1].reshape(3, 3)
        yaw = float(np.arctan2(to_world[1, 0], to_world[0, 0]))
        vx, vy = self.data.qvel[:2]
        return *self.data.qpos[:2], yaw, float(np.cos(yaw) * vx + np.sin(yaw) * vy)

    def sensors(self) -> np.ndarray:
        """Return the 30 numbers of encoders and IMU: joint positions and velocities,
        up, angular velocity."""
        qpos, qvel = self.data.qpos, self.data.qvel
        to_trunk, up = np.zeros(4), np.zeros(3)
        mujoco.mju_negQuat(to_trunk, qpos[3:7])
        mujoco.mju_rotVecQuat(up, self._up, to_trunk)
        return np.concatenate([qpos[self._q], qvel[self._qd], up, qvel[3:6]])

    def millisecond(self, targets: DriveTargets) -> None:
        """Advance motors and physics by a millisecond under these joint targets."""
        data = self.data
        q, qd = data.qpos[self._q], data.qvel[self._qd]
        data.ctrl[:] = joint_torque(self.motors, data.ctrl.copy(), q, qd, *targets, DT)
        if self.resistance is not None:
            losses = loss(self.resistance, data.qpos, data.qvel, data.ctrl)
            data.qfrc_applied[:] = generalized(losses, data.qvel)
        mujoco.mj_step(self.model, data)


@dataclasses.dataclass(frozen=True)
class RehearsalPlan:
    """The plan of a rehearsal: a launch to a speed that is then held, with a fault on
    the way if wanted."""

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
        """Time at which the command reaches the full speed, s."""
        return self.speed / self.acceleration

    @property
    def duration(self) -> float:
        """Duration of the rehearsal, s."""
        return self.fault_at + self.after if self.fault else self.ramp + self.hold


class RehearsalWorld:
    """A rehearsal's simulated robot, operator and links, advanced millisecond by
    millisecond.

    Args:
        folder: the bundle.
        robot: one of its `robots`.
        plan: what is rehearsed.
    """

    def __init__(self, folder: Path | str, robot: str, plan: RehearsalPlan):
        self.robot, self.plan = SimulatedRobot(folder, robot), plan
        settings = self.robot.settings
        self._operator = HeadingHold(**settings["operator"])
        self._law, self._command, self._trim = command_law(settings), np.zeros(3), 0.0
        self._out: BadLink[tuple[bytes, np.ndarray]] = BadLink(
            plan.loss, 0.0, plan.seed
        )
        self._in: BadLink[DriveTargets] = BadLink(plan.loss, plan.late, plan.seed + 1)
        self._targets = DriveTargets(
            np.array(settings["control"]["stand"]), np.zeros(12)
        )
        self.milliseconds = round(plan.duration / DT)
        # x, y (m), yaw (rad), forward speed (m/s)
        self.places = np.zeros((self.milliseconds, 4))
        self.targets = np.zeros((self.milliseconds, 12))  # rad, in force
        self.fell_at: float | None = None

    def says(self, k: int, now: float) -> list[tuple[bytes, np.ndarray]]:
        """Return the datagrams sent to the controller in millisecond `k`: command and
        sensor values, every fifth ms."""
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
        """Receive joint targets from the controller, which reach the drives through the
        link."""
        self._in.put(targets, now)

    def millisecond(self, k: int, now: float) -> None:
        """Advance the robot by a millisecond under the newest joint targets that have
        arrived."""
        for targets in self._in.take(now):
            self._targets = targets
        self.places[k], self.targets[k] = self.robot.place, self._targets.position
        self.robot.millisecond(self._targets)
        if self.fell_at is None and self.robot.fallen:
            self.fell_at = round((k + 1) * DT, 6)

    def outcome(self) -> dict[str, float | None]:
        """Return the figures of the rehearsal: speeds (m/s), distances (m), fall (s)
        and lost datagrams."""
        x, y, _, speed = self.places.T
        held = speed[:0] if self.plan.fault else speed[round(self.plan.ramp / DT) :]
        second, whole = round(1.0 / DT), np.cumsum([0.0, *held])
        means = (whole[second:] - whole[:-second]) / second
        return {
            "mean_speed": float(held.mean()) if len(held) else None,
            "least_second": float(means.min()) if len(means) else None,
            "distance": float(x[-1]),
            "beside_line": float(np.abs(y).max()),
            "final_speed": float(speed[-500:].mean()),
            "fell_at": self.fell_at,
            "lost": float(self._out.lost + self._in.lost),
            "sent": float(self._out.put_in + self._in.put_in),
        }

    def _ask(self, time: float) -> np.ndarray:
        """Return the operator's command: the planned speed, trimmed by feedback, and a
        yaw rate along the line."""
        _, y, yaw, speed = self.robot.place
        forward = min(self.plan.acceleration * time, self.plan.speed)
        # as the controller takes it
        self._command = self._law.tell(self._command, np.array([forward, 0.0, 0.0]))
        if self._command[0] >= self.plan.speed:
            self._trim += 0.5 * TICK * DT * (self.plan.speed - speed)
            self._trim = min(max(self._trim, -1.0), 1.0)
        asked = np.array([max(forward + self._trim, 0.0), 0.0, 0.0])
        return self._operator.steer(asked, y, yaw)
