"""The manoeuvres: what the robot is told, on what ground, with what motors, and which rule it must keep."""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator
from typing import Any

from bp2_rl.evaluation.benchmarks.manoeuvres import rules
from bp2_rl.evaluation.benchmarks.manoeuvres.rules import Assessment
from bp2_rl.evaluation.benchmarks.sprint import TIME_LIMIT, TRACK
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.simulation.operator import HeadingHold
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.schedule import COMMAND_ACCELERATION, Course, Ramp, Schedule
from bp2_rl.simulation.track import LANE_WIDTH
from bp2_rl.simulation.trajectory import Trajectory
from bp2_rl.simulation.world import Push, World

STEADY = 1.5  # s, at a speed before anything else is asked
AFTERWARDS = 2.0  # s, that a robot must stay up at the end
BRAKING = 2.0, 4.0, 6.0, 8.0  # m/s2
LAUNCH_ACCELERATIONS = 2.0, 3.0, 4.0, 6.0, 8.0  # m/s2
FRICTIONS = 0.6, 0.8, 0.9
TURN_SPEEDS = 3.0, 6.0, 10.0, 13.0  # m/s
TURNS = 1.0, 2.0, 3.0, 4.0  # m/s2, speed x yaw rate
YAW_ACCELERATION = 2.0  # rad/s2, at which yaw-rate commands rise, as in training
TURN_SETTLING, TURN_TIME = 1.0, 2.0  # s, at a yaw rate: before it is measured, and while it is
SLOW = 0.5, 1.0, 1.5, 2.0, 3.0  # m/s
SLOW_SETTLING, SLOW_TIME = 1.0, 4.0  # s
SIDEWAYS, BACKWARDS = 0.5, (0.5, 1.0)  # m/s
SPINS = 0.5, 1.0  # rad/s
STAND = 10.0  # s
GYRO_BIASES = 0.05, 0.5  # deg/s
PUSHES = 0.5, 1.0, 1.5  # m/s
ARROWS = "↑↖←↙↓↘→↗"  # ahead is up; each turned by 45 deg to the left
AFTER_PUSH = 3.0  # s
ROUGHNESS = 0.01, 0.02, 0.03  # m
SLOPES = 2.0, 4.0  # deg
LATENCIES = 0.005, 0.010, 0.015  # s


@dataclasses.dataclass(frozen=True, kw_only=True)
class Manoeuvre(RunRequest):
    """One try, and the rule that it must keep."""

    group: str  # what is tried ...
    asked: str  # ... and how hard
    rule: str  # what passes, in words
    assess: Callable[[Trajectory], Assessment[Any]]  # applies the rule to the run


def all_manoeuvres(
    top: Ramp, level: float, hardware: HardwareSpec, operator: HeadingHold, seed: int
) -> tuple[Manoeuvre, ...]:
    """Every one, in the order of the report.

    Args:
        top: the launch to the top speed.
        level: m/s, what the robot reaches of it on level ground.
        hardware: the robot.
        operator: who keeps it straight where nothing else is said.
        seed: of the rough ground.
    """

    def of(
        group: str,
        asked: str,
        rule: str,
        assess: Callable[[Trajectory], Assessment[Any]],
        schedule: Schedule,
        **other: Any,
    ) -> Manoeuvre:
        run: dict[str, Any] = {"hardware": hardware, "operator": operator} | other
        return Manoeuvre(schedule, group=group, asked=asked, rule=rule, assess=assess, **run)

    speed = top.target[0]
    dash = dash_of(top)
    return (
        *_braking(of, bp2.OUTDOOR_TOP_SPEED, f"Brake from {bp2.OUTDOOR_TOP_SPEED:g} m/s"),
        *_braking(of, speed, "Brake from the top"),
        *_launches(of, speed, level, hardware),
        *_turns(of),
        *_slow_motion(of),
        *_standing(of),
        *_straightness(of, dash, operator),
        *_pushes(of),
        *_bad_ground(of, dash, level, seed),
        *_latency(of, dash, level, hardware),
    )


Make = Callable[..., Manoeuvre]


def dash_of(top: Ramp) -> Ramp:
    """Over the track at the top speed, with the time that this takes."""
    return dataclasses.replace(top, hold=min(TRACK / (rules.SPEED_SHARE * top.target[0]), TIME_LIMIT))


def run_up(speed: float) -> Course:
    """From a stand to a speed, and steady there."""
    return Course().to((speed, 0.0, 0.0), speed / COMMAND_ACCELERATION).hold(STEADY)


def _braking(of: Make, speed: float, group: str) -> Iterator[Manoeuvre]:
    run = run_up(speed)
    for deceleration in BRAKING:
        yield of(
            group,
            f"{deceleration:g} m/s²",
            f"stops within {rules.BRAKING_DISTANCE:g} x v² / 2a",
            functools.partial(rules.assess_braking, since=run.duration, deceleration=deceleration),
            run.to((0.0, 0.0, 0.0), speed / deceleration).hold(AFTERWARDS),
        )


def _launches(of: Make, speed: float, level: float, hardware: HardwareSpec) -> Iterator[Manoeuvre]:
    for friction in FRICTIONS:
        for acceleration in LAUNCH_ACCELERATIONS:
            yield of(
                f"Launch, friction {friction:g}",
                f"{acceleration:g} m/s²",
                f"{rules.SPEED_SHARE:.0%} of top {AFTERWARDS:g} s after the command",
                functools.partial(rules.assess_launch, speed=level, acceleration=acceleration),
                Ramp(speed, acceleration, AFTERWARDS),
                hardware=dataclasses.replace(hardware, friction=friction),
            )


