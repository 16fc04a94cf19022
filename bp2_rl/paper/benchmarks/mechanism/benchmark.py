"""The mechanism benchmark: how far other limbs' inertia balances the hips' inertial
torque in a policy's gait.

The paper has it that coupling between limbs relieves the motors. In the equations of
motion that is a question of source: of the inertial torque at a hip that other
coordinates' accelerations make up for, what is the leg's own, and what comes from other
legs through the trunk?
"""

import itertools

import numpy as np
from matplotlib.figure import Figure

from bp2_rl.base.plotting import INK, LEG_COLORS, WIDTH, styled
from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    describe_simulator,
    describe_subject,
    robot_of,
)
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture
from bp2_rl.evaluation.benchmarks.run import ramp_to_topspeed
from bp2_rl.learning.policy import Policy
from bp2_rl.optimiser.figure import letter
from bp2_rl.paper.benchmarks.mechanism.forces import (
    STRIDES,
    MechanismAtSpeed,
    MechanismMetrics,
    decompose_run,
    measure_forces,
)
from bp2_rl.paper.benchmarks.options import DeepSetup
from bp2_rl.paper.benchmarks.speeds import (
    Line,
    card_over_speed,
    commands_below,
    describe_speeds,
    draw_lines,
    draw_stacks,
    metrics_table,
    rows_over_speed,
    run_speeds,
    shares_table,
    steady_strides,
)
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import Trajectory

SPEEDS = 3.0, 5.5, 8.0, 10.74  # m/s, commands, and the top one
SHORT = (8.0,)  # in the quick version
HOLD = 5.0  # s
SMALL = 5.0  # %, of a hip's main torque: what other legs cover is small below
TILES = "Covered", "By the leg itself", "By other legs", "Trunk saves, hips", "Closure"
PART = f"looked at are the last whole strides of that, at most {STRIDES}"
CAPTION = (
    "A: what covers the hips' main inertial torque at its peaks. B: what other legs give of it. C: the hips' and "
    "knees' greatest torque (u), and the same on a trunk that is not accelerated (ũ); both with what gears give when "
    "they brake."
)
SOURCE_COLORS = {
    "other joint": "#D55E00",
    "spring": "#F2A65A",
    "abduction": "#CC79A7",
    "trunk": INK,
}
PAIR_COLORS = {"same pair": "#009E73", "other pair": "#56B4E9"}


def mechanism(policy: Policy, ramp: Ramp, setup: DeepSetup) -> Evaluation:
    """Run a policy at each speed, and split the joints' inertial torques by source."""
    commands = commands_below(SHORT if setup.quick else SPEEDS, ramp.target[0])
    ran = run_speeds(decompose, policy, ramp, commands, setup)
    metrics = MechanismMetrics(tuple(ran))
    found = metrics.found
    within, through = [f.within for _, f in found], [f.through for _, f in found]
    tables = [
        metrics_table("At each speed", found),
        shares_table("Of the hips' main torque at its peaks, by source", found, within),
        shares_table("... the trunk's part, by what accelerates it", found, through),
    ]
    pictures = []
    if found:
        pictures.append(Picture("sources", CAPTION, draw_sources(metrics)))
    closure = {"closure": max((f.closure for _, f in found), default=None)}
    return Evaluation(
        benchmark="mechanism",
        subject=describe_subject(policy, setup),
        backend="C MuJoCo",
        conditions=conditions(
            policy,
            describe_speeds(ramp, commands, PART),
            describe_simulator("mujoco", robot_of(policy, setup)),
            setup,
        ),
        verdict=say_coverage(metrics),
        good=len(found) == len(ran),
        rows=rows_over_speed(ran, found),
        tiles=TILES,
        pictures=tuple(pictures),
        metrics=metrics,
        results=card_over_speed(ran, found) | closure,
        tables=tuple(tables),
    )


def ramp_to_mechanism(policy: Policy, setup: DeepSetup) -> Ramp:
    """Return the command's ramp to the top speed, held for `HOLD` s by default."""
    return ramp_to_topspeed(policy, setup, hold=HOLD)


def decompose(ramp: Ramp, run: Trajectory) -> MechanismAtSpeed:
    """Return the speed of a run's last strides, and their inertial torques split by
    source."""
    chosen = steady_strides(run, ramp, STRIDES)
    part, strides = chosen or (run, 0)
    forces = measure_forces(decompose_run(part), strides, run.dt) if chosen else None
    speed = float(np.mean(part.ground_velocity[:, 0]))
    return MechanismAtSpeed(ramp.target[0], speed, run.fell_at, forces)


def say_coverage(metrics: MechanismMetrics) -> str:
    """Return a sentence on how much of the hips' main inertial torque coupling
    balances."""
    if not metrics.found:
        return "No speed was run through: nothing to take apart."
    own = [100.0 * forces.own for _, forces in metrics.found]
    legs = [100.0 * forces.legs for _, forces in metrics.found]
    small = "small" if max(map(abs, legs)) < SMALL else "not small"
    return f"Within a leg coupling covers {_span(own, '.0f')} %, between legs {_span(legs, '+.1f')} %: {small}."


def _span(values: list[float], form: str) -> str:
    least, greatest = (format(end(values), form) for end in (min, max))
    return least if least == greatest else f"{least} to {greatest}"


@styled
def draw_sources(metrics: MechanismMetrics) -> Figure:
    """Draw over speed what balances the hips' main inertial torque, and the torque that
    the trunk's motion saves."""
    figure = Figure(figsize=(WIDTH, 4.0), layout="constrained")
    shares, legs, torques = figure.subplots(1, 3, width_ratios=(1.4, 1.0, 1.0))
    speeds = [at.speed for at, _ in metrics.found]
    found = [forces for _, forces in metrics.found]
    trunk = [{"trunk": forces.covered - forces.own} for forces in found]
    by_source = [f.within | rest for f, rest in zip(found, trunk, strict=True)]
    draw_stacks(shares, speeds, by_source, SOURCE_COLORS)
    shares.set(title="Covered, by source", ylabel="Share of main torque")
    draw_stacks(legs, speeds, [forces.through for forces in found], PAIR_COLORS)
    legs.set(title="Covered by other legs")
    styles = itertools.product((LEG_COLORS["FR"], LEG_COLORS["RR"]), ("o-", "--"))
    lines = [
        Line(name, [forces.torques[name] for forces in found], *style)
        for name, style in zip(found[0].torques, styles, strict=True)
    ]
    draw_lines(torques, speeds, lines)
    torques.set(title="Greatest torque", ylabel="Torque [Nm]", ylim=(0.0, None))
    letter([shares, legs, torques])
    return figure
