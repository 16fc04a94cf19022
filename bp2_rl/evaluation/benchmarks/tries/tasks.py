"""The trials of `manoeuvres` and `disturbances` as data: their commands, ground, motors
and rules."""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator

from bp2_rl.evaluation.benchmarks.run import time_limit
from bp2_rl.evaluation.benchmarks.tries import rules
from bp2_rl.evaluation.benchmarks.tries.rules import Assessment
from bp2_rl.evaluation.races import TRACK
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.settings.env import CommandConfig
from bp2_rl.settings.terrain import Terrain
from bp2_rl.simulation.measuring import LANE_WIDTH
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.schedule import COMMAND_ACCELERATION, Course, Ramp
from bp2_rl.simulation.trajectory import Trajectory
from bp2_rl.simulation.world import Push, World

STEADY = 1.5  # s, at a steady speed before the manoeuvre begins
AFTERWARDS = 2.0  # s, for which the robot must stay upright at the end
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
SIDES = ("left", 1.0), ("right", -1.0)
AFTER_PUSH = 3.0  # s
SLOPES = 2.0, 4.0  # deg
LATENCIES = 0.005, 0.010, 0.015  # s
UPRIGHT = "no fall; shown: off the line"

PHASES = 8  # of a stride at which disturbances come
SHOVE, TURN = 1.5, 0.5  # m/s and rad/s of BP2
ROUGHNESS = 0.05  # m of BP2
CELLS = 0.1, 0.2, 0.4  # m of BP2
CELL = 0.1  # m, of the manoeuvres' rough ground
SEEDS = 5  # grounds of each cell
CROSSING = 6.0  # s, over rough ground at the speed


@dataclasses.dataclass(frozen=True)
class ManoeuvreSizes:
    """The speeds, yaw rates, pushes and roughness of the manoeuvres; the defaults are
    BP2's."""

    cruise: float = bp2.OUTDOOR_TOP_SPEED  # m/s, of stops and pushes
    turns: tuple[float, ...] = (3.0, 6.0, 10.0, 13.0)  # m/s
    slow: tuple[float, ...] = (0.5, 1.0, 1.5, 2.0, 3.0)  # m/s
    sideways: float = 0.5  # m/s
    backwards: tuple[float, ...] = (0.5, 1.0)  # m/s
    spins: tuple[float, ...] = (0.5, 1.0)  # rad/s
    pushes: tuple[float, ...] = (0.5, 1.0, 1.5)  # m/s
    roughness: tuple[float, ...] = (0.01, 0.02, 0.03)  # m
    most_turning: float = math.inf  # rad/s: faster turns are left out


TURN_SHARES = 0.2, 0.4, 0.65, 0.85
"""Speeds of turns as shares of top speed, for robots other than BP2; BP2's turns as
shares of 15 m/s."""
MOST_TURNING = 1.5
"""Largest yaw rate of a turn over the largest yaw rate of the training."""


