"""What of a speed rests on the robot that was assumed: the same policy on others.

Physics and motors change; the policy, its reference motion and its controller stay as
they are.
"""

import dataclasses
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.plotting import FALL, FRONT, INK, WIDTH, legend_above, styled
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
)
from bp2_rl.evaluation.benchmarks.run import (
    TRACK,
    SprintMetrics,
    describe_race,
    ramp_to_sprint,
    ramp_to_topspeed,
    sprint_metrics,
)
from bp2_rl.learning.policy import Policy
from bp2_rl.robot.hardware import HardwareSpec, times
from bp2_rl.simulation.metrics import RunMetrics
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import Trajectory

SENSITIVITY_HOLD = 5.0  # s
AS_ASSUMED, WEAKER = "as assumed", "peak torque 100 Nm"
# of the fastest time over 100 m: those beyond are drawn at the picture's edge
SLOW = 1.2
FULL: dict[str, Any] = {"ms": 7, "color": FRONT}
HOLLOW: dict[str, Any] = FULL | {"mfc": "white", "mew": 1.4}
TILES = (
    "Without a fall",
    "Lowest best speed",
    "Highest best speed",
    "Fastest 100 m",
    "Slowest 100 m",
)


def robots_of(assumed: HardwareSpec) -> dict[str, HardwareSpec]:
    """The robot that the policy is for, and others, each with one property changed."""

    changed, is_bp2 = assumed.changed, assumed.is_bp2
    other_legs = "legs that pass through" if assumed.solid_legs else "solid legs"

    def stops(factor: float) -> HardwareSpec:
        compression, rebound = (
            factor * assumed.spring_stop_stiffness,
            factor * assumed.rebound_stiffness,
        )
        return changed(spring_stop_stiffness=compression, rebound_stiffness=rebound)

    springs = {
        "spring stops x 2": stops(2.0),
        "spring stops x 10": stops(10.0),
        "rebound undamped": changed(rebound_damping=0.0),
        "spring damping x 2": changed(spring_damping=2.0 * assumed.spring_damping),
        "spring travel -10 mm": changed(spring_travel=assumed.spring_travel - 0.010),
    }
    others = {
        "friction 0.6": changed(friction=0.6),
        "friction 0.8": changed(friction=0.8),
        "friction 1.1": changed(friction=1.1),
        "ground's contact 2 ms": changed(contact_time=0.002),
        "ground's contact 5 ms": changed(contact_time=0.005),
        "ground that bounces": changed(contact_damping=0.5),
        **(springs if assumed.anatomy.sprung else {}),
        "joint stops 20 ms": changed(joint_stop_time=0.020),
        "joint stops 5 ms": changed(joint_stop_time=0.005),
        **({"no braking at 30 rad/s": changed(braking_speed=30.0)} if is_bp2 else {}),
        "braking as driving": changed(braking_speed=assumed.no_load_speed),
        "rotor inertia x 0.5": changed(rotor_inertia=times(0.5, assumed.rotor_inertia)),
        "rotor inertia x 2": changed(rotor_inertia=times(2.0, assumed.rotor_inertia)),
        WEAKER if is_bp2 else "peak torque -20 %": changed(
            peak_torque=100.0 if is_bp2 else times(0.8, assumed.peak_torque)
        ),
        "mass -10 %": changed(mass_scale=0.9 * assumed.mass_scale),
        "mass +10 %": changed(mass_scale=1.1 * assumed.mass_scale),
        other_legs: changed(solid_legs=not assumed.solid_legs),
    }
    if assumed.is_bp2:
        others |= {
            "hind track -20 mm": changed(hind_track=assumed.bp2.hind_track - 0.020),
            "hind track +20 mm": changed(hind_track=assumed.bp2.hind_track + 0.020),
            "fore track +10 mm": changed(fore_track=assumed.bp2.fore_track + 0.010),
        }
    return {AS_ASSUMED: assumed} | {
        name: robot for name, robot in others.items() if robot != assumed
    }


