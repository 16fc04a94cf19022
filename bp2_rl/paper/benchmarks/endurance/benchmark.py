"""How long the motors last: a speed is held until a winding is too hot, no torque
margin is left, or the robot falls.

The motor is calibrated on the paper's 1.8 K/s over 86 s, in this policy's gait at the
paper's speed: so 86 s are put in there, and not predicted. What is predicted is which
motor gets hottest, how long it lasts at other speeds, and what ends it.
"""

import dataclasses
import math

import numpy as np

from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    describe_simulator,
    describe_subject,
    robot_of,
)
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture
from bp2_rl.evaluation.benchmarks.run import ramp_to_topspeed
from bp2_rl.learning.policy import Policy
from bp2_rl.paper.benchmarks.endurance import figures, tables
from bp2_rl.paper.benchmarks.endurance.calibration import calibrated, family, seconds_to
from bp2_rl.paper.benchmarks.endurance.heating import (
    EnduranceResult,
    HeatingTry,
    run_hot,
)
from bp2_rl.paper.benchmarks.endurance.measured import (
    EnduranceAtSpeed,
    EnduranceMetrics,
    HeldSpeed,
    RandomRobot,
)
from bp2_rl.paper.benchmarks.options import DeepSetup
from bp2_rl.paper.motor_heat import Network
from bp2_rl.paper.thermal_specs import MotorHeat
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.settings.env import RandomizationConfig
from bp2_rl.simulation.schedule import Ramp

SPEED = bp2.OUTDOOR_TOP_SPEED
LONGEST = 2.0 * bp2.ENDURANCE_TIME + 8.0  # s
# of the accelerated runs: heat over seconds wavers, so a faster pace samples too few of
# them
PACE = 4.0
LIMITLESS = 1000.0  # C: copper melts at 1085
# s of cold running; a hip's heat wavers by a tenth from one second to the next
CALIBRATION = 12.0
ROBOTS = 8  # drawn
SCAN = 4.0, 6.0, 8.0, 9.5, 12.0, 14.0  # m/s, commands
REAR_HIPS = (
    conventions.MOTOR_NAMES.index("RR_hip"),
    conventions.MOTOR_NAMES.index("RL_hip"),
)


