"""Pictures of trajectories: the paper's Figs. robot_model_analysis and hardware_opt, and a family over speed.

Drawn off screen, in the style of `plotting`. Left is blue and right is vermilion, fore legs are dotted and
hind legs solid; the terms of the equations of motion keep their colours (Okabe-Ito's, and Tol's indigo and wine).
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MultipleLocator

from bp2_rl.errors import UserError
from bp2_rl.plotting import FAINT, INK, QUIET, WIDTH, styled
from bp2_rl.robot import specs
from bp2_rl.robot.actuator import Actuator, torque_limits
from bp2_rl.trajopt.cycle import (
    Cycle,
    center_of_mass_velocity,
    cost_of_transport,
    leg_points,
    robot_mass,
    whole_cycle,
)
from bp2_rl.trajopt.decomposition import BALANCE, KINDS, TERMS, Decomposition, Trends, comparable
from bp2_rl.trajopt.problem import PER_LEG, TRUNK
from bp2_rl.trajopt.solution import Solution, resample

LEFT, RIGHT, ARROW = "#0072B2", "#D55E00", "#D55E00"
TERM_COLORS = dict(
    zip(
        TERMS,
        ("#0072B2", "#D55E00", "#56B4E9", "#332288", "#009E73", "#E69F00", "#882255", "#CC79A7"),
        strict=True,
    )
)
KIND_TITLES = {"x": "Horizontal", "z": "Vertical", "hip": "Hip", "knee": "Knee"}
FRAMES = 8  # stick figures in a cycle
SPACE = 1.2  # m, least distance from one to the next
FINE = 64  # intervals of each segment that curves are drawn with


@styled
def decomposition_figure(decomposition: Decomposition, trends: Trends, leg: str | None = None) -> Figure:
    """Who balances whom, at one speed and over speed (paper, Fig. robot_model_analysis, A to L).

    A to C stack the terms with the sign that makes them add up to zero: what stands above the line balances what
    hangs below. D is the motion, E to H the average forces and I to L their shares over speed.

    Args:
        decomposition: at the speed of panels A to D.
        trends: over speed, for panels E to L.
        leg: whose hip and knee panels B and C show; the hind leg that stands first if none is given.

    Raises:
        UserError: the robot has no such leg.
    """
    cycle = decomposition.cycle
    leg = leg or _shown_leg(cycle)
    if leg not in decomposition.legs:
        raise UserError(f"leg must be one of {', '.join(decomposition.legs)}, got {leg!r}")
    figure = Figure(figsize=(WIDTH, 10.4), layout="constrained")
    top, middle, bottom = _rows(figure, 3.0, 1.45, 4.9)
    profiles, motion = top.subplots(1, 3), middle.subplots()
    means, shares = bottom.subplots(2, len(KINDS), sharex=True)

    for axes, coordinate in zip(profiles, ("z", f"{leg} hip", f"{leg} knee"), strict=True):
        feet = (leg,) if coordinate.startswith(leg) else cycle.problem.stride.legs
        _shade_stance(axes, cycle, feet)
        _stack(axes, decomposition, coordinate)
        kind = coordinate.split()[-1]
        name = f"{KIND_TITLES[kind]}, {leg}" if kind in ("hip", "knee") else KIND_TITLES[kind]
        axes.set(title=name, ylabel=f"{_quantity(kind)} [{_unit(kind)}]", xlabel="Time / period", xlim=(0.0, 1.0))
    _stick_figures(motion, cycle)
    for k, (mean, share) in enumerate(zip(means, shares, strict=True)):
        _mean_panel(mean, trends, k)
        _share_panel(share, trends, k)
    means[0].set_ylabel("Mean magnitude")
    shares[0].set_ylabel("Share of the sum of means")
    top.suptitle(
        "A to C: main + coupled + centrifugal + Coriolis + gravity - active - ground reaction = 0, "
        "so the stacks above and below the line balance",
        fontsize=8.5,
        color=QUIET,
    )
    _letter([*profiles, motion, *means, *shares])
    shown = np.max(trends.share, axis=(0, 2)) > 0.0
    handles = [Patch(color=TERM_COLORS[term], label=term) for term in np.array(TERMS)[shown]]
    handles.append(Patch(color=FAINT, label="stance"))
    sides = [Line2D([], [], color=color, label=side) for side, color in (("left", LEFT), ("right", RIGHT))]
    if "FL" in cycle.problem.stride.legs:
        motion.legend(handles=sides, loc="upper left", ncols=2, handlelength=1.2, borderpad=0.0)
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), handlelength=0.8, columnspacing=0.8)
    return figure


@styled
def trajectory_figure(solution: Solution) -> Figure:
    """One gait cycle: motion, velocities, ground reaction forces and torques (paper, Fig. hardware_opt, A to I).

    The dashed limits of a torque are those of the left hind leg's motor at its joint's speed.
    """
    cycle = whole_cycle(_finely(solution))
    problem, motion, legs = cycle.problem, cycle.motion, cycle.problem.stride.legs
    share = cycle.time / cycle.period
    figure = Figure(figsize=(WIDTH, 10.4), layout="constrained")
    top, rest = _rows(figure, 1.35, 8.0)
    sticks, panels = top.subplots(), rest.subplots(4, 2, sharex=True).ravel().tolist()
    for axes in panels:
        _shade_stance(axes, cycle, legs)
    _stick_figures(sticks, cycle)

    body = center_of_mass_velocity(motion.q, motion.v, legs, problem.hardware)
    _along(panels[0], share, body[..., 0], color=INK)
    _along(panels[1], share, body[..., 1], color=INK)
    motors = Actuator.from_hardware(problem.hardware)
    limited = legs[-1]
    stands = {name: np.array([[name in feet] for feet in cycle.standing]) for name in legs}
    for leg, name in enumerate(legs):
        block = TRUNK + PER_LEG * leg
        for joint in (0, 1):
            _along(panels[2 + joint], share, motion.v[..., block + joint], **_leg_style(name))
            if name == limited:
                for limit in torque_limits(motors, motion.v[..., block + joint]):
                    _along(panels[6 + joint], share, limit, color=QUIET, linewidth=1.1, linestyle=(0, (4, 2)))
            _along(panels[6 + joint], share, motion.tau[..., 2 * leg + joint], **_leg_style(name))
            force = motion.force[..., 2 * leg + joint]
            _along(panels[4 + joint], share, np.where(stands[name], force, np.nan), **_leg_style(name))
    titles = (
        ("Horizontal velocity of the CoM", "[m/s]"),
        ("Vertical velocity of the CoM", "[m/s]"),
        ("Hip velocity", "[rad/s]"),
        ("Knee velocity", "[rad/s]"),
        ("Horizontal ground reaction", "[N]"),
        ("Vertical ground reaction", "[N]"),
        ("Hip torque", "[Nm]"),
        ("Knee torque", "[Nm]"),
    )
    for axes, (title, unit) in zip(panels, titles, strict=True):
        axes.set(title=title, ylabel=unit, xlim=(0.0, 1.0))
        axes.margins(y=0.08)
    for axes in panels[-2:]:
        axes.set_xlabel("Time / period")
    _letter([sticks, *panels])
    handles = [Line2D([], [], label=name, **_leg_style(name)) for name in legs]
    handles.append(Line2D([], [], label=f"limit, {limited}", color=QUIET, linestyle=(0, (4, 2))))
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles), handlelength=2.2)
    return figure


@dataclasses.dataclass(frozen=True)
class _Figures:
    """What a solution is, in numbers."""

    period: float  # s
    duty: float
    force: float  # N, peak vertical ground reaction of a foot
    torque: tuple[float, float]  # Nm, peak at a hip and at a knee
    compression: float  # m, peak
    transport: float
    height: tuple[float, float]  # m, least and greatest
    pitch: tuple[float, float]  # rad, likewise


@styled
def family_figure(solutions: Sequence[Solution]) -> Figure:
    """What changes with speed in a family of motions: times, loads, effort and the trunk's posture.

    Raises:
        UserError: there are no solutions, or they differ in gait or hardware.
    """
    solutions = comparable(solutions)
    problem = solutions[0].problem
    speeds = [solution.problem.speed for solution in solutions]
    rows = [_in_numbers(solution) for solution in solutions]
    figure = Figure(figsize=(WIDTH, 8.6), layout="constrained")
    panels = figure.subplots(4, 2, sharex=True).ravel().tolist()

    def line(axes: Axes, values: Sequence[float] | np.ndarray, **style: Any) -> None:
        axes.plot(speeds, values, "o-", ms=3.5, **{"color": LEFT, **style})

    line(panels[0], [1e3 * row.period for row in rows])
    line(panels[1], [row.duty for row in rows])
    line(panels[2], [row.force for row in rows])
    for joint, (name, color) in enumerate((("hip", LEFT), ("knee", RIGHT))):
        line(panels[3], [row.torque[joint] for row in rows], label=name, color=color)
    line(panels[4], [1e3 * row.compression for row in rows])
    line(panels[5], [row.transport for row in rows])
    for axes, extent in (
        (panels[6], np.array([row.height for row in rows])),
        (panels[7], np.rad2deg(np.array([row.pitch for row in rows]))),
    ):
        low, high = extent.T
        axes.fill_between(speeds, low, high, color=LEFT, alpha=0.2, linewidth=0)
        line(axes, low)
        line(axes, high)
    _mark_level(panels[2], robot_mass(problem) * specs.GRAVITY, "body weight")
    _mark_level(panels[3], problem.hardware.joint_peak_torque, "motor's peak")
    _mark_level(panels[4], 1e3 * problem.hardware.spring_travel, "stop")
    panels[3].legend(loc="lower right", ncols=2)
    titles = (
        ("Period", "[ms]"),
        ("Duty factor", "share of the period"),
        ("Peak vertical force of a foot", "[N]"),
        ("Peak torque", "[Nm]"),
        ("Peak spring compression", "[mm]"),
        ("Cost of transport, mechanical", "work / (m g distance)"),
        ("Range of the trunk height", "[m]"),
        ("Range of the pitch, nose down", "[deg]"),
    )
    for axes, (title, unit) in zip(panels, titles, strict=True):
        axes.set(title=title, ylabel=unit)
    for axes in panels[:6]:
        axes.set_ylim(bottom=0.0)
    for axes in panels[-2:]:
        axes.set_xlabel("Speed [m/s]")
    _letter(panels)
    return figure


def _rows(figure: Figure, *heights: float) -> list[SubFigure]:
    """Subfigures one above the other."""
    return list(np.asarray(figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)).ravel())


def _in_numbers(solution: Solution) -> _Figures:
    motion = _finely(solution).motion
    legs = len(solution.problem.stride.legs)
    joints = motion.q[..., TRUNK:].reshape(*motion.q.shape[:2], legs, PER_LEG)
    torque = np.max(np.abs(motion.tau), axis=(0, 1)).reshape(legs, 2).max(axis=0)
    height, pitch = motion.q[..., 1], motion.q[..., 2]
    return _Figures(
        period=solution.period,
        duty=solution.duty,
        force=float(np.max(motion.force[..., 1::2])),
        torque=(float(torque[0]), float(torque[1])),
        compression=float(np.max(joints[..., 2])),
        transport=cost_of_transport(solution),
        height=(float(np.min(height)), float(np.max(height))),
        pitch=(float(np.min(pitch)), float(np.max(pitch))),
    )


def _finely(solution: Solution) -> Solution:
    """The solution as its scheme's polynomials go on between the points of its mesh."""
    problem = solution.problem.on_mesh(FINE)
    return dataclasses.replace(solution, problem=problem, motion=resample(solution.problem, solution.motion, problem))


