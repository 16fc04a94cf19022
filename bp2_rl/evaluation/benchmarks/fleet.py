"""The robustness benchmark: the share of a fleet of randomised robots that runs without
a fall."""

import dataclasses
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.metric import NOT_MEASURED, card_of, metric, rounded, rows_of, show
from bp2_rl.base.plotting import (
    FALL,
    FRONT,
    INK,
    WIDTH,
    legend_above,
    moving_mean,
    styled,
)
from bp2_rl.env.randomization import DESIGN_FACTORS
from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    cruising_speed,
    describe_ramp,
    describe_sensors,
    robot_of,
    title_of,
)
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture
from bp2_rl.evaluation.benchmarks.run import ramp_to_topspeed
from bp2_rl.learning.policy import Policy
from bp2_rl.robot import conventions
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.settings.env import EnvConfig, RandomizationConfig
from bp2_rl.settings.presets.robots import on_robot
from bp2_rl.simulation.backend import TITLES
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.parallel import FleetRun, run_fleet
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.world import World

NUM_ROBOTS = 200
ROBUSTNESS_HOLD = 15.0  # s


@dataclasses.dataclass(frozen=True)
class DrawnRobot:
    """One robot of a fleet: its random properties and the measurements of its run."""

    friction: float  # of the feet on the ground
    latency: float  # s, from observation to new joint targets
    mass: float  # kg
    strength: float  # share of the peak torque that its weakest motor has
    mean_speed: float | None  # m/s, while held; None if it fell
    # m, greatest distance of its trunk from the line through the start; None if it fell
    offset: float | None
    fell_at: float | None  # s


Quantiles: TypeAlias = tuple[float, float, float]
"""Of a figure over robots: 5 % lie below the first and above the last, the median between
them."""


def _within(interval: Quantiles | None, unit: str) -> str:
    if interval is None:
        return ""
    low, _, high = interval
    return f"; 90 %: {low:.2f} to {high:.2f} {unit}"


def show_interval(interval: Sequence[float] | None, form: str, unit: str = "") -> str:
    """Return a median and its interval as text, from (low, median, high); a dash for
    None."""
    if interval is None:
        return NOT_MEASURED
    low, middle, high = (f"{x:{form}}" for x in interval)
    return f"{middle} ({low} to {high}) {unit}".rstrip()


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobustnessMetrics:
    """The falls, speeds and lane offsets of a fleet, and each robot's; quantiles are
    None if all fell."""

    duration: float  # s
    upright: int  # robots that did not fall
    share: float = metric(
        "Without a fall",
        form=".1%",
        meaning=lambda m: (
            f"upright for {m.duration:.1f} s: {m.upright} of {len(m.robots)}"
        ),
        card=True,
    )
    share_interval: tuple[float, float] = metric(
        "95 % interval",
        form=lambda interval: f"{interval[0]:.1%} to {interval[1]:.1%}",
        meaning="Wilson score interval of that share",
        card=True,
    )
    commanded_speed: float = metric(
        "Commanded speed", "m/s", meaning="at the end", card=True
    )
    # over robots, of each one's mean while held
    mean_speed: Quantiles | None = metric(
        "Mean speed",
        form=lambda speed: show(speed and speed[1], ".2f", "m/s"),
        meaning=lambda m: f"held, median{_within(m.mean_speed, 'm/s')}",
    )
    # over robots, of each one's greatest distance from the line
    offset: Quantiles | None = metric(
        "Off the line",
        form=lambda offset: show(offset and offset[1], ".2f", "m"),
        meaning=lambda m: f"greatest, median{_within(m.offset, 'm')}",
    )
    greatest_offset: float | None = metric(
        "Worst off the line",
        "m",
        meaning="greatest of the upright",
        card="greatest_lane_offset",
    )
    # s, in order
    fallen_at: tuple[float, ...] = metric(
        "First fall",
        form=lambda times: show(times[0] if times else None, ".2f", "s"),
        meaning=lambda m: (
            f"after the start; the last at {show(m.fallen_at[-1] if m.fallen_at else None, '.2f', 's')}"
        ),
    )
    # with a leg at or in another or the trunk at the beginning of some control step
    legs_touch: int = metric(
        "Legs touch",
        form="d",
        meaning=lambda m: (
            f"robots, before a fall; {1e3 * m.leg_depth:.0f} mm deep at most"
        ),
        card=True,
    )
    leg_depth: float = metric("Depth", "mm", ".0f", card=True, shown=False)
    robots: tuple[DrawnRobot, ...]


