"""The scaling study: robots' published and learned speeds beside the greatest speed
that their legs and motors allow.

For each legged robot of Table S1 whose legs and motors are published, and for each that
ships as a file, the greatest speed of its trot by the optimiser stands beside its
published speed and beside what policies learned. A speed above the optimiser's refutes
the model.
"""

import dataclasses
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from matplotlib.figure import Figure

from bp2_rl.base.assets import asset_path
from bp2_rl.base.bounds import Within
from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import metric, show
from bp2_rl.base.plotting import FALL, FRONT, INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.paper.figures.drawn import name_rows, note
from bp2_rl.paper.figures.scaling import shipped
from bp2_rl.paper.published import PublishedRobot
from bp2_rl.paper.published_tables import ColumnHeading, read_table
from bp2_rl.paper.scaling.limits import SpeedLimit, SpeedLimits
from bp2_rl.paper.scaling.robots import BP2, find_robots, read_legs

LEARNED = "scaling/learned.csv"
FOUND = "scaling/limits.json"


@dataclasses.dataclass(frozen=True)
class LearnedSpeed:
    """The top speed of a policy in C MuJoCo: the best mean of a ramp's holds of 6 s."""

    robot: str  # as in Table S1
    speed: Annotated[float, Within(0.0, 1e3), ColumnHeading("top speed [m/s]")]
    command: str  # that trained it


def _show_greatest(speeds: Sequence[float]) -> str:
    return show(max(speeds, default=None), ".2f")


def _show_gains(limit: SpeedLimit) -> str:
    """Return the limits that matter, by gain, and the verifier's objections as text."""
    ranked = sorted(limit.gains.items(), key=lambda gain: -gain[1])
    said = ", ".join(f"{name} {gain:.2f}" for name, gain in ranked if gain >= 0.05)
    return "; ".join((said, *limit.unsound))


@dataclasses.dataclass(frozen=True, kw_only=True)
class LimitedRobot:
    """A robot's published and learned speeds, m/s, and its speed limit by the
    optimiser."""

    robot: str = metric("Robot", form="s")
    # None of BP2's variants
    published: float | None = metric("Published", "m/s")
    learned: tuple[float, ...] = metric("Learned", "m/s", _show_greatest)
    ratio: float | None = metric("Limit / published")
    # whether some of its links' masses are ASSUMED
    assumed: bool
    limit: float = metric("Limit", "m/s")
    found: SpeedLimit = metric("% for 1 % more", form=_show_gains)


@dataclasses.dataclass(frozen=True)
class ScalingStudy:
    """All results of the study: robots with their speed limits."""

    # the least ratio of limit to published speed first, then BP2's variants
    robots: tuple[LimitedRobot, ...]
    not_found: tuple[str, ...]  # robots without any trot
    # legged robots of Table S1 whose legs or motors are not published
    left_out: tuple[str, ...]


def compare_limits(
    limits: SpeedLimits,
    published: Sequence[PublishedRobot],
    learned: Sequence[LearnedSpeed],
) -> ScalingStudy:
    """Return the study: speed limits beside published and learned speeds.

    Raises:
        UserError: no robot has a limit.
    """
    speeds = {robot.robot: robot.top_speed for robot in published}
    assumed = {legs.robot for legs in read_legs() if legs.thigh_mass is None}
    robots = [
        LimitedRobot(
            robot=name,
            published=speeds.get(name),
            learned=tuple(one.speed for one in learned if one.robot == name),
            ratio=limit.speed / speeds[name] if name in speeds else None,
            assumed=name in assumed,
            limit=limit.speed,
            found=limit,
        )
        for name, limit in limits.limits.items()
        if limit
    ]
    if not robots:
        raise UserError(f"no trot was found of {', '.join(limits.limits)}")
    known = find_robots()
    return ScalingStudy(
        robots=tuple(sorted(robots, key=lambda robot: robot.ratio or float("inf"))),
        not_found=tuple(name for name, limit in limits.limits.items() if not limit),
        left_out=tuple(
            one.robot for one in published if not one.wheels and one.robot not in known
        ),
    )


def read_learned() -> tuple[LearnedSpeed, ...]:
    """Return the speeds that policies learned: the table that ships, and BP2's policy
    by its card."""
    own = (
        LearnedSpeed(BP2, robot.top_speed, "the policy that ships")
        for robot in shipped()
    )
    return (*read_table(asset_path(LEARNED), LearnedSpeed), *own)


def refutations(study: ScalingStudy) -> list[str]:
    """Return a line for each published or learned speed above a robot's limit, or one
    line that there is none."""
    lines = [
        f"{robot.robot} runs {speed:.2f} m/s ({kind}), and its limit is {robot.limit:.2f} m/s: the model is wrong"
        for robot in study.robots
        for kind, speed in (
            ("published", robot.published or 0.0),
            ("learned", max(robot.learned, default=0.0)),
        )
        if speed > robot.limit
    ]
    known = sum(robot.published is not None for robot in study.robots)
    return lines or [
        f"no speed of {known} robots, published or learned, is above the optimiser's limit"
    ]


@styled
def draw_limits(study: ScalingStudy) -> Figure:
    """Draw published and learned speeds and the limit robot by robot, BP2's variants
    at the bottom."""
    robots = study.robots[::-1]
    figure = Figure(figsize=(WIDTH, 1.6 + 0.27 * len(robots)), layout="constrained")
    axes = figure.subplots()
    limits = [(robot.limit,) for robot in robots]
    published = [(robot.published,) if robot.published else () for robot in robots]
    learned = [robot.learned for robot in robots]
    for row, robot in enumerate(robots):
        speeds = (*robot.learned, robot.published or 0.0)
        limit = robot.limit
        color = FALL if max(speeds) > limit else QUIET
        if robot.published:
            axes.plot((robot.published, limit), (row, row), color=color, linewidth=0.8)
        ratio = f"{robot.ratio:.2f}, " if robot.ratio else ""
        said = f"{ratio}{robot.found.binds}"
        note(axes, said, (max(*speeds, limit), row), (7, 0), va="center", fontsize=8)
    for label, columns, mark, size, color in (
        ("optimiser's limit", limits, "|", 11, LEG_COLORS["FL"]),
        ("learned, simulated", learned, "D", 4, FRONT),
        ("published", published, "o", 5, INK),
    ):
        points = [(x, row) for row, speeds in enumerate(columns) for x in speeds]
        at = np.reshape(points, (-1, 2)).T
        axes.plot(*at, mark, ms=size, mew=1.5, color=color, label=label)
    name_rows(axes, [robot.robot + " *" * robot.assumed for robot in robots])
    axes.set_title(
        "Beside: limit over published speed, and what binds; *: links ASSUMED", x=0.0
    )
    axes.set(xlabel="Speed [m/s]", xlim=(0.0, None))
    axes.margins(x=0.22)
    axes.legend(loc="center right", fontsize=8.5)
    return figure
