"""The losses benchmark: the speed that each loss between the ideal and the built robot
costs.

For a robot from a file, the built robot has the file's losses and the ideal robot none.
"""

import dataclasses

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import read_json
from bp2_rl.base.metric import (
    Row,
    metric,
    rounded,
    rows_of,
    show_fall,
    table_of,
)
from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    describe_ramp,
    describe_subject,
    robot_of,
)
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture
from bp2_rl.evaluation.benchmarks.run import (
    ramp_to_topspeed,
)
from bp2_rl.evaluation.benchmarks.variants import (
    Dots,
    Panel,
    measure_variant,
    variants_figure,
)
from bp2_rl.learning.policy import Policy
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import PARTS, differing, ideal_of, robot_name, with_parts
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.schedule import Ramp

LOSSES_HOLD = 6.0  # s
OPTIMISER = "reference_motions/greatest_speeds.json"
"""File of the optimiser's greatest speeds, m/s, by part of `robot.hardware`, from `bp2
paper trajectories limits --losses --robot built`."""


@dataclasses.dataclass(frozen=True)
class Tried:
    """The mean speed of a robot's run, and its time of fall."""

    speed: float  # m/s, mean while held, or up to the fall
    fell_at: float | None  # s

    @property
    def upright(self) -> float | None:
        """Mean speed of the run, m/s; None if the robot fell."""
        return None if self.fell_at is not None else self.speed


def price(before: Tried, after: Tried) -> float:
    """Return the speed that a loss costs between two runs, m/s; all of the speed if the
    robot falls."""
    return before.speed - (after.upright or 0.0)


def _show_speed(tried: "Tried") -> str:
    if tried.fell_at is not None:
        return f"fell {show_fall(tried.fell_at)}"
    return f"{tried.speed:.2f}"


