"""The pass rules of the manoeuvres and disturbances: the measurements of a run without
a fall, and the limits that it must keep."""

import dataclasses
import math

import numpy as np
from jaxtyping import Float

from bp2_rl.base.plotting import moving_mean
from bp2_rl.robot import conventions
from bp2_rl.simulation.measuring import (
    LANE_WIDTH,
    lateral_drift,
    mean_powers,
    track_position,
    trunk_edges,
)
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.schedule import Command
from bp2_rl.simulation.trajectory import Trajectory, best_window

STOPPED = 0.3  # m/s: slower is at rest
BRAKING_DISTANCE = 1.5  # times v^2 / 2a, at most
SPEED_SHARE = 0.9  # of a speed commanded, at least
VELOCITY_ERROR = 0.1  # of a velocity commanded, at most
YAW_ERROR = 0.15  # of a yaw rate commanded, at most
WANDER = 0.5  # m, of a turn on the spot
CREEP = 0.02  # m, of a stand
# Nm, of BP2's stand; of another robot as much of its weight times its legs' length
CHATTER = 1.0
CHATTER_WINDOW = 0.1  # s: what varies faster is chatter
ASTRAY = 3.0  # m, of a run without steering

Measured = dict[str, float | None]
"""Quantities that a rule measured in a run, by name, SI units; None if not measured."""


@dataclasses.dataclass(frozen=True)
class Assessment:
    """The judgement of a rule about a run, with the quantities that the rule
    measured."""

    passed: bool
    result: str  # the measured quantity, as text
    measured: Measured


def assess_braking(run: Trajectory, *, since: float, deceleration: float) -> Assessment:
    """Judge whether the robot stops within `BRAKING_DISTANCE`; the command falls from
    `since` (s) on.

    Measured: the `speed` when it begins to fall, the `slowest` from there on (m/s), the
    `distance` from there until slower than `STOPPED`, and the one `allowed` (m).
    """
    start = round(since / run.dt)
    ripple = round(RIPPLE / run.dt)
    before = float(
        np.linalg.norm(np.mean(run.qvel[start - ripple : start, :2], axis=0))
    )
    speed = np.linalg.norm(_smooth(run, run.qvel[:, :2]), axis=-1)[start:]
    allowed = BRAKING_DISTANCE * before**2 / (2.0 * deceleration)
    slow = np.flatnonzero(speed < STOPPED)
    measured: Measured = {
        "deceleration": deceleration,
        "speed": before,
        "slowest": float(np.min(speed)),
        "distance": None,
        "allowed": allowed,
    }
    if not len(slow):
        return Assessment(False, "no stop", measured)
    way = run.qpos[start + slow[0], :2] - run.qpos[start, :2]
    measured["distance"] = distance = float(np.linalg.norm(way))
    if speed[-1] >= STOPPED:
        return Assessment(False, "moves again", measured)
    return Assessment(distance <= allowed, f"{distance:.0f} m", measured)


def assess_launch(run: Trajectory, *, speed: float, acceleration: float) -> Assessment:
    """Judge whether the robot reaches `SPEED_SHARE` of `speed` (m/s) before the
    schedule ends.

    Measured: the `time` to that speed (s), and the greatest `speed` (m/s).
    """
    forward = _smooth(run, run.ground_velocity[:, 0])
    fast = np.flatnonzero(forward >= SPEED_SHARE * speed)
    time = float(run.time[fast[0]]) if len(fast) else None
    greatest = float(np.max(forward))
    measured: Measured = {
        "acceleration": acceleration,
        "friction": run.hardware.friction,
        "time": time,
        "speed": greatest,
    }
    text = f"{greatest:.1f} m/s" if time is None else f"{time:.1f} s"
    return Assessment(time is not None, text, measured)


def assess_turn(
    run: Trajectory,
    *,
    yaw_rate: float,
    since: float,
    speed: float = 0.0,
    within: float = math.inf,
) -> Assessment:
    """Judge whether the robot turns at the commanded yaw rate and speed after `since`
    (s), `within` (m) of its start.

    Measured: the means of `yaw_rate` (rad/s) and `speed` (m/s), the `radius`, and the
    greatest distance from the start, `wander` (m).
    """
    wander = _wander(run)
    steady = run.between(since, math.inf)
    turned = float(steady.heading[-1] - steady.heading[0])
    rate = turned / float(steady.time[-1] - steady.time[0])
    mean = float(np.linalg.norm(np.mean(steady.ground_velocity, axis=0)))
    measured: Measured = {
        "commanded_yaw_rate": yaw_rate,
        "yaw_rate": rate,
        "speed": mean,
        "radius": mean / abs(rate) if rate else None,
        "wander": wander,
    }
    share = rate / yaw_rate
    kept_speed = mean >= SPEED_SHARE * speed
    turned_as_commanded = abs(share - 1.0) <= YAW_ERROR
    # what failed
    text = (
        f"{mean:.1f} m/s" if turned_as_commanded and not kept_speed else f"{share:.0%}"
    )
    if math.isfinite(within):
        text = f"{text}, {wander:.1f} m"
    return Assessment(
        turned_as_commanded and kept_speed and wander <= within, text, measured
    )


