"""The rules of the manoeuvres: what is measured of a run, and what passes."""

import dataclasses
import math
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Float

from bp2_rl.base.plotting import moving_mean
from bp2_rl.robot import conventions
from bp2_rl.simulation.measuring import mean_powers
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.samples import best_window
from bp2_rl.simulation.schedule import Command
from bp2_rl.simulation.track import LANE_WIDTH, track_position, trunk_edges
from bp2_rl.simulation.trajectory import Trajectory

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
ASTRAY = 3.0  # m, of a run that nobody steers


@dataclasses.dataclass(frozen=True)
class Braking:
    """From a speed to rest."""

    deceleration: float  # m/s2, of the command
    speed: float | None  # m/s, when it begins to fall
    slowest: float | None  # m/s, from there on
    # m, from there until slower than `STOPPED`; None if it did not stop
    distance: float | None
    allowed: float | None  # m


@dataclasses.dataclass(frozen=True)
class Launching:
    """From a stand to a speed."""

    acceleration: float  # m/s2, of the command
    friction: float
    time: float | None  # s, to `SPEED_SHARE` of the speed; None if that was not reached
    speed: float  # m/s, greatest


@dataclasses.dataclass(frozen=True)
class Turning:
    """At a speed, or on the spot."""

    commanded_yaw_rate: float  # rad/s
    yaw_rate: float | None  # rad/s, mean; None for a run that ended before
    speed: float | None  # m/s, mean
    radius: float | None  # m
    wander: float  # m, greatest distance from the start


@dataclasses.dataclass(frozen=True)
class SlowMotion:
    """Slowly, in any direction."""

    commanded_speed: float  # m/s
    # m/s, mean, in the direction commanded; None for a run that ended before
    speed: float | None
    height: float | None  # m, mean, of the trunk's centre
    cost_of_transport: float | None  # electrical; None where it went nowhere


@dataclasses.dataclass(frozen=True)
class StandingStill:
    """At rest, with no motion commanded."""

    creep: float  # m, greatest distance from the start
    # Nm, root mean square of what varies faster than in `CHATTER_WINDOW`, of all motors
    chatter: float


@dataclasses.dataclass(frozen=True)
class Straight:
    """Along the line through the start."""

    distance: float  # m, along it
    reach: float  # m, greatest distance of the trunk's sides from it
    allowed: float  # m


@dataclasses.dataclass(frozen=True)
class Pushed:
    """Shoved while running."""

    offset: float  # m, greatest distance from the line


@dataclasses.dataclass(frozen=True)
class Running:
    """On bad ground, or with late motors."""

    level: float  # m/s, best 1-s mean of the same run on level ground
    speed: float | None  # m/s, best 1-s mean; None for a run shorter than that
    distance: float  # m


Measured = (
    Braking
    | Launching
    | Turning
    | SlowMotion
    | StandingStill
    | Straight
    | Pushed
    | Running
)
M = TypeVar("M", bound=Measured)


@dataclasses.dataclass(frozen=True)
class Assessment(Generic[M]):
    """What a rule says of a run, and the figures that the rule looked at."""

    passed: bool
    said: str  # what it did, in a word
    measured: M


@dataclasses.dataclass(frozen=True)
class ManoeuvreOutcome:
    """What came of one try."""

    group: str
    asked: str
    rule: str
    did: str
    passed: bool
    fell_at: float | None  # s
    measured: Measured


def assess_braking(
    run: Trajectory, *, since: float, deceleration: float
) -> Assessment[Braking]:
    """Return whether the robot stops within `BRAKING_DISTANCE`; the command falls from
    `since` (s) on."""
    if run.time[-1] < since:
        return Assessment(
            False, "not begun", Braking(deceleration, None, None, None, None)
        )
    start, ripple = round(since / run.dt), round(RIPPLE / run.dt)
    before = float(
        np.linalg.norm(np.mean(run.qvel[start - ripple : start, :2], axis=0))
    )
    speed = np.linalg.norm(_smooth(run, run.qvel[:, :2]), axis=-1)[start:]
    allowed = BRAKING_DISTANCE * before**2 / (2.0 * deceleration)
    slow = np.flatnonzero(speed < STOPPED)
    distance = (
        float(np.linalg.norm(run.qpos[start + slow[0], :2] - run.qpos[start, :2]))
        if len(slow)
        else None
    )
    measured = Braking(deceleration, before, float(np.min(speed)), distance, allowed)
    if distance is None:
        return Assessment(False, "no stop", measured)
    if speed[-1] >= STOPPED:
        return Assessment(False, "moves again", measured)
    return Assessment(distance <= allowed, f"{distance:.0f} m", measured)


def assess_launch(
    run: Trajectory, *, speed: float, acceleration: float
) -> Assessment[Launching]:
    """Return whether the robot reaches `SPEED_SHARE` of the speed before the schedule
    ends."""
    forward = _smooth(run, run.ground_velocity[:, 0])
    fast = np.flatnonzero(forward >= SPEED_SHARE * speed)
    time, greatest = (
        float(run.time[fast[0]]) if len(fast) else None,
        float(np.max(forward)),
    )
    said = f"{time:.1f} s" if time is not None else f"{greatest:.1f} m/s"
    return Assessment(
        time is not None,
        said,
        Launching(acceleration, run.hardware.friction, time, greatest),
    )


