"""A simulated robot in place of the real one: C MuJoCo with the laws of BP2's motors
and losses.

The motors keep to their envelope at the start of each millisecond.
"""

from pathlib import Path

import mujoco
import numpy as np

from bp2_rl.base.errors import require_one_of
from bp2_rl.robot.actuator import Actuator, Bus, joint_torque
from bp2_rl.robot.losses import Resistance, generalized, loss

from .contents import ROBOT_FOLDER, loading, read_bundle
from .controller import DriveTargets, numbers

DT = 1e-3  # s


class SimulatedRobot:
    """A robot on flat ground, which stands at rest at first.

    Args:
        folder: the bundle.
        name: one of its `robots`.

    Raises:
        UserError: there is no such robot.
        BundleError: the bundle is damaged.
    """

    def __init__(self, folder: Path | str, name: str):
        settings, files = read_bundle(folder)
        require_one_of("robot", name, settings["robots"])
        with loading(folder):
            robot = settings["robots"][name]
            bus = Bus(**robot["bus"]) if robot["bus"] else None
            self.motors = Actuator(
                **settings["gains"], **numbers(robot["motors"]), bus=bus
            )
            self.resistance = (
                Resistance(**numbers(robot["losses"])) if robot["losses"] else None
            )
            self._fall = settings["fall"]
            self.model = mujoco.MjModel.from_xml_string(
                files[f"{ROBOT_FOLDER}/{name}.xml"].decode()
            )
            self.model.opt.iterations, self.model.opt.ls_iterations = 100, 50
            self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
            self.data = mujoco.MjData(self.model)
            joints = [self.model.joint(joint) for joint in settings["joints"]]
            self._q, self._qd = (
                np.array([j.qposadr[0] for j in joints]),
                np.array([j.dofadr[0] for j in joints]),
            )
            self.data.qpos[:], self.data.ctrl[:] = (
                robot["stand"]["qpos"],
                robot["stand"]["torque"],
            )
            mujoco.mj_forward(self.model, self.data)

    @property
    def fallen(self) -> bool:
        """Whether the robot has fallen, by the limits of height and tilt at which
        training ends an episode."""
        height, up = self.data.qpos[2], self.data.xmat[1].reshape(3, 3)[2, 2]
        return not (height >= self._fall["height"] and up >= self._fall["up"])

    @property
    def place(self) -> tuple[float, float, float, float]:
        """The pose and speed that an operator sees: x and y (m), yaw (rad), forward
        speed (m/s)."""
        to_world = self.data.xmat[1].reshape(3, 3)
        yaw = float(np.arctan2(to_world[1, 0], to_world[0, 0]))
        vx, vy = self.data.qvel[:2]
        return *self.data.qpos[:2], yaw, float(np.cos(yaw) * vx + np.sin(yaw) * vy)

    def sensors(self) -> np.ndarray:
        """Return the 30 numbers of encoders and IMU: joint positions and velocities,
        up, angular velocity."""
        qpos, qvel = self.data.qpos, self.data.qvel
        w, x, y, z = qpos[3:7]
        up = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
        return np.concatenate([qpos[self._q], qvel[self._qd], up, qvel[3:6]])

    def millisecond(self, targets: DriveTargets) -> None:
        """Advance motors and physics by a millisecond under these joint targets."""
        data, (position, velocity) = self.data, targets
        q, qd = data.qpos[self._q], data.qvel[self._qd]
        data.ctrl[:] = joint_torque(
            self.motors, data.ctrl.copy(), q, qd, position, velocity, DT
        )
        if self.resistance is not None:
            data.qfrc_applied[:] = generalized(
                loss(self.resistance, data.qpos, data.qvel, data.ctrl), data.qvel
            )
        mujoco.mj_step(self.model, data)