@dataclasses.dataclass(frozen=True)
class RobotMetrics:
    """One robot: held at its top speed, and raced."""

    name: str
    best_speed: float | None  # m/s, best 1-s mean; None for a run shorter than 1 s
    mean_speed: float | None  # m/s, while held; None if it fell
    fell_at: float | None  # s, while ramping up to top speed or holding it
    stop_hits: int  # times that a spring came onto its stop meanwhile
    # s, for which a leg was at or in another or the trunk meanwhile
    leg_contact_time: float
    leg_depth: float  # m, greatest
    time_100m: float | None  # s; None if it did not arrive
    fell_in_sprint_at: float | None  # s
    lane_kept: bool  # in the sprint, to its end

    @property
    def upright(self) -> bool:
        """Whether it fell in neither run."""
        return self.fell_at is None and self.fell_in_sprint_at is None


@dataclasses.dataclass(frozen=True)
class SensitivityMetrics:
    """All robots, the assumed one first; ranges are over those that did not fall, None
    if all did."""

    commanded_speed: float  # m/s
    upright: int  # robots that fell in neither run
    best_speeds: tuple[float, float] | None  # m/s, least and greatest
    times_100m: tuple[float, float] | None  # s, least and greatest
    robots: tuple[RobotMetrics, ...]


def sensitivity(policy: Policy, ramp: Ramp, setup: Setup) -> Evaluation:
    """Run top speed and sprint on every robot and compare."""
    sprint, robot = ramp_to_sprint(policy, setup), robot_of(policy, setup)
    robots = robots_of(robot)
    held = [
        RunRequest(ramp, other, setup.operator, name=name)
        for name, other in robots.items()
    ]
    raced = [dataclasses.replace(one, schedule=sprint, finish=TRACK) for one in held]
    ran: list[Any] = simulate_all(measure_try, policy, [*held, *raced])
    pairs = zip(robots, ran[: len(robots)], ran[len(robots) :], strict=True)
    metrics = compare(
        ramp.target[0], [measure_robot(name, *pair) for name, *pair in pairs]
    )
    said = conditions(
        policy, describe_ramp(ramp), describe_simulator("mujoco", robot), setup
    )
    return Evaluation(
        benchmark="sensitivity",
        subject=describe_subject(policy, setup),
        backend="C MuJoCo",
        conditions=said | {"sprint": describe_race(sprint), "robots": ROBOTS},
        verdict=verdict(metrics),
        good=metrics.upright == len(metrics.robots),
        rows=sensitivity_rows(metrics),
        tiles=TILES,
        pictures=(Picture("sensitivity", CAPTION, sensitivity_figure(metrics)),),
        metrics=metrics,
        results=sensitivity_results(metrics),
        tables=(robot_table(metrics),),
    )


def measure_try(one: RunRequest, run: Trajectory) -> RunMetrics | SprintMetrics:
    """What a robot did at its top speed, or in the race."""
    if one.finish == TRACK:
        assert isinstance(one.schedule, Ramp)
        return sprint_metrics(run, one.schedule.acceleration)
    return run.metrics


def ramp_to_sensitivity(policy: Policy, setup: Setup) -> Ramp:
    """The schedule of the runs at top speed; that of the sprints is looked at, too,
    before any robot runs."""
    ramp_to_sprint(policy, setup)
    return ramp_to_topspeed(policy, setup, hold=SENSITIVITY_HOLD)


# --- What is measured -----------------------------------------------------------------


def measure_robot(name: str, held: RunMetrics, raced: SprintMetrics) -> RobotMetrics:
    """What is compared, of both runs of one robot."""
    return RobotMetrics(
        name=name,
        best_speed=held.best_speed,
        mean_speed=held.mean_speed if held.fell_at is None else None,
        fell_at=held.fell_at,
        stop_hits=held.stop_hits,
        leg_contact_time=held.leg_contact_time,
        leg_depth=held.leg_depth,
        time_100m=raced.time,
        fell_in_sprint_at=raced.run.fell_at,
        lane_kept=raced.lane.kept and raced.time is not None,
    )


