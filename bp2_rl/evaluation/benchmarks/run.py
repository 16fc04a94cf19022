"""The benchmarks of a single run: `topspeed` holds the top speed, `sprint` runs 100 m
from a stand."""

import dataclasses
import math

import numpy as np

from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import (
    NOT_MEASURED,
    Row,
    Table,
    card_of,
    metric,
    rows_of,
    show,
    show_fall,
    table_of,
    table_of_rows,
)
from bp2_rl.base.plotting import NARROW
from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    describe_ramp,
    describe_rise,
    describe_subject,
    on_card,
    robot_of,
    speed_to_command,
)
from bp2_rl.evaluation.benchmarks.options import POSTERIOR, BenchmarkOptions
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture
from bp2_rl.evaluation.benchmarks.sprint_figure import sprint_pictures
from bp2_rl.evaluation.races import BOLT_SPLITS, LAUNCH_DISTANCE, MARKS, TRACK
from bp2_rl.learning.policy import Policy
from bp2_rl.robot.hardware import BUILT, HardwareSpec
from bp2_rl.simulation.account import account
from bp2_rl.simulation.figures import FIGURES
from bp2_rl.simulation.measuring import Lane, measure_lane, time_at, track_position
from bp2_rl.simulation.metrics import RIPPLE, PowerMetrics, RunMetrics
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import COMMAND_ACCELERATION, Ramp
from bp2_rl.simulation.trajectory import Trajectory, steady_window
from bp2_rl.simulation.world import World


def run_once(
    policy: Policy, ramp: Ramp, setup: BenchmarkOptions, finish: float = math.inf
) -> Trajectory:
    """Simulate a policy under a command ramp as `setup` says, until `finish` (m) at
    most; return the trajectory."""
    request = RunRequest(
        ramp,
        robot_of(policy, setup),
        setup.operator,
        World(setup.ground),
        finish=finish,
        noise_seed=setup.noise_seed,
        name=describe_subject(policy, setup),
    )
    [run] = simulate(policy, [request], backend=setup.backend)
    return run


def plausible_rows(
    policy: Policy, setup: BenchmarkOptions, name: str, unit: str
) -> tuple[Row, ...]:
    """Return a report's row with the results of plausible robots on the policy's card;
    none for another robot than the built one, or other ground."""
    results = policy.card.results.get(POSTERIOR)
    interval = isinstance(results, dict) and results.get(name)
    if not interval or robot_of(policy, setup) != BUILT or setup.terrain != "flat":
        return ()
    return (
        Row(
            "Plausible robots",
            "{1:.2f} ({0:.2f} to {2:.2f}) {3}".format(*interval, unit),
            "median (90 %) of plausible robots, by --benchmark posterior",
        ),
    )


# --- Top speed ------------------------------------------------------------------------

TOPSPEED_HOLD = 20.0  # s
# of the commanded speed: a slower robot does not follow its command
FOLLOWS = 0.5


def topspeed(policy: Policy, ramp: Ramp, setup: BenchmarkOptions) -> Evaluation:
    """Ramp to the commanded speed and hold it; return the measurements of the run as an
    evaluation."""
    run = run_once(policy, ramp, setup)
    metrics = run.metrics
    if setup.backend == "mujoco" and metrics.hold_time >= 1.0:
        metrics = dataclasses.replace(metrics, account=account(steady_window(run)))
    return Evaluation(
        benchmark="topspeed",
        subject=run.name,
        backend=run.backend,
        conditions=conditions(policy, setup, describe_ramp(ramp))
        | {
            "good": f"no fall, and a mean speed of {FOLLOWS:.0%} of the commanded one or more"
        },
        verdict=f"Ran {metrics.mean_speed:.2f} m/s in the mean over {metrics.steady_to - metrics.steady_from:.1f} s, "
        f"{show(metrics.best_speed, '.2f', 'm/s')} in the best second; "
        f"command {metrics.commanded_speed:g} m/s; fall: {show_fall(metrics.fell_at)}.",
        good=metrics.fell_at is None
        and metrics.mean_speed >= FOLLOWS * metrics.commanded_speed,
        rows=(*rows_of(metrics), *plausible_rows(policy, setup, "road", "m/s")),
        tiles=(
            "Best speed",
            "Time held",
            "Tracking error",
            "Fall",
            "Electrical cost",
            "On the envelope",
        ),
        pictures=run_pictures(run),
        metrics=metrics,
        results=card_of(metrics),
        tables=run_tables(metrics),
        trajectory=run,
    )


