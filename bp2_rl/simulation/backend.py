"""The simulators that can run a policy for an evaluation, and the settings of Drake's
contact model."""

import dataclasses
import math
from typing import Annotated, Literal

from bp2_rl.base.bounds import Bounded, Within

Backend = Literal["mujoco", "mjx", "drake"]
TITLES: dict[Backend, str] = {"mujoco": "C MuJoCo", "mjx": "MJX", "drake": "Drake"}


DISSIPATION_OF_ONE = 1.0
"""Largest `DrakeContact.dissipation` for which Drake needs one step a millisecond,
s/m."""


@dataclasses.dataclass(frozen=True)
class DrakeContact(Bounded, path="--drake."):
    """How a foot meets the ground in Drake."""

    model: Literal["point", "hydroelastic"] = "point"
    """point: a force at the deepest point, by Hunt and Crossley. hydroelastic: a
    pressure over the patch of contact"""
    solver: Literal["lagged", "similar", "sap", "tamsi"] = "lagged"
    """how friction and damping are discretised, by Drake's names; in sap, which damps
    by a law of its own, and in similar slip lifts a foot"""
    stiffness: Annotated[float, Within(1e3, 1e8)] | None = None
    """of the ground under a foot, N/m; by default what the robot's `contact_time`
    stands for"""
    dissipation: Annotated[float, Within(0.0, 20.0)] = 0.5
    """Hunt and Crossley's, s/m: a foot leaves the ground at no more than the
    reciprocal; beyond 1 s/m Drake takes shorter steps"""
    stiction: Annotated[float, Within(1e-6, 1.0)] = 1e-3
    """m/s: slip that friction needs to reach its limit"""

    @property
    def steps(self) -> int:
        """Return the number of physics steps a millisecond that this dissipation needs.

        With a single step the built robot runs 0.6 m/s too slow at 2 s/m, 1.6 at 3.
        """
        return max(math.ceil(self.dissipation / DISSIPATION_OF_ONE), 1)


DRAKE_CONTACT = DrakeContact()
