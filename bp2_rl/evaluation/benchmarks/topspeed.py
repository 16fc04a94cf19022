"""How fast a policy runs, and what it takes: from a stand to the commanded speed, and
hold it."""

import dataclasses

from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    describe_ramp,
    describe_simulator,
    describe_subject,
    robot_of,
    speed_to_command,
)
from bp2_rl.evaluation.benchmarks.options import Setup
from bp2_rl.evaluation.benchmarks.outcome import Evaluation
from bp2_rl.evaluation.benchmarks.run_tables import (
    run_pictures,
    run_results,
    run_rows,
    run_tables,
)
from bp2_rl.learning.policy import Policy
from bp2_rl.simulation.account import account
from bp2_rl.simulation.metrics import RunMetrics, measure
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import COMMAND_ACCELERATION, Ramp
from bp2_rl.simulation.simulator import Numerics
from bp2_rl.simulation.windows import steady_window

TOPSPEED_HOLD = 20.0  # s
# of the commanded speed: a robot that is slower does not run at all as it is told
FOLLOWS = 0.5
GOOD = f"no fall, and a mean speed of {FOLLOWS:.0%} of the commanded one or more"
TILES = (
    "Best speed",
    "Time held",
    "Tracking error",
    "Fall",
    "Electrical cost",
    "On the envelope",
)


def topspeed(policy: Policy, ramp: Ramp, setup: Setup) -> Evaluation:
    """Ramp to the commanded speed, hold it, and measure the run."""
    name, robot = describe_subject(policy, setup), robot_of(policy, setup)
    request = RunRequest(
        ramp,
        robot,
        setup.operator,
        noise_seed=setup.noise_seed,
        numerics=Numerics(drake=setup.drake),
        name=name,
    )
    [run] = simulate(policy, [request], backend=setup.backend)
    said = conditions(
        policy,
        describe_ramp(ramp),
        describe_simulator(setup.backend, robot, setup.drake),
        setup,
    )
    metrics = measure(run)
    if setup.backend == "mujoco" and metrics.hold_time >= 1.0:
        metrics = dataclasses.replace(metrics, account=account(steady_window(run)))
    return Evaluation(
        benchmark="topspeed",
        subject=name,
        backend=run.backend,
        conditions=said | {"good": GOOD},
        verdict=verdict(metrics),
        good=metrics.fell_at is None and follows(metrics),
        rows=run_rows(metrics),
        tiles=TILES,
        pictures=run_pictures(run),
        metrics=metrics,
        results=run_results(metrics),
        tables=run_tables(metrics),
        trajectory=run,
    )


def ramp_to_topspeed(
    policy: Policy,
    setup: Setup,
    *,
    speed: float | None = None,
    hold: float = TOPSPEED_HOLD,
) -> Ramp:
    """Return the schedule; `speed` (m/s) and `hold` (s) are for a setup that leaves
    them open."""
    speed = setup.speed or speed or speed_to_command(policy)
    ramp = Ramp(speed, setup.acceleration or COMMAND_ACCELERATION, setup.hold or hold)
    return ramp.under(policy.card.env.control)


def follows(metrics: RunMetrics) -> bool:
    """Whether the robot runs at all as it is told."""
    return metrics.mean_speed >= FOLLOWS * metrics.commanded_speed


def verdict(metrics: RunMetrics) -> str:
    """The run in one sentence."""
    if metrics.fell_at is not None:
        return f"Fell after {metrics.fell_at:.2f} s, {metrics.hold_time:.1f} s into the hold."
    if not follows(metrics):
        return f"Does not run: {metrics.mean_speed:.2f} m/s where {metrics.commanded_speed:g} m/s were commanded."
    best = (
        ""
        if metrics.best_speed is None
        else f", {metrics.best_speed:.2f} m/s in the best second"
    )
    return f"Ran {metrics.mean_speed:.2f} m/s in the mean of {metrics.hold_time:.1f} s{best}, without a fall."
