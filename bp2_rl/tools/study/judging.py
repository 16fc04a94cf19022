"""Saved policies judged: what each does in C MuJoCo, from a standing start."""

import dataclasses
import datetime
from pathlib import Path

import jax

from bp2_rl.base.folders import folder_names
from bp2_rl.base.serialization import load_config, save_config
from bp2_rl.env.observations import layout_of
from bp2_rl.learning.exports import POLICIES
from bp2_rl.learning.policy import Policy, load_policy
from bp2_rl.robot import specs
from bp2_rl.simulation.bodies import SwiftMachine
from bp2_rl.simulation.metrics import RunMetrics, measure
from bp2_rl.simulation.rollout import rollout_mujoco
from bp2_rl.simulation.schedule import Ramp

JUDGED = "judged.json"
CRUISE = 10.0  # m/s, at which the cost of transport is measured
JUDGED_HOLD = 5.0  # s that each command is held
LADDER = (1.0, 0.8, 0.6)  # commands at which the top speed is looked for, shares of the training's fastest


@dataclasses.dataclass(frozen=True)
class Judgement:
    """What one saved policy does in C MuJoCo, from a standing start."""

    control_steps: int  # of all its training, the stages before included
    weights_sha256: str  # of the policy
    wall_time: float | None  # s, from the start of the stage's process, compilation included; None if it was resumed
    top_speed: float  # m/s, best 1-s mean of the runs under LADDER that held it without a fall; 0 if none did
    falls: int  # of these runs
    cruise_speed: float  # m/s, mean under the command that should make it CRUISE; 0 unless held
    cruise_cost: float | None  # electrical cost of transport there; None unless held within 10 % of CRUISE


@dataclasses.dataclass(frozen=True)
class _Judged:
    """The file beside a run's policies."""

    ladder: tuple[float, ...]
    policies: tuple[Judgement, ...]


def judge(run_dir: Path) -> list[Judgement]:
    """Judge each saved policy of a run, in order, and write `JUDGED` beside them; what is there is not done again."""
    known = {j.weights_sha256: j for j in judgements(run_dir)}
    began = _began(run_dir)
    result = []
    names = (name for name in folder_names(run_dir / POLICIES) if name.isdecimal())
    for name in sorted(names, key=int):
        policy = load_policy(run_dir / POLICIES / name, layout_of=layout_of)
        judgement = known.get(policy.card.weights_sha256)
        if judgement is None:
            made = datetime.datetime.fromisoformat(policy.card.created)
            judgement = _judge(policy, None if began is None else (made - began).total_seconds())
            jax.clear_caches()  # each policy is a program of its own
        result.append(judgement)
    save_config(run_dir / JUDGED, _Judged(LADDER, tuple(result)))
    return result


def judgements(run_dir: Path) -> list[Judgement]:
    """What `judge` has written, if it has."""
    path = run_dir / JUDGED
    if not path.is_file():
        return []
    judged = load_config(_Judged, path)
    return list(judged.policies) if judged.ladder == LADDER else []


def _judge(policy: Policy, wall_time: float | None) -> Judgement:
    top = policy.card.env.commands.max_forward

    def held(speed: float) -> RunMetrics:
        ramp = Ramp((min(speed, top), 0.0, 0.0), hold=JUDGED_HOLD).under(policy.card.env.control)
        return measure(rollout_mujoco(policy, ramp, policy.card.env, machine=SwiftMachine))

    best, falls = 0.0, 0
    for share in LADDER:
        if best >= share * top:
            break  # told so little it will not be faster
        attempt = held(share * top)
        falls += attempt.fell_at is not None
        if attempt.fell_at is None:
            best = max(best, attempt.best_speed or 0.0)
    cruise = held(CRUISE)
    if cruise.fell_at is None and cruise.mean_speed > 0.5 * CRUISE:
        cruise = held(CRUISE**2 / cruise.mean_speed)  # it runs slower than it is told, or faster
    cruising = cruise.fell_at is None and abs(cruise.mean_speed - CRUISE) <= 0.1 * CRUISE
    return Judgement(
        control_steps=policy.card.physics_steps // specs.SUBSTEPS,
        weights_sha256=policy.card.weights_sha256,
        wall_time=wall_time,
        top_speed=best,
        falls=falls,
        cruise_speed=cruise.mean_speed if cruise.fell_at is None else 0.0,
        cruise_cost=cruise.electrical_cost_of_transport if cruising else None,
    )


def _began(run_dir: Path) -> datetime.datetime | None:
    """When the process began that trained a run; None if there were several."""
    output = run_dir.with_suffix(".txt")
    starts = [line for line in output.read_text().splitlines() if " --out " in line or " --resume " in line]
    return datetime.datetime.fromisoformat(starts[0].split()[0]) if len(starts) == 1 else None
