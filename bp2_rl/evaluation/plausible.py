"""Robots that BP2 may be: the built robot with other values for what had to be assumed,
on the paper's treadmill and on its road."""

import dataclasses
import tomllib
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from bp2_rl.base.assets import asset_path
from bp2_rl.base.serialization import from_json
from bp2_rl.robot.hardware import BUILT, HardwareSpec
from bp2_rl.simulation.world import World

ASSUMPTIONS = "plausible/assumptions.toml"
Values = Mapping[str, float]
"""The assumed numbers of a robot, by name."""


@dataclasses.dataclass(frozen=True)
class Assumption:
    """The range of a number that had to be assumed, and what the range rests on."""

    range: tuple[float, float]
    why: str
    even_in: Literal["number", "log"] = "number"

    def at(self, share: Any) -> Any:
        """Return the values below which a share (0 to 1) of the drawn robots lies."""
        low, high = self.range
        if self.even_in == "log":
            return low * (high / low) ** np.asarray(share)
        return low + (high - low) * np.asarray(share)


def read_assumptions() -> dict[str, Assumption]:
    """Return all assumptions by name, from the file that ships."""
    text = asset_path(ASSUMPTIONS).read_text("utf-8")
    return {name: from_json(Assumption, a) for name, a in tomllib.loads(text).items()}


def plausible_robot(values: Values) -> HardwareSpec:
    """Return the robot with these values, as it is on the road."""
    own = dict(values)
    for condition in ("belt_supply", "slope", "roughness"):
        own.pop(condition)
    weak = own.pop("weak_braking")
    no_load = own["no_load_speed"]
    # The envelope's fall to the no-load speed takes a twentieth of it, at least.
    corner = min(own.pop("corner_power") / own["peak_torque"], 0.95 * no_load)
    braking = no_load / weak if weak else float("inf")
    return BUILT.changed(**own, corner_speed=corner, braking_speed=braking)


def on_the_belt(values: Values) -> HardwareSpec:
    """Return the robot on a treadmill: no air moves past it, and it may have mains."""
    robot, supply = plausible_robot(values), values["belt_supply"]
    return robot.changed(
        drag_area=0.0,
        headwind=0.0,
        bus_sag=supply * robot.losses.bus_sag,
        bus_power_out=robot.losses.bus_power_out / max(supply, 1e-3),
    )


def road(values: Values) -> World:
    """Return the ground of the robot's run outdoors."""
    return World(slope=values["slope"], roughness=values["roughness"])