def endurance(policy: Policy, ramp: Ramp, setup: DeepSetup) -> Evaluation:
    """Calibrate the motor, then hold the paper's speed and the top one."""
    robot, top = robot_of(policy, setup), ramp.target[0]
    commands = tuple(dict.fromkeys((SPEED, top)))
    gait = HeatingTry(
        robot,
        setup.operator,
        ramp,
        _network(setup.heat),
        math.inf,
        longest=0.0,
        pace=1.0,
    ).at(SPEED)
    scan = () if setup.quick else tuple(speed for speed in SCAN if speed < top)
    others = (
        ()
        if setup.quick
        else draw_robots(robot, setup.robots or ROBOTS, setup.seed or 0)
    )
    tries = [
        dataclasses.replace(gait, cold_window=CALIBRATION),
        *(gait.at(speed) for speed in scan),
        *(dataclasses.replace(gait, robot=other) for other in others),
    ]
    ran = [run.endured for run in run_hot(policy, tries)]
    cold, of_others = ran[: 1 + len(scan)], ran[1 + len(scan) :]
    cold_heat = max(cold[0].first.heat[hip] for hip in REAR_HIPS)
    heat = calibrated(setup.heat, cold_heat)
    full = dataclasses.replace(
        gait, network=_network(heat), limit=heat.limit, longest=ramp.hold
    )
    fast = dataclasses.replace(full, pace=PACE)
    kinds = (
        [fast]
        if setup.quick
        else [full, fast, dataclasses.replace(fast, limit=LIMITLESS)]
    )
    hot = run_hot(policy, [kind.at(speed) for kind in kinds for speed in commands])
    by_kind = [hot[i : i + len(commands)] for i in range(0, len(hot), len(commands))]
    runs, accelerated = by_kind[0], by_kind[min(1, len(by_kind) - 1)]
    limitless = (
        [None] * len(commands) if setup.quick else [run.endured for run in by_kind[2]]
    )
    metrics = EnduranceMetrics(
        heat=heat,
        is_input=setup.heat.winding_to_case is None,
        cold_heat=cold_heat,
        held=tuple(
            HeldSpeed(
                full=None if setup.quick else run.endured,
                accelerated=fast.endured,
                limitless=beyond,
                by_cold_gait=_seconds_to_limit(run.endured, heat),
                course=run.course,
            )
            for run, fast, beyond in zip(runs, accelerated, limitless, strict=True)
        ),
        speeds=tuple(
            _at_speed(run, heat)
            for run in sorted(
                (*cold, *(run.endured for run in runs[1:])),
                key=lambda run: run.commanded_speed,
            )
        ),
        drawn=tuple(
            RandomRobot(
                other.friction,
                other.mass_scale / robot.mass_scale,
                other.parameter("peak_torque") / robot.parameter("peak_torque"),
                other.losses.latency,
                _at_speed(run, heat),
            )
            for other, run in zip(others, of_others, strict=True)
        ),
        family=family(setup.heat, cold_heat, max(runs[-1].endured.first.heat)),
    )
    said = conditions(
        policy,
        tables.describe_course(ramp, commands),
        describe_simulator("mujoco", robot),
        setup,
    )
    return Evaluation(
        benchmark="endurance",
        subject=describe_subject(policy, setup),
        backend="C MuJoCo",
        conditions=said | {"motor heat": tables.describe_heat(metrics)},
        verdict=tables.verdict(metrics),
        good=all(held.result.cause != "fall" for held in metrics.held),
        rows=tables.endurance_rows(metrics),
        tiles=tables.TILES,
        pictures=(
            Picture(
                "temperatures",
                figures.TEMPERATURES,
                figures.temperature_figure(metrics, accelerated),
            ),
            Picture(
                "operating_points",
                figures.OPERATING,
                figures.operating_figure(metrics, runs, robot),
            ),
            Picture("margin", figures.MARGIN_CAPTION, figures.margin_figure(metrics)),
            Picture("endurance", figures.ENDURANCE, figures.endurance_figure(metrics)),
            Picture(
                "calibration", figures.CALIBRATION, figures.calibration_figure(metrics)
            ),
        ),
        metrics=metrics,
        results=tables.endurance_results(metrics),
        tables=tables.endurance_tables(metrics),
    )


def draw_robots(robot: HardwareSpec, count: int, seed: int) -> tuple[HardwareSpec, ...]:
    """Robots drawn evenly from the ranges of training: friction, mass, strength and
    latency."""
    rng, ranges = np.random.default_rng(seed), RandomizationConfig()
    drawn = [
        [
            float(rng.uniform(*bounds))
            for bounds in (
                ranges.friction,
                ranges.mass,
                ranges.strength,
                ranges.latency,
            )
        ]
        for _ in range(count)
    ]
    return tuple(
        dataclasses.replace(
            robot,
            friction=robot.friction * friction,
            mass_scale=robot.mass_scale * mass,
            peak_torque=robot.parameter("peak_torque") * strength,
            losses=dataclasses.replace(robot.losses, latency=latency),
        )
        for friction, mass, strength, latency in drawn
    )


def ramp_to_endurance(policy: Policy, setup: DeepSetup) -> Ramp:
    """The schedule to the top speed; it is held for so long at most."""
    return ramp_to_topspeed(policy, setup, hold=LONGEST)


def _network(heat: MotorHeat) -> Network:
    return Network.from_spec(heat, heat.winding_to_case or 1.0)


def _at_speed(cold: EnduranceResult, heat: MotorHeat) -> EnduranceAtSpeed:
    most = int(np.argmax(cold.first.heat))
    return EnduranceAtSpeed(
        commanded_speed=cold.commanded_speed,
        speed=cold.first.speed,
        motor=conventions.MOTOR_NAMES[most],
        heat=cold.first.heat[most],
        torque=cold.first.torque[most],
        seconds=_seconds_to_limit(cold, heat),
        fell=cold.cause == "fall" and cold.seconds == 0.0,
    )


def _seconds_to_limit(run: EnduranceResult, heat: MotorHeat) -> float | None:
    """By the heat of the cold gait alone; None of a robot that never got into it."""
    if run.cause == "fall" and run.seconds == 0.0:
        return None
    first = float(
        np.min(seconds_to(_network(heat), np.array(run.first.heat), heat.limit))
    )
    return first if math.isfinite(first) else None
