"""What a policy cannot do yet: braking, launches, turns, slow motion, standing,
straightness, pushes, bad ground.

Every manoeuvre has a rule that a reader would expect a running robot to keep; a robot
that falls fails.
"""

import dataclasses
import itertools
from collections.abc import Iterable, Sequence

from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    cruising_speed,
    describe_simulator,
    describe_subject,
    robot_of,
    top_speed,
)
from bp2_rl.evaluation.benchmarks.manoeuvres.figure import (
    CAPTION,
    CAPTION_OF_BP2,
    manoeuvres_figure,
)
from bp2_rl.evaluation.benchmarks.manoeuvres.rules import (
    CHATTER_WINDOW,
    STOPPED,
    ManoeuvreOutcome,
    Measured,
    StandingStill,
    Straight,
)
from bp2_rl.evaluation.benchmarks.manoeuvres.tasks import (
    SLOW_TIME,
    STAND,
    STEADY,
    TURN_TIME,
    Manoeuvre,
    all_manoeuvres,
    dash_of,
    sizes_of,
)
from bp2_rl.evaluation.benchmarks.options import Setup
from bp2_rl.evaluation.benchmarks.outcome import (
    NOT_MEASURED,
    Evaluation,
    Picture,
    Row,
    Table,
    rounded,
    show,
)
from bp2_rl.evaluation.benchmarks.sprint import TRACK
from bp2_rl.learning.policy import Policy
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import COMMAND_ACCELERATION, Ramp
from bp2_rl.simulation.trajectory import Trajectory
from bp2_rl.simulation.windows import best_window
from bp2_rl.simulation.world import EVEN, World

TILES = "Passed", "Fell", "Hardest stop", "Hardest launch", "Creep", "Nobody steering"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tries:
    """All tries."""

    passed: int
    fell: int
    outcomes: tuple[ManoeuvreOutcome, ...]

    @property
    def groups(self) -> dict[str, tuple[ManoeuvreOutcome, ...]]:
        """By what was tried."""
        return {
            name: tuple(group)
            for name, group in itertools.groupby(self.outcomes, key=lambda o: o.group)
        }

    @property
    def passes(self) -> dict[str, str]:
        """How many of each group passed, in words."""
        return {name: share_of(group) for name, group in self.groups.items()}


@dataclasses.dataclass(frozen=True, kw_only=True)
class ManoeuvreMetrics(Tries):
    """All manoeuvres, and what they were measured by."""

    level_speed: float  # m/s, best 1-s mean at the top speed's command, on level ground
    cruise: float  # m/s, of stops and pushes


def manoeuvres(policy: Policy, ramp: Ramp, setup: Setup) -> Evaluation:
    """Try them all."""
    robot = robot_of(policy, setup)
    level = level_speed(policy, ramp, robot, setup.operator)
    cruise = cruising_speed(policy)
    sizes = sizes_of(robot, top_speed(policy), cruise, policy.card.env.commands)
    asked = all_manoeuvres(ramp, level, robot, setup.operator, setup.seed or 0, sizes)
    tries = summarise(simulate_all(outcome_of, policy, asked))
    metrics = ManoeuvreMetrics(**vars(tries), level_speed=level, cruise=cruise)
    caption = CAPTION_OF_BP2 if robot.is_bp2 else CAPTION
    said = conditions(
        policy, describe_schedules(cruise), describe_simulator("mujoco", robot), setup
    )
    return Evaluation(
        benchmark="manoeuvres",
        subject=describe_subject(policy, setup),
        backend="C MuJoCo",
        conditions=said
        | {
            "ground": GROUND,
            "rough ground's seed": f"{setup.seed or 0}",
            "measures": MEASURES,
        },
        verdict=verdict(metrics),
        good=metrics.passed == len(metrics.outcomes),
        rows=manoeuvre_rows(metrics),
        tiles=TILES,
        pictures=(Picture("manoeuvres", caption, manoeuvres_figure(metrics.outcomes)),),
        metrics=metrics,
        results=manoeuvre_results(metrics),
        tables=(manoeuvre_table(metrics),),
    )


# --- How they are run -----------------------------------------------------------------


def level_speed(
    policy: Policy, ramp: Ramp, robot: HardwareSpec, operator: HeadingHold
) -> float:
    """Return the best speed over the track at the top speed's command, m/s; the command
    itself where it fell."""
    [run] = simulate(
        policy, [RunRequest(dash_of(ramp, robot), robot, operator, finish=TRACK)]
    )
    best = best_window(run, 1.0)
    return ramp.target[0] if run.fell_at is not None or best is None else best.speed


def outcome_of(manoeuvre: Manoeuvre, run: Trajectory) -> ManoeuvreOutcome:
    """What became of it; a robot that falls fails."""
    found, fell = manoeuvre.assess(run), run.fell_at is not None
    return ManoeuvreOutcome(
        group=manoeuvre.group,
        asked=manoeuvre.asked,
        rule=manoeuvre.rule,
        did=FELL if fell else found.said,
        passed=found.passed and not fell,
        fell_at=run.fell_at,
        measured=found.measured,
    )


# --- What is shown --------------------------------------------------------------------


FELL = "fell"
LAUNCH_GROUP = "Launch, friction 0.8"