def _shown_leg(cycle: Cycle) -> str:
    """The hind leg that stands first."""
    return next(leg for feet in cycle.standing for leg in feet if not leg.startswith("F"))


def _leg_style(leg: str) -> dict[str, Any]:
    """Colour by side and dashes by end; a leg without sides is its end's."""
    right = leg.endswith("R") if len(leg) > 1 else not leg.startswith("F")
    dots = {"linestyle": (0, (1.2, 1.2))} if leg.startswith("F") and len(leg) > 1 else {}
    return {"color": RIGHT if right else LEFT, **dots}


def _along(axes: Axes, share: np.ndarray, values: np.ndarray, **style: Any) -> None:
    """A curve over the cycle, (segments, points), that may jump from one segment to the next."""
    axes.plot(share.ravel(), values.ravel(), **style)


def _shade_stance(axes: Axes, cycle: Cycle, feet: Sequence[str]) -> None:
    """Grey where any of these feet stands."""
    edges = np.append(cycle.starts, cycle.period) / cycle.period
    for standing, start, end in zip(cycle.standing, edges, edges[1:], strict=False):
        if set(standing) & set(feet):
            axes.axvspan(start, end, color=FAINT, alpha=0.8, linewidth=0)


def _stack(axes: Axes, decomposition: Decomposition, coordinate: str) -> None:
    """The terms of one coordinate, positive ones stacked upwards and negative ones downwards."""
    cycle = decomposition.cycle
    fine = np.linspace(0.0, 1.0, 12 * len(cycle.problem.points) + 1)
    share = ((cycle.starts[:, None] + cycle.motion.durations[:, None] * fine) / cycle.period).ravel()
    tops = np.zeros((2, share.size))
    for term, sign in zip(TERMS, BALANCE, strict=True):
        knots = sign * decomposition.along(term, coordinate).reshape(cycle.time.shape)
        values = np.concatenate([np.interp(fine, cycle.problem.points, segment) for segment in knots])
        if not np.any(values):
            continue
        for side, part in enumerate((np.maximum(values, 0.0), np.minimum(values, 0.0))):
            axes.fill_between(share, tops[side], tops[side] + part, color=TERM_COLORS[term], linewidth=0)
            tops[side] += part
    axes.axhline(0.0, color=INK, linewidth=0.8)


