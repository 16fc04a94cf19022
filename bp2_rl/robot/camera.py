"""Pictures of a robot. MuJoCo binds its GL library when it is first imported."""

import mujoco
import numpy as np
from jaxtyping import Float, UInt8

TRACK = "track"
"""The model's camera that follows the robot."""
Picture = UInt8[np.ndarray, "height width 3"]


class Camera:
    """Takes pictures of a robot from a camera that follows it.

    Args:
        model: the robot with its looks.
        height: of a picture, pixels.
        width: of a picture, pixels.

    Raises:
        FatalError, RuntimeError: there is no GL library; which of them depends on it.
    """

    def __init__(self, model: mujoco.MjModel, height: int, width: int):
        self._model = model
        self._data = mujoco.MjData(model)
        self._renderer = mujoco.Renderer(model, height, width)

    def picture(self, qpos: Float[np.ndarray, " nq"]) -> Picture:
        """Return the robot in a state, as rows and columns of red, green and blue."""
        self._data.qpos[:] = qpos
        mujoco.mj_forward(self._model, self._data)
        self._renderer.update_scene(self._data, TRACK)
        return self._renderer.render()

    def close(self) -> None:
        """Free the GL library's memory."""
        self._renderer.close()