def describe_schedules(cruise: float) -> str:
    """Return what the robot is told, in one line; pushes come at the speed `cruise`,
    m/s."""
    return (
        f"commands rise at {COMMAND_ACCELERATION:g} m/s² where nothing else is said; the top is the command of the "
        f"card's top speed; braking, turns and pushes begin after {STEADY:g} s at their speed, pushes at {cruise:g} "
        f"m/s; straightness, ground and latency: {TRACK:g} m at the top"
    )


GROUND = (
    "slope: gravity tilts, the robot's sensors know the true vertical, heights and falls are over the slope; rough "
    f"ground: heights drawn evenly at points {World.cell:g} m apart, straight between them, the figure from lowest to "
    f"highest, even for {EVEN:g} m around the start; pushes: the whole robot's velocity jumps, in its heading's frame"
)
MEASURES = (
    f"speeds are {RIPPLE:g}-s means, slower than {STOPPED:g} m/s is at rest; yaw rates are means of "
    f"{TURN_TIME:g} s, on the spot of {SLOW_TIME:g} s; chatter: root mean square of torque that varies faster than in "
    f"{CHATTER_WINDOW:g} s; a gyro's heading is off by its bias x time"
)


def summarise(outcomes: Sequence[ManoeuvreOutcome]) -> Tries:
    """Count."""
    passed, fell = (
        sum(flags)
        for flags in zip(
            *((o.passed, o.fell_at is not None) for o in outcomes), strict=True
        )
    )
    return Tries(passed=passed, fell=fell, outcomes=tuple(outcomes))


def share_of(group: Sequence[ManoeuvreOutcome]) -> str:
    """How many passed, in words."""
    return f"{sum(outcome.passed for outcome in group)} of {len(group)}"


def verdict(metrics: Tries) -> str:
    """The sheet in one sentence."""
    falls = (
        "without a fall"
        if metrics.fell == 0
        else "one fall"
        if metrics.fell == 1
        else f"{metrics.fell} falls"
    )
    return f"{metrics.passed} of {len(metrics.outcomes)} manoeuvres passed, {falls}."


def hardest(outcomes: Iterable[ManoeuvreOutcome]) -> str:
    """The hardest try that passed along with all gentler ones."""
    passed = list(itertools.takewhile(lambda outcome: outcome.passed, outcomes))
    return passed[-1].asked if passed else NOT_MEASURED


def manoeuvre_rows(metrics: ManoeuvreMetrics) -> tuple[Row, ...]:
    """A few figures that say most, then every manoeuvre."""
    groups, tries = metrics.groups, len(metrics.outcomes)
    return (
        Row(
            "Passed",
            f"{metrics.passed} of {tries}",
            "tries, each by its rule, as said below",
        ),
        Row("Fell", f"{metrics.fell}", "a robot that falls fails"),
        Row(
            "Hardest stop",
            hardest(groups[f"Brake from {metrics.cruise:g} m/s"]),
            f"from {metrics.cruise:g} m/s",
        ),
        Row(
            "Hardest launch",
            hardest(groups[LAUNCH_GROUP]),
            "to the top, on friction 0.8",
        ),
        Row("Creep", show(_creep(metrics), ".2f", "m"), f"of a stand for {STAND:g} s"),
        Row(
            "Nobody steering",
            show(_astray(metrics), ".1f", "m"),
            f"how far the trunk's edge strays within {TRACK:g} m",
        ),
        *(Row(name, share_of(group), group[0].rule) for name, group in groups.items()),
    )


def manoeuvre_table(metrics: Tries) -> Table:
    """Every try."""
    head = "Manoeuvre", "Asked", "Did", "Fall", "Passed", "Measured, in SI units"
    return Table(
        "Manoeuvres",
        head,
        [
            (
                o.group,
                o.asked,
                o.did,
                show(o.fell_at, ".2f", "s"),
                "yes" if o.passed else "NO",
                _in_words(o.measured),
            )
            for o in metrics.outcomes
        ],
        words=True,
    )


def manoeuvre_results(metrics: ManoeuvreMetrics) -> dict[str, object]:
    """What a policy's card says of them: how many of each passed, and what each try
    did."""
    return rounded(
        {
            "level_speed": metrics.level_speed,
            "passed": metrics.passed,
            "of": len(metrics.outcomes),
            "fell": metrics.fell,
            "creep": _creep(metrics),
            "astray": _astray(metrics),
            "passes": metrics.passes,
            "did": {
                name: {o.asked: o.did for o in group}
                for name, group in metrics.groups.items()
            },
        }
    )


def _creep(metrics: ManoeuvreMetrics) -> float | None:
    return next(
        (
            o.measured.creep
            for o in metrics.outcomes
            if isinstance(o.measured, StandingStill)
        ),
        None,
    )


def _astray(metrics: ManoeuvreMetrics) -> float | None:
    """Without an operator, m."""
    last = [o.measured for o in metrics.outcomes if isinstance(o.measured, Straight)][
        -1
    ]
    return last.reach


def _in_words(measured: Measured) -> str:
    values = vars(measured).items()
    return ", ".join(
        f"{name.replace('_', ' ')} {show(value, '.3g')}" for name, value in values
    )
