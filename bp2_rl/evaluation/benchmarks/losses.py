"""What each loss costs: the same policy from the ideal robot to the built one, a loss
at a time.

Every loss is tried alone on the ideal robot, and left out alone from the built one;
then they are added one to the other, which is the waterfall. Below stands how much
faster the built robot runs than BP2 did: outdoors, and without air where BP2 ran on a
treadmill. A robot of a file is the built one; the ideal one is that robot without its
losses.
"""

import dataclasses
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import read_json
from bp2_rl.base.plotting import FAINT, FALL, FRONT, INK, QUIET, WIDTH, styled
from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    describe_ramp,
    describe_simulator,
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
from bp2_rl.evaluation.benchmarks.run import ramp_to_topspeed
from bp2_rl.learning.policy import Policy
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import robot_name
from bp2_rl.robot.variants import PARTS, differing, ideal_of, with_parts
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import Trajectory

LOSSES_HOLD = 6.0  # s
OPTIMISER = "reference_motions/greatest_speeds.json"
"""What `bp2 paper trajectories limits --losses --robot built` found; parts by the names
of `robot.variants`."""
TREADMILL, OUTDOORS = "Over the treadmill", "Over outdoors"
TILES = "Ideal robot", "Built robot", "Costliest alone"
PUBLISHED = {TREADMILL: bp2.TREADMILL_TOP_SPEED, OUTDOORS: bp2.OUTDOOR_TOP_SPEED}
"""m/s, what BP2 itself ran."""


@dataclasses.dataclass(frozen=True)
class Tried:
    """How one robot ran."""

    speed: float  # m/s, mean while held, or up to the fall
    fell_at: float | None  # s


@dataclasses.dataclass(frozen=True)
class PricedLoss:
    """One loss: its price in three ways; m/s, mean speed held."""

    name: str
    alone: Tried  # on the ideal robot
    without: Tried  # on the built one without it
    added: Tried  # on the ideal robot with this one and all before it
    # m/s, greatest speed of the optimiser's ideal robot with this loss alone
    optimiser: float | None


@dataclasses.dataclass(frozen=True)
class LossesMetrics:
    """All losses in the order of the waterfall."""

    commanded_speed: float  # m/s
    ideal: Tried
    built: Tried
    losses: tuple[PricedLoss, ...]
    # m/s, greatest speeds of its ideal and its built robot
    optimiser: tuple[float, float] | None
    is_bp2: bool = True  # whether BP2's published speeds are those of this robot

    @property
    def over_published(self) -> dict[str, tuple[float, float]]:
        """Speeds of the built robot and of BP2 by condition, m/s; on a treadmill there
        is no air."""
        without_air = next(
            (loss.without for loss in self.losses if loss.name == "air"), self.built
        )
        ours = {TREADMILL: without_air.speed, OUTDOORS: self.built.speed}
        return (
            {name: (ours[name], theirs) for name, theirs in PUBLISHED.items()}
            if self.is_bp2
            else {}
        )


def losses(policy: Policy, ramp: Ramp, setup: Setup) -> Evaluation:
    """Run all robots and compare."""
    built = robot_of(policy, setup)
    lossless = ideal_of(built)
    parts = differing(lossless, built)
    added = ideal = with_parts(built, lossless, PARTS)
    robots = [ideal, built]
    for part in parts:
        added = with_parts(added, built, [part])
        robots += [
            with_parts(ideal, built, [part]),
            with_parts(built, ideal, [part]),
            added,
        ]
    different = list(dict.fromkeys(robots))
    ran = simulate_all(
        speed_held,
        policy,
        [RunRequest(ramp, robot, setup.operator) for robot in different],
    )
    tried = dict(zip(different, ran, strict=True))
    is_bp2 = built.is_bp2
    found = greatest_speeds() if robot_name(built) else {}
    rows = []
    for i, part in enumerate(parts):
        alone, without, added = (
            tried[robot] for robot in robots[2 + 3 * i : 5 + 3 * i]
        )
        name = part if is_bp2 else part.removesuffix(", tracks")
        rows.append(
            PricedLoss(name, alone, without, added, found.get(f"ideal + {part}"))
        )
    pair = (
        (found["ideal"], found["built"]) if {"ideal", "built"} <= set(found) else None
    )
    metrics = LossesMetrics(
        ramp.target[0], tried[ideal], tried[built], tuple(rows), pair, is_bp2
    )
    return Evaluation(
        benchmark="losses",
        subject=describe_subject(policy, setup),
        backend="C MuJoCo",
        conditions=conditions(
            policy, describe_ramp(ramp), describe_simulator("mujoco", built), setup
        ),
        verdict=verdict(metrics),
        good=metrics.built.fell_at is None,
        rows=losses_rows(metrics),
        tiles=(*TILES, *(PUBLISHED if is_bp2 else ())),
        pictures=(
            Picture(
                "losses",
                CAPTION.format(CAPTION_OF_BP2 if is_bp2 else ""),
                losses_figure(metrics),
            ),
        ),
        metrics=metrics,
        results=losses_results(metrics),
        tables=(loss_table(metrics),),
    )