def _stick_figures(axes: Axes, cycle: Cycle) -> None:
    """The robot at equal intervals of the cycle, moved apart where it would stand in its own way."""
    problem, motion, legs = cycle.problem, cycle.motion, cycle.problem.stride.legs
    step = problem.speed * cycle.period / FRAMES
    space = max(step, SPACE)
    q = motion.q.reshape(-1, motion.q.shape[-1])
    for frame in range(FRAMES):
        t = frame * cycle.period / FRAMES
        pose = np.array([np.interp(t, cycle.time.ravel(), coordinate) for coordinate in q.T])
        pose[0] += frame * space - problem.speed * t
        points = leg_points(pose, legs, problem.hardware)
        for leg in sorted(range(len(legs)), key=lambda leg: legs[leg][-1] != "R"):
            color = _leg_style(legs[leg])["color"]
            axes.plot(*points[leg].T, color=color, linewidth=1.6, solid_joinstyle="round", clip_on=False)
            axes.plot(*points[leg, 2], "o", color=color, ms=2.4, clip_on=False)
        hips = points[:, 0]
        axes.plot(*hips[np.argsort(hips[:, 0])].T, color=INK, linewidth=3.0)
        axes.annotate(
            f"{frame}/{FRAMES}", (pose[0], 0.0), (0, -4), textcoords="offset points", ha="center", va="top", fontsize=8
        )
    axes.axhline(0.0, color=QUIET, linewidth=0.8)
    arrow = {"arrowstyle": "-|>", "color": ARROW, "linewidth": 2.0}
    end = (FRAMES - 1) * space
    axes.annotate("", (end / 2 + 0.6, 0.92), (end / 2 - 0.6, 0.92), arrowprops=arrow)
    moved = f"frames moved {space - step:.2f} m apart; " if space > step else ""
    axes.set_title(f"Motion at {problem.speed:g} m/s")
    axes.annotate(
        f"{moved}below: time / period", (1.0, 1.0), xycoords="axes fraction", ha="right", va="bottom", color=QUIET
    )
    axes.set(xlim=(-0.7, end + 0.7), ylim=(-0.16, 1.0))
    axes.set_aspect("equal", anchor="W")
    axes.set_axis_off()


