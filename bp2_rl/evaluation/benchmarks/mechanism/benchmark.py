"""Whose inertia balances whose in the gait that the policy really runs, at five speeds, beside the optimiser's.

The paper has it that coupling between limbs relieves the motors. In the equations of motion that is a question of
source: of the inertial torque at a hip that other coordinates' accelerations make up for, what is the leg's own, and
what comes from other legs through the trunk?
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from bp2_rl.errors import UserError
from bp2_rl.evaluation.benchmarks.conditions import conditions, describe_command, describe_simulator, robot_of
from bp2_rl.evaluation.benchmarks.mechanism import figures
from bp2_rl.evaluation.benchmarks.mechanism.measured import (
    LEG,
    AtSpeed,
    MechanismMetrics,
    Optimiser,
    Ran,
    measure_forces,
    whole_strides,
)
from bp2_rl.evaluation.benchmarks.mechanism.tables import (
    TILES,
    describe_runs,
    mechanism_results,
    mechanism_rows,
    mechanism_tables,
    verdict,
)
from bp2_rl.evaluation.benchmarks.options import Setup
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture
from bp2_rl.evaluation.benchmarks.topspeed import ramp_to_topspeed
from bp2_rl.evaluation.runs.forces import HIPS_AND_KNEES, decompose_run
from bp2_rl.evaluation.runs.operator import HeadingHold
from bp2_rl.evaluation.runs.parallel import in_parallel
from bp2_rl.evaluation.runs.rollout import rollout_mujoco
from bp2_rl.evaluation.runs.schedule import Ramp
from bp2_rl.gait.collocation.file import load_library
from bp2_rl.learning.policy import Policy
from bp2_rl.robot.specs import HardwareSpec
from bp2_rl.settings.gait import CollocationConfig
from bp2_rl.trajopt.coupling_account import CouplingAccount, account_coupling
from bp2_rl.trajopt.family import family_of

SPEEDS = 3.0, 5.5, 8.0, 10.74  # m/s, commands, and the top one
SHORT = (8.0,)  # in the quick version
HOLD = 5.0  # s
EASING = 1.5  # s of the hold that are not looked at


class Try(NamedTuple):
    """One run."""

    ramp: Ramp
    operator: HeadingHold
    robot: HardwareSpec


def mechanism(policy: Policy, ramp: Ramp, setup: Setup) -> Evaluation:
    """Run all speeds and take their forces apart."""
    robot, top = robot_of(policy, setup), ramp.target[0]
    commands = (*(speed for speed in (SHORT if setup.quick else SPEEDS) if speed < top), top)
    tries = [Try(dataclasses.replace(ramp, target=(speed, 0.0, 0.0)), setup.operator, robot) for speed in commands]
    longest_first = in_parallel(run_and_decompose, policy, tries[::-1])
    ran = longest_first[::-1]
    found = tuple(each.at for each in ran)
    metrics = MechanismMetrics(found, optimised([at.speed for at in found if at.forces is not None]))
    said = conditions(policy, describe_runs(ramp, commands), describe_simulator("mujoco", robot), setup)
    pictures = [Picture("sources", figures.SOURCES, figures.sources_figure(metrics))] if metrics.decomposed else []
    if metrics.decomposed:
        fastest = next(each for each in ran[::-1] if each.stride is not None)
        pictures.append(Picture("terms", figures.TERMS_CAPTION, figures.terms_figure(metrics, fastest)))
    return Evaluation(
        benchmark="mechanism",
        subject=describe_command(policy, setup, top),
        backend="C MuJoCo",
        conditions=said,
        verdict=verdict(metrics),
        good=all(at.forces is not None for at in metrics.speeds),
        rows=mechanism_rows(metrics),
        tiles=TILES,
        pictures=tuple(pictures),
        metrics=metrics,
        results=mechanism_results(metrics),
        tables=mechanism_tables(metrics),
    )


def ramp_to_mechanism(policy: Policy, setup: Setup) -> Ramp:
    """The schedule to the top speed."""
    return ramp_to_topspeed(policy, dataclasses.replace(setup, hold=setup.hold or HOLD))


def run_and_decompose(policy: Policy, one: Try) -> Ran:
    """Run one speed and take the last strides of its hold apart."""
    run = rollout_mujoco(policy, one.ramp, policy.card.env, operator=one.operator, hardware=one.robot)
    command = one.ramp.target[0]
    steady = one.ramp.steady_from + min(EASING, 0.5 * one.ramp.hold)
    end = len(run) * run.dt
    chosen = whole_strides(run.between(steady, end)) if run.fell_at is None and end - steady > 2 * run.dt else None
    if chosen is None:
        return Ran(AtSpeed(command, float(np.mean(run.ground_velocity[:, 0])), run.fell_at, None), None)
    part, strides = chosen
    forces = decompose_run(part)
    at = AtSpeed(command, float(np.mean(part.ground_velocity[:, 0])), None, measure_forces(forces, strides, run.dt))
    hip = HIPS_AND_KNEES[2 * LEG]
    return Ran(at, forces.terms[:, -(len(part) // strides) :, [2, hip, hip + 1]])


def optimised(speeds: list[float]) -> tuple[Optimiser, ...]:
    """The shipped library at the speeds nearest to these; nothing where CasADi is not installed."""
    library = load_library(CollocationConfig().file)
    family = family_of(library.arrays, library.provenance)
    try:
        return tuple(
            _of_account(account_coupling(min(family, key=lambda s: abs(s.problem.speed - speed)))) for speed in speeds
        )
    except UserError:  # that is what a missing CasADi is
        return ()


def _of_account(account: CouplingAccount) -> Optimiser:
    joint, spring, *trunk = account.within.values()
    hips = [torque for name, torque in account.torques.items() if name.endswith("hip")]
    return Optimiser(
        account.speed,
        account.covered,
        joint,
        spring,
        account.through["same pair"] + account.through["other pair"],
        sum(trunk),
        max(torque.peak for torque in hips),
        max(torque.fixed_peak for torque in hips),
    )
