"""The simulators that can run a policy for an evaluation."""

from typing import Literal

Backend = Literal["mujoco", "mjx"]
TITLES: dict[Backend, str] = {"mujoco": "C MuJoCo", "mjx": "MJX"}