def _mean_panel(axes: Axes, trends: Trends, kind: int) -> None:
    """Average forces of one kind over speed."""
    for i, term in enumerate(TERMS):
        if np.any(trends.average[:, i, kind]):
            dashes = (0, (2.0, 1.0)) if term == "ground reaction" else "-"  # lets the gravity below show through
            style = {"linestyle": dashes, "marker": "o", "ms": 2.5, "color": TERM_COLORS[term], "clip_on": False}
            axes.plot(trends.speeds, trends.average[:, i, kind], **style)
    name = KINDS[kind]
    axes.set(title=f"{KIND_TITLES[name]} [{_unit(name)}]")
    axes.set_ylim(bottom=0.0)
    axes.xaxis.set_major_locator(MultipleLocator(5.0))


def _share_panel(axes: Axes, trends: Trends, kind: int) -> None:
    """Shares of one kind over speed, stacked to one."""
    axes.stackplot(trends.speeds, trends.share[:, :, kind].T, colors=list(TERM_COLORS.values()), linewidth=0)
    axes.set(title=KIND_TITLES[KINDS[kind]], xlabel="Speed [m/s]", ylim=(0.0, 1.0))
    axes.set_xlim(trends.speeds[0], trends.speeds[-1])
    axes.tick_params(labelleft=kind == 0)
    axes.xaxis.set_major_locator(MultipleLocator(5.0))


def _quantity(kind: str) -> str:
    return "Force" if kind in ("x", "z") else "Torque"


def _unit(kind: str) -> str:
    return "N" if kind in ("x", "z") else "Nm"


def _mark_level(axes: Axes, level: float, text: str) -> None:
    """A dashed line across, with its name, and room above it."""
    axes.axhline(level, color=QUIET, linewidth=0.9, linestyle=(0, (4, 2)))
    axes.set_ylim(top=max(axes.get_ylim()[1], 1.15 * level))
    box = {"boxstyle": "square,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
    at = (0.02, level)
    axes.annotate(text, at, xycoords=("axes fraction", "data"), ha="left", va="center", color=QUIET, bbox=box)


def _letter(panels: Sequence[Axes]) -> None:
    """A, B, C and so on before the panels' titles."""
    for letter, axes in zip("ABCDEFGHIJKL", panels, strict=False):
        axes.set_title(f"{letter}   {axes.get_title(loc='left')}")
