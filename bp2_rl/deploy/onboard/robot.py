"""A stand-in for the robot: C MuJoCo with BP2's motors and losses, in NumPy.

The laws of motors, bus and losses are those of `bp2_rl.robot.actuator` and `losses`, written once more because those
need JAX. The motors keep to their envelope at the start of each millisecond.
"""

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np

from .controller import DriveTargets, read_settings

DT = 1e-3  # s
LEAST_VOLTAGE = 0.3  # share of the nominal one, below which the bus does not sag
SETTLING, DAMPING = 3.0, 10.0  # s of standing before the clock starts; 1/s, on everything that moves meanwhile
FALLEN_HEIGHT, FALLEN_UP = 0.3, 0.8  # m, of the trunk's centre; vertical part of its z axis


class SimulatedRobot:
    """A robot on flat ground, standing at first.

    Args:
        folder: the bundle.
        name: one of its `robots`.

    Raises:
        ValueError: there is no such robot.
    """

    def __init__(self, folder: Path | str, name: str):
        settings = read_settings(folder)
        if name not in settings["robots"]:
            raise ValueError(f"no robot {name!r} in {folder}: it has {', '.join(settings['robots'])}")
        machine = settings["robots"][name]
        self.model = mujoco.MjModel.from_xml_path(str(Path(folder) / "robots" / f"{name}.xml"))
        self.model.opt.iterations, self.model.opt.ls_iterations = 100, 50
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = mujoco.MjData(self.model)
        self.motors = Motors(settings["gains"], machine["drive"], machine["bus"])
        self._losses = machine["losses"]
        joints = [self.model.joint(joint) for joint in settings["joints"]]
        springs = [self.model.joint(f"{joint.removesuffix('_knee')}_spring") for joint in settings["joints"][2::3]]
        self._q, self._qd = (np.array([j.qposadr[0] for j in joints]), np.array([j.dofadr[0] for j in joints]))
        self._s, self._sd = (np.array([j.qposadr[0] for j in springs]), np.array([j.dofadr[0] for j in springs]))
        self._stand()

    @property
    def fallen(self) -> bool:
        """Whether the robot has fallen."""
        height, up = self.data.qpos[2], self.data.xmat[1].reshape(3, 3)[2, 2]
        return not (height >= FALLEN_HEIGHT and up >= FALLEN_UP)

    @property
    def place(self) -> tuple[float, float, float, float]:
        """The pose and speed that an operator sees: x and y (m), yaw (rad), forward speed (m/s)."""
        to_world = self.data.xmat[1].reshape(3, 3)
        yaw = float(np.arctan2(to_world[1, 0], to_world[0, 0]))
        vx, vy = self.data.qvel[:2]
        return *self.data.qpos[:2], yaw, float(np.cos(yaw) * vx + np.sin(yaw) * vy)

    def sensors(self) -> np.ndarray:
        """Return the 30 numbers of encoders and IMU: joint positions and velocities, up, angular velocity."""
        qpos, qvel = self.data.qpos, self.data.qvel
        w, x, y, z = qpos[3:7]
        up = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
        return np.concatenate([qpos[self._q], qvel[self._qd], up, qvel[3:6]])

    def millisecond(self, targets: DriveTargets) -> None:
        """Advance motors and physics by a millisecond under these joint targets."""
        data = self.data
        data.ctrl[:] = self.motors.torque(data.ctrl.copy(), data.qpos[self._q], data.qvel[self._qd], targets)
        self.resist()
        mujoco.mj_step(self.model, data)

    def resist(self) -> None:
        """Apply what air, gears, joints, slides and the springs' stops take in this state."""
        if (r := self._losses) is None:
            return
        data, force = self.data, self.data.qfrc_applied
        wind = data.qvel[:2] + np.array([r["headwind"], 0.0])
        force[:2] = -r["drag"] * np.hypot(*wind) * wind
        qd, most = data.qvel[self._qd], r["joint_friction"] + r["gear_loss"] * np.abs(data.ctrl)
        force[self._qd] = -np.clip(r["joint_hold"] * qd, -most, most) - r["joint_viscosity"] * qd
        rate = data.qvel[self._sd]
        slide = np.clip(r["spring_hold"] * rate, -r["spring_friction"], r["spring_friction"])
        force[self._sd] = -slide - r["rebound_damping"] * np.where(data.qpos[self._s] < 0.0, rate, 0.0)

    def _stand(self) -> None:
        """Let the robot stand at the keyframe `stand` until it is still."""
        data = self.data
        mujoco.mj_resetDataKeyframe(self.model, data, self.model.key("stand").id)
        stand = DriveTargets(data.qpos[self._q].copy(), np.zeros(12))
        for _ in range(round(SETTLING / DT)):
            self.millisecond(stand)
            data.qvel *= 1.0 - DAMPING * DT
        data.qpos[:2], data.qvel[:], data.time = 0.0, 0.0, 0.0
        mujoco.mj_forward(self.model, data)


