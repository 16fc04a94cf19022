"""100 m from a standing start, on one lane: the paper's race against people, which any
robot may run."""

import dataclasses
import math

import numpy as np

from bp2_rl.base.errors import UserError
from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    describe_rise,
    describe_simulator,
    describe_subject,
    on_card,
    robot_of,
    speed_to_command,
)
from bp2_rl.evaluation.benchmarks.options import Setup
from bp2_rl.evaluation.benchmarks.outcome import (
    MEASURES,
    Evaluation,
    Picture,
    Row,
    Table,
    rounded,
    show,
    show_fall,
)
from bp2_rl.evaluation.benchmarks.run_tables import (
    leg_rows,
    motor_rows,
    run_pictures,
    run_results,
    run_rows,
    run_tables,
    spring_rows,
)
from bp2_rl.evaluation.benchmarks.sprint_figure import caption, sprint_figure
from bp2_rl.evaluation.races import BOLT_SPLITS, LAUNCH_DISTANCE, MARKS, TRACK
from bp2_rl.learning.policy import Policy
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.simulation.metrics import RIPPLE, RunMetrics, measure
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.simulator import Numerics
from bp2_rl.simulation.track import (
    LANE_WIDTH,
    Lane,
    measure_lane,
    time_at,
    track_position,
)
from bp2_rl.simulation.trajectory import Trajectory

# s; more for another robot than BP2 that is told a speed at which that is short
TIME_LIMIT = 30.0
SLOWNESS = 1.5  # times the time that the track takes at the speed commanded
GOOD = f"{TRACK:g} m in the time allowed, with trunk and feet inside one lane"
SPRINT_ACCELERATION = 3.0  # m/s2; most policies stall at 5
TILES = (
    "100 m",
    "Mean acceleration",
    "Best speed",
    "Lane used",
    "Fall",
    "Peak motor power",
)

RUN_RESULTS = (
    "commanded_speed",
    "best_speed",
    "fell_at",
    "peak_torque",
    "peak_motor_power",
    "on_envelope",
    "outside_envelope",
    "peak_foot_force",
    "peak_spring_travel",
    "stop_hits",
    "leg_contact",
    "leg_contact_time",
    "leg_depth",
    "leg_clearance",
    "trunk_clearance",
)
"""What a policy's card says of the race as of any other run."""


@dataclasses.dataclass(frozen=True)
class Split:
    """One stretch of the track."""

    distance: float  # m, at its end
    time: float  # s, at its end
    speed: float  # m/s, mean


@dataclasses.dataclass(frozen=True)
class SprintLaunch:
    """The first `LAUNCH_DISTANCE` metres.

    The paper gives mean accelerations (BP2 2.38, a trained sprinter 4.8 m/s2) without a
    definition. Here it is the speed on reaching the mark, a mean over the `RIPPLE`
    seconds around it, over the time since the start.
    """

    time: float  # s
    speed: float  # m/s, on reaching the mark
    mean_acceleration: float  # m/s2, speed / time
    # m/s2, 2 distance / time^2: the constant one that takes as long
    equivalent_acceleration: float


@dataclasses.dataclass(frozen=True)
class SprintMetrics:
    """The race, and the same run by the measures of any other."""

    # s over 100 m, from when the command begins to rise; None if it did not arrive
    time: float | None
    sprint_acceleration: float  # m/s2, of the command
    splits: tuple[Split, ...]  # as far as it came
    launch: SprintLaunch | None  # None if it did not come so far
    lane: Lane
    run: RunMetrics


def time_limit(speed: float, robot: HardwareSpec) -> float:
    """Return the time in which a robot that is told a speed (m/s) must arrive, s."""
    return TIME_LIMIT if robot.is_bp2 else max(TIME_LIMIT, SLOWNESS * TRACK / speed)


