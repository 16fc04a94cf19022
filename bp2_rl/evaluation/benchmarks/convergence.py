"""That no speed comes from the numerics: the top-speed run under finer physics, and
under motors as fine."""

import dataclasses

import mujoco
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.plotting import (
    FALL,
    INK,
    LEG_COLORS,
    QUIET,
    WIDTH,
    legend_above,
    moving_mean,
    styled,
)
from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    describe_limits,
    describe_ramp,
    describe_subject,
    robot_of,
)
from bp2_rl.evaluation.benchmarks.options import Setup
from bp2_rl.evaluation.benchmarks.outcome import (
    Evaluation,
    Picture,
    Row,
    Table,
    rounded,
    show,
    show_fall,
)
from bp2_rl.learning.policy import Policy
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.simulator import CONVERGED, Numerics
from bp2_rl.simulation.trajectory import Trajectory

TOLERANCE = 0.01  # of the mean speed held: what a change of the numerics may change

VARIANTS = {
    "1 ms, as usual": CONVERGED,
    "solver x 2": Numerics(iterations=200, line_search_iterations=100, tolerance=1e-12),
    "0.5 ms": Numerics(steps=2),
    "0.25 ms": Numerics(steps=4),
    "0.25 ms, motors too": Numerics(steps=4, motors_each_step=True),
}
MEANINGS = {
    "solver x 2": "twice the iterations, tolerance 1e-12",
    "0.5 ms": "two physics steps a millisecond",
    "0.25 ms": "four physics steps a millisecond",
    "0.25 ms, motors too": "four steps a ms, torques at each",
}
TILES = "Greatest change", "Mean speed", "Best speed"


@dataclasses.dataclass(frozen=True)
class NumericsVariant:
    """One run; changes are relative to the first one."""

    name: str
    mean_speed: float  # m/s, over the steady window
    best_speed: float | None  # m/s, best 1-s mean
    mean_speed_change: float
    best_speed_change: float | None
    fell_at: float | None  # s


@dataclasses.dataclass(frozen=True)
class ConvergenceMetrics:
    """All runs, the usual one first."""

    commanded_speed: float  # m/s
    greatest_change: float  # of the mean speed held, relative
    variants: tuple[NumericsVariant, ...]


def convergence(policy: Policy, ramp: Ramp, setup: Setup) -> Evaluation:
    """Run top speed under all numerics and compare."""
    robot = robot_of(policy, setup)
    requests = [
        RunRequest(ramp, robot, setup.operator, numerics=how, name=name)
        for name, how in VARIANTS.items()
    ]
    runs = dict(zip(VARIANTS, simulate_all(as_it_is, policy, requests), strict=True))
    metrics = compare(runs)
    simulator = (
        f"C MuJoCo {mujoco.__version__}, float64; {describe_limits(robot)}, but for '0.25 ms, motors too'; policy at "
        "200 Hz, full strength"
    )
    return Evaluation(
        benchmark="convergence",
        subject=describe_subject(policy, setup),
        backend="C MuJoCo",
        conditions=conditions(policy, describe_ramp(ramp), simulator, setup),
        verdict=verdict(metrics),
        good=metrics.greatest_change <= TOLERANCE
        and not any(v.fell_at for v in metrics.variants),
        rows=convergence_rows(metrics),
        tiles=TILES,
        pictures=(Picture("convergence", CAPTION, convergence_figure(runs, metrics)),),
        metrics=metrics,
        results=convergence_results(metrics),
        tables=(variant_table(metrics),),
    )


def as_it_is(_: RunRequest, run: Trajectory) -> Trajectory:
    """The run itself."""
    return run


def compare(runs: dict[str, Trajectory]) -> ConvergenceMetrics:
    """Speeds of each run beside those of the first."""
    measured = {name: run.metrics for name, run in runs.items()}
    first = next(iter(measured.values()))
    variants = tuple(
        NumericsVariant(
            name=name,
            mean_speed=m.mean_speed,
            best_speed=m.best_speed,
            mean_speed_change=m.mean_speed / first.mean_speed - 1.0,
            best_speed_change=m.best_speed / first.best_speed - 1.0
            if m.best_speed and first.best_speed
            else None,
            fell_at=m.fell_at,
        )
        for name, m in measured.items()
    )
    greatest = max(abs(variant.mean_speed_change) for variant in variants)
    return ConvergenceMetrics(first.commanded_speed, greatest, variants)


# --- What is shown --------------------------------------------------------------------


def verdict(metrics: ConvergenceMetrics) -> str:
    """The comparison in one sentence."""
    fallen = [
        variant.name for variant in metrics.variants if variant.fell_at is not None
    ]
    fall = f" Fell: {', '.join(fallen)}." if fallen else ""
    return f"Finer physics changes the mean speed held by {metrics.greatest_change:.2%} at most.{fall}"