def compare(commanded_speed: float, robots: list[RobotMetrics]) -> SensitivityMetrics:
    """Count those that did not fall, and give the range of what they did."""
    upright = [robot for robot in robots if robot.upright]
    return SensitivityMetrics(
        commanded_speed=commanded_speed,
        upright=len(upright),
        best_speeds=_range([robot.best_speed for robot in upright]),
        times_100m=_range([robot.time_100m for robot in upright]),
        robots=tuple(robots),
    )


def _range(values: list[float | None]) -> tuple[float, float] | None:
    measured = [value for value in values if value is not None]
    return (min(measured), max(measured)) if measured else None


# --- What is shown --------------------------------------------------------------------


ROBOTS = (
    "as named, one property changed in each; policy, reference motion and controller are those of the assumed robot; "
    "the motors' corner and no-load speeds stay, so that less torque is less power, too; one run each: an unlucky "
    "landing can cost a stride or not, by chance"
)
CAPTION = (
    "The same policy on robots other than the one assumed: speed under the top-speed command, and time over 100 m; "
    "crosses: fallen, or not arrived; arrowheads: farther off; lines: the robot as assumed."
)


def verdict(metrics: SensitivityMetrics) -> str:
    """The comparison in one sentence."""
    count = f"{metrics.upright} of {len(metrics.robots)} robots did not fall"
    if metrics.best_speeds is None:
        return f"{count}."
    (slow, fast), times = metrics.best_speeds, metrics.times_100m
    raced = f", {TRACK:g} m in {times[0]:.2f} to {times[1]:.2f} s" if times else ""
    return f"{count}: {slow:.2f} to {fast:.2f} m/s{raced}."


def sensitivity_rows(metrics: SensitivityMetrics) -> tuple[Row, ...]:
    """The figures of merit for a reader, each with what it means."""
    (slow, fast), (least, most) = (
        metrics.best_speeds or (None, None),
        metrics.times_100m or (None, None),
    )
    return (
        Row(
            "Without a fall",
            f"{metrics.upright} of {len(metrics.robots)}",
            "in both runs",
        ),
        Row(
            "Lowest best speed",
            show(slow, ".2f", "m/s"),
            "best 1-s mean, of the upright",
        ),
        Row(
            "Highest best speed",
            show(fast, ".2f", "m/s"),
            "best 1-s mean, of the upright",
        ),
        Row("Fastest 100 m", show(least, ".2f", "s"), "of the upright"),
        Row("Slowest 100 m", show(most, ".2f", "s"), "of the upright"),
        Row(
            "Lane kept",
            f"{sum(r.lane_kept for r in metrics.robots)} of {len(metrics.robots)}",
            "to the sprint's end",
        ),
        *(
            Row(
                r.name[0].upper() + r.name[1:],
                show(r.best_speed, ".2f", "m/s"),
                _in_words(r),
            )
            for r in metrics.robots
        ),
    )


def _in_words(robot: RobotMetrics) -> str:
    """The sprint, and the fall at top speed."""
    fell = f"fell at {robot.fell_at:.2f} s; " if robot.fell_at is not None else ""
    if robot.time_100m is None:
        return f"{fell}100 m: {_fall(robot.fell_in_sprint_at, none='not reached')}"
    return f"{fell}100 m in {robot.time_100m:.2f} s{'' if robot.lane_kept else ', left its lane'}"


def _fall(fell_at: float | None, none: str = "none") -> str:
    return none if fell_at is None else f"fell at {fell_at:.2f} s"


def robot_table(metrics: SensitivityMetrics) -> Table:
    """Every robot."""
    head = (
        *(
            "Robot",
            "Best speed [m/s]",
            "Mean held [m/s]",
            "Fall",
            "Stop hits",
            "Legs touch [ms]",
            "Depth [mm]",
        ),
        *("100 m [s]", "Fall", "Lane kept"),
    )
    return Table(
        "Robots",
        head,
        [
            (
                robot.name,
                show(robot.best_speed, ".2f"),
                show(robot.mean_speed, ".2f"),
                _fall(robot.fell_at),
                f"{robot.stop_hits}",
                f"{1e3 * robot.leg_contact_time:.0f}",
                f"{1e3 * robot.leg_depth:.0f}",
                show(robot.time_100m, ".2f"),
                _fall(robot.fell_in_sprint_at),
                "yes" if robot.lane_kept else "no",
            )
            for robot in metrics.robots
        ],
    )