def assess_motion(run: Trajectory, *, command: Command, since: float) -> Assessment:
    """Judge whether the robot's velocity follows the command within `VELOCITY_ERROR`
    after `since` (s).

    Measured: the mean `speed` in the direction commanded (m/s), the trunk's `height`
    (m), and the electrical `cost_of_transport`, None if the robot does not move.
    """
    commanded = math.hypot(*command[:2])
    steady = run.between(since, math.inf)
    along = np.mean(steady.ground_velocity, axis=0) @ np.array(command[:2])
    speed = float(along) / commanded
    drag = run.mass * conventions.GRAVITY * speed
    measured: Measured = {
        "commanded_speed": commanded,
        "speed": speed,
        "height": float(np.mean(steady.qpos[:, 2])),
        "cost_of_transport": mean_powers(steady)[1] / drag
        if speed > 0.1 * commanded
        else None,
    }
    passed = abs(speed - commanded) <= VELOCITY_ERROR * commanded
    return Assessment(passed, f"{speed:.2f} m/s", measured)


def assess_stand(run: Trajectory, *, quiet: bool) -> Assessment:
    """Judge whether a standing robot stays within `CREEP` of its place or, if `quiet`,
    its torque below `CHATTER`.

    Measured: the greatest distance from the start, `creep` (m), and the root mean
    square of what varies faster than in `CHATTER_WINDOW`, of all motors, `chatter` (Nm).
    """
    ripple = run.torque - moving_mean(run.torque, round(CHATTER_WINDOW / run.dt))
    creep = _wander(run)
    chatter = float(np.sqrt(np.mean(ripple**2)))
    measured: Measured = {"creep": creep, "chatter": chatter}
    if not quiet:
        return Assessment(creep < CREEP, f"{100 * creep:.1f} cm", measured)
    most = CHATTER * run.hardware.size.torque
    text = f"{chatter:.{1 if most == CHATTER else 2}f} Nm"
    return Assessment(chatter < most, text, measured)


def assess_straightness(
    run: Trajectory, *, length: float, allowed: float = LANE_WIDTH / 2
) -> Assessment:
    """Judge whether the robot runs `length` (m) with its trunk's edges within `allowed`
    (m) of the line.

    Measured: the `distance` along the line, and the `reach` of the trunk's sides (m).
    """
    distance = float(track_position(run)[0][-1])
    reach = float(np.max(np.abs(trunk_edges(run))))
    arrived = distance >= length
    text = f"{reach:.2f} m" if arrived else f"{distance:.0f} m run"
    measured: Measured = {"distance": distance, "reach": reach, "allowed": allowed}
    return Assessment(arrived and reach <= allowed, text, measured)


def assess_push(run: Trajectory) -> Assessment:
    """Measure a pushed robot's greatest `offset` from the line, m; every robot that
    stays upright passes."""
    offset = lateral_drift(run)
    return Assessment(True, f"{offset:.1f} m", {"offset": offset})


def assess_run(run: Trajectory, *, level: float) -> Assessment:
    """Judge whether the best speed reaches `SPEED_SHARE` of `level`, the speed on level
    ground (m/s).

    Measured: the best 1-s mean, `speed`, 0 for a shorter run, and the `distance`.
    """
    best = best_window(run, 1.0)
    speed = best.speed if best else 0.0
    measured: Measured = {
        "level": level,
        "speed": speed,
        "distance": float(track_position(run)[0][-1]),
    }
    return Assessment(speed >= SPEED_SHARE * level, f"{speed:.1f} m/s", measured)


def _smooth(
    run: Trajectory, values: Float[np.ndarray, "N ..."]
) -> Float[np.ndarray, "N ..."]:
    return moving_mean(values, round(RIPPLE / run.dt))


def _wander(run: Trajectory) -> float:
    """Return the robot's greatest horizontal distance from its start, m."""
    return float(np.max(np.linalg.norm(run.qpos[:, :2] - run.qpos[0, :2], axis=-1)))
