"""Plausible robots: the built robot with other values of the assumed parameters, on the
paper's treadmill and on its road.

`assumptions.toml` has the ranges. `robots.csv` has robots drawn from the ranges, each
with the weight that the paper's numbers give to the robot: the posterior of `bp2 paper
posterior`.
"""

import csv
import dataclasses
import math
import tomllib
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bp2_rl.base.arrays import Number
from bp2_rl.base.assets import asset_path
from bp2_rl.base.metric import metric
from bp2_rl.base.serialization import from_json
from bp2_rl.evaluation.races import TRACK
from bp2_rl.learning.policy import Policy
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import BUILT, HardwareSpec
from bp2_rl.settings.terrain import Terrain
from bp2_rl.simulation.measuring import time_at
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import Trajectory, window_means
from bp2_rl.simulation.world import World

ASSUMPTIONS, ROBOTS = "plausible/assumptions.toml", "plausible/robots.csv"
RISE = 1.2  # m/s2, of the command: slow, so that each robot reaches its best speed
HOLD = 1.0  # s, of the greatest command
SECOND = 1000  # samples
HIND = slice(6, 12)  # motors of the hind legs
Values = Mapping[str, float]
"""The assumed numbers of a robot, by name."""


@dataclasses.dataclass(frozen=True)
class Assumption:
    """The range of an assumed parameter, and the source of the range."""

    range: tuple[float, float]
    why: str
    even_in: Literal["number", "log"] = "number"

    def at(self, share: Number) -> Number:
        """Return the values below which a share (0 to 1) of the drawn robots lies."""
        low, high = self.range
        if self.even_in == "log":
            return low * (high / low) ** np.asarray(share)
        return low + (high - low) * np.asarray(share)

    def share_of(self, value: float) -> float:
        """Return the share of the drawn robots that lies below a value."""
        low, high = self.range
        if self.even_in == "log":
            return float(np.log(value / low) / np.log(high / low))
        return (value - low) / (high - low)


def read_assumptions() -> dict[str, Assumption]:
    """Return all assumptions by name, from the file that ships."""
    text = asset_path(ASSUMPTIONS).read_text("utf-8")
    return {name: from_json(Assumption, a) for name, a in tomllib.loads(text).items()}


def read_posterior(count: int) -> list[Values]:
    """Return plausible robots, weighted by the paper's numbers, from the shipped file.

    A robot is repeated in proportion to its weight; the same `count` gives the same
    robots.
    """
    with asset_path(ROBOTS).open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    which = resample(np.array([float(row["weight"]) for row in rows]), count)
    names = read_assumptions()
    return [{name: float(rows[i][name]) for name in names} for i in which]


def resample(weights: Float[np.ndarray, " N"], count: int) -> Int[np.ndarray, " count"]:
    """Return indices, each repeated in proportion to its weight (systematic
    resampling)."""
    upto = np.cumsum(weights)
    return np.searchsorted(upto, (np.arange(count) + 0.5) / count * upto[-1])


# --- A robot and its conditions -------------------------------------------------------


def plausible_robot(values: Values) -> HardwareSpec:
    """Return the robot with these values, as it is on the road."""
    own = dict(values)
    for condition in ("belt_supply", "slope", "roughness"):
        own.pop(condition)
    weak = own.pop("weak_braking")
    no_load = own["no_load_speed"]
    # The envelope's fall to the no-load speed takes a twentieth of it, at least.
    corner = min(own.pop("corner_power") / own["peak_torque"], 0.95 * no_load)
    # below a hundredth the motors always brake
    braking = no_load / weak if weak > 0.01 else math.inf
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
    roughness, slope = values["roughness"] / 2.0, values["slope"]
    return World(Terrain("rough", roughness, cell=0.1, slope=slope))


# --- What such robots run -------------------------------------------------------------


class BestSecond(NamedTuple):
    """A run's fastest second, and its motors' peaks at the paper's pace."""

    speed: float  # m/s; 0 where the run did not last a second
    told: float  # m/s, in its middle
    # W, of hind hip and hind knee, in the first second at the paper's outdoor speed, or
    # in the fastest one
    powers: tuple[float, float]
    fell_at: float | None  # s


def _show_best(best: BestSecond) -> str:
    return f"{best.speed:.2f}{', fell' if best.fell_at else ''}"


@dataclasses.dataclass(frozen=True)
class PlausibleRun:
    """The best seconds of a robot on treadmill and road, and its time over 100 m."""

    belt: BestSecond = metric("Belt [m/s]", form=_show_best)
    road: BestSecond = metric("Road [m/s]", form=_show_best)
    # at the command of the road's best second; None: the robot fell
    time_100m: float | None = metric("100 m", "s")

    @property
    def fell(self) -> bool:
        """True if the robot fell under the slowly rising command, on belt or road."""
        return bool(self.belt.fell_at or self.road.fell_at)


def run_plausible(
    policy: Policy, robots: Sequence[Values], launch: float
) -> list[PlausibleRun]:
    """Run robots on the treadmill, on the road and over 100 m.

    On treadmill and road the command rises slowly to the greatest one of the policy's
    training. Under a command that rises fast, a weak robot runs slower than it can.

    Args:
        policy: the policy that drives the robots.
        robots: their values.
        launch: m/s2, rise of the command in the race.
    """
    control = policy.card.env.control
    rise = Ramp(
        policy.card.env.commands.max_forward, acceleration=RISE, hold=HOLD
    ).under(control)
    outdoors = [
        RunRequest(rise, plausible_robot(values), world=road(values))
        for values in robots
    ]
    belts = [RunRequest(rise, on_the_belt(values)) for values in robots]
    ran = simulate_all(best_second, policy, belts + outdoors)
    on_belt, on_road = ran[: len(robots)], ran[len(robots) :]
    races = [
        dataclasses.replace(
            request, schedule=_race(best.told, launch).under(control), finish=TRACK
        )
        for request, best in zip(outdoors, on_road, strict=True)
    ]
    times = simulate_all(_race_time, policy, races)
    return list(map(PlausibleRun, on_belt, on_road, times))


def _race(speed: float, launch: float) -> Ramp:
    """Return the ramp of a race: a launch to a speed (m/s), which is then held beyond
    the time that the track takes."""
    speed = max(speed, 1.0)
    return Ramp(speed, acceleration=launch, hold=2.0 * TRACK / speed)


def best_second(_: RunRequest, run: Trajectory) -> BestSecond:
    """Measure a run's fastest second, and the hind motors' peaks at the paper's
    pace."""
    if len(run) <= SECOND:
        return BestSecond(0.0, 0.0, (0.0, 0.0), run.fell_at)
    speeds = window_means(run.ground_velocity[:, 0], SECOND)
    best = int(np.argmax(speeds))
    pace = int(np.argmax(speeds >= min(bp2.OUTDOOR_TOP_SPEED, speeds[best])))
    during = slice(pace, pace + SECOND)
    power = (run.torque * run.joint_velocity)[during, HIND].max(axis=0)
    hip, knee = power.reshape(2, 3).max(axis=0)[1:]
    command = float(run.command[best + SECOND // 2, 0])
    return BestSecond(
        float(speeds[best]), command, (float(hip), float(knee)), run.fell_at
    )


def _race_time(_: RunRequest, run: Trajectory) -> float | None:
    return time_at(run, TRACK)