def robustness(policy: Policy, ramp: Ramp, setup: BenchmarkOptions) -> Evaluation:
    """Run a fleet of randomised robots; return falls, speeds and lane offsets as an
    evaluation."""
    count = setup.robots or NUM_ROBOTS
    seed = setup.seed or 0
    robot = robot_of(policy, setup)
    drawn = on_robot(EnvConfig(), robot).randomization
    request = RunRequest(ramp, robot, setup.operator, World(setup.ground))
    run = run_fleet(policy, request, drawn, count, seed, setup.backend)
    metrics = fleet_metrics(run)
    speed = metrics.mean_speed
    offset = metrics.offset
    return Evaluation(
        benchmark="robustness",
        subject=f"{count} x {title_of(robot)}, {policy.card.stage} policy, command {ramp.target[0]:g} m/s",
        backend=TITLES[setup.backend],
        conditions=conditions(policy, setup, describe_ramp(ramp))
        | {
            "robots": f"{count}, seed {seed}",
            "sensors": describe_sensors(drawn, seed),
            "drawn": describe_randomization(drawn, robot),
            "good": "no robot falls",
        },
        verdict=f"{metrics.upright} of {count} robots did not fall at a command of {metrics.commanded_speed:g} m/s.",
        good=metrics.upright == len(metrics.robots),
        rows=rows_of(metrics),
        tiles=("Without a fall", "Mean speed", "Off the line", "Worst off the line"),
        pictures=(
            Picture(
                "robots",
                "Each robot's mean speed while held over the friction drawn for it, with the latency as colour; "
                "crosses: fallen.",
                robots_figure(metrics),
            ),
            Picture(
                "fleet",
                "Speed over time (0.25-s means) of the robots that had not fallen until then: the median, and the "
                "bands that hold half and nine tenths of them; ticks: falls.",
                fleet_figure(run),
            ),
        ),
        metrics=metrics,
        results=card_of(metrics)
        | rounded(
            {
                "robots": count,
                "upright": metrics.upright,
                "mean_speed": speed and speed[1],
                "mean_speed_5_to_95": speed and speed[::2],
                "lane_offset": offset and offset[1],
            }
        ),
    )


def ramp_to_robustness(policy: Policy, setup: BenchmarkOptions) -> Ramp:
    """Return the command ramp of the robustness benchmark, for BP2 at the same speed
    for every policy, to compare policies."""
    return ramp_to_topspeed(
        policy, setup, speed=cruising_speed(policy), hold=ROBUSTNESS_HOLD
    )


def describe_randomization(drawn: RandomizationConfig, robot: HardwareSpec) -> str:
    """Describe in one line the ranges of a fleet's random properties, and its
    pushes."""
    low, high = (robot.friction * factor for factor in drawn.friction)
    mass, strength, gains, losses = (
        f"{least:g} to {most:g}"
        for least, most in (drawn.mass, drawn.strength, drawn.gains, drawn.losses)
    )
    design = "".join(
        f", {name.replace('_', ' ')} x {bounds[0]:g} to {bounds[1]:g}"
        for name in DESIGN_FACTORS
        if (bounds := getattr(drawn, name)) is not None
    )
    return (
        f"friction {low:.2f} to {high:.2f}, each body's mass by itself x {mass}, trunk's centre of mass "
        f"±{1e3 * drawn.com_offset:.3g} mm, each motor's strength x {strength} and gains x "
        f"{gains}, latency {1e3 * drawn.latency[0]:g} to {1e3 * drawn.latency[1]:g} ms, each loss "
        f"x {losses}{design}; pushes of up to {drawn.push_velocity:.3g} m/s on each "
        f"axis, every {drawn.push_interval:g} s on average"
    )


