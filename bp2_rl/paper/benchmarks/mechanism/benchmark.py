"""The mechanism benchmark: how far other limbs' inertia balances the hips' inertial
torque in a policy's gait.

The paper has it that coupling between limbs relieves the motors. In the equations of
motion that is a question of source: of the inertial torque at a hip that other
coordinates' accelerations make up for, what is the leg's own, and what comes from other
legs through the trunk?
"""

import itertools

from matplotlib.figure import Figure

from bp2_rl.base.metric import Table
from bp2_rl.base.plotting import INK, LEG_COLORS, WIDTH, styled
from bp2_rl.optimiser.figure import letter
from bp2_rl.paper.benchmarks.mechanism.forces import (
    STRIDES,
    Decomposed,
    MechanismAtSpeed,
    MechanismMetrics,
    decompose_run,
    measure_forces,
)
from bp2_rl.paper.benchmarks.speeds import (
    Line,
    SpeedBenchmark,
    draw_lines,
    draw_stacks,
    metrics_table,
    shares_table,
)
from bp2_rl.simulation.trajectory import Trajectory

SMALL = 5.0  # %, of a hip's main torque: what other legs cover is small below
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


def measure_mechanism(strides: Trajectory, count: int) -> Decomposed:
    """Take the forces of whole strides apart."""
    return measure_forces(decompose_run(strides), count, strides.dt)


def tabulate_mechanism(metrics: MechanismMetrics) -> list[Table]:
    """Return the tables of all metrics, and of the hips' main torque by source."""
    found = metrics.found
    within = [forces.within for _, forces in found]
    through = [forces.through for _, forces in found]
    return [
        metrics_table("At each speed", found),
        shares_table("Of the hips' main torque at its peaks, by source", found, within),
        shares_table("... the trunk's part, by what accelerates it", found, through),
    ]


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


def greatest_gap(metrics: MechanismMetrics) -> dict[str, float | None]:
    """Return the largest closure at any speed."""
    return {"closure": max((f.closure for _, f in metrics.found), default=None)}


MECHANISM = SpeedBenchmark(
    name="mechanism",
    speeds=(3.0, 5.5, 8.0, 10.74),
    short=(8.0,),
    holds=(5.0, 5.0),
    most=STRIDES,
    part=f"looked at are the last whole strides of that, at most {STRIDES}",
    measure=measure_mechanism,
    at_speed=MechanismAtSpeed,
    gather=MechanismMetrics,
    say=say_coverage,
    tiles=(
        "Covered",
        "By the leg itself",
        "By other legs",
        "Trunk saves, hips",
        "Closure",
    ),
    tabulate=tabulate_mechanism,
    picture=("sources", CAPTION),
    draw=draw_sources,
    card=greatest_gap,
)
