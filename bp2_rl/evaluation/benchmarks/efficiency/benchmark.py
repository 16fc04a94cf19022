"""What it costs to run, over speed: the motors' work, where it goes, and what the battery gives for it.

The paper prints no cost of transport. It says that all motors work within their high-efficiency regions, and that the
springs relieve them; both are asked here.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from bp2_rl.evaluation.benchmarks.conditions import conditions, describe_command, describe_simulator, robot_of
from bp2_rl.evaluation.benchmarks.efficiency import figures
from bp2_rl.evaluation.benchmarks.efficiency.measured import (
    AtSpeed,
    EfficiencyMetrics,
    Optimiser,
    measure_energy,
    measure_optimiser,
)
from bp2_rl.evaluation.benchmarks.efficiency.tables import (
    TILES,
    describe_runs,
    efficiency_results,
    efficiency_rows,
    efficiency_tables,
    verdict,
)
from bp2_rl.evaluation.benchmarks.mechanism.measured import whole_strides
from bp2_rl.evaluation.benchmarks.options import Setup
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture
from bp2_rl.evaluation.benchmarks.topspeed import ramp_to_topspeed
from bp2_rl.evaluation.runs.account import replay
from bp2_rl.evaluation.runs.machine import SwiftMachine
from bp2_rl.evaluation.runs.operator import HeadingHold
from bp2_rl.evaluation.runs.parallel import in_parallel
from bp2_rl.evaluation.runs.rollout import rollout_mujoco
from bp2_rl.evaluation.runs.schedule import Ramp
from bp2_rl.gait.collocation.file import load_library
from bp2_rl.learning.policy import Policy
from bp2_rl.robot import specs
from bp2_rl.robot.specs import HardwareSpec
from bp2_rl.settings.gait import CollocationConfig
from bp2_rl.trajopt.family import family_of

SPEEDS = 2.0, 4.0, 6.0, 8.0, specs.OUTDOOR_TOP_SPEED, 12.0, 14.0  # m/s, commands, and the top one
SHORT = (specs.OUTDOOR_TOP_SPEED,)  # in the quick version
HOLD, QUICK_HOLD = 10.0, 3.0  # s
EASING = 1.5  # s of the hold that are not looked at


class Try(NamedTuple):
    """One run."""

    ramp: Ramp
    operator: HeadingHold
    robot: HardwareSpec


def efficiency(policy: Policy, ramp: Ramp, setup: Setup) -> Evaluation:
    """Run all speeds and account for their energy."""
    robot, top = robot_of(policy, setup), ramp.target[0]
    commands = (*(speed for speed in (SHORT if setup.quick else SPEEDS) if speed < top), top)
    tries = [Try(dataclasses.replace(ramp, target=(speed, 0.0, 0.0)), setup.operator, robot) for speed in commands]
    ran = in_parallel(run_and_account, policy, tries[::-1])[::-1]  # the longest first
    metrics = EfficiencyMetrics(tuple(ran), optimised([at.speed for at in ran if at.energy is not None]))
    said = conditions(policy, describe_runs(ramp, commands), describe_simulator("mujoco", robot), setup)
    return Evaluation(
        benchmark="efficiency",
        subject=describe_command(policy, setup, top),
        backend="C MuJoCo",
        conditions=said,
        verdict=verdict(metrics),
        good=all(at.energy is not None for at in metrics.speeds),
        rows=efficiency_rows(metrics),
        tiles=TILES,
        pictures=(Picture("efficiency", figures.CAPTION, figures.efficiency_figure(metrics)),) if metrics.found else (),
        metrics=metrics,
        results=efficiency_results(metrics),
        tables=efficiency_tables(metrics),
    )


def ramp_to_efficiency(policy: Policy, setup: Setup) -> Ramp:
    """The schedule to the top speed."""
    hold = setup.hold or (QUICK_HOLD if setup.quick else HOLD)
    return ramp_to_topspeed(policy, dataclasses.replace(setup, hold=hold))


def run_and_account(policy: Policy, one: Try) -> AtSpeed:
    """Run one speed and account for the whole strides of its hold."""
    given = {"operator": one.operator, "hardware": one.robot, "machine": SwiftMachine}
    run = rollout_mujoco(policy, one.ramp, policy.card.env, **given)
    steady = one.ramp.steady_from + min(EASING, 0.5 * one.ramp.hold)
    end = len(run) * run.dt
    chosen = (
        whole_strides(run.between(steady, end), most=len(run))
        if run.fell_at is None and end - steady > 2 * run.dt
        else None
    )
    part, strides = chosen or (run, 0)
    energy = measure_energy(part, replay(part)[0], strides) if chosen else None
    return AtSpeed(one.ramp.target[0], float(np.mean(part.ground_velocity[:, 0])), run.fell_at, energy)


def optimised(speeds: list[float]) -> tuple[Optimiser, ...]:
    """The shipped library at the speeds nearest to these."""
    library = load_library(CollocationConfig().file)
    family = family_of(library.arrays, library.provenance)
    return tuple(measure_optimiser(min(family, key=lambda s: abs(s.problem.speed - speed))) for speed in speeds)
