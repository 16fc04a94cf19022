"""The benchmarks `manoeuvres` and `disturbances`: many short trials that show the
limits of a policy.

Every try has a rule that a reader would expect a running robot to keep; a robot that
falls fails. Manoeuvres are braking, launches, turns, slow motion, standing,
straightness, pushes and bad ground.
"""

import dataclasses
import itertools
import math
from collections.abc import Iterable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from bp2_rl.base.metric import (
    NOT_MEASURED,
    Row,
    metric,
    rounded,
    show,
    table_of,
)
from bp2_rl.base.plotting import FALL, FRONT, INK, QUIET, WIDTH, styled
from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    cruising_speed,
    describe_subject,
    robot_of,
    top_speed,
)
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture
from bp2_rl.evaluation.benchmarks.run import ramp_to_topspeed
from bp2_rl.evaluation.benchmarks.tries.rules import (
    CHATTER_WINDOW,
    STOPPED,
    Assessment,
    Measured,
)
from bp2_rl.evaluation.benchmarks.tries.tasks import (
    AFTER_PUSH,
    ARROWS,
    CELL,
    CROSSING,
    PHASES,
    SEEDS,
    SHOVE,
    SLOW_TIME,
    STAND,
    STEADY,
    TURN,
    TURN_TIME,
    UPRIGHT,
    Try,
    all_disturbances,
    all_manoeuvres,
    dash_of,
    run_up,
    sizes_of,
)
from bp2_rl.evaluation.races import TRACK
from bp2_rl.learning.policy import Policy
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import COMMAND_ACCELERATION, Ramp
from bp2_rl.simulation.trajectory import Trajectory, best_window
from bp2_rl.simulation.world import EVEN

FELL = "fell"
LAUNCH_GROUP = "Launch, friction 0.8"