def sprint(policy: Policy, ramp: Ramp, setup: Setup) -> Evaluation:
    """Race over 100 m and measure the run."""
    name, robot = describe_subject(policy, setup), robot_of(policy, setup)
    request = RunRequest(
        ramp,
        robot,
        setup.operator,
        finish=TRACK,
        noise_seed=setup.noise_seed,
        numerics=Numerics(drake=setup.drake),
        name=name,
    )
    [run] = simulate(policy, [request], backend=setup.backend)
    said = conditions(
        policy,
        describe_race(ramp),
        describe_simulator(setup.backend, robot, setup.drake),
        setup,
    )
    metrics = measure_sprint(run, ramp.acceleration)
    return Evaluation(
        benchmark="sprint",
        subject=name,
        backend=run.backend,
        conditions=said | {"good": GOOD},
        verdict=verdict(metrics),
        good=metrics.time is not None and metrics.lane.kept,
        rows=sprint_rows(metrics, robot),
        tiles=TILES,
        pictures=(
            Picture("sprint", caption(robot), sprint_figure(run, metrics.time)),
            *run_pictures(run),
        ),
        metrics=metrics,
        results=sprint_results(metrics),
        tables=(
            split_table(metrics),
            Table("The run", MEASURES, run_rows(metrics.run), words=True),
            *run_tables(metrics.run),
        ),
        trajectory=run,
    )


def race(policy: Policy, setup: Setup) -> Ramp:
    """The schedule: to the speed and the acceleration that the card names, if it does;
    else as fast as the policy's controller launches, if it does."""
    speed = setup.speed or speed_to_command(policy, "sprint")
    launching = policy.card.env.control.launching
    usual = launching if math.isfinite(launching) else SPRINT_ACCELERATION
    acceleration = (
        setup.acceleration or on_card(policy, "sprint", "sprint_acceleration") or usual
    )
    ramp = Ramp(speed, acceleration=acceleration).under(policy.card.env.control)
    limit = time_limit(speed, robot_of(policy, setup))
    if ramp.steady_from >= limit:
        raise UserError(
            f"--acceleration {acceleration:g} reaches {speed:g} m/s after the race's {limit:g} s"
        )
    return dataclasses.replace(ramp, hold=limit - ramp.steady_from)


def describe_race(ramp: Ramp) -> str:
    """The schedule in one line."""
    return (
        f"from a stand; the command rises {describe_rise(ramp)} to {ramp.target[0]:g} m/s and stays there to "
        f"the end of {TRACK:g} m, for {ramp.duration:.3g} s at most; the clock starts when it begins to rise"
    )


# --- What is measured -----------------------------------------------------------------


def measure_sprint(run: Trajectory, acceleration: float) -> SprintMetrics:
    """All figures of merit of a race; `acceleration` is the command's, m/s2."""
    splits = measure_splits(run)
    return SprintMetrics(
        time=splits[-1].time if splits and splits[-1].distance == TRACK else None,
        sprint_acceleration=acceleration,
        splits=splits,
        launch=measure_first_metres(run),
        lane=measure_lane(run),
        run=measure(run),
    )


def measure_splits(run: Trajectory) -> tuple[Split, ...]:
    """The 10-m splits, as far as the robot came."""
    splits, last = [], Split(0.0, 0.0, 0.0)
    for mark in map(float, MARKS):
        time = time_at(run, mark)
        if time is None:
            break
        last = Split(mark, time, (mark - last.distance) / (time - last.time))
        splits.append(last)
    return tuple(splits)


def measure_first_metres(run: Trajectory) -> SprintLaunch | None:
    """The first metres; None if the run ends less than half of `RIPPLE` after them."""
    time = time_at(run, LAUNCH_DISTANCE)
    if time is None or time + RIPPLE / 2 > run.time[-1]:
        return None
    behind, ahead = np.interp(
        (time - RIPPLE / 2, time + RIPPLE / 2), run.time, track_position(run)[0]
    )
    speed = float(ahead - behind) / RIPPLE
    return SprintLaunch(time, speed, speed / time, 2.0 * LAUNCH_DISTANCE / time**2)


# --- What is shown --------------------------------------------------------------------