def _turns(of: Make) -> Iterator[Manoeuvre]:
    for speed in TURN_SPEEDS:
        for lateral in TURNS:
            yaw_rate = lateral / speed
            run = run_up(speed).to((speed, 0.0, yaw_rate), yaw_rate / YAW_ACCELERATION).hold(TURN_SETTLING)
            yield of(
                f"Turn at {speed:g} m/s",
                f"{lateral:g} m/s²",
                f"yaw rate within {rules.YAW_ERROR:.0%}, at {rules.SPEED_SHARE:.0%} of the speed",
                functools.partial(rules.assess_turn, yaw_rate=yaw_rate, since=run.duration, speed=speed),
                run.hold(TURN_TIME),
            )


def _slow_motion(of: Make) -> Iterator[Manoeuvre]:
    ways = [("Slow", f"{speed:g} m/s", (speed, 0.0, 0.0)) for speed in SLOW]
    ways += [("Sideways", "left", (0.0, SIDEWAYS, 0.0)), ("Sideways", "right", (0.0, -SIDEWAYS, 0.0))]
    ways += [("Backwards", f"{speed:g} m/s", (-speed, 0.0, 0.0)) for speed in BACKWARDS]
    for group, asked, command in ways:
        rise = Course().to(command, math.hypot(*command) / COMMAND_ACCELERATION).hold(SLOW_SETTLING)
        yield of(
            f"Sideways at {SIDEWAYS:g} m/s" if group == "Sideways" else group,
            asked,
            f"speed within {rules.VELOCITY_ERROR:.0%}",
            functools.partial(rules.assess_motion, command=command, since=rise.duration),
            rise.hold(SLOW_TIME),
        )
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for rate in SPINS:
            command = (0.0, 0.0, sign * rate)
            rise = Course().to(command, rate / YAW_ACCELERATION).hold(SLOW_SETTLING)
            yield of(
                "Turn on the spot",
                f"{side} {rate:g} rad/s",
                f"within {rules.YAW_ERROR:.0%} and {rules.WANDER:g} m",
                functools.partial(rules.assess_spin, yaw_rate=sign * rate, since=rise.duration),
                rise.hold(SLOW_TIME),
            )


def _standing(of: Make) -> Iterator[Manoeuvre]:
    group, still = f"Stand for {STAND:g} s", Course().hold(STAND)
    rule = f"creep < {100 * rules.CREEP:g} cm, chatter < {rules.CHATTER:g} Nm"
    yield of(group, "creep", rule, rules.assess_creep, still)
    yield of(group, "chatter", rule, rules.assess_chatter, still)


def _straightness(of: Make, dash: Ramp, operator: HeadingHold) -> Iterator[Manoeuvre]:
    heading_only, nobody = (dataclasses.replace(operator, **{part: 0.0}) for part in ("lane_gain", "limit"))
    steered = functools.partial(rules.assess_straightness, length=TRACK)
    rule = f"trunk within {LANE_WIDTH / 2:g} m; nobody: {rules.ASTRAY:g} m"
    straight = functools.partial(of, f"Straight for {TRACK:g} m", rule=rule, schedule=dash, finish=TRACK)
    yield straight("lane seen", assess=steered)
    yield straight("heading", assess=steered, operator=heading_only)
    for bias in (sign * bias for bias in GYRO_BIASES for sign in (1.0, -1.0)):
        yield straight(f"gyro {bias:+g}°/s", assess=steered, operator=heading_only, gyro_bias=math.radians(bias))
    yield straight("nobody", assess=functools.partial(steered, allowed=rules.ASTRAY), operator=nobody)


def _pushes(of: Make) -> Iterator[Manoeuvre]:
    run = run_up(bp2.OUTDOOR_TOP_SPEED)
    for size in PUSHES:
        for i, arrow in enumerate(ARROWS):
            angle = math.tau * i / len(ARROWS)
            push = Push(run.duration, size * math.cos(angle), size * math.sin(angle))
            yield of(
                f"Push of {size:g} m/s",
                arrow,
                "no fall; shown: off the line",
                rules.assess_push,
                run.hold(AFTER_PUSH),
                world=World(pushes=(push,)),
            )


def _bad_ground(of: Make, dash: Ramp, level: float, seed: int) -> Iterator[Manoeuvre]:
    running = _dash(of, dash, level)
    for height in ROUGHNESS:
        yield running("Rough ground", f"{100 * height:g} cm", world=World(roughness=height, seed=seed))
    for way, sign in (("up", 1.0), ("down", -1.0)):
        for slope in SLOPES:
            yield running("Slope", f"{way} {slope:g}°", world=World(slope=math.radians(sign * slope)))


def _latency(of: Make, dash: Ramp, level: float, hardware: HardwareSpec) -> Iterator[Manoeuvre]:
    for latency in LATENCIES:
        late = dataclasses.replace(hardware, losses=dataclasses.replace(hardware.losses, latency=latency))
        yield _dash(of, dash, level)("Latency", f"{1e3 * latency:g} ms", hardware=late)


def _dash(of: Make, dash: Ramp, level: float) -> Make:
    """Over the track at the top speed."""
    return functools.partial(
        of,
        rule=f"best speed >= {rules.SPEED_SHARE:.0%} of that on level",
        assess=functools.partial(rules.assess_run, level=level),
        schedule=dash,
        finish=TRACK,
    )
