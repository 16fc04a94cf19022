"""The session in MuJoCo's own window. Arrow keys change speed and turn; the mouse may
pull at the robot."""

import queue
from collections.abc import Callable

import glfw
import mujoco
import numpy as np

from bp2_rl.base.errors import UserError
from bp2_rl.play.pace import Pace
from bp2_rl.play.readings import readings
from bp2_rl.play.session import Session
from bp2_rl.robot.model import load_model

SHOVE = 0.8  # m/s that a key adds
GHOST = (0.3, 0.6, 1.0, 0.25)  # red, green, blue, opacity
KEYS = """up, down: speed
left, right: turn
Insert, Delete: sideways
Home: stand
Enter: push to the left
Backspace: reset"""


class Window:
    """A window onto the session.

    Raises:
        UserError: there is no display.
    """

    def __init__(self, session: Session):
        # else the viewer would wait for ever for a window that never opens
        if not glfw.init():
            raise UserError(
                "no window can be opened on this display; pass --web to play in a browser"
            )
        import mujoco.viewer

        self._session, self._model = session, load_model(session.hardware)
        self._data, self._ghost = mujoco.MjData(self._model), mujoco.MjData(self._model)
        self._keys: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._data.qpos[:] = session.qpos
        self._viewer = mujoco.viewer.launch_passive(
            self._model,
            self._data,
            key_callback=self._keys.put,
            show_left_ui=False,
            show_right_ui=False,
        )
        with self._viewer.lock():
            camera, options = self._viewer.cam, self._viewer.opt
            camera.type, camera.trackbodyid = (
                mujoco.mjtCamera.mjCAMERA_TRACKING,
                self._model.body("trunk").id,
            )
            camera.distance, camera.azimuth, camera.elevation = 2.8, 110.0, -12.0
            options.flags[mujoco.mjtVisFlag.mjVIS_CONTACTFORCE] = True
            options.flags[mujoco.mjtVisFlag.mjVIS_PERTFORCE] = True

    def close(self) -> None:
        """Close the window."""
        self._viewer.close()

    def watched(self) -> bool:
        """Return that somebody may look: a window that is shut ends the session, in
        `show`."""
        return True

    def show(self, pace: Pace) -> bool:
        """Do what keys and mouse asked for since the last time, and draw; False once it
        has been shut."""
        if not self._viewer.is_running():
            return False
        session = self._session
        while not self._keys.empty():
            press(session, self._keys.get())
        real, shown = session.data, self._data
        with self._viewer.lock():
            real.xfrc_applied[:] = shown.xfrc_applied
            shown.qpos[:], shown.qvel[:], shown.ctrl[:] = (
                real.qpos,
                real.qvel,
                real.ctrl,
            )
            mujoco.mj_forward(self._model, shown)
            self._draw_ghost(session.reference())
        said = readings(session, pace)
        names, values = "\n".join((*said, "", KEYS)), "\n".join(said.values())
        self._viewer.set_texts(
            [(None, int(mujoco.mjtGridPos.mjGRID_TOPLEFT), names, values)]
        )
        self._viewer.sync()
        return True

    def _draw_ghost(self, qpos: np.ndarray) -> None:
        """Draw the reference motion at the robot's place."""
        if (scene := self._viewer.user_scn) is None:  # it has just been shut
            return
        self._ghost.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._ghost)
        scene.ngeom = 0
        options, perturb = mujoco.MjvOption(), mujoco.MjvPerturb()
        mujoco.mjv_addGeoms(
            self._model,
            self._ghost,
            options,
            perturb,
            int(mujoco.mjtCatBit.mjCAT_DYNAMIC),
            scene,
        )
        for geom in scene.geoms[: scene.ngeom]:
            geom.rgba[:], geom.matid = GHOST, -1


def press(session: Session, key: int) -> None:
    """Carry out what the GLFW key `key` stands for."""
    actions: dict[int, Callable[[], None]] = {
        glfw.KEY_UP: lambda: session.step(speed=1),
        glfw.KEY_DOWN: lambda: session.step(speed=-1),
        glfw.KEY_LEFT: lambda: session.step(turn=1),
        glfw.KEY_RIGHT: lambda: session.step(turn=-1),
        glfw.KEY_INSERT: lambda: session.step(left=1),
        glfw.KEY_DELETE: lambda: session.step(left=-1),
        glfw.KEY_HOME: session.stand,
        glfw.KEY_ENTER: lambda: session.push(0.0, SHOVE),
        glfw.KEY_BACKSPACE: session.reset,
    }
    actions.get(key, lambda: None)()
