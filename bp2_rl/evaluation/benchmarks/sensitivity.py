"""The sensitivity benchmark: one policy on robots that differ in one property from the
assumed robot.

Physics and motors change; the policy, its reference motion and its controller stay as
they are.
"""

import dataclasses
from collections.abc import Sequence

from bp2_rl.base.bounds import Range
from bp2_rl.base.metric import (
    NOT_MEASURED,
    Row,
    card_of,
    metric,
    rounded,
    rows_of,
    show,
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
    describe_race,
    ramp_to_sprint,
    ramp_to_topspeed,
)
from bp2_rl.evaluation.benchmarks.variants import (
    Dots,
    Panel,
    VariantRun,
    measure_variant,
    variants_figure,
)
from bp2_rl.evaluation.races import TRACK
from bp2_rl.learning.policy import Policy
from bp2_rl.robot.hardware import HardwareSpec, times
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.schedule import Ramp

SENSITIVITY_HOLD = 5.0  # s
COMMANDS = 1.0, 0.9, 0.8
"""Commands given to each robot, as shares of the commanded speed: a weak robot may run
faster under a slower command."""
AS_ASSUMED = "as assumed"
# of the fastest time over 100 m: those beyond are drawn at the picture's edge
SLOW = 1.2
ROBOTS_IN_WORDS = (
    "as named, one property changed in each; policy, reference motion and controller are those of the assumed robot; "
    "the motors' corner and no-load speeds stay unless named, so that less torque is less power, too; "
    f"each runs at {', '.join(f'{share:.0%}' for share in COMMANDS)} of the commanded speed, and is shown at its best; "
    "one run each: an unlucky landing can cost a stride or not, by chance"
)


def robots_of(assumed: HardwareSpec) -> dict[str, HardwareSpec]:
    """Return the assumed robot and variants with one property changed, by name."""
    stop = assumed.spring_stop_stiffness
    rebound = assumed.rebound_stiffness
    springs: dict[str, dict[str, object]] = {
        "spring stops x 2": {
            "spring_stop_stiffness": 2.0 * stop,
            "rebound_stiffness": 2.0 * rebound,
        },
        "spring stops x 10": {
            "spring_stop_stiffness": 10.0 * stop,
            "rebound_stiffness": 10.0 * rebound,
        },
        "rebound undamped": {"rebound_damping": 0.0},
        "spring damping x 2": {"spring_damping": 2.0 * assumed.spring_damping},
        "spring travel -10 mm": {"spring_travel": assumed.spring_travel - 0.01},
    }
    changes: dict[str, dict[str, object]] = {
        "friction 0.6": {"friction": 0.6},
        "friction 0.8": {"friction": 0.8},
        "friction 1.1": {"friction": 1.1},
        "ground's contact 2 ms": {"contact_time": 0.002},
        "ground's contact 5 ms": {"contact_time": 0.005},
        "ground that bounces": {"contact_damping": 0.5},
        **(springs if assumed.anatomy.sprung else {}),
        "joint stops 20 ms": {"joint_stop_time": 0.02},
        "joint stops 5 ms": {"joint_stop_time": 0.005},
        "braking as driving": {"braking_speed": assumed.no_load_speed},
        "rotor inertia x 0.5": {"rotor_inertia": times(0.5, assumed.rotor_inertia)},
        "rotor inertia x 2": {"rotor_inertia": times(2.0, assumed.rotor_inertia)},
        "no-load speed -10 %": {"no_load_speed": times(0.9, assumed.no_load_speed)},
        "no-load speed -20 %": {"no_load_speed": times(0.8, assumed.no_load_speed)},
        "mass -10 %": {"mass_scale": 0.9 * assumed.mass_scale},
        "mass +10 %": {"mass_scale": 1.1 * assumed.mass_scale},
        "legs that pass through" if assumed.solid_legs else "solid legs": {
            "solid_legs": not assumed.solid_legs
        },
        "no air": {"drag_area": 0.0},
    }
    if assumed.is_bp2:
        changes |= {
            "spring damping 30 N s/m": {"spring_damping": 30.0},
            "spring damping 50 N s/m": {"spring_damping": 50.0},
            "spring damping 100 N s/m": {"spring_damping": 100.0},
            "no braking at 30 rad/s": {"braking_speed": 30.0},
            "peak torque 100 Nm": {"peak_torque": 100.0},
            "bus sag 2.5 %/kW": {"bus_sag": 0.025},
            "bus sag 5 %/kW": {"bus_sag": 0.05},
            "bus 6 kW": {"bus_power_out": 6000.0},
            "bus 5 kW": {"bus_power_out": 5000.0},
            "charging 1 kW": {"bus_power_in": 1000.0},
            "drag area 0.3 m²": {"drag_area": 0.3},
            "drag area 0.4 m²": {"drag_area": 0.4},
            "hind track -20 mm": {"hind_track": assumed.bp2.hind_track - 0.02},
            "hind track +20 mm": {"hind_track": assumed.bp2.hind_track + 0.02},
            "fore track +10 mm": {"fore_track": assumed.bp2.fore_track + 0.01},
        }
    else:
        changes["peak torque -20 %"] = {"peak_torque": times(0.8, assumed.peak_torque)}
    robots = {name: assumed.changed(**change) for name, change in changes.items()}
    return {AS_ASSUMED: assumed} | {
        name: robot for name, robot in robots.items() if robot != assumed
    }