def assess_turn(
    run: Trajectory, *, yaw_rate: float, since: float, speed: float = 0.0
) -> Assessment[Turning]:
    """Return whether the robot turns as told, within `YAW_ERROR`, at `SPEED_SHARE` of
    its speed, from `since` (s)."""
    measured = _measure_turn(run, yaw_rate, since)
    if measured.yaw_rate is None or measured.speed is None:
        return Assessment(False, "not begun", measured)
    share, kept = measured.yaw_rate / yaw_rate, measured.speed >= SPEED_SHARE * speed
    turned = abs(share - 1.0) <= YAW_ERROR
    # what failed
    said = f"{measured.speed:.1f} m/s" if turned and not kept else f"{share:.0%}"
    return Assessment(turned and kept, said, measured)


def assess_spin(
    run: Trajectory, *, yaw_rate: float, since: float
) -> Assessment[Turning]:
    """Return whether the robot turns as fast as it is told, and stays within `WANDER`
    of where it was."""
    turn = assess_turn(run, yaw_rate=yaw_rate, since=since)
    wander = turn.measured.wander
    return Assessment(
        turn.passed and wander <= WANDER, f"{turn.said}, {wander:.1f} m", turn.measured
    )


def assess_motion(
    run: Trajectory, *, command: Command, since: float
) -> Assessment[SlowMotion]:
    """Return whether the robot moves as fast as it is told, within `VELOCITY_ERROR`;
    measured `since` (s)."""
    told = math.hypot(*command[:2])
    if run.time[-1] < since + RIPPLE:
        return Assessment(False, "not begun", SlowMotion(told, None, None, None))
    steady = run.between(since, math.inf)
    speed = (
        float(np.mean(steady.ground_velocity, axis=0) @ np.array(command[:2])) / told
    )
    cost = (
        mean_powers(steady)[1] / (run.mass * conventions.GRAVITY * speed)
        if speed > 0.1 * told
        else None
    )
    measured = SlowMotion(told, speed, float(np.mean(steady.qpos[:, 2])), cost)
    return Assessment(
        abs(speed - told) <= VELOCITY_ERROR * told, f"{speed:.2f} m/s", measured
    )


def assess_creep(run: Trajectory) -> Assessment[StandingStill]:
    """Return whether the robot stays within `CREEP` of where it was."""
    measured = _measure_stand(run)
    return Assessment(
        measured.creep < CREEP, f"{100 * measured.creep:.1f} cm", measured
    )


def assess_chatter(run: Trajectory) -> Assessment[StandingStill]:
    """Return whether the motors are quiet: less than `CHATTER`."""
    measured, most = _measure_stand(run), CHATTER * run.hardware.size.torque
    said = f"{measured.chatter:.{1 if most == CHATTER else 2}f} Nm"
    return Assessment(measured.chatter < most, said, measured)


def assess_straightness(
    run: Trajectory, *, length: float, allowed: float = LANE_WIDTH / 2
) -> Assessment[Straight]:
    """Return whether the robot arrives with no edge of its trunk farther than allowed
    (m) from the line."""
    distance, reach = (
        float(track_position(run)[0][-1]),
        float(np.max(np.abs(trunk_edges(run)))),
    )
    arrived = distance >= length
    said = f"{reach:.2f} m" if arrived else f"{distance:.0f} m run"
    return Assessment(
        arrived and reach <= allowed, said, Straight(distance, reach, allowed)
    )


def assess_push(run: Trajectory) -> Assessment[Pushed]:
    """Return whether the robot stays upright."""
    offset = float(np.max(np.abs(track_position(run)[1])))
    return Assessment(True, f"{offset:.1f} m", Pushed(offset))


def assess_run(run: Trajectory, *, level: float) -> Assessment[Running]:
    """Return whether the best speed reaches `SPEED_SHARE` of that on level ground."""
    best, distance = best_window(run, 1.0), float(track_position(run)[0][-1])
    if best is None:
        return Assessment(False, "-", Running(level, None, distance))
    return Assessment(
        best.speed >= SPEED_SHARE * level,
        f"{best.speed:.1f} m/s",
        Running(level, best.speed, distance),
    )


def _smooth(
    run: Trajectory, values: Float[np.ndarray, "N ..."]
) -> Float[np.ndarray, "N ..."]:
    return moving_mean(values, round(RIPPLE / run.dt))


def _measure_turn(run: Trajectory, commanded: float, since: float) -> Turning:
    wander = _wander(run)
    if run.time[-1] < since + RIPPLE:
        return Turning(commanded, None, None, None, wander)
    steady = run.between(since, math.inf)
    rate = float(steady.heading[-1] - steady.heading[0]) / float(
        steady.time[-1] - steady.time[0]
    )
    speed = float(np.linalg.norm(np.mean(steady.ground_velocity, axis=0)))
    return Turning(commanded, rate, speed, speed / abs(rate) if rate else None, wander)


def _measure_stand(run: Trajectory) -> StandingStill:
    ripple = run.torque - moving_mean(run.torque, round(CHATTER_WINDOW / run.dt))
    return StandingStill(_wander(run), float(np.sqrt(np.mean(ripple**2))))


def _wander(run: Trajectory) -> float:
    return float(np.max(np.linalg.norm(run.qpos[:, :2] - run.qpos[0, :2], axis=-1)))