@dataclasses.dataclass(frozen=True)
class PricedLoss:
    """The speed that a loss costs, m/s: alone on the ideal robot, left out of the built
    one, and added in turn."""

    name: str = metric("Loss", form="s")
    # on the ideal robot
    alone: Tried = metric("Alone [m/s]", form=_show_speed)
    cost: float = metric("Cost", "m/s", ".2f")
    # on the built robot without it
    without: Tried = metric("All but this [m/s]", form=_show_speed)
    gain: float = metric("Gain", "m/s", "+.2f")
    # on the ideal robot with this one and all before it
    added: Tried = metric("Added in turn [m/s]", form=_show_speed)
    # greatest speed of the optimiser's ideal robot with this loss alone
    optimiser: float | None = metric(
        "Optimiser, alone", "m/s", shown=lambda loss: loss.optimiser is not None
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class LossesMetrics:
    """The costs of all losses, in the order in which they are added from the ideal
    robot to the built one.

    BP2's own speeds are compared with the built robot's: outdoors, and without air
    where BP2 ran on a treadmill.
    """

    commanded_speed: float  # m/s
    ideal: Tried = metric(
        "Ideal robot [m/s]", form=_show_speed, meaning="mean while held"
    )
    built: Tried = metric(
        "Built robot [m/s]", form=_show_speed, meaning="mean while held"
    )
    losses: tuple[PricedLoss, ...]
    # of its ideal and its built robot
    optimiser: tuple[float, float] | None = metric(
        "Optimiser",
        form=lambda pair: f"{pair[0]:.2f}, {pair[1]:.2f} m/s",
        meaning="its greatest speeds, ideal and built",
        shown=lambda m: m.optimiser is not None,
    )
    # of the built robot without air; None: the robot is no BP2
    over_treadmill: float | None = metric(
        "Over the treadmill",
        "m/s",
        "+.2f",
        f"without air, less BP2's {bp2.TREADMILL_TOP_SPEED:g} m/s",
        shown=lambda m: m.over_treadmill is not None,
    )
    over_outdoors: float | None = metric(
        "Over outdoors",
        "m/s",
        "+.2f",
        f"less BP2's {bp2.OUTDOOR_TOP_SPEED:g} m/s",
        shown=lambda m: m.over_outdoors is not None,
    )


def losses(policy: Policy, ramp: Ramp, setup: BenchmarkOptions) -> Evaluation:
    """Measure the speed that each loss costs: alone, left out of the built robot, and
    added in turn."""
    built = robot_of(policy, setup)
    ideal = with_parts(built, ideal_of(built), PARTS)
    parts = differing(ideal, built)
    ways = {
        part: (
            with_parts(ideal, built, [part]),
            with_parts(built, ideal, [part]),
            with_parts(ideal, built, parts[: place + 1]),
        )
        for place, part in enumerate(parts)
    }
    robots = dict.fromkeys([ideal, built, *(x for way in ways.values() for x in way)])
    requests = [RunRequest(ramp, robot, setup.operator) for robot in robots]
    runs = simulate_all(measure_variant, policy, requests)
    results = {
        robot: Tried(one.metrics.mean_speed, one.metrics.fell_at)
        for robot, one in zip(robots, runs, strict=True)
    }
    optimiser_speeds = greatest_speeds() if robot_name(built) else {}
    priced = [
        PricedLoss(
            part if built.is_bp2 else part.removesuffix(", tracks"),
            results[alone],
            price(results[ideal], results[alone]),
            results[without],
            -price(results[built], results[without]),
            results[added],
            optimiser_speeds.get(f"ideal + {part}"),
        )
        for part, (alone, without, added) in ways.items()
    ]
    pair = (
        (optimiser_speeds["ideal"], optimiser_speeds["built"])
        if "built" in optimiser_speeds
        else None
    )
    still = results[ways["air"][1] if "air" in ways else built].speed
    metrics = LossesMetrics(
        commanded_speed=ramp.target[0],
        ideal=results[ideal],
        built=results[built],
        losses=tuple(priced),
        optimiser=pair,
        over_treadmill=still - bp2.TREADMILL_TOP_SPEED if built.is_bp2 else None,
        over_outdoors=results[built].speed - bp2.OUTDOOR_TOP_SPEED
        if built.is_bp2
        else None,
    )
    costliest = max(priced, key=lambda loss: loss.cost)
    rows = (
        *rows_of(metrics),
        Row("Costliest alone", costliest.name, f"{costliest.cost:.2f} m/s"),
    )
    return Evaluation(
        benchmark="losses",
        subject=describe_subject(policy, setup),
        conditions=conditions(policy, setup, describe_ramp(ramp)),
        verdict=f"Built {_show_speed(metrics.built)}, ideal {_show_speed(metrics.ideal)} m/s.",
        good=metrics.built.fell_at is None,
        rows=rows,
        tiles=tuple(row.label for row in rows if row.label != "Optimiser"),
        pictures=(losses_picture(metrics, built.is_bp2),),
        metrics=metrics,
        results=rounded(
            {
                "commanded_speed": metrics.commanded_speed,
                "ideal": metrics.ideal.upright,
                "built": metrics.built.upright,
                "alone": {loss.name: loss.alone.upright for loss in priced},
                "without": {loss.name: loss.without.upright for loss in priced},
            }
        ),
        tables=(table_of("Losses", priced),),
    )


def ramp_to_losses(policy: Policy, setup: BenchmarkOptions) -> Ramp:
    """Return the command ramp of the losses benchmark.

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
    """Return the optimiser's greatest speeds, m/s: `ideal`, `ideal + part`, `built`;
    empty if not computed."""
    path = asset_path(OPTIMISER)
    return read_json(path)["speeds"] if path.is_file() else {}


def losses_picture(metrics: LossesMetrics, is_bp2: bool) -> Picture:
    """Draw the speed while losses are added from the ideal to the built robot; below,
    if the robot is BP2, the speeds of the paper."""
    own = {
        "BP2 on a treadmill": bp2.TREADMILL_TOP_SPEED,
        "BP2 outdoors": bp2.OUTDOOR_TOP_SPEED,
    }
    added = {loss.name: loss.added.upright for loss in metrics.losses}
    alone = {loss.name: loss.alone.upright for loss in metrics.losses}
    cost = {loss.name: f"{loss.name} ({-loss.cost:+.2f})" for loss in metrics.losses}
    speeds = {"ideal robot": metrics.ideal.upright} | added
    speeds |= {"built robot": metrics.built.upright} | (own if is_bp2 else {})
    series = (
        Dots("one loss added after the other", [*speeds.values()]),
        Dots("that loss alone", [alone.get(name) for name in speeds], hollow=True),
    )
    panel = Panel("Mean speed held", "Speed [m/s]", series, metrics.ideal.speed)
    caption = (
        "Mean speed held, from the ideal robot to the built one, one loss added after the other; circles: with "
        "that loss alone on the ideal robot, and in brackets what it changes"
        f"{'; below, what BP2 itself ran' if is_bp2 else ''}; crosses: fallen. The "
        "axis does not begin at 0."
    )
    names = [cost.get(name, name) for name in speeds]
    return Picture("losses", caption, variants_figure(names, [panel]))
