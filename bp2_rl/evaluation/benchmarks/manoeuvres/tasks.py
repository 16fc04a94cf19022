"""The manoeuvres: what the robot is told, on what ground, with what motors, and which
rule it must keep."""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator
from typing import Any

from bp2_rl.evaluation.benchmarks.manoeuvres import rules
from bp2_rl.evaluation.benchmarks.manoeuvres.rules import Assessment
from bp2_rl.evaluation.benchmarks.sprint import TRACK, time_limit
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.settings.env import CommandConfig
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
TURNS = 1.0, 2.0, 3.0, 4.0  # m/s2, speed x yaw rate
YAW_ACCELERATION = 2.0  # rad/s2, at which yaw-rate commands rise, as in training
# s, at a yaw rate: before it is measured, and while it is
TURN_SETTLING, TURN_TIME = 1.0, 2.0
SLOW_SETTLING, SLOW_TIME = 1.0, 4.0  # s
STAND = 10.0  # s
GYRO_BIASES = 0.05, 0.5  # deg/s
ARROWS = "↑↖←↙↓↘→↗"  # ahead is up; each turned by 45 deg to the left
AFTER_PUSH = 3.0  # s
SLOPES = 2.0, 4.0  # deg
LATENCIES = 0.005, 0.010, 0.015  # s


@dataclasses.dataclass(frozen=True)
class ManoeuvreSizes:
    """How fast, how hard and how high; the defaults are BP2's."""

    cruise: float = bp2.OUTDOOR_TOP_SPEED  # m/s, of stops and pushes
    turns: tuple[float, ...] = (3.0, 6.0, 10.0, 13.0)  # m/s
    slow: tuple[float, ...] = (0.5, 1.0, 1.5, 2.0, 3.0)  # m/s
    sideways: float = 0.5  # m/s
    backwards: tuple[float, ...] = (0.5, 1.0)  # m/s
    spins: tuple[float, ...] = (0.5, 1.0)  # rad/s
    pushes: tuple[float, ...] = (0.5, 1.0, 1.5)  # m/s
    roughness: tuple[float, ...] = (0.01, 0.02, 0.03)  # m
    most_turning: float = math.inf  # rad/s: turns that ask for more are left out


TURN_SHARES = 0.2, 0.4, 0.65, 0.85
"""Of another robot's top speed: BP2's turns at 15 m/s."""
MOST_TURNING = 1.5
"""Times the fastest yaw rate of the training."""


