"""What a policy is put to: each benchmark runs it under a stated schedule and measures the run."""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import mujoco

from bp2_rl.errors import UserError
from bp2_rl.evaluation.metrics import RunMetrics, measure
from bp2_rl.evaluation.rollout import HEADING_HOLD, HeadingHold, Ramp, rollout_mjx, rollout_mujoco
from bp2_rl.evaluation.trajectory import Trajectory
from bp2_rl.learning.policy import Policy

BACKENDS = {"mujoco": rollout_mujoco, "mjx": rollout_mjx}
HOLD = 20.0  # s at the top speed
ACCELERATION = 2.4  # m/s2; the paper's launch: 2.38


@dataclasses.dataclass(frozen=True)
class Setup:
    """What may be chosen about a benchmark."""

    backend: str = "mujoco"
    speed: float | None = None  # m/s; None: what `speed_to_command` reads from the policy's card
    hold: float = HOLD  # s
    operator: HeadingHold = HEADING_HOLD

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        if self.backend not in BACKENDS:
            raise UserError(f"--backend {self.backend}: there are {' and '.join(BACKENDS)}")
        if self.speed is not None and not (math.isfinite(self.speed) and self.speed > 0):
            raise UserError(f"--speed must be a positive number of m/s, got {self.speed:g}")
        if not (math.isfinite(self.hold) and self.hold > 0):
            raise UserError(f"--hold must be a positive number of seconds, got {self.hold:g}")


class Evaluation(NamedTuple):
    """A benchmark's outcome: what was done, what came out, and the run it came from."""

    benchmark: str
    conditions: dict[str, str]  # what a reader must know to do it again
    metrics: RunMetrics
    trajectory: Trajectory


def topspeed(policy: Policy, setup: Setup) -> Evaluation:
    """From a stand to the commanded speed at 2.4 m/s2, and hold it."""
    env = policy.card.env
    speed = setup.speed if setup.speed is not None else speed_to_command(policy)
    schedule = Ramp((speed, 0.0, 0.0), acceleration=ACCELERATION, hold=setup.hold)
    run = BACKENDS[setup.backend](
        policy, schedule, env, operator=setup.operator, name=f"{policy.card.stage} policy, {speed:g} m/s commanded"
    )
    conditions = {
        "schedule": f"from a stand to {speed:g} m/s at {ACCELERATION:g} m/s², then hold for {setup.hold:g} s",
        "policy": describe(policy),
        "weights_sha256": policy.card.weights_sha256,
        "simulator": _SIMULATORS[setup.backend].format(mujoco=mujoco.__version__, jax=jax.__version__),
        "operator": describe_operator(setup.operator),
    }
    return Evaluation("topspeed", conditions, measure(run), run)


BENCHMARKS: dict[str, Callable[[Policy, Setup], Evaluation]] = {"topspeed": topspeed}


def speed_to_command(policy: Policy) -> float:
    """The command (m/s) under which the card's top speed was measured: a robot may run slower than it is told.

    A card without `commanded_speed` gives its `top_speed`, one without either the fastest command of the training.
    """
    for result in ("commanded_speed", "top_speed"):
        speed = policy.card.results.get(result)
        if isinstance(speed, int | float) and speed > 0:
            return float(speed)
    return policy.card.env.commands.max_forward


def describe(policy: Policy) -> str:
    """The policy in one line."""
    card = policy.card
    return (
        f"{card.stage} stage, {card.physics_steps / 1e6:.3g} M physics steps, seed {card.seed}, {card.created}, "
        f"config {card.config_hash}"
    )


def describe_operator(operator: HeadingHold) -> str:
    """The outer loop in one line."""
    if operator.limit == 0:
        return "none: the yaw command is the schedule's"
    return (
        f"yaw-rate command = -{operator.heading_gain:g}/s x heading - {operator.lane_gain:g}/(m s) x offset to the "
        f"left, at most {operator.limit:g} rad/s, on straight commands"
    )


_SIMULATORS = {
    "mujoco": "C MuJoCo {mujoco}, 1 kHz, float64, solver converged to 1e-10; policy at 200 Hz, no noise, full strength",
    "mjx": "MJX {mujoco} on JAX {jax}, 1 kHz, float32, the solver settings of training; policy at 200 Hz, no noise",
}
