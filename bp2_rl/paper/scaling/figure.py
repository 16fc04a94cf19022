"""The figure of a scaling study: each robot's speeds and limit, and what springs and
legs do to BP2's limit."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.plotting import FALL, FRONT, INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.paper.figures.drawn import name_rows
from bp2_rl.paper.scaling.study import LimitedRobot, ScalingStudy
from bp2_rl.paper.scaling.variants import BP2

LIMIT, LEARNED = LEG_COLORS["FL"], FRONT
ROW = 0.27  # inches


@styled
def draw_limits(study: ScalingStudy) -> Figure:
    """Draw published and learned speeds and the limit robot by robot, and the limits of
    BP2's variants."""
    panels = [rows for rows in (len(study.robots), len(study.variants)) if rows]
    figure = Figure(
        figsize=(WIDTH, 1.6 * len(panels) + ROW * sum(panels)), layout="constrained"
    )
    axes = figure.subplots(
        len(panels), 1, squeeze=False, height_ratios=panels, sharex=True
    )[:, 0]
    if study.robots:
        _draw_robots(axes[0], study.robots)
    if study.variants:
        _draw_variants(axes[-1], study)
    axes[-1].set(xlabel="Speed [m/s]", xlim=(0.0, None))
    return figure


def _draw_robots(axes: Axes, robots: tuple[LimitedRobot, ...]) -> None:
    rows = range(len(robots) - 1, -1, -1)
    for row, robot in zip(rows, robots, strict=True):
        color = FALL if robot.fastest > robot.limit.speed else QUIET
        axes.plot(
            (robot.published, robot.limit.speed), (row, row), color=color, linewidth=0.8
        )
        said = f"{robot.ratio:.2f}, {robot.limit.binds}"
        right = max(robot.fastest, robot.limit.speed)
        axes.annotate(
            said,
            (right, row),
            (7, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    limits = [robot.limit.speed for robot in robots]
    axes.plot(
        limits,
        rows,
        "|",
        ms=11,
        markeredgewidth=2.2,
        color=LIMIT,
        label="optimiser's limit",
    )
    learned = [
        (speed, row)
        for row, robot in zip(rows, robots, strict=True)
        for speed in robot.learned
    ]
    if learned:
        axes.plot(
            *zip(*learned, strict=True),
            "D",
            ms=4,
            color=LEARNED,
            alpha=0.8,
            label="learned, simulated",
        )
    axes.plot(
        [robot.published for robot in robots],
        rows,
        "o",
        ms=5,
        color=INK,
        label="published",
    )
    names = [robot.robot + ("" if robot.links_published else " *") for robot in robots]
    _name(axes, names, "A   Speeds; beside: limit over published speed, and what binds")
    axes.legend(loc="lower right", fontsize=8.5)


def _draw_variants(axes: Axes, study: ScalingStudy) -> None:
    variants = study.variants
    rows = range(len(variants) - 1, -1, -1)
    limits = [one.limit.speed for one in variants]
    axes.barh(
        rows,
        limits,
        height=0.62,
        color=[LIMIT if one.variant == BP2 else QUIET for one in variants],
        alpha=0.75,
    )
    for row, one in zip(rows, variants, strict=True):
        said = f"{one.limit.speed:.1f}, {one.limit.binds}"
        axes.annotate(
            said,
            (one.limit.speed, row),
            (5, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    names = [
        f"{one.variant} ({one.leg_share:.0%}, {one.leg_length:.2f} m)"
        for one in variants
    ]
    _name(axes, names, "B   BP2's limit at equal motors (legs' share of mass, length)")


def _name(axes: Axes, names: list[str], title: str) -> None:
    name_rows(axes, names[::-1])
    axes.set_title(title, x=0.0)
    axes.margins(x=0.22)
