"""The simulators that can run a policy for an evaluation."""

from typing import Literal

Backend = Literal["mujoco", "drake"]
TITLES: dict[Backend, str] = {"mujoco": "C MuJoCo", "drake": "Drake"}