def sizes_of(
    robot: HardwareSpec, top: float, cruise: float, commands: CommandConfig
) -> ManoeuvreSizes:
    """Return the speeds and sizes of a robot's manoeuvres, scaled from BP2's for other
    robots.

    Speeds of another robot are shares of its top speed; pushes and heights are scaled
    by its size.

    Args:
        robot: the robot that runs.
        top: m/s, its policy's own top speed.
        cruise: m/s, its cruising speed.
        commands: of its training.
    """
    if robot.is_bp2:
        return ManoeuvreSizes()
    size = robot.size
    of_bp2 = ManoeuvreSizes()

    def times(factor: float, *values: float) -> tuple[float, ...]:
        return tuple(float(f"{factor * value:.2g}") for value in values)

    return ManoeuvreSizes(
        cruise=cruise,
        turns=times(top, *TURN_SHARES),
        slow=tuple(speed for speed in of_bp2.slow if speed <= top)
        or (round(top / 2.0, 2),),
        sideways=times(size.speed, of_bp2.sideways)[0],
        backwards=times(size.speed, *of_bp2.backwards),
        spins=tuple(round(size.rate * rate, 1) for rate in of_bp2.spins),
        pushes=times(size.speed, *of_bp2.pushes),
        roughness=times(size.length, *of_bp2.roughness),
        most_turning=MOST_TURNING * commands.max_yaw_rate,
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Try(RunRequest):
    """One trial: a run to simulate, and the rule that the robot must keep."""

    group: str  # the manoeuvre or disturbance
    asked: str  # its strength or direction
    rule: str  # the condition to pass, in words
    assess: Callable[[Trajectory], Assessment]  # applies the rule to the run


Make = Callable[..., Try]
"""Makes a trial from a schedule and the fields of `Try` that are still open."""


def all_manoeuvres(
    top: Ramp,
    level: float,
    hardware: HardwareSpec,
    operator: HeadingHold,
    seed: int,
    sizes: ManoeuvreSizes = ManoeuvreSizes(),
) -> tuple[Try, ...]:
    """Return the trials of the manoeuvres benchmark, in the order of the report.

    Args:
        top: the launch to the top speed.
        level: m/s, the robot's best speed of that launch on level ground.
        hardware: the robot.
        operator: the steering controller of all trials but those of straightness.
        seed: of the rough ground.
        sizes: speeds, pushes and heights.
    """
    of = functools.partial(Try, hardware=hardware, operator=operator)
    dash = dash_of(top, hardware)
    running = functools.partial(
        of,
        dash,
        rule=f"best speed >= {rules.SPEED_SHARE:.0%} of that on level",
        assess=functools.partial(rules.assess_run, level=level),
        finish=TRACK,
    )
    cruising = run_up(sizes.cruise)
    return (
        *_braking(of, sizes.cruise, f"Brake from {sizes.cruise:g} m/s"),
        *_braking(of, top.target[0], "Brake from the top"),
        *_launches(of, top.target[0], level, hardware),
        *_turns(of, sizes),
        *_slow_motion(of, sizes),
        *_standing(of, hardware),
        *_straightness(of, dash, operator),
        *(
            trial
            for size in sizes.pushes
            for trial in _pushes(
                functools.partial(
                    of, cruising.hold(AFTER_PUSH), group=f"Push of {size:g} m/s"
                ),
                Push(cruising.duration, size, 0.0),
            )
        ),
        *(
            running(
                group="Rough ground",
                asked=f"{100 * height:.2g} cm",
                world=_rough(height, CELL, seed),
            )
            for height in sizes.roughness
        ),
        *(
            running(
                group="Slope",
                asked=f"{way} {slope:g}°",
                world=World(Terrain(slope=math.radians(sign * slope))),
            )
            for way, sign in (("up", 1.0), ("down", -1.0))
            for slope in SLOPES
        ),
        *(
            running(
                group="Latency",
                asked=f"{1e3 * latency:g} ms",
                hardware=dataclasses.replace(
                    hardware,
                    losses=dataclasses.replace(hardware.losses, latency=latency),
                ),
            )
            for latency in LATENCIES
        ),
    )


def all_disturbances(
    speed: float, stride: float, robot: HardwareSpec, operator: HeadingHold, seed: int
) -> tuple[Try, ...]:
    """Return the trials of the disturbances benchmark, in the order of the report.

    Pushes come at eight phases of the stride: a robot may survive a push at one phase
    and fall at another.

    Args:
        speed: m/s, held.
        stride: s, duration of a stride at this speed.
        robot: the robot.
        operator: the steering controller.
        seed: of the first rough ground.
    """
    of = functools.partial(Try, hardware=robot, operator=operator)
    steady = run_up(speed)
    shove = SHOVE * robot.size.speed
    height, *cells = (
        float(f"{robot.size.length * length:.2g}") for length in (ROUGHNESS, *CELLS)
    )
    return (
        *(
            trial
            for phase in range(PHASES)
            for way, sign in SIDES
            for trial in _pushes(
                functools.partial(
                    of,
                    steady.hold(AFTER_PUSH + stride),
                    group=f"Push {phase}/{PHASES}, turning {way}",
                ),
                Push(
                    steady.duration + phase * stride / PHASES,
                    shove,
                    0.0,
                    sign * TURN * robot.size.rate,
                ),
            )
        ),
        *(
            of(
                Ramp(speed, hold=CROSSING),
                group=f"{100 * height:g} cm, points {cell:g} m apart",
                asked=f"ground {drawn}",
                rule=UPRIGHT,
                assess=rules.assess_push,
                world=_rough(height, cell, drawn),
            )
            for cell in cells
            for drawn in range(seed, seed + SEEDS)
        ),
    )


def dash_of(top: Ramp, robot: HardwareSpec) -> Ramp:
    """Return the command ramp of a run over the track at top speed, with the hold time
    that it needs."""
    speed = top.target[0]
    return dataclasses.replace(
        top, hold=min(TRACK / (rules.SPEED_SHARE * speed), time_limit(speed, robot))
    )


def run_up(speed: float) -> Course:
    """Return a command course from a stand to a forward speed (m/s), held for `STEADY`
    seconds."""
    return Course().to((speed, 0.0, 0.0), speed / COMMAND_ACCELERATION).hold(STEADY)


def _rough(height: float, cell: float, seed: int) -> World:
    """Return rough ground that is `height` (m) from the lowest point to the highest."""
    return World(terrain=Terrain("rough", height / 2.0, cell, seed))


def _braking(of: Make, speed: float, group: str) -> Iterator[Try]:
    run = run_up(speed)
    for deceleration in BRAKING:
        yield of(
            run.to((0.0, 0.0, 0.0), speed / deceleration).hold(AFTERWARDS),
            group=group,
            asked=f"{deceleration:g} m/s²",
            rule=f"stops within {rules.BRAKING_DISTANCE:g} x v² / 2a",
            assess=functools.partial(
                rules.assess_braking, since=run.duration, deceleration=deceleration
            ),
        )


def _launches(
    of: Make, speed: float, level: float, hardware: HardwareSpec
) -> Iterator[Try]:
    for friction in FRICTIONS:
        for acceleration in LAUNCH_ACCELERATIONS:
            yield of(
                Ramp(speed, acceleration, AFTERWARDS),
                group=f"Launch, friction {friction:g}",
                asked=f"{acceleration:g} m/s²",
                rule=f"{rules.SPEED_SHARE:.0%} of top {AFTERWARDS:g} s after the command",
                assess=functools.partial(
                    rules.assess_launch, speed=level, acceleration=acceleration
                ),
                hardware=dataclasses.replace(hardware, friction=friction),
            )


def _turns(of: Make, sizes: ManoeuvreSizes) -> Iterator[Try]:
    asked = [(v, a, a / v) for v in sizes.turns for a in TURNS]
    for speed, lateral, yaw_rate in asked:
        if yaw_rate > sizes.most_turning:
            continue
        turning = run_up(speed).to((speed, 0.0, yaw_rate), yaw_rate / YAW_ACCELERATION)
        run = turning.hold(TURN_SETTLING)
        yield of(
            run.hold(TURN_TIME),
            group=f"Turn at {speed:g} m/s",
            asked=f"{lateral:g} m/s²",
            rule=f"yaw rate within {rules.YAW_ERROR:.0%}, at {rules.SPEED_SHARE:.0%} of the speed",
            assess=functools.partial(
                rules.assess_turn, yaw_rate=yaw_rate, since=run.duration, speed=speed
            ),
        )


def _slow_motion(of: Make, sizes: ManoeuvreSizes) -> Iterator[Try]:
    sideways = f"Sideways at {sizes.sideways:g} m/s"
    ways = [
        *(("Slow", f"{speed:g} m/s", (speed, 0.0, 0.0)) for speed in sizes.slow),
        *((sideways, way, (0.0, sign * sizes.sideways, 0.0)) for way, sign in SIDES),
        *(("Backwards", f"{v:g} m/s", (-v, 0.0, 0.0)) for v in sizes.backwards),
    ]
    for group, asked, command in ways:
        seconds = math.hypot(*command) / COMMAND_ACCELERATION
        rise = Course().to(command, seconds).hold(SLOW_SETTLING)
        yield of(
            rise.hold(SLOW_TIME),
            group=group,
            asked=asked,
            rule=f"speed within {rules.VELOCITY_ERROR:.0%}",
            assess=functools.partial(
                rules.assess_motion, command=command, since=rise.duration
            ),
        )
    spins = [(side, sign, rate) for side, sign in SIDES for rate in sizes.spins]
    for side, sign, rate in spins:
        turning = Course().to((0.0, 0.0, sign * rate), rate / YAW_ACCELERATION)
        rise = turning.hold(SLOW_SETTLING)
        yield of(
            rise.hold(SLOW_TIME),
            group="Turn on the spot",
            asked=f"{side} {rate:g} rad/s",
            rule=f"within {rules.YAW_ERROR:.0%} and {rules.WANDER:g} m",
            assess=functools.partial(
                rules.assess_turn,
                yaw_rate=sign * rate,
                since=rise.duration,
                within=rules.WANDER,
            ),
        )


def _standing(of: Make, hardware: HardwareSpec) -> Iterator[Try]:
    chatter = f"{rules.CHATTER * hardware.size.torque:.2g} Nm"
    for asked in ("creep", "chatter"):
        yield of(
            Course().hold(STAND),
            group=f"Stand for {STAND:g} s",
            asked=asked,
            rule=f"creep < {100 * rules.CREEP:g} cm, chatter < {chatter}",
            assess=functools.partial(rules.assess_stand, quiet=asked == "chatter"),
        )


def _straightness(of: Make, dash: Ramp, operator: HeadingHold) -> Iterator[Try]:
    heading_only, unsteered = (
        dataclasses.replace(operator, **{part: 0.0}) for part in ("lane_gain", "limit")
    )
    biases = [sign * bias for bias in GYRO_BIASES for sign in (1.0, -1.0)]
    for asked, steering, bias, allowed in (
        ("lane seen", operator, 0.0, LANE_WIDTH / 2),
        ("heading", heading_only, 0.0, LANE_WIDTH / 2),
        *((f"gyro {b:+g}°/s", heading_only, b, LANE_WIDTH / 2) for b in biases),
        ("nobody", unsteered, 0.0, rules.ASTRAY),
    ):
        yield of(
            dash,
            group=f"Straight for {TRACK:g} m",
            asked=asked,
            rule=f"trunk within {LANE_WIDTH / 2:g} m; nobody: {rules.ASTRAY:g} m",
            assess=functools.partial(
                rules.assess_straightness, length=TRACK, allowed=allowed
            ),
            finish=TRACK,
            operator=steering,
            gyro_bias=math.radians(bias),
        )


def _pushes(of: Make, ahead: Push) -> Iterator[Try]:
    """Make a trial for each of eight directions of the push `ahead`."""
    for i, arrow in enumerate(ARROWS):
        angle = math.tau * i / len(ARROWS)
        push = dataclasses.replace(
            ahead,
            forward=ahead.forward * math.cos(angle),
            left=ahead.forward * math.sin(angle),
        )
        yield of(
            asked=arrow,
            rule=UPRIGHT,
            assess=rules.assess_push,
            world=World(pushes=(push,)),
        )
