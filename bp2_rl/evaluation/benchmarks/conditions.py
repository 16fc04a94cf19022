"""What a benchmark is run with, and what a reader must know to run it again."""

import jax
import mujoco

from bp2_rl.evaluation.runs.operator import HeadingHold
from bp2_rl.evaluation.runs.rollout import rollout_mjx, rollout_mujoco
from bp2_rl.evaluation.runs.schedule import Ramp
from bp2_rl.learning.policy import Policy

BACKENDS = {"mujoco": rollout_mujoco, "mjx": rollout_mjx}
HELD = "motor torques computed, and checked against the envelope, at the speed at the start of each ms, then held"


def speed_to_command(policy: Policy, benchmark: str = "topspeed") -> float:
    """The command (m/s) under which the card's result was measured: a robot may run slower than it is told.

    A card without a result of this benchmark gives the one of its top speed, one without either the fastest command
    of the training.
    """
    for result in ("commanded_speed", "top_speed"):
        speed = on_card(policy, benchmark, result)
        if speed is not None:
            return speed
    return policy.card.env.commands.max_forward


def on_card(policy: Policy, benchmark: str, result: str) -> float | None:
    """A positive number that a benchmark left on the card, if there is one.

    Results stand under their benchmark's name; what another does not say is topspeed's.
    """
    for group in (policy.card.results.get(benchmark), policy.card.results.get("topspeed")):
        value = group.get(result) if isinstance(group, dict) else None
        if isinstance(value, int | float) and value > 0:
            return float(value)
    return None


def conditions(policy: Policy, schedule: str, simulator: str, operator: HeadingHold) -> dict[str, str]:
    """What a reader must know to do it again, by name."""
    return {
        "schedule": schedule,
        "policy": describe(policy),
        "weights_sha256": policy.card.weights_sha256,
        "simulator": simulator,
        "operator": describe_operator(operator),
    }


def describe(policy: Policy) -> str:
    """The policy in one line."""
    card = policy.card
    return (
        f"{card.stage} stage, {card.physics_steps / 1e6:.3g} M physics steps, seed {card.seed}, {card.created}, "
        f"config {card.config_hash}"
    )


def describe_command(policy: Policy, speed: float) -> str:
    """Who runs at which command, for titles."""
    return f"{policy.card.stage} policy, {speed:g} m/s commanded"


def describe_ramp(ramp: Ramp) -> str:
    """The schedule in one line."""
    return f"from a stand to {ramp.target[0]:g} m/s at {ramp.acceleration:g} m/s², then hold for {ramp.hold:g} s"


def describe_operator(operator: HeadingHold) -> str:
    """The outer loop in one line."""
    if operator.limit == 0:
        return "none: the yaw command is the schedule's"
    return (
        f"yaw-rate command = -{operator.heading_gain:g}/s x heading - {operator.lane_gain:g}/(m s) x offset to the "
        f"left, at most {operator.limit:g} rad/s, on straight commands; sees the true heading and offset, without "
        "noise or delay"
    )


def describe_simulator(backend: str) -> str:
    """The physics of a single run in one line."""
    return {
        "mujoco": f"C MuJoCo {mujoco.__version__}, 1 kHz, float64, solver converged to 1e-10; {HELD}; policy at 200 "
        "Hz, no noise, full strength",
        "mjx": f"MJX {mujoco.__version__} on JAX {jax.__version__}, 1 kHz, float32, the solver settings of training; "
        f"{HELD}; policy at 200 Hz, no noise",
    }[backend]