@dataclasses.dataclass(frozen=True)
class RobotMetrics:
    """The runs of a robot: at the command under which it ran fastest, and over 100
    m."""

    name: str = metric("Robot", form="s")
    told: float = metric("Command", "m/s")
    # best 1-s mean; None for a run shorter than 1 s
    best_speed: float | None = metric("Best speed", "m/s")
    # while held; None if it fell
    mean_speed: float | None = metric("Mean held", "m/s")
    # while ramping up to top speed or holding it
    fell_at: float | None = metric("Fall", form=show_fall)
    # times that a spring came onto its stop meanwhile
    stop_hits: int = metric("Stop hits", form="d")
    # for which a leg was at or in another or the trunk meanwhile
    leg_contact_time: float = metric("Legs touch", "ms", ".0f")
    leg_depth: float = metric("Depth", "mm", ".0f")
    # None if it did not arrive
    time_100m: float | None = metric("100 m", "s")
    fell_in_sprint_at: float | None = metric("Fall in the sprint", form=show_fall)
    # in the sprint, to its end
    lane_kept: bool = metric("Lane kept")

    @property
    def upright(self) -> bool:
        """Return whether the robot stayed upright, both at top speed and in the
        sprint."""
        return self.fell_at is None and self.fell_in_sprint_at is None


@dataclasses.dataclass(frozen=True, kw_only=True)
class SensitivityMetrics:
    """The runs of all robots, the assumed one first; ranges cover the robots that did
    not fall."""

    commanded_speed: float = metric("Commanded", "m/s", card=True, shown=False)
    upright: int = metric(
        "Without a fall",
        form="d",
        meaning=lambda m: f"of {len(m.robots)} robots, in both runs",
        card=True,
    )
    best_speeds: Range | None = metric(
        "Best speeds",
        form=lambda speeds: _show_range(speeds, "m/s"),
        meaning="best 1-s means of the upright",
        card="best_speed_range",
    )
    times_100m: Range | None = metric(
        f"{TRACK:g} m",
        form=lambda times: _show_range(times, "s"),
        meaning="of the upright",
        card="time_100m_range",
    )
    lanes_kept: int = metric(
        "Lane kept", form="d", meaning="robots, to the sprint's end", card=True
    )
    robots: tuple[RobotMetrics, ...]


def _show_range(values: Range | None, unit: str) -> str:
    """Return a range as text; a dash for None."""
    return "{:.2f} to {:.2f} {}".format(*values, unit) if values else NOT_MEASURED


def sensitivity(policy: Policy, ramp: Ramp, setup: BenchmarkOptions) -> Evaluation:
    """Run every variant of the robot at several commands and over 100 m; return the
    results as an evaluation."""
    race = ramp_to_sprint(policy, setup)
    robots = robots_of(robot_of(policy, setup))
    commands = [share * ramp.target[0] for share in COMMANDS]
    requests = [
        RunRequest(
            dataclasses.replace(ramp, to=speed), other, setup.operator, name=name
        )
        for name, other in robots.items()
        for speed in commands
    ]
    requests += [
        RunRequest(race, other, setup.operator, finish=TRACK, name=name)
        for name, other in robots.items()
    ]
    ran = simulate_all(measure_variant, policy, requests)
    held, raced = ran[: -len(robots)], ran[-len(robots) :]
    count = len(COMMANDS)
    metrics = compare_robots(
        [
            robot_metrics(name, commands, held[count * i : count * (i + 1)], raced[i])
            for i, name in enumerate(robots)
        ],
        ramp.target[0],
    )
    run_conditions = conditions(policy, setup, describe_ramp(ramp))
    best_speeds = {
        r.name: None if r.fell_at is not None else r.best_speed for r in metrics.robots
    }
    times_100m = {r.name: r.time_100m for r in metrics.robots}
    return Evaluation(
        benchmark="sensitivity",
        subject=describe_subject(policy, setup),
        conditions=run_conditions
        | {"sprint": describe_race(race), "robots": ROBOTS_IN_WORDS},
        verdict=f"{metrics.upright} of {len(robots)} robots did not fall: "
        f"{_show_range(metrics.best_speeds, 'm/s')}, {TRACK:g} m in {_show_range(metrics.times_100m, 's')}.",
        good=metrics.upright == len(robots),
        rows=(
            *rows_of(metrics),
            *(
                Row(
                    robot.name,
                    show(robot.best_speed, ".2f", "m/s"),
                    f"at {robot.told:.1f} m/s{', fell' if robot.fell_at else ''}; "
                    f"{TRACK:g} m: {show(robot.time_100m, '.2f', 's')}",
                )
                for robot in metrics.robots
            ),
        ),
        tiles=("Without a fall", "Best speeds", f"{TRACK:g} m"),
        pictures=(sensitivity_picture(metrics.robots),),
        metrics=metrics,
        results=card_of(metrics)
        | {"robots": len(robots)}
        | rounded({"best_speeds": best_speeds, "times_100m": times_100m}),
        tables=(table_of("Robots", metrics.robots),),
    )


