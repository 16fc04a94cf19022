"""The convergence benchmark: the top-speed run repeated with smaller physics steps and
more frequent torque updates."""

import dataclasses
from collections.abc import Sequence

import mujoco

from bp2_rl.base.metric import (
    Row,
    card_of,
    metric,
    rounded,
    rows_of,
    show_fall,
    table_of,
)
from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    describe_limits,
    describe_ramp,
    describe_subject,
    robot_of,
)
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture
from bp2_rl.evaluation.benchmarks.variants import (
    Dots,
    Panel,
    measure_variant,
    variants_figure,
)
from bp2_rl.learning.policy import Policy
from bp2_rl.simulation.metrics import RunMetrics
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.simulator import CONVERGED, Numerics

TOLERANCE = 0.01  # of the mean speed held: what a change of the numerics may change
NUMERICS = {
    "1 ms, as usual": (CONVERGED, "in steps of 1 ms"),
    "solver x 2": (
        Numerics(iterations=200, line_search_iterations=100, tolerance=1e-12),
        "twice the iterations, tolerance 1e-12",
    ),
    "0.5 ms": (Numerics(steps=2), "two physics steps a millisecond"),
    "0.25 ms": (Numerics(steps=4), "four physics steps a millisecond"),
    "0.25 ms, motors too": (
        Numerics(steps=4, motors_each_step=True),
        "four steps a ms, torques at each",
    ),
}
"""The numerical settings that are compared, the usual ones first, each with its meaning
in words."""


@dataclasses.dataclass(frozen=True)
class NumericsVariant:
    """The speeds of a run with one numerical setting, and their changes from the usual
    run."""

    name: str = metric("Physics", form="s")
    # over the steady window
    mean_speed: float = metric("Mean speed", "m/s", ".3f")
    mean_speed_change: float = metric("Change", form="+.3%")
    # best 1-s mean
    best_speed: float | None = metric("Best speed", "m/s", ".3f")
    best_speed_change: float | None = metric("Change of the best", form="+.3%")
    fell_at: float | None = metric("Fall", form=show_fall)


@dataclasses.dataclass(frozen=True, kw_only=True)
class ConvergenceMetrics:
    """The runs of the convergence benchmark, the usual one first, and the greatest
    change of speed."""

    commanded_speed: float = metric("Commanded", "m/s", card=True, shown=False)
    greatest_change: float = metric(
        "Greatest change",
        form=".2%",
        meaning="of the mean speed held, relative",
        card=True,
    )
    variants: tuple[NumericsVariant, ...]


def convergence(policy: Policy, ramp: Ramp, setup: BenchmarkOptions) -> Evaluation:
    """Repeat the top-speed run with finer numerics; return the changes of speed as an
    evaluation."""
    robot = robot_of(policy, setup)
    requests = [
        RunRequest(ramp, robot, setup.operator, numerics=how, name=name)
        for name, (how, _) in NUMERICS.items()
    ]
    ran = simulate_all(measure_variant, policy, requests)
    metrics = compare_numerics([run.metrics for run in ran])
    first, *finer = metrics.variants
    fallen = [
        variant.name for variant in metrics.variants if variant.fell_at is not None
    ]
    simulator = (
        f"C MuJoCo {mujoco.__version__}, float64; {describe_limits(robot)}, but for '0.25 ms, motors too'; policy at "
        "200 Hz, full strength"
    )
    return Evaluation(
        benchmark="convergence",
        subject=describe_subject(policy, setup),
        conditions=conditions(policy, setup, describe_ramp(ramp), simulator),
        verdict=f"Finer physics changes the mean speed held by {metrics.greatest_change:.2%} at most; "
        f"fell: {', '.join(fallen) or 'none'}.",
        good=metrics.greatest_change <= TOLERANCE and not fallen,
        rows=(
            *rows_of(metrics),
            *rows_of(first, "mean_speed", "best_speed"),
            *(
                Row(
                    f"Change, {v.name}",
                    f"{v.mean_speed_change:+.3%}",
                    NUMERICS[v.name][1],
                )
                for v in finer
            ),
        ),
        tiles=("Greatest change", "Mean speed", "Best speed"),
        pictures=(convergence_picture(finer),),
        metrics=metrics,
        results=card_of(metrics)
        | rounded(
            {
                "mean_speed": first.mean_speed,
                "changes": {v.name: v.mean_speed_change for v in finer},
            }
        ),
        tables=(table_of("Runs", metrics.variants),),
    )


def compare_numerics(ran: Sequence[RunMetrics]) -> ConvergenceMetrics:
    """Return the speeds of all runs and their relative changes from the first run."""
    first = ran[0]
    variants = tuple(
        NumericsVariant(
            name=name,
            mean_speed=m.mean_speed,
            mean_speed_change=m.mean_speed / first.mean_speed - 1.0,
            best_speed=m.best_speed,
            best_speed_change=m.best_speed / first.best_speed - 1.0
            if m.best_speed and first.best_speed
            else None,
            fell_at=m.fell_at,
        )
        for name, m in zip(NUMERICS, ran, strict=True)
    )
    greatest = max(abs(variant.mean_speed_change) for variant in variants)
    return ConvergenceMetrics(
        commanded_speed=first.commanded_speed,
        greatest_change=greatest,
        variants=variants,
    )


def convergence_picture(finer: Sequence[NumericsVariant]) -> Picture:
    """Draw how much each run's speeds differ from the usual run's."""
    mean, best = (
        [None if change is None else 100.0 * change for change in changes]
        for changes in (
            [variant.mean_speed_change for variant in finer],
            [variant.best_speed_change for variant in finer],
        )
    )
    panel = Panel(
        "Difference from the usual run",
        "Relative difference [%]",
        (Dots("mean speed held", mean), Dots("best speed", best, hollow=True)),
        0.0,
    )
    caption = (
        "The same run under finer physics: how much the mean speed held and the best second differ from those of the "
        "usual run. There a motor's torque lies inside the envelope at the speed at which it was computed, the start "
        "of each millisecond, and is held for the rest of it; in '0.25 ms, motors too' it is computed, and limited, "
        "at every physics step."
    )
    figure = variants_figure([variant.name for variant in finer], [panel])
    return Picture("convergence", caption, figure)