def _show_measured(measured: Measured) -> str:
    return ", ".join(
        f"{name.replace('_', ' ')} {show(value, '.3g')}"
        for name, value in measured.items()
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class TryOutcome:
    """The outcome of a trial: the task, the robot's behaviour, and whether it passed
    the rule."""

    group: str = metric("Tried", form="s")
    asked: str = metric("Asked", form="s")
    rule: str
    did: str = metric("Did", form="s")
    fell_at: float | None = metric("Fall", "s")
    passed: bool = metric("Passed", form=lambda passed: "yes" if passed else "NO")
    measured: Measured = metric("Measured, in SI units", form=_show_measured)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tries:
    """The outcomes of all trials of a benchmark, with the numbers of passes and
    falls."""

    passed: int
    fell: int
    outcomes: tuple[TryOutcome, ...]

    @property
    def groups(self) -> dict[str, tuple[TryOutcome, ...]]:
        """The outcomes of the trials by group, such as one manoeuvre at several
        strengths."""
        return {
            name: tuple(group)
            for name, group in itertools.groupby(self.outcomes, key=lambda o: o.group)
        }

    @property
    def passes(self) -> dict[str, str]:
        """Number of trials passed in each group, in words."""
        return {name: share_passed(group) for name, group in self.groups.items()}


@dataclasses.dataclass(frozen=True, kw_only=True)
class ManoeuvreMetrics(Tries):
    """The outcomes of all manoeuvres, with the robot's speed on level ground and its
    cruising speed."""

    level_speed: float  # m/s, best 1-s mean at the top speed's command, on level ground
    cruise: float  # m/s, of stops and pushes


def outcome_of(one: Try, run: Trajectory) -> TryOutcome:
    """Judge the run of a trial by the trial's rule; a robot that falls fails, and is
    not measured."""
    fell = run.fell_at is not None
    assessment = Assessment(False, FELL, {}) if fell else one.assess(run)
    return TryOutcome(
        group=one.group,
        asked=one.asked,
        rule=one.rule,
        did=assessment.result,
        passed=assessment.passed,
        fell_at=run.fell_at,
        measured=assessment.measured,
    )


def count_tries(outcomes: Sequence[TryOutcome]) -> Tries:
    """Count the trials that passed, and those in which the robot fell."""
    return Tries(
        passed=sum(outcome.passed for outcome in outcomes),
        fell=sum(outcome.fell_at is not None for outcome in outcomes),
        outcomes=tuple(outcomes),
    )


def share_passed(group: Sequence[TryOutcome]) -> str:
    """Say in words how many trials of a group passed."""
    return f"{sum(outcome.passed for outcome in group)} of {len(group)}"


# --- Manoeuvres -----------------------------------------------------------------------

GROUND = (
    "slope: gravity tilts, the robot's sensors measure the true vertical, heights and falls are relative to the slope; "
    f"rough ground: uniform random heights at points {CELL:g} m apart, planes between them, the number from lowest to "
    f"highest, flat for {EVEN:g} m around the start; pushes: the whole robot's velocity jumps, in its heading's frame"
)
MEASURES = (
    f"speeds are {RIPPLE:g}-s means, slower than {STOPPED:g} m/s is at rest; yaw rates are means of "
    f"{TURN_TIME:g} s, on the spot of {SLOW_TIME:g} s; chatter: root mean square of torque that varies faster than in "
    f"{CHATTER_WINDOW:g} s; a gyro's heading is off by its bias x time"
)


def manoeuvres(policy: Policy, ramp: Ramp, setup: BenchmarkOptions) -> Evaluation:
    """Simulate all manoeuvres, such as stops, turns and pushes; return passes and falls
    as an evaluation."""
    robot = robot_of(policy, setup)
    seed = setup.seed or 0
    level = level_speed(policy, ramp, robot, setup.operator)
    cruise = cruising_speed(policy)
    sizes = sizes_of(robot, top_speed(policy), cruise, policy.card.env.commands)
    asked = all_manoeuvres(ramp, level, robot, setup.operator, seed, sizes)
    tries = count_tries(simulate_all(outcome_of, policy, asked))
    metrics = ManoeuvreMetrics(**vars(tries), level_speed=level, cruise=cruise)
    schedule = (
        f"commands rise at {COMMAND_ACCELERATION:g} m/s² unless stated otherwise; the top is the command of the "
        f"card's top speed; braking, turns and pushes begin after {STEADY:g} s at their speed, pushes at {cruise:g} "
        f"m/s; straightness, ground and latency: {TRACK:g} m at the top"
    )
    run_conditions = conditions(policy, setup, schedule)
    drift = " A gyro bias of 0.5°/s alone leads some 5 m astray in 100 m."
    caption = (
        "One row per manoeuvre, one cell per trial: the task, and below it the result. Red: the trial failed the rule on "
        "the left. Turns: the commanded speed x yaw rate, and the share of the yaw rate that was reached, or the speed "
        f"if only the speed failed. Pushes: towards the arrow, ahead is up.{drift if robot.is_bp2 else ''}"
    )
    return Evaluation(
        benchmark="manoeuvres",
        subject=describe_subject(policy, setup),
        conditions=run_conditions
        | {"ground": GROUND, "rough ground's seed": f"{seed}", "measures": MEASURES},
        verdict=f"{share_passed(metrics.outcomes)} manoeuvres passed; {metrics.fell} fell.",
        good=metrics.passed == len(metrics.outcomes),
        rows=manoeuvre_rows(metrics),
        tiles=(
            "Passed",
            "Fell",
            "Hardest stop",
            "Hardest launch",
            "Creep",
            "No steering",
        ),
        pictures=(Picture("manoeuvres", caption, tries_figure(metrics)),),
        metrics=metrics,
        results=rounded(
            {
                "level_speed": level,
                "passed": metrics.passed,
                "of": len(metrics.outcomes),
                "fell": metrics.fell,
                "creep": _measured("creep", metrics),
                "astray": _measured("reach", metrics),
                "passes": metrics.passes,
                "did": {
                    name: {o.asked: o.did for o in group}
                    for name, group in metrics.groups.items()
                },
            }
        ),
        tables=(table_of("Manoeuvres", metrics.outcomes, words=True),),
    )


def level_speed(
    policy: Policy, ramp: Ramp, robot: HardwareSpec, operator: HeadingHold
) -> float:
    """Return the best speed on level ground at the top speed's command, m/s; the
    command if the robot fell."""
    request = RunRequest(dash_of(ramp, robot), robot, operator, finish=TRACK)
    [run] = simulate(policy, [request])
    best = best_window(run, 1.0)
    return ramp.target[0] if run.fell_at is not None or best is None else best.speed


def hardest(outcomes: Iterable[TryOutcome]) -> str:
    """Return the hardest task of a group that passed together with all gentler
    tasks."""
    passed = list(itertools.takewhile(lambda outcome: outcome.passed, outcomes))
    return passed[-1].asked if passed else NOT_MEASURED


def manoeuvre_rows(metrics: ManoeuvreMetrics) -> tuple[Row, ...]:
    """Return report rows: the main figures of the manoeuvres, then one row for each
    group."""
    groups = metrics.groups
    from_cruise = f"from {metrics.cruise:g} m/s"
    return (
        Row(
            "Passed",
            share_passed(metrics.outcomes),
            "trials, each by its rule below",
        ),
        Row("Fell", f"{metrics.fell}", "a robot that falls fails"),
        Row("Hardest stop", hardest(groups[f"Brake {from_cruise}"]), from_cruise),
        Row(
            "Hardest launch",
            hardest(groups[LAUNCH_GROUP]),
            "to the top, on friction 0.8",
        ),
        Row(
            "Creep",
            show(_measured("creep", metrics), ".2f", "m"),
            f"of a stand for {STAND:g} s",
        ),
        Row(
            "No steering",
            show(_measured("reach", metrics), ".1f", "m"),
            f"how far the trunk's edge strays within {TRACK:g} m",
        ),
        *(
            Row(name, share_passed(group), group[0].rule)
            for name, group in groups.items()
        ),
    )


def _measured(name: str, tries: Tries) -> float | None:
    """Return a figure of the last trial that measured it; for straightness this is the
    run without steering."""
    values = [o.measured[name] for o in tries.outcomes if name in o.measured]
    return values[-1] if values else None


# --- Disturbances ---------------------------------------------------------------------


def disturbances(policy: Policy, ramp: Ramp, setup: BenchmarkOptions) -> Evaluation:
    """Push the robot, and run it over rough ground, at its cruising speed; return
    passes as an evaluation."""
    robot = robot_of(policy, setup)
    speed = ramp.target[0]
    seed = setup.seed or 0
    steady = run_up(speed).hold(AFTER_PUSH)
    [calm] = simulate(policy, [RunRequest(steady, robot, setup.operator)])
    stride = 1.0 / (calm.metrics.stride_frequency or math.inf)
    asked = all_disturbances(speed, stride, robot, setup.operator, seed)
    tries = count_tries(simulate_all(outcome_of, policy, asked))
    schedule = (
        f"commands rise to {speed:g} m/s at {COMMAND_ACCELERATION:g} m/s²; pushes after {STEADY:g} s there, of "
        f"{SHOVE * robot.size.speed:.3g} m/s and {TURN * robot.size.rate:.3g} rad/s"
    )
    ground = (
        "rough ground: uniform random heights at points, planes between them, the number from lowest to highest, flat "
        f"for {EVEN:g} m around the start; pushes: the whole robot's velocity and yaw rate jump, in its heading's frame"
    )
    caption = (
        "One row per phase of the stride or kind of ground, one cell per trial: the direction of the push, ahead is up, "
        "and the largest distance from the line. Red: the robot fell."
    )
    run_conditions = conditions(policy, setup, schedule)
    seeds = f"{seed} and the next {SEEDS - 1}"
    return Evaluation(
        benchmark="disturbances",
        subject=describe_subject(policy, setup),
        conditions=run_conditions | {"ground": ground, "rough ground's seeds": seeds},
        verdict=f"{share_passed(tries.outcomes)} disturbances without a fall.",
        good=tries.fell == 0,
        rows=disturbance_rows(tries),
        tiles=("Without a fall", "Pushes", "Rough ground"),
        pictures=(Picture("disturbances", caption, tries_figure(tries)),),
        metrics=tries,
        results={
            "of": len(tries.outcomes),
            "passed": tries.passed,
            "passes": tries.passes,
        },
        tables=(table_of("Disturbances", tries.outcomes, words=True),),
    )


def ramp_to_disturbances(policy: Policy, setup: BenchmarkOptions) -> Ramp:
    """Return the command ramp over rough ground, for BP2 at the same speed for every
    policy, to compare policies."""
    return ramp_to_topspeed(policy, setup, speed=cruising_speed(policy), hold=CROSSING)


def disturbance_rows(tries: Tries) -> tuple[Row, ...]:
    """Return report rows: passes of all trials, of pushes and of rough ground, then one
    row for each group."""
    pushes, grounds = (
        [o for o in tries.outcomes if o.group.startswith("Push") is push]
        for push in (True, False)
    )
    sides = f"at {PHASES} phases of a stride, from {len(ARROWS)} sides"
    return (
        Row("Without a fall", share_passed(tries.outcomes), "of all"),
        Row("Pushes", share_passed(pushes), sides),
        Row("Rough ground", share_passed(grounds), f"{CROSSING:g} s at the speed"),
        *(Row(name, passes, UPRIGHT) for name, passes in tries.passes.items()),
    )


# --- The picture ----------------------------------------------------------------------

COLUMN, ROW = 0.76, 0.42  # inches
LABELS = 2.2  # inches, left of the cells
LONG = 9  # characters: what is longer is written smaller


@styled
def tries_figure(tries: Tries) -> Figure:
    """Draw the outcomes of all trials as a chart with one row for each group."""
    groups = tries.groups.values()
    figure = Figure(figsize=(WIDTH, ROW * (len(groups) + 1.2)))
    axes: Axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, WIDTH), ylim=(len(groups) + 0.2, -1.0))
    axes.set_axis_off()
    axes.text(
        0.1,
        -0.5,
        f"{share_passed(tries.outcomes)} passed; red: failed",
        va="center",
        weight="bold",
        size=12,
    )
    for row, group in enumerate(groups):
        axes.text(0.1, row + 0.34, group[0].group, va="center", weight="bold")
        axes.text(0.1, row + 0.70, group[0].rule, va="center", color=QUIET, size=6.5)
        for column, outcome in enumerate(group):
            _draw_cell(axes, LABELS + column * COLUMN, row, outcome)
    return figure


def _draw_cell(axes: Axes, left: float, top: float, outcome: TryOutcome) -> None:
    color, alpha = (FRONT, 0.16) if outcome.passed else (FALL, 1.0)
    axes.add_patch(
        Rectangle(
            (left, top + 0.06),
            COLUMN - 0.05,
            0.88,
            facecolor=color,
            alpha=alpha,
            linewidth=0,
        )
    )
    middle = left + (COLUMN - 0.05) / 2
    head, body = (QUIET, INK) if outcome.passed else ("white", "white")
    axes.text(
        middle,
        top + 0.31,
        outcome.asked,
        ha="center",
        va="center",
        color=head,
        size=6.5,
    )
    size = 8.5 if len(outcome.did) <= LONG else 7.0
    axes.text(
        middle,
        top + 0.68,
        outcome.did,
        ha="center",
        va="center",
        color=body,
        size=size,
        weight="bold",
    )