def ramp_to_topspeed(
    policy: Policy,
    setup: BenchmarkOptions,
    *,
    speed: float | None = None,
    hold: float = TOPSPEED_HOLD,
) -> Ramp:
    """Return the command ramp to top speed; `speed` (m/s) and `hold` (s) replace what
    `setup` leaves open."""
    speed = setup.speed or speed or speed_to_command(policy)
    ramp = Ramp(speed, setup.acceleration or COMMAND_ACCELERATION, setup.hold or hold)
    return ramp.under(policy.card.env.control)


# --- Sprint ---------------------------------------------------------------------------

# s; longer for robots other than BP2 at slow commands
TIME_LIMIT = 30.0
SLOWNESS = 1.5  # times the time that the track takes at the speed commanded
SPRINT_ACCELERATION = 3.0  # m/s2; most policies stall at 5
OF_THE_RUN = (
    "commanded_speed",
    "best_speed",
    "fell_at",
    "peak_torque",
    "peak_joint_speed",
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
"""Fields of `RunMetrics` that are also reported for a sprint."""


@dataclasses.dataclass(frozen=True)
class Split:
    """The time and mean speed over a stretch of the track."""

    distance: float = metric("Distance", "m", ".0f", "at its end")
    time: float = metric("Time", "s", meaning="at its end")
    speed: float = metric("Mean speed", "m/s")


@dataclasses.dataclass(frozen=True)
class SprintLaunch:
    """The time and acceleration over the first `LAUNCH_DISTANCE` metres of a sprint.

    Its figures are None where the robot did not finish these metres.

    The paper gives mean accelerations (BP2 2.38, a trained sprinter 4.8 m/s2) without a
    definition. Here it is the speed on reaching the mark, a mean over the `RIPPLE`
    seconds around it, over the time since the start.
    """

    time: float | None = metric(
        f"First {LAUNCH_DISTANCE:g} m",
        "s",
        meaning=lambda m: f"at {show(m.speed, '.2f', 'm/s')}",
        card="launch_time",
        default=None,
    )
    speed: float | None = None  # m/s, on reaching the mark
    mean_acceleration: float | None = metric(
        "Mean acceleration",
        "m/s\u00b2",
        meaning=f"speed at {LAUNCH_DISTANCE:g} m over time at {LAUNCH_DISTANCE:g} m",
        card=True,
        default=None,
    )
    equivalent_acceleration: float | None = metric(
        "Equivalent",
        "m/s\u00b2",
        meaning="constant one of the same time, 2 d / t\u00b2",
        card=True,
        default=None,
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class SprintMetrics:
    """The measurements of a 100-m sprint: time, splits, launch and lane, and the
    figures of any run."""

    # None if it did not arrive
    time: float | None = metric(
        f"{TRACK:g} m",
        "s",
        meaning="from when the command begins to rise",
        card="time_100m",
    )
    sprint_acceleration: float = metric(
        "Command rises at",
        "m/s\u00b2",
        "g",
        "from a stand, to the commanded speed",
        card=True,
    )
    splits: tuple[Split, ...]  # as far as it came
    launch: SprintLaunch
    lane: Lane
    run: RunMetrics


def sprint(policy: Policy, ramp: Ramp, setup: BenchmarkOptions) -> Evaluation:
    """Run 100 m from a stand; return the measurements of the sprint as an
    evaluation."""
    run = run_once(policy, ramp, setup, finish=TRACK)
    metrics = sprint_metrics(run, ramp.acceleration)
    own = "time", "launch", "lane", "sprint_acceleration"
    return Evaluation(
        benchmark="sprint",
        subject=run.name,
        backend=run.backend,
        conditions=conditions(policy, setup, describe_race(ramp))
        | {
            "good": f"{TRACK:g} m in the time allowed, with trunk and feet inside one lane"
        },
        verdict=f"{TRACK:g} m in {show(metrics.time, '.2f', 's')}, "
        f"{'inside' if metrics.lane.kept else 'not inside'} one lane; "
        f"ran {metrics.run.distance:.1f} m; fall: {show_fall(metrics.run.fell_at)}.",
        good=metrics.time is not None and metrics.lane.kept,
        rows=(
            *rows_of(metrics, *own),
            *rows_of(metrics.run, *OF_THE_RUN),
            *plausible_rows(policy, setup, "time_100m", "s"),
        ),
        tiles=(
            "100 m",
            "Mean acceleration",
            "Best speed",
            "Lane used",
            "Fall",
            "Peak motor power",
        ),
        pictures=(*sprint_pictures(run, metrics.time), *run_pictures(run)),
        metrics=metrics,
        results=card_of(metrics, *own)
        | {"splits": [float(f"{split.time:.4g}") for split in metrics.splits]}
        | card_of(metrics.run, *OF_THE_RUN),
        tables=(
            *split_tables(metrics),
            table_of_rows("The run", rows_of(metrics.run)),
            *run_tables(metrics.run),
        ),
        trajectory=run,
    )


def ramp_to_sprint(policy: Policy, setup: BenchmarkOptions) -> Ramp:
    """Return the command ramp of a sprint, with the card's speed and acceleration if
    any, else as the controller launches."""
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


def time_limit(speed: float, robot: HardwareSpec) -> float:
    """Return the longest time allowed for the track at a commanded speed (m/s), s."""
    return TIME_LIMIT if robot.is_bp2 else max(TIME_LIMIT, SLOWNESS * TRACK / speed)


def describe_race(ramp: Ramp) -> str:
    """Describe the command ramp of a sprint in one line."""
    return (
        f"from a stand; the command rises {describe_rise(ramp)} to {ramp.target[0]:g} m/s and stays there to "
        f"the end of {TRACK:g} m, for {ramp.duration:.3g} s at most; the clock starts when it begins to rise"
    )


def sprint_metrics(run: Trajectory, acceleration: float) -> SprintMetrics:
    """Compute all figures of merit of a sprint; `acceleration` is the command's,
    m/s2."""
    splits = measure_splits(run)
    return SprintMetrics(
        time=splits[-1].time if splits and splits[-1].distance == TRACK else None,
        sprint_acceleration=acceleration,
        splits=splits,
        launch=measure_first_metres(run),
        lane=measure_lane(run),
        run=run.metrics,
    )


def measure_splits(run: Trajectory) -> tuple[Split, ...]:
    """Return time and mean speed for every 10-m split that the robot finished."""
    splits = []
    last = Split(0.0, 0.0, 0.0)
    for mark in map(float, MARKS):
        time = time_at(run, mark)
        if time is None:
            break
        last = Split(mark, time, (mark - last.distance) / (time - last.time))
        splits.append(last)
    return tuple(splits)


def measure_first_metres(run: Trajectory) -> SprintLaunch:
    """Measure time and acceleration over the first `LAUNCH_DISTANCE` metres; empty if
    the run ends before or just after."""
    time = time_at(run, LAUNCH_DISTANCE)
    if time is None or time + RIPPLE / 2 > run.time[-1]:
        return SprintLaunch()
    behind, ahead = np.interp(
        (time - RIPPLE / 2, time + RIPPLE / 2), run.time, track_position(run)[0]
    )
    speed = float(ahead - behind) / RIPPLE
    return SprintLaunch(time, speed, speed / time, 2.0 * LAUNCH_DISTANCE / time**2)


# --- What is shown of a run -----------------------------------------------------------

ENERGY = {
    "copper": "windings",
    "gears": "gears",
    "joints": "joint friction",
    "slides": "spring slides",
    "dampers": "spring dampers and rebound stops",
    "air": "air",
    "ground": "ground, impacts and slip",
    "stops": "joint limits",
    "legs": "legs against each other",
    "stored": "stored: motion, height, springs",
    "integration": "lost by steps of 1 ms (no loss of the robot's)",
}
"""Name in a report of each cause of energy loss in an `account.Ledger`, and of two
further terms."""


def split_tables(metrics: SprintMetrics) -> tuple[Table, ...]:
    """Return a table of the 10-m splits beside the world record's; none without a
    finished split."""
    if not metrics.splits:
        return ()
    table = table_of("Splits", metrics.splits)
    record = zip(BOLT_SPLITS, np.diff((0.0, *BOLT_SPLITS)), strict=True)
    lines = [
        (*line, f"{bolt:.2f}", f"{10.0 / split:.2f}")
        for line, (bolt, split) in zip(table.lines, record, strict=False)
    ]
    head = *table.head, "Bolt 2009 [s]", "Bolt's mean speed [m/s]"
    return (Table(table.title, head, lines),)


def run_tables(metrics: RunMetrics) -> tuple[Table, ...]:
    """Return tables of the energy balance (if computed), of the motors and of the
    legs."""
    tables = (table_of("Motors", metrics.motors), table_of("Legs", metrics.legs))
    if metrics.account is None:
        return tables
    return (_energy_table(metrics.account.power), *tables)


def _energy_table(power: PowerMetrics) -> Table:
    shares = {**power.lost, "stored": power.stored, "integration": power.integration}
    lines = [
        (
            ENERGY[cause],
            f"{watts:.0f}",
            f"{watts / power.mean:.1%}" if power.mean > 0.0 else NOT_MEASURED,
        )
        for cause, watts in shares.items()
        if watts  # a robot with rigid shanks loses nothing in springs
    ]
    head = "Cause", "Power [W]", "Share of the bus"
    return Table("Where the energy goes, steady window", head, lines)


def run_pictures(run: Trajectory) -> tuple[Picture, ...]:
    """Draw every figure of `simulation.figures` for a run."""
    return tuple(
        Picture(name, caption, draw(run), draw(run, NARROW))
        for name, (draw, caption) in FIGURES.items()
    )