def sizes_of(
    robot: HardwareSpec, top: float, cruise: float, commands: CommandConfig
) -> ManoeuvreSizes:
    """Return BP2's sizes, or those of another robot: shares of its top speed, and what
    is similar at its own size.

    Args:
        robot: the robot that runs.
        top: m/s, its policy's own top speed.
        cruise: m/s, its cruising speed.
        commands: of its training.
    """
    if robot.is_bp2:
        return ManoeuvreSizes()
    size, of_bp2 = robot.size, ManoeuvreSizes()

    def times(factor: float, values: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(float(f"{factor * value:.2g}") for value in values)

    (sideways,) = times(size.speed, (of_bp2.sideways,))
    return ManoeuvreSizes(
        cruise=cruise,
        turns=times(top, TURN_SHARES),
        slow=tuple(speed for speed in of_bp2.slow if speed <= top)
        or (round(top / 2.0, 2),),
        sideways=sideways,
        backwards=times(size.speed, of_bp2.backwards),
        spins=tuple(round(size.rate * rate, 1) for rate in of_bp2.spins),
        pushes=times(size.speed, of_bp2.pushes),
        roughness=times(size.length, of_bp2.roughness),
        most_turning=MOST_TURNING * commands.max_yaw_rate,
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Manoeuvre(RunRequest):
    """One try, and the rule that it must keep."""

    group: str  # what is tried ...
    asked: str  # ... and how hard
    rule: str  # what passes, in words
    assess: Callable[[Trajectory], Assessment[Any]]  # applies the rule to the run


def all_manoeuvres(
    top: Ramp,
    level: float,
    hardware: HardwareSpec,
    operator: HeadingHold,
    seed: int,
    sizes: ManoeuvreSizes = ManoeuvreSizes(),
) -> tuple[Manoeuvre, ...]:
    """Every one, in the order of the report.

    Args:
        top: the launch to the top speed.
        level: m/s, what the robot reaches of it on level ground.
        hardware: the robot.
        operator: who keeps it straight where nothing else is said.
        seed: of the rough ground.
        sizes: how fast, how hard and how high.
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
        return Manoeuvre(
            schedule, group=group, asked=asked, rule=rule, assess=assess, **run
        )

    speed = top.target[0]
    dash = dash_of(top, hardware)
    return (
        *_braking(of, sizes.cruise, f"Brake from {sizes.cruise:g} m/s"),
        *_braking(of, speed, "Brake from the top"),
        *_launches(of, speed, level, hardware),
        *_turns(of, sizes),
        *_slow_motion(of, sizes),
        *_standing(of, hardware),
        *_straightness(of, dash, operator),
        *_pushes(of, sizes),
        *_bad_ground(of, dash, level, seed, sizes),
        *_latency(of, dash, level, hardware),
    )


Make = Callable[..., Manoeuvre]


def dash_of(top: Ramp, robot: HardwareSpec) -> Ramp:
    """Over the track at the top speed, with the time that this takes."""
    speed = top.target[0]
    return dataclasses.replace(
        top, hold=min(TRACK / (rules.SPEED_SHARE * speed), time_limit(speed, robot))
    )


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
            functools.partial(
                rules.assess_braking, since=run.duration, deceleration=deceleration
            ),
            run.to((0.0, 0.0, 0.0), speed / deceleration).hold(AFTERWARDS),
        )


def _launches(
    of: Make, speed: float, level: float, hardware: HardwareSpec
) -> Iterator[Manoeuvre]:
    for friction in FRICTIONS:
        for acceleration in LAUNCH_ACCELERATIONS:
            yield of(
                f"Launch, friction {friction:g}",
                f"{acceleration:g} m/s²",
                f"{rules.SPEED_SHARE:.0%} of top {AFTERWARDS:g} s after the command",
                functools.partial(
                    rules.assess_launch, speed=level, acceleration=acceleration
                ),
                Ramp(speed, acceleration, AFTERWARDS),
                hardware=dataclasses.replace(hardware, friction=friction),
            )


def _turns(of: Make, sizes: ManoeuvreSizes) -> Iterator[Manoeuvre]:
    for speed in sizes.turns:
        for lateral in TURNS:
            yaw_rate = lateral / speed
            if yaw_rate > sizes.most_turning:
                continue
            run = (
                run_up(speed)
                .to((speed, 0.0, yaw_rate), yaw_rate / YAW_ACCELERATION)
                .hold(TURN_SETTLING)
            )
            yield of(
                f"Turn at {speed:g} m/s",
                f"{lateral:g} m/s²",
                f"yaw rate within {rules.YAW_ERROR:.0%}, at {rules.SPEED_SHARE:.0%} of the speed",
                functools.partial(
                    rules.assess_turn,
                    yaw_rate=yaw_rate,
                    since=run.duration,
                    speed=speed,
                ),
                run.hold(TURN_TIME),
            )


def _slow_motion(of: Make, sizes: ManoeuvreSizes) -> Iterator[Manoeuvre]:
    ways = [("Slow", f"{speed:g} m/s", (speed, 0.0, 0.0)) for speed in sizes.slow]
    ways += [
        ("Sideways", way, (0.0, sign * sizes.sideways, 0.0))
        for way, sign in (("left", 1.0), ("right", -1.0))
    ]
    ways += [
        ("Backwards", f"{speed:g} m/s", (-speed, 0.0, 0.0)) for speed in sizes.backwards
    ]
    for group, asked, command in ways:
        rise = (
            Course()
            .to(command, math.hypot(*command) / COMMAND_ACCELERATION)
            .hold(SLOW_SETTLING)
        )
        yield of(
            f"Sideways at {sizes.sideways:g} m/s" if group == "Sideways" else group,
            asked,
            f"speed within {rules.VELOCITY_ERROR:.0%}",
            functools.partial(
                rules.assess_motion, command=command, since=rise.duration
            ),
            rise.hold(SLOW_TIME),
        )
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for rate in sizes.spins:
            command = (0.0, 0.0, sign * rate)
            rise = Course().to(command, rate / YAW_ACCELERATION).hold(SLOW_SETTLING)
            yield of(
                "Turn on the spot",
                f"{side} {rate:g} rad/s",
                f"within {rules.YAW_ERROR:.0%} and {rules.WANDER:g} m",
                functools.partial(
                    rules.assess_spin, yaw_rate=sign * rate, since=rise.duration
                ),
                rise.hold(SLOW_TIME),
            )


def _standing(of: Make, hardware: HardwareSpec) -> Iterator[Manoeuvre]:
    group, still = f"Stand for {STAND:g} s", Course().hold(STAND)
    rule = f"creep < {100 * rules.CREEP:g} cm, chatter < {rules.CHATTER * hardware.size.torque:.2g} Nm"
    yield of(group, "creep", rule, rules.assess_creep, still)
    yield of(group, "chatter", rule, rules.assess_chatter, still)


def _straightness(of: Make, dash: Ramp, operator: HeadingHold) -> Iterator[Manoeuvre]:
    heading_only, nobody = (
        dataclasses.replace(operator, **{part: 0.0}) for part in ("lane_gain", "limit")
    )
    steered = functools.partial(rules.assess_straightness, length=TRACK)
    rule = f"trunk within {LANE_WIDTH / 2:g} m; nobody: {rules.ASTRAY:g} m"
    straight = functools.partial(
        of, f"Straight for {TRACK:g} m", rule=rule, schedule=dash, finish=TRACK
    )
    yield straight("lane seen", assess=steered)
    yield straight("heading", assess=steered, operator=heading_only)
    for bias in (sign * bias for bias in GYRO_BIASES for sign in (1.0, -1.0)):
        yield straight(
            f"gyro {bias:+g}°/s",
            assess=steered,
            operator=heading_only,
            gyro_bias=math.radians(bias),
        )
    yield straight(
        "nobody",
        assess=functools.partial(steered, allowed=rules.ASTRAY),
        operator=nobody,
    )


def _pushes(of: Make, sizes: ManoeuvreSizes) -> Iterator[Manoeuvre]:
    run = run_up(sizes.cruise)
    for size in sizes.pushes:
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


def _bad_ground(
    of: Make, dash: Ramp, level: float, seed: int, sizes: ManoeuvreSizes
) -> Iterator[Manoeuvre]:
    running = _dash(of, dash, level)
    for height in sizes.roughness:
        yield running(
            "Rough ground",
            f"{100 * height:.2g} cm",
            world=World(roughness=height, seed=seed),
        )
    for way, sign in (("up", 1.0), ("down", -1.0)):
        for slope in SLOPES:
            yield running(
                "Slope",
                f"{way} {slope:g}°",
                world=World(slope=math.radians(sign * slope)),
            )


def _latency(
    of: Make, dash: Ramp, level: float, hardware: HardwareSpec
) -> Iterator[Manoeuvre]:
    for latency in LATENCIES:
        late = dataclasses.replace(
            hardware, losses=dataclasses.replace(hardware.losses, latency=latency)
        )
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
