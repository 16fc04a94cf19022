"""The posterior benchmark: one policy on plausible robots, on treadmill and road."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import card_of, metric, rows_of, table_of
from bp2_rl.base.plotting import FALL, FRONT, INK, WIDTH, legend_above, styled
from bp2_rl.evaluation.benchmarks.conditions import conditions, describe_rise
from bp2_rl.evaluation.benchmarks.fleet import Quantiles, quantiles, show_interval
from bp2_rl.evaluation.benchmarks.options import POSTERIOR, BenchmarkOptions
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture
from bp2_rl.evaluation.benchmarks.run import ramp_to_sprint
from bp2_rl.evaluation.plausible import (
    HOLD,
    RISE,
    PlausibleRun,
    read_posterior,
    run_plausible,
)
from bp2_rl.learning.policy import Policy
from bp2_rl.robot import bp2
from bp2_rl.simulation.parallel import keep_workers
from bp2_rl.simulation.schedule import Ramp

NUM_ROBOTS = 32


@dataclasses.dataclass(frozen=True, kw_only=True)
class PosteriorMetrics:
    """Speeds and times of all robots: the median and the 90 % interval."""

    belt: Quantiles | None = metric(
        "Treadmill",
        form=lambda speed: show_interval(speed, ".2f", "m/s"),
        meaning=f"best second: median (90 %); BP2: {bp2.TREADMILL_TOP_SPEED:g}",
        card=True,
    )
    road: Quantiles | None = metric(
        "Road",
        form=lambda speed: show_interval(speed, ".2f", "m/s"),
        meaning=f"best second: median (90 %); BP2: {bp2.OUTDOOR_TOP_SPEED:g}",
        card=True,
    )
    time_100m: Quantiles | None = metric(
        "100 m",
        form=lambda time: show_interval(time, ".2f", "s"),
        meaning=f"of those that arrived: median (90 %); BP2: {bp2.SPRINT_100M_TIME:g}",
        card=True,
    )
    arrived: int = metric("Arrived", form="d", meaning="robots, after 100 m", card=True)
    falls: int = metric(
        "Falls",
        form="d",
        meaning="robots that fell while the command rose beyond their top speed",
        card=True,
    )
    robots: tuple[PlausibleRun, ...]


def posterior(policy: Policy, race: Ramp, setup: BenchmarkOptions) -> Evaluation:
    """Run a policy on plausible robots; return belt, road and 100 m as an
    evaluation."""
    count = setup.robots or NUM_ROBOTS
    with keep_workers():  # for belt and road, and for the race after them
        robots = run_plausible(policy, read_posterior(count), race.acceleration)
    times = [robot.time_100m for robot in robots if robot.time_100m is not None]
    metrics = PosteriorMetrics(
        belt=quantiles(np.array([robot.belt.speed for robot in robots])),
        road=quantiles(np.array([robot.road.speed for robot in robots])),
        time_100m=quantiles(np.array(times)),
        arrived=len(times),
        falls=sum(robot.fell for robot in robots),
        robots=tuple(robots),
    )
    rows = rows_of(metrics)
    run_conditions = conditions(
        policy,
        setup,
        f"from a stand to {policy.card.env.commands.max_forward:g} m/s at {RISE:g} m/s², then hold for {HOLD:g} s; "
        f"over 100 m {describe_rise(race)} to what gave the road's best second",
    )
    return Evaluation(
        benchmark=POSTERIOR,
        subject=f"{policy.card.stage} policy, {count} plausible robots",
        conditions=run_conditions
        | {
            "robot": f"{count} plausible robots, by `bp2 paper posterior`; on the treadmill without air"
        },
        verdict=f"{', '.join(f'{row.label} {row.value}' for row in rows[:3])}: median and 90 % of {count} robots.",
        good=len(times) == count,
        rows=rows,
        tiles=("Treadmill", "Road", "100 m"),
        pictures=(
            Picture(
                POSTERIOR,
                "Each robot's best second on the road over that on the treadmill; the cross is the paper's BP2.",
                posterior_figure(robots),
            ),
        ),
        metrics=metrics,
        results=card_of(metrics) | {"robots": count},
        tables=(table_of("Robots", robots),),
    )


def ramp_to_posterior(policy: Policy, setup: BenchmarkOptions) -> Ramp:
    """Return the ramp of the race, whose launch is the policy's own.

    Raises:
        UserError: the policy's robot is no BP2.
    """
    if not policy.card.env.hardware.is_bp2:
        raise UserError(
            f"--benchmark {POSTERIOR}: these robots may be BP2; the policy runs {policy.card.env.hardware.anatomy.name}"
        )
    return ramp_to_sprint(policy, setup)


@styled
def posterior_figure(robots: Sequence[PlausibleRun]) -> Figure:
    """Draw road over belt, a dot for each robot."""
    figure = Figure(figsize=(0.6 * WIDTH, 0.6 * WIDTH), layout="constrained")
    axes = figure.subplots()
    for fell, color in ((False, FRONT), (True, FALL)):
        some = np.array(
            [(r.belt.speed, r.road.speed) for r in robots if r.fell is fell]
        )
        if len(some):
            label = "fell beyond it" if fell else "no fall"
            axes.plot(*some.T, "o", ms=5, color=color, alpha=0.7, label=label)
    paper = bp2.TREADMILL_TOP_SPEED, bp2.OUTDOOR_TOP_SPEED
    axes.plot(*paper, "X", ms=10, color=INK, label="BP2, paper")
    axes.set(xlabel="Treadmill, best second [m/s]", ylabel="Road, best second [m/s]")
    legend_above(axes)
    return figure