def ramp_to_sensitivity(policy: Policy, setup: BenchmarkOptions) -> Ramp:
    """Return the schedule of the runs at top speed.

    The schedule of the sprints is checked, too, before any robot runs.
    """
    ramp_to_sprint(policy, setup)
    return ramp_to_topspeed(policy, setup, hold=SENSITIVITY_HOLD)


def robot_metrics(
    name: str,
    commands: Sequence[float],
    held: Sequence[VariantRun],
    raced: VariantRun,
) -> RobotMetrics:
    """Return the measurements of a robot's fastest run without a fall, and of its
    sprint.

    For a robot that fell at every command, the run at the first command is returned.

    Args:
        name: of the robot.
        commands: the robot's commands, m/s.
        held: its run at each command.
        raced: its run over 100 m.
    """
    runs = list(zip(commands, (run.metrics for run in held), strict=True))
    upright = [run for run in runs if run[1].fell_at is None] or runs[:1]
    command, best = max(upright, key=lambda run: run[1].best_speed or 0.0)
    return RobotMetrics(
        name=name,
        told=command,
        best_speed=best.best_speed,
        mean_speed=best.mean_speed if best.fell_at is None else None,
        fell_at=best.fell_at,
        stop_hits=best.stop_hits,
        leg_contact_time=best.leg_contact_time,
        leg_depth=best.leg_depth,
        time_100m=raced.time_100m,
        fell_in_sprint_at=raced.metrics.fell_at,
        lane_kept=raced.lane_kept and raced.time_100m is not None,
    )


def compare_robots(
    robots: Sequence[RobotMetrics], commanded_speed: float
) -> SensitivityMetrics:
    """Count the robots that did not fall, and return the ranges of their speeds and
    100-m times."""
    upright = [robot for robot in robots if robot.upright]
    return SensitivityMetrics(
        commanded_speed=commanded_speed,
        upright=len(upright),
        best_speeds=_range([robot.best_speed for robot in upright]),
        times_100m=_range([robot.time_100m for robot in upright]),
        lanes_kept=sum(robot.lane_kept for robot in robots),
        robots=tuple(robots),
    )


def _range(values: Sequence[float | None]) -> Range | None:
    measured = [value for value in values if value is not None]
    return (min(measured), max(measured)) if measured else None


def sensitivity_picture(robots: Sequence[RobotMetrics]) -> Picture:
    """Draw the top speeds and the 100-m times of all robots."""
    raced = [robot.time_100m for robot in robots if robot.time_100m is not None]
    full = [None if r.fell_at is not None else r.best_speed for r in robots]
    kept, left = (
        [r.time_100m if r.lane_kept is inside else None for r in robots]
        for inside in (True, False)
    )
    speeds = Panel(
        "Speed",
        "Speed [m/s]",
        (
            Dots("best speed", full),
            Dots("mean held", [robot.mean_speed for robot in robots], hollow=True),
        ),
        robots[0].best_speed,
    )
    times = Panel(
        f"{TRACK:g} m",
        "Time [s]",
        (Dots("in its lane", kept), Dots("not", left, hollow=True)),
        robots[0].time_100m,
        most=SLOW * min(raced, default=1.0),
    )
    caption = (
        "The same policy on robots other than the one assumed: speed under the command at which each ran fastest, and "
        "time over 100 m; crosses: fallen, or not arrived; arrowheads: farther off; lines: the robot as assumed."
    )
    figure = variants_figure([robot.name for robot in robots], [speeds, times])
    return Picture("sensitivity", caption, figure)