def verdict(metrics: SprintMetrics) -> str:
    """The race in one sentence."""
    if metrics.run.fell_at is not None:
        return (
            f"Fell after {metrics.run.fell_at:.2f} s and {metrics.run.distance:.1f} m."
        )
    if metrics.time is None:
        return f"Came {metrics.run.distance:.1f} m far in {metrics.run.duration:.0f} s."
    return f"{TRACK:g} m in {metrics.time:.2f} s, {'inside' if metrics.lane.kept else 'but not inside'} one lane."


def sprint_rows(metrics: SprintMetrics, robot: HardwareSpec) -> tuple[Row, ...]:
    """The figures of merit for a reader, each with what it means."""
    width = 2.0 * robot.anatomy.footprint[1]
    run, lane, launch = metrics.run, metrics.lane, metrics.launch
    used = max(lane.trunk_reach, lane.foot_reach)
    mean, equivalent = (
        (launch.mean_acceleration, launch.equivalent_acceleration)
        if launch
        else (None, None)
    )
    return (
        Row(
            "100 m",
            show(metrics.time, ".2f", "s"),
            "from when the command begins to rise",
        ),
        Row(
            "Commanded",
            f"{run.commanded_speed:.2f} m/s",
            f"at the end, rising at {metrics.sprint_acceleration:g} m/s\u00b2",
        ),
        Row(
            "First 5 m",
            show(launch and launch.time, ".2f", "s"),
            f"at {show(launch and launch.speed, '.2f', 'm/s')}",
        ),
        Row(
            "Mean acceleration",
            show(mean, ".2f", "m/s\u00b2"),
            "speed at 5 m over time at 5 m",
        ),
        Row(
            "Equivalent",
            show(equivalent, ".2f", "m/s\u00b2"),
            "constant one of the same time, 2 d / t\u00b2",
        ),
        Row(
            "Best speed",
            show(run.best_speed, ".2f", "m/s"),
            "best 1-s mean of forward speed",
        ),
        Row("Fall", show_fall(run.fell_at), f"in {run.duration:.1f} s"),
        Row(
            "Trunk off the line",
            f"{lane.trunk_offset:.2f} m",
            "greatest, of its centre",
        ),
        Row(
            "Trunk's side",
            f"{lane.trunk_reach:.2f} m",
            f"greatest distance from the line, {width:.2f} m wide",
        ),
        Row(
            "Feet's outer edge",
            f"{lane.foot_reach:.2f} m",
            "greatest distance from the line",
        ),
        Row(
            "Lane used",
            f"{used / (LANE_WIDTH / 2):.0%}",
            f"of \u00b1{LANE_WIDTH / 2:.2f} m, by trunk and feet",
        ),
        *motor_rows(run),
        *spring_rows(run)[1:],
        *leg_rows(run),
    )


def split_table(metrics: SprintMetrics) -> Table:
    """Every 10 m, with the world record's beside them."""
    record = np.diff((0.0, *BOLT_SPLITS))
    head = (
        "Distance [m]",
        "Time [s]",
        "Mean speed [m/s]",
        "Bolt 2009 [s]",
        "Bolt's mean speed [m/s]",
    )
    return Table(
        "Splits",
        head,
        [
            (
                f"{s.distance:.0f}",
                f"{s.time:.2f}",
                f"{s.speed:.2f}",
                f"{bolt:.2f}",
                f"{10.0 / split:.2f}",
            )
            for s, bolt, split in zip(metrics.splits, BOLT_SPLITS, record, strict=False)
        ],
    )


def sprint_results(metrics: SprintMetrics) -> dict[str, object]:
    """What a policy's card says of the race."""
    launch, lane = metrics.launch, metrics.lane
    race = {
        "time_100m": metrics.time,
        "sprint_acceleration": metrics.sprint_acceleration,
        "splits": [split.time for split in metrics.splits],
        "launch_time": launch and launch.time,
        "mean_acceleration": launch and launch.mean_acceleration,
        "equivalent_acceleration": launch and launch.equivalent_acceleration,
        "trunk_reach": lane.trunk_reach,
        "foot_reach": lane.foot_reach,
        "lane_kept": lane.kept,
    }
    return rounded(race) | run_results(metrics.run, RUN_RESULTS)