def speed_held(_: RunRequest, run: Trajectory) -> Tried:
    """How it ran."""
    ran = run.metrics
    return Tried(ran.mean_speed, ran.fell_at)


def ramp_to_losses(policy: Policy, setup: Setup) -> Ramp:
    """The schedule.

    Raises:
        UserError: the robot loses nothing.
    """
    robot = robot_of(policy, setup)
    if not differing(ideal_of(robot), robot):
        raise UserError(
            "--benchmark losses: the robot of this policy's card has no losses to leave out"
        )
    return ramp_to_topspeed(policy, setup, hold=LOSSES_HOLD)


def greatest_speeds() -> dict[str, float]:
    """What the optimiser found: `ideal`, `ideal + part`, `built`; m/s. Empty where it
    was not asked."""
    path = asset_path(OPTIMISER)
    return read_json(path)["speeds"] if path.is_file() else {}


# --- What is shown --------------------------------------------------------------------

CAPTION = (
    "Mean speed held, from the ideal robot to the built one, one loss added after the other; circles: with that loss "
    "alone{}. The axis does not begin at 0."
)
CAPTION_OF_BP2 = "; below, what BP2 itself ran, and how much faster the built robot is there, on a treadmill without air"


def verdict(metrics: LossesMetrics) -> str:
    """The comparison in one sentence."""
    for name, tried in (("ideal", metrics.ideal), ("built", metrics.built)):
        if tried.fell_at is not None:
            return f"The {name} robot fell at {tried.fell_at:.2f} s."
    ran = (
        f"; BP2: {' and '.join(f'{speed:g}' for speed in PUBLISHED.values())} m/s"
        if metrics.is_bp2
        else ""
    )
    return f"Built {metrics.built.speed:.2f} m/s, ideal {metrics.ideal.speed:.2f} m/s{ran}."


def losses_rows(metrics: LossesMetrics) -> tuple[Row, ...]:
    """The figures of merit for a reader, each with what it means."""
    costliest = max(metrics.losses, key=lambda loss: price(metrics.ideal, loss.alone))
    optimiser = metrics.optimiser or (None, None)
    rows = (
        Row("Ideal robot", show(metrics.ideal.speed, ".2f", "m/s"), "mean while held"),
        Row("Built robot", show(metrics.built.speed, ".2f", "m/s"), "mean while held"),
        Row(
            "Costliest alone",
            costliest.name,
            show(price(metrics.ideal, costliest.alone), ".2f", "m/s"),
        ),
        Row(
            "Optimiser, ideal",
            show(optimiser[0], ".2f", "m/s"),
            "greatest speed of its stride",
        ),
        Row(
            "Optimiser, built",
            show(optimiser[1], ".2f", "m/s"),
            "greatest speed of its stride",
        ),
    )
    if not metrics.is_bp2:
        return rows[:3]
    over = (
        Row(
            name,
            _signed(ours - theirs),
            f"{ours:.2f} m/s{', without air,' if name == TREADMILL else ''} less BP2's",
        )
        for name, (ours, theirs) in metrics.over_published.items()
    )
    return (*rows[:3], *over, *rows[3:])


def price(before: Tried, after: Tried) -> float:
    """What a loss costs, m/s; all of the speed where the robot falls."""
    return before.speed if after.fell_at is not None else before.speed - after.speed


def loss_table(metrics: LossesMetrics) -> Table:
    """Every loss."""
    head = (
        "Loss",
        "Alone [m/s]",
        "Cost",
        "All but this [m/s]",
        "Gain",
        "Added in turn [m/s]",
        *(("Optimiser, alone [m/s]",) if metrics.is_bp2 else ()),
    )
    return Table(
        "Losses",
        head,
        [
            (
                loss.name,
                _speed(loss.alone),
                _signed(-price(metrics.ideal, loss.alone)),
                _speed(loss.without),
                _signed(-price(metrics.built, loss.without)),
                _speed(loss.added),
                *((show(loss.optimiser, ".2f"),) if metrics.is_bp2 else ()),
            )
            for loss in metrics.losses
        ],
    )