def convergence_rows(metrics: ConvergenceMetrics) -> tuple[Row, ...]:
    """The figures of merit for a reader, each with what it means."""
    first, *others = metrics.variants
    return (
        Row(
            "Greatest change",
            f"{metrics.greatest_change:.2%}",
            "of the mean speed held, relative",
        ),
        Row(
            "Mean speed", f"{first.mean_speed:.3f} m/s", "while held, in steps of 1 ms"
        ),
        Row(
            "Best speed",
            show(first.best_speed, ".3f", "m/s"),
            "best 1-s mean, in steps of 1 ms",
        ),
        *(
            Row(f"Change, {v.name}", f"{v.mean_speed_change:+.3%}", MEANINGS[v.name])
            for v in others
        ),
    )


def variant_table(metrics: ConvergenceMetrics) -> Table:
    """Every run."""
    head = "Physics", "Mean speed [m/s]", "Change", "Best speed [m/s]", "Change", "Fall"
    return Table(
        "Runs",
        head,
        [
            (
                v.name,
                f"{v.mean_speed:.3f}",
                f"{v.mean_speed_change:+.3%}",
                show(v.best_speed, ".3f"),
                show(v.best_speed_change, "+.3%"),
                show_fall(v.fell_at),
            )
            for v in metrics.variants
        ],
    )


def convergence_results(metrics: ConvergenceMetrics) -> dict[str, object]:
    """What a policy's card says of the comparison."""
    return rounded(
        {
            "commanded_speed": metrics.commanded_speed,
            "greatest_change": metrics.greatest_change,
            "mean_speed": metrics.variants[0].mean_speed,
            "changes": {
                variant.name: variant.mean_speed_change
                for variant in metrics.variants[1:]
            },
        }
    )


CAPTION = (
    "The same run under finer physics: speed over time (0.25-s means), and how much the mean speed held and the best "
    "second differ from those of the usual run. There a motor's torque lies inside the envelope at the speed at "
    "which it was computed, the start of each millisecond, and is held for the rest of it; in '0.25 ms, motors too' it "
    "is computed, and limited, at every physics step."
)


@styled
def convergence_figure(
    runs: dict[str, Trajectory], metrics: ConvergenceMetrics
) -> Figure:
    """The speeds overlaid, and their relative differences."""
    figure = Figure(figsize=(WIDTH, 5.6), layout="constrained")
    speed, change = figure.subplots(2, 1, height_ratios=(1.7, 1))
    colors = dict(zip(runs, (INK, *LEG_COLORS.values()), strict=True))
    _draw_speeds(speed, runs, colors)
    _draw_changes(change, metrics, colors)
    return figure


def _draw_speeds(
    axes: Axes, runs: dict[str, Trajectory], colors: dict[str, str]
) -> None:
    for place, (name, run) in enumerate(runs.items()):
        mean = moving_mean(run.ground_velocity[:, 0], round(RIPPLE / run.dt))
        # where runs agree, the earlier shows on both sides of the later
        width = 1.2 * (len(runs) - place)
        axes.plot(run.time, mean, color=colors[name], linewidth=width, label=name)
        if run.fell_at is not None:
            axes.plot(run.time[-1], mean[-1], "X", ms=8, color=FALL)
    end = max(len(run) * run.dt for run in runs.values())
    axes.set(
        title="Forward speed",
        xlabel="Time [s]",
        ylabel="Speed [m/s]",
        xlim=(0.0, end),
        ylim=(0.0, None),
    )
    axes.legend(loc="lower right")


def _draw_changes(
    axes: Axes, metrics: ConvergenceMetrics, colors: dict[str, str]
) -> None:
    others = metrics.variants[1:]
    for place, variant in enumerate(others):
        color = colors[variant.name]
        axes.plot(1e2 * variant.mean_speed_change, place, "o", ms=8, color=color)
        if variant.best_speed_change is not None:
            axes.plot(
                1e2 * variant.best_speed_change,
                place,
                "o",
                ms=8,
                mfc="none",
                mew=1.4,
                color=color,
            )
    axes.plot([], [], "o", ms=8, color=QUIET, label="mean speed held")
    axes.plot([], [], "o", ms=8, mfc="none", mew=1.4, color=QUIET, label="best speed")
    axes.axvline(0.0, color=INK, linewidth=1.0)
    reach = 1.2 * max(
        0.1,
        *(
            1e2 * abs(c)
            for v in others
            for c in (v.mean_speed_change, v.best_speed_change or 0.0)
        ),
    )
    axes.set(
        title="Difference from the usual run",
        xlabel="Relative difference [%]",
        xlim=(-reach, reach),
    )
    axes.set(
        yticks=range(len(others)),
        yticklabels=[v.name for v in others],
        ylim=(len(others) - 0.5, -0.5),
    )
    axes.tick_params(axis="y", length=0)
    legend_above(axes)
