"""Where a policy that passes the pushes and the rough ground of the manoeuvres may
still fall: harder ones, many.

Pushes come at eight phases of the stride, for a robot may bear at one touchdown what
fells it at the next.
"""

import functools
import math
from collections.abc import Iterator

from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    cruising_speed,
    describe_simulator,
    describe_subject,
    robot_of,
)
from bp2_rl.evaluation.benchmarks.manoeuvres import rules
from bp2_rl.evaluation.benchmarks.manoeuvres.benchmark import (
    Tries,
    manoeuvre_table,
    outcome_of,
    share_of,
    summarise,
)
from bp2_rl.evaluation.benchmarks.manoeuvres.figure import manoeuvres_figure
from bp2_rl.evaluation.benchmarks.manoeuvres.tasks import (
    AFTER_PUSH,
    ARROWS,
    STEADY,
    Make,
    Manoeuvre,
    run_up,
)
from bp2_rl.evaluation.benchmarks.options import Setup
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture, Row, rounded
from bp2_rl.evaluation.benchmarks.topspeed import ramp_to_topspeed
from bp2_rl.learning.policy import Policy
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import COMMAND_ACCELERATION, Course, Ramp
from bp2_rl.simulation.world import EVEN, Push, World

PHASES = 8  # of a stride
SHOVE, TURN = 1.5, 0.5  # m/s and rad/s of BP2
ROUGHNESS = 0.05  # m of BP2
CELLS = 0.1, 0.2, 0.4  # m of BP2
SEEDS = 5  # grounds of each cell
CROSSING = 6.0  # s, over rough ground at the speed
RULE = "no fall; shown: off the line"
GROUND = (
    "rough ground: heights drawn evenly at points, straight between them, the figure from lowest to highest, even for "
    f"{EVEN:g} m around the start; pushes: the whole robot's velocity and yaw rate jump, in its heading's frame"
)
CAPTION = (
    "A row a phase of the stride, or a kind of ground; a cell a try: where the push goes, ahead is up, and how far the "
    "robot went off its line. Red: it fell."
)


def disturbances(policy: Policy, ramp: Ramp, setup: Setup) -> Evaluation:
    """Push the robot, and let it run over rough ground, at its cruising speed."""
    robot, speed = robot_of(policy, setup), ramp.target[0]
    steady = run_up(speed)
    [calm] = simulate(
        policy, [RunRequest(steady.hold(AFTER_PUSH), robot, setup.operator)]
    )
    stride = 1.0 / (calm.metrics.stride_frequency or math.inf)
    asked = all_disturbances(speed, stride, robot, setup.operator, setup.seed or 0)
    tries = summarise(simulate_all(outcome_of, policy, asked))
    told = (
        f"commands rise to {speed:g} m/s at {COMMAND_ACCELERATION:g} m/s²; pushes after {STEADY:g} s there, of "
        f"{SHOVE * robot.size.speed:.3g} m/s and {TURN * robot.size.rate:.3g} rad/s"
    )
    said = conditions(policy, told, describe_simulator("mujoco", robot), setup)
    return Evaluation(
        benchmark="disturbances",
        subject=describe_subject(policy, setup),
        backend="C MuJoCo",
        conditions=said
        | {
            "ground": GROUND,
            "rough ground's seeds": f"{setup.seed or 0} and the next {SEEDS - 1}",
        },
        verdict=f"{tries.passed} of {len(tries.outcomes)} disturbances without a fall.",
        good=tries.fell == 0,
        rows=_rows(tries),
        tiles=("Without a fall", "Pushes", "Rough ground"),
        pictures=(Picture("disturbances", CAPTION, manoeuvres_figure(tries.outcomes)),),
        metrics=tries,
        results=rounded(
            {"of": len(tries.outcomes), "passed": tries.passed, "passes": tries.passes}
        ),
        tables=(manoeuvre_table(tries),),
    )


def ramp_to_disturbances(policy: Policy, setup: Setup) -> Ramp:
    """The schedule over rough ground: of BP2 the same for every policy, so that they
    can be compared."""
    return ramp_to_topspeed(policy, setup, speed=cruising_speed(policy), hold=CROSSING)


def all_disturbances(
    speed: float, stride: float, robot: HardwareSpec, operator: HeadingHold, seed: int
) -> tuple[Manoeuvre, ...]:
    """Every one, in the order of the report.

    Args:
        speed: m/s, held.
        stride: s, one at this speed.
        robot: the robot.
        operator: who keeps it straight.
        seed: of the first rough ground.
    """
    of = functools.partial(
        Manoeuvre,
        hardware=robot,
        operator=operator,
        rule=RULE,
        assess=rules.assess_push,
    )
    return (
        *_pushes(of, run_up(speed), stride, robot),
        *_rough_ground(of, speed, robot, seed),
    )


def _pushes(
    of: Make, steady: Course, stride: float, robot: HardwareSpec
) -> Iterator[Manoeuvre]:
    shove, turn = SHOVE * robot.size.speed, TURN * robot.size.rate
    for phase in range(PHASES):
        for way, sign in (("left", 1.0), ("right", -1.0)):
            for i, arrow in enumerate(ARROWS):
                angle, time = (
                    math.tau * i / len(ARROWS),
                    steady.duration + phase * stride / PHASES,
                )
                push = Push(
                    time, shove * math.cos(angle), shove * math.sin(angle), sign * turn
                )
                yield of(
                    steady.hold(AFTER_PUSH + stride),
                    group=f"Push {phase}/{PHASES}, turning {way}",
                    asked=arrow,
                    world=World(pushes=(push,)),
                )


def _rough_ground(
    of: Make, speed: float, robot: HardwareSpec, seed: int
) -> Iterator[Manoeuvre]:
    height, *cells = (
        float(f"{robot.size.length * length:.2g}") for length in (ROUGHNESS, *CELLS)
    )
    for cell in cells:
        for drawn in range(seed, seed + SEEDS):
            yield of(
                Ramp(speed, hold=CROSSING),
                group=f"{100 * height:g} cm, points {cell:g} m apart",
                asked=f"ground {drawn}",
                world=World(roughness=height, cell=cell, seed=drawn),
            )


def _rows(tries: Tries) -> tuple[Row, ...]:
    pushes, grounds = (
        [o for o in tries.outcomes if o.group.startswith("Push") is push]
        for push in (True, False)
    )
    return (
        Row("Without a fall", f"{tries.passed} of {len(tries.outcomes)}", "of all"),
        Row(
            "Pushes",
            share_of(pushes),
            f"at {PHASES} phases of a stride, from {len(ARROWS)} sides",
        ),
        Row("Rough ground", share_of(grounds), f"{CROSSING:g} s at the speed"),
        *(Row(name, passes, RULE) for name, passes in tries.passes.items()),
    )