class Motors:
    """Twelve drives: PD law, current loop, torque-speed envelope, and the bus that they share."""

    def __init__(self, gains: Mapping[str, float], drive: Mapping[str, float | None], bus: Mapping[str, float] | None):
        def number(name: str) -> float:
            value = drive[name]
            return np.inf if value is None else value

        self._stiffness, self._damping = gains["stiffness"], gains["damping"]
        self._peak, self._corner, self._no_load = (
            number(name) for name in ("peak_torque", "corner_speed", "no_load_speed")
        )
        self._stall = self._peak / (1.0 - self._corner / self._no_load)
        self._braking, self._bus = number("braking_speed"), bus
        self._follow, self._rate = DT / (number("current_lag") + DT), DT * number("torque_rate")
        self._resistance = self._no_load / self._stall  # W/Nm2, copper loss

    def torque(self, before: np.ndarray, q: np.ndarray, qd: np.ndarray, targets: DriveTargets) -> np.ndarray:
        """Return the motors' torques for the next millisecond, Nm."""
        wanted = self._stiffness * (targets.position - q) + self._damping * (targets.velocity - qd)
        torque = before + np.clip(self._follow * (wanted - before), -self._rate, self._rate)
        voltage = 1.0
        if self._bus is not None:
            voltage = min(max(1.0 - self._bus["sag"] * self._power(before, qd), LEAST_VOLTAGE), 1.0)
        lower, upper = self._limits(qd, voltage)
        return self._shared(np.clip(torque, lower, upper), lower, upper, qd)

    def _limits(self, qd: np.ndarray, voltage: float) -> tuple[np.ndarray, np.ndarray]:
        line, slope = self._stall * voltage, self._stall / self._no_load
        upper = np.clip(line - slope * qd, -self._peak, self._peak)
        lower = -np.clip(line + slope * qd, -self._peak, self._peak)
        if np.isfinite(self._braking):
            stall = self._peak / (1.0 - self._corner / self._braking)
            down, up = (np.clip(stall * (1.0 - s * qd / self._braking), 0.0, self._peak) for s in (1.0, -1.0))
            lower, upper = np.minimum(np.maximum(lower, -down), upper), np.maximum(np.minimum(upper, up), lower)
        return lower, upper

    def _power(self, torque: np.ndarray, qd: np.ndarray) -> float:
        return float(torque @ qd + self._resistance * (torque @ torque))

    def _shared(self, torque: np.ndarray, lower: np.ndarray, upper: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Scale all torques by one factor, so that the bus can supply their power."""
        if self._bus is None:
            return torque
        power, out, into = self._power(torque, qd), self._bus["power_out"], -self._bus["power_in"]
        if into <= power <= out:
            return torque
        limit, sign = (out, 1.0) if power > out else (into, -1.0)
        least = np.clip(0.0, lower, upper)
        way = torque - least
        p0, p2 = self._power(least, qd), self._resistance * (way @ way)
        p1 = way @ qd + 2.0 * self._resistance * (least @ way)
        root = np.sqrt(max(p1 * p1 - 4.0 * p2 * (p0 - limit), 0.0))
        return least + np.clip((sign * root - p1) / (2.0 * p2), 0.0, 1.0) * way
