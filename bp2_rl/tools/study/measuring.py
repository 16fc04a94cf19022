"""Measure a run's saved policies: what each does in C MuJoCo, from a standing start."""

import dataclasses
from pathlib import Path

from bp2_rl.base.serialization import load_config, save_config
from bp2_rl.env.observations import layout_of
from bp2_rl.evaluation.judge import JUDGED_LAUNCHES, measure_launches
from bp2_rl.learning.judged import exported_steps, policy_folder
from bp2_rl.learning.policy import Policy, load_policy
from bp2_rl.robot import conventions

MEASURED = "measured.json"
# commands under which a policy is launched, shares of the training's fastest
LADDER = (1.0, 0.8, 0.6)


@dataclasses.dataclass(frozen=True)
class PolicyMeasurement:
    """What one saved policy does in C MuJoCo, from a standing start."""

    control_steps: int  # of all its training, the stages before included
    weights_sha256: str  # of the policy
    top_speed: float  # m/s, best of the launches under LADDER; 0 if all fell
    falls: int  # launches that ended in a fall


@dataclasses.dataclass(frozen=True)
class _Measured:
    """The file beside a run's policies."""

    ladder: tuple[float, ...]
    policies: tuple[PolicyMeasurement, ...]


def measure_policies(run_dir: Path) -> list[PolicyMeasurement]:
    """Measure each saved policy of a run in order, and write `MEASURED` beside them;
    measure no policy twice."""
    known = {one.weights_sha256: one for one in read_measurements(run_dir)}
    result: list[PolicyMeasurement] = []
    for steps in exported_steps(run_dir):
        policy = load_policy(policy_folder(run_dir, steps), layout_of=layout_of)
        measurement = known.get(policy.card.weights_sha256)
        if measurement is None:
            measurement = _measure(policy)
        result.append(measurement)
    save_config(run_dir / MEASURED, _Measured(LADDER, tuple(result)))
    return result


def read_measurements(run_dir: Path) -> list[PolicyMeasurement]:
    """Return what `measure_policies` has written; empty where there is nothing yet."""
    path = run_dir / MEASURED
    if not path.is_file():
        return []
    measured = load_config(_Measured, path)
    return list(measured.policies) if measured.ladder == LADDER else []


def _measure(policy: Policy) -> PolicyMeasurement:
    env, best, falls = policy.card.env, 0.0, 0
    for share in LADDER:
        if best >= share * env.commands.max_forward:
            break  # a slower command makes no faster run
        asked = dataclasses.replace(JUDGED_LAUNCHES[0], share=share, noise_seed=None)
        [launch] = measure_launches(policy, env, [asked])
        falls += launch.fell
        best = max(best, launch.best_speed)
    return PolicyMeasurement(
        control_steps=policy.card.physics_steps // conventions.SUBSTEPS,
        weights_sha256=policy.card.weights_sha256,
        top_speed=best,
        falls=falls,
    )