def sensitivity_results(metrics: SensitivityMetrics) -> dict[str, object]:
    """What a policy's card says of the comparison; a robot that fell has no speed and
    no time there."""
    return rounded(
        {
            "commanded_speed": metrics.commanded_speed,
            "robots": len(metrics.robots),
            "upright": metrics.upright,
            "best_speed_range": metrics.best_speeds,
            "time_100m_range": metrics.times_100m,
            "lanes_kept": sum(robot.lane_kept for robot in metrics.robots),
            "best_speeds": {
                r.name: None if r.fell_at is not None else r.best_speed
                for r in metrics.robots
            },
            "times_100m": {r.name: r.time_100m for r in metrics.robots},
        }
    )


@styled
def sensitivity_figure(metrics: SensitivityMetrics) -> Figure:
    """Speeds and times of all robots, one below the other."""
    figure = Figure(
        figsize=(WIDTH, 1.1 + 0.3 * len(metrics.robots)), layout="constrained"
    )
    speed, time = figure.subplots(1, 2, sharey=True, width_ratios=(1.2, 1))
    robots = metrics.robots
    _draw_speeds(speed, robots)
    _draw_times(time, robots)
    speed.set(
        yticks=range(len(robots)),
        yticklabels=[robot.name for robot in robots],
        ylim=(len(robots) - 0.5, -0.5),
    )
    for axes in (speed, time):
        axes.tick_params(axis="y", length=0)
        legend_above(axes)
    return figure


def _draw_speeds(axes: Axes, robots: tuple[RobotMetrics, ...]) -> None:
    for place, robot in enumerate(robots):
        if robot.fell_at is not None:
            _draw_cross(axes, place)
        elif robot.best_speed is not None and robot.mean_speed is not None:
            axes.plot(robot.best_speed, place, "o", **FULL)
            axes.plot(robot.mean_speed, place, "o", **HOLLOW)
    axes.plot([], [], "o", **FULL, label="best speed")
    axes.plot([], [], "o", **HOLLOW, label="mean held")
    _draw_line(axes, robots[0].best_speed)
    axes.set(title="Speed", xlabel="Speed [m/s]")


def _draw_times(axes: Axes, robots: tuple[RobotMetrics, ...]) -> None:
    times = [robot.time_100m for robot in robots if robot.time_100m is not None]
    edge = SLOW * min(times, default=1.0)
    for place, robot in enumerate(robots):
        look = FULL if robot.lane_kept else HOLLOW
        if robot.time_100m is None:
            _draw_cross(axes, place)
        elif robot.time_100m > edge:
            at = axes.get_yaxis_transform()
            axes.plot(0.97, place, ">", **look, transform=at)
            axes.text(
                0.93,
                place,
                f"{robot.time_100m:.1f} s",
                transform=at,
                ha="right",
                va="center",
            )
        else:
            axes.plot(robot.time_100m, place, "o", **look)
    axes.plot([], [], "o", **FULL, label="in its lane")
    axes.plot([], [], "o", **HOLLOW, label="not")
    _draw_line(axes, robots[0].time_100m)
    axes.set(title=f"{TRACK:g} m", xlabel="Time [s]")


def _draw_cross(axes: Axes, place: int) -> None:
    axes.plot(0.03, place, "X", ms=8, color=FALL, transform=axes.get_yaxis_transform())


def _draw_line(axes: Axes, value: float | None) -> None:
    """Where the robot as assumed is."""
    if value is not None:
        axes.axvline(value, color=INK, linewidth=1.0, zorder=0.9)
    axes.margins(x=0.12)