def fleet_metrics(run: FleetRun) -> RobustnessMetrics:
    """Compute all figures of merit of a fleet from the motion of its robots."""
    upright = np.isinf(run.fell_at)
    speeds = np.mean(run.speed[run.time > run.steady_from], axis=0)
    offsets = np.max(np.abs(run.offset), axis=0)
    robots = tuple(
        DrawnRobot(
            **{name: float(values[i]) for name, values in run.robots.items()},
            mean_speed=float(speeds[i]) if up else None,
            offset=float(offsets[i]) if up else None,
            fell_at=None if up else float(run.fell_at[i]),
        )
        for i, up in enumerate(upright)
    )
    count = int(np.sum(upright))
    return RobustnessMetrics(
        commanded_speed=float(run.command[-1]),
        duration=float(run.time[-1]),
        upright=count,
        share=count / len(robots),
        share_interval=wilson_interval(count, len(robots)),
        mean_speed=quantiles(speeds[upright]),
        offset=quantiles(offsets[upright]),
        greatest_offset=float(np.max(offsets[upright])) if count else None,
        fallen_at=tuple(float(time) for time in np.sort(run.fell_at[~upright])),
        legs_touch=int(np.sum(run.leg_room <= 0.0)),
        leg_depth=max(-float(np.min(run.leg_room)), 0.0),
        robots=robots,
    )


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval of a share, valid also for no and all
    successes."""
    from scipy.stats import binomtest  # takes a second to load

    interval = binomtest(successes, trials).proportion_ci(0.95, "wilson")
    return float(interval.low), float(interval.high)


def quantiles(values: Float[np.ndarray, " N"]) -> Quantiles | None:
    """Return the 5 % quantile, the median and the 95 % quantile of the values; None for
    no values."""
    if not len(values):
        return None
    low, median, high = np.quantile(values, (0.05, 0.5, 0.95)).tolist()
    return low, median, high


# --- Pictures -------------------------------------------------------------------------


@styled
def robots_figure(metrics: RobustnessMetrics) -> Figure:
    """Draw each robot's mean speed over its friction, coloured by latency, with crosses
    for falls."""
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    axes: Axes = figure.subplots()
    robots = [
        (r.friction, r.mean_speed, 1e3 * r.latency)
        for r in metrics.robots
        if r.mean_speed is not None
    ]
    fallen = [r.friction for r in metrics.robots if r.fell_at is not None]
    latencies = [1e3 * robot.latency for robot in metrics.robots]
    if robots:
        friction, speed, latency = zip(*robots, strict=True)
        points = axes.scatter(
            friction,
            speed,
            c=latency,
            s=26,
            linewidths=0,
            cmap="cividis",
            vmin=min(latencies),
            vmax=max(latencies),
        )
        figure.colorbar(
            points, ax=axes, label="Latency [ms]", pad=0.02
        ).outline.set_visible(False)
    axes.axhline(
        metrics.commanded_speed,
        color=INK,
        linestyle=(0, (4, 2)),
        linewidth=1.2,
        label="command",
    )
    if fallen:
        axes.plot(
            fallen,
            [0.03] * len(fallen),
            "x",
            ms=7,
            mew=1.8,
            color=FALL,
            transform=axes.get_xaxis_transform(),
            label=f"{len(fallen)} fell",
        )
    axes.set(title="Mean speed held", xlabel="Friction [1]", ylabel="Speed [m/s]")
    axes.margins(y=0.12)
    legend_above(axes)
    return figure


@styled
def fleet_figure(run: FleetRun) -> Figure:
    """Draw the quantiles of a fleet's forward speed as bands over time."""
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    axes: Axes = figure.subplots()
    speed = moving_mean(run.speed, round(RIPPLE / conventions.CONTROL_STEP))
    standing = run.time[:, None] < run.fell_at - RIPPLE / 2
    standing[0] = True
    last = int(np.sum(np.any(standing, axis=1)))
    shown = np.where(standing, speed, np.nan)[:last]
    bands = np.nanquantile(shown, (0.05, 0.25, 0.5, 0.75, 0.95), axis=1)
    time = run.time[:last]
    axes.fill_between(
        time,
        bands[0],
        bands[4],
        color=FRONT,
        alpha=0.18,
        linewidth=0,
        label="90 % of the robots",
    )
    axes.fill_between(
        time, bands[1], bands[3], color=FRONT, alpha=0.35, linewidth=0, label="50 %"
    )
    axes.plot(time, bands[2], color=FRONT, linewidth=1.8, label="median")
    axes.plot(
        run.time,
        run.command,
        color=INK,
        linestyle=(0, (4, 2)),
        linewidth=1.2,
        label="command",
    )
    fell = run.fell_at[np.isfinite(run.fell_at)]
    if len(fell):
        axes.plot(
            fell,
            0.03 + 0.0 * fell,
            "|",
            ms=10,
            mew=1.6,
            color=FALL,
            transform=axes.get_xaxis_transform(),
            label="falls",
        )
    axes.set(
        title="Speed",
        xlabel="Time [s]",
        ylabel="Speed [m/s]",
        xlim=(0.0, run.time[-1]),
        ylim=(0.0, None),
    )
    legend_above(axes)
    return figure