def _speed(tried: Tried) -> str:
    return (
        f"{tried.speed:.2f}"
        if tried.fell_at is None
        else f"fell {show_fall(tried.fell_at)}"
    )


def _signed(speed: float) -> str:
    return f"{speed:+.2f} m/s"


def losses_results(metrics: LossesMetrics) -> dict[str, Any]:
    """What a policy's card says."""

    def upright(tried: Tried) -> float | None:
        return None if tried.fell_at is not None else tried.speed

    return rounded(
        {
            "commanded_speed": metrics.commanded_speed,
            "ideal": upright(metrics.ideal),
            "built": upright(metrics.built),
            "alone": {loss.name: upright(loss.alone) for loss in metrics.losses},
            "without": {loss.name: upright(loss.without) for loss in metrics.losses},
        }
    )


@styled
def losses_figure(metrics: LossesMetrics) -> Figure:
    """The waterfall, read from top to bottom."""
    figure = Figure(figsize=(WIDTH, 5.2), layout="constrained")
    axes = figure.subplots()
    names = [
        "ideal robot",
        *(loss.name for loss in metrics.losses),
        "built robot",
        *(("BP2 on a treadmill", "BP2 outdoors") if metrics.is_bp2 else ()),
    ]
    _draw_total(axes, 0, metrics.ideal.speed, FRONT)
    before = metrics.ideal.speed
    for place, loss in enumerate(metrics.losses, 1):
        after = loss.added.speed
        axes.barh(
            place,
            after - before,
            left=before,
            height=0.62,
            color=FALL if after < before else "#7FB3A0",
        )
        axes.plot(
            [before, before], [place - 1, place], color=QUIET, linewidth=0.7, zorder=0.8
        )
        if loss.alone.fell_at is None:
            axes.plot(loss.alone.speed, place, "o", ms=5, mfc="white", mec=INK, mew=1.0)
        change = (
            "fell"
            if loss.added.fell_at is not None
            else f"{round(after - before, 2) + 0.0:+.2f}"
        )
        axes.text(
            min(before, after) - 0.08,
            place,
            change,
            va="center",
            ha="right",
            fontsize=8.5,
        )
        before = after
    end = len(metrics.losses) + 1
    _draw_total(axes, end, metrics.built.speed, FRONT)
    published = metrics.over_published
    for place, (name, (ours, theirs)) in enumerate(published.items(), end + 1):
        _draw_total(axes, place, theirs, INK)
        gap, robot = ours - theirs, "built, no air" if name == TREADMILL else "built"
        axes.barh(
            place,
            gap,
            left=theirs,
            height=0.62,
            color="none",
            edgecolor=QUIET,
            hatch="////",
            linewidth=0.8,
        )
        axes.text(
            max(theirs, ours) + 0.08,
            place,
            f"{robot} {gap:+.2f}",
            va="center",
            fontsize=8.5,
        )
    axes.plot(
        [],
        [],
        "o",
        ms=5,
        mfc="white",
        mec=INK,
        label="that loss alone, on the ideal robot",
    )
    axes.legend(loc="center left", frameon=False)
    speeds = [metrics.ideal.speed, *(loss.added.speed for loss in metrics.losses)]
    speeds += [theirs for _, theirs in published.values()]
    left, right = (
        (2.2, 1.2) if metrics.is_bp2 else (0.25 * max(speeds), 0.1 * max(speeds))
    )
    axes.set(
        yticks=range(len(names)),
        yticklabels=names,
        ylim=(len(names) - 0.4, -0.6),
        xlabel="Mean speed held [m/s]",
        xlim=(min(speeds) - left, max(speeds) + right),
        title=f"From the ideal robot to the built one{', and to BP2' if metrics.is_bp2 else ''}",
    )
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)
    return figure


def _draw_total(axes: Axes, place: int, speed: float, color: str) -> None:
    axes.barh(place, speed, height=0.62, color=color)
    axes.axvline(speed, color=FAINT, linewidth=0.8, zorder=0.5)
    axes.text(
        speed - 0.08,
        place,
        f"{speed:.2f}",
        va="center",
        ha="right",
        color="white",
        fontweight="bold",
    )
