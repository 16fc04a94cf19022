"""Whose inertia balances whose in the gait that the policy really runs, at five speeds,
beside the optimiser's.

The paper has it that coupling between limbs relieves the motors. In the equations of
motion that is a question of
source: of the inertial torque at a hip that other coordinates' accelerations make up
for, what is the leg's own, and what comes from other legs through the trunk?
"""

import numpy as np

from bp2_rl.base.errors import UserError
from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    describe_simulator,
    describe_subject,
    robot_of,
)
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture
from bp2_rl.evaluation.benchmarks.run import ramp_to_topspeed
from bp2_rl.learning.policy import Policy
from bp2_rl.paper.benchmarks.mechanism import figures, tables
from bp2_rl.paper.benchmarks.mechanism.forces import HIPS_AND_KNEES, decompose_run
from bp2_rl.paper.benchmarks.mechanism.measured import (
    STRIDES,
    MechanismAtSpeed,
    MechanismMetrics,
    MechanismRun,
    OptimisedMechanism,
    measure_forces,
)
from bp2_rl.paper.benchmarks.options import DeepSetup
from bp2_rl.paper.benchmarks.speeds import (
    LEG,
    commands_below,
    nearest_solutions,
    run_speeds,
    steady_strides,
)
from bp2_rl.paper.trajectories.coupling_account import CouplingAccount, account_coupling
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import Trajectory

SPEEDS = 3.0, 5.5, 8.0, 10.74  # m/s, commands, and the top one
SHORT = (8.0,)  # in the quick version
HOLD = 5.0  # s


def mechanism(policy: Policy, ramp: Ramp, setup: DeepSetup) -> Evaluation:
    """Run all speeds and take their forces apart."""
    robot, top = robot_of(policy, setup), ramp.target[0]
    commands = commands_below(SHORT if setup.quick else SPEEDS, top)
    ran = run_speeds(decompose, policy, ramp, commands, setup)
    found = tuple(each.at for each in ran)
    metrics = MechanismMetrics(
        found, optimised([at.speed for at in found if at.forces is not None])
    )
    said = conditions(
        policy,
        tables.describe_runs(ramp, commands),
        describe_simulator("mujoco", robot),
        setup,
    )
    pictures = (
        [Picture("sources", figures.SOURCES, figures.sources_figure(metrics))]
        if metrics.decomposed
        else []
    )
    if metrics.decomposed:
        fastest = next(each for each in ran[::-1] if each.stride is not None)
        pictures.append(
            Picture(
                "terms", figures.TERMS_CAPTION, figures.terms_figure(metrics, fastest)
            )
        )
    return Evaluation(
        benchmark="mechanism",
        subject=describe_subject(policy, setup),
        backend="C MuJoCo",
        conditions=said,
        verdict=tables.verdict(metrics),
        good=all(at.forces is not None for at in metrics.speeds),
        rows=tables.mechanism_rows(metrics),
        tiles=tables.TILES,
        pictures=tuple(pictures),
        metrics=metrics,
        results=tables.mechanism_results(metrics),
        tables=tables.mechanism_tables(metrics),
    )


def ramp_to_mechanism(policy: Policy, setup: DeepSetup) -> Ramp:
    """The schedule to the top speed."""
    return ramp_to_topspeed(policy, setup, hold=HOLD)


def decompose(ramp: Ramp, run: Trajectory) -> MechanismRun:
    """Take the last strides of a run's hold apart."""
    command = ramp.target[0]
    if (chosen := steady_strides(run, ramp, STRIDES)) is None:
        return MechanismRun(
            MechanismAtSpeed(
                command, float(np.mean(run.ground_velocity[:, 0])), run.fell_at, None
            ),
            None,
        )
    part, strides = chosen
    forces = decompose_run(part)
    at = MechanismAtSpeed(
        command,
        float(np.mean(part.ground_velocity[:, 0])),
        None,
        measure_forces(forces, strides, run.dt),
    )
    hip = HIPS_AND_KNEES[2 * LEG]
    return MechanismRun(
        at, forces.terms[:, -(len(part) // strides) :, [2, hip, hip + 1]]
    )


def optimised(speeds: list[float]) -> tuple[OptimisedMechanism, ...]:
    """The shipped library at the speeds nearest to these; nothing where CasADi is not
    installed."""
    solutions = nearest_solutions(speeds)
    try:
        return tuple(_of_account(account_coupling(solution)) for solution in solutions)
    except UserError:  # that is what a missing CasADi is
        return ()


def _of_account(account: CouplingAccount) -> OptimisedMechanism:
    joint, spring, *trunk = account.within.values()
    hips = [torque for name, torque in account.torques.items() if name.endswith("hip")]
    return OptimisedMechanism(
        account.speed,
        account.covered,
        joint,
        spring,
        account.through["same pair"] + account.through["other pair"],
        sum(trunk),
        max(torque.peak for torque in hips),
        max(torque.fixed_peak for torque in hips),
    )
