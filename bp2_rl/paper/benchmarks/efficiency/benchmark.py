"""What it costs to run, over speed: the motors' work, where it goes, and what the
battery gives for it.

The paper prints no cost of transport. It says that all motors work within their
high-efficiency regions, and that the springs relieve them; both are asked here.
"""

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
from bp2_rl.paper.benchmarks.efficiency import figures, tables
from bp2_rl.paper.benchmarks.efficiency.measured import (
    EfficiencyAtSpeed,
    EfficiencyMetrics,
    OptimisedEfficiency,
    measure_energy,
    measure_optimiser,
)
from bp2_rl.paper.benchmarks.options import DeepSetup
from bp2_rl.paper.benchmarks.speeds import (
    commands_below,
    nearest_solutions,
    run_speeds,
    steady_strides,
)
from bp2_rl.robot import bp2
from bp2_rl.simulation.account import replay
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import Trajectory

# m/s, commands, and the top one
SPEEDS = 2.0, 4.0, 6.0, 8.0, bp2.OUTDOOR_TOP_SPEED, 12.0, 14.0
SHORT = (bp2.OUTDOOR_TOP_SPEED,)  # in the quick version
HOLD, QUICK_HOLD = 10.0, 3.0  # s


def efficiency(policy: Policy, ramp: Ramp, setup: DeepSetup) -> Evaluation:
    """Run all speeds and account for their energy."""
    robot, top = robot_of(policy, setup), ramp.target[0]
    commands = commands_below(SHORT if setup.quick else SPEEDS, top)
    ran = run_speeds(account, policy, ramp, commands, setup)
    metrics = EfficiencyMetrics(
        tuple(ran), optimised([at.speed for at in ran if at.energy is not None])
    )
    said = conditions(
        policy,
        tables.describe_runs(ramp, commands),
        describe_simulator("mujoco", robot),
        setup,
    )
    return Evaluation(
        benchmark="efficiency",
        subject=describe_subject(policy, setup),
        backend="C MuJoCo",
        conditions=said,
        verdict=tables.verdict(metrics),
        good=all(at.energy is not None for at in metrics.speeds),
        rows=tables.efficiency_rows(metrics),
        tiles=tables.TILES,
        pictures=(
            Picture("efficiency", figures.CAPTION, figures.efficiency_figure(metrics)),
        )
        if metrics.found
        else (),
        metrics=metrics,
        results=tables.efficiency_results(metrics),
        tables=tables.efficiency_tables(metrics),
    )


def ramp_to_efficiency(policy: Policy, setup: DeepSetup) -> Ramp:
    """The schedule to the top speed."""
    return ramp_to_topspeed(policy, setup, hold=QUICK_HOLD if setup.quick else HOLD)


def account(ramp: Ramp, run: Trajectory) -> EfficiencyAtSpeed:
    """Account for the whole strides of a run's hold."""
    chosen = steady_strides(run, ramp)
    part, strides = chosen or (run, 0)
    energy = measure_energy(part, replay(part)[0], strides) if chosen else None
    return EfficiencyAtSpeed(
        ramp.target[0], float(np.mean(part.ground_velocity[:, 0])), run.fell_at, energy
    )


def optimised(speeds: list[float]) -> tuple[OptimisedEfficiency, ...]:
    """The shipped library at the speeds nearest to these."""
    return tuple(measure_optimiser(solution) for solution in nearest_solutions(speeds))
