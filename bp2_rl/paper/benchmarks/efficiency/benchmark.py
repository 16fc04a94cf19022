"""The efficiency benchmark: cost of transport over speed, and where the energy goes.

The paper prints no cost of transport. It says that all motors work within their
high-efficiency regions, and that the springs relieve them; both are asked here.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.metric import table_of
from bp2_rl.base.plotting import FALL, INK, LEG_COLORS, WIDTH, styled
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
from bp2_rl.paper.benchmarks.efficiency.measured import (
    EfficiencyAtSpeed,
    EfficiencyMetrics,
    Energy,
    measure_energy,
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
from bp2_rl.robot import bp2
from bp2_rl.simulation.account import replay
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import Trajectory

# m/s, commands, and the top one
SPEEDS = 2.0, 4.0, 6.0, 8.0, bp2.OUTDOOR_TOP_SPEED, 12.0, 14.0
SHORT = (bp2.OUTDOOR_TOP_SPEED,)  # in the quick version
HOLD, QUICK_HOLD = 10.0, 3.0  # s
TILES = "Mechanical cost", "Electrical cost", "All returned", "Spring share"
PART = "accounted for are the whole strides of that, but of its first 1.5 s at the most"
CAPTION = (
    "A: costs of transport over speed. The band is what becomes of the motors' braking: from all of it lost (upper "
    "edge) to all of it returned (lower). B: where the energy goes if all is returned. C: what springs give of what "
    "springs and motors give, and the motors' efficiency while they drive."
)
CAUSE_COLORS = {
    "copper": "#D55E00",
    "gears": "#E69F00",
    "joints": "#F5CE7A",
    "slides": "#56B4E9",
    "dampers": "#0072B2",
    "air": "#CC79A7",
    "ground": "#009E73",
    "stops": "#6E7781",
    "legs": "#1F2328",
}
POLICY = LEG_COLORS["FR"]


def efficiency(policy: Policy, ramp: Ramp, setup: DeepSetup) -> Evaluation:
    """Run a policy at each speed, and evaluate its cost of transport and energy
    losses."""
    commands = commands_below(SHORT if setup.quick else SPEEDS, ramp.target[0])
    ran = run_speeds(account_energy, policy, ramp, commands, setup)
    metrics = EfficiencyMetrics(tuple(ran))
    found = metrics.found
    tables = [
        metrics_table("At each speed; costs are power / (m g v)", found),
        shares_table(
            "Where the work goes, as cost of transport",
            found,
            [e.lost for _, e in found],
        ),
    ]
    pictures = []
    if found:
        paper = " and ".join(f"{power:g}" for power in bp2.HIND_PEAK_POWERS)
        title = f"One motor at the top speed (paper, hind legs: peaks of {paper} W)"
        tables.append(table_of(title, found[-1][1].joints))
        pictures.append(Picture("efficiency", CAPTION, draw_efficiency(metrics)))
    return Evaluation(
        benchmark="efficiency",
        subject=describe_subject(policy, setup),
        backend="C MuJoCo",
        conditions=conditions(
            policy,
            describe_speeds(ramp, commands, PART),
            describe_simulator("mujoco", robot_of(policy, setup)),
            setup,
        ),
        verdict=say_cost(metrics),
        good=len(found) == len(ran),
        rows=rows_over_speed(ran, found),
        tiles=TILES,
        pictures=tuple(pictures),
        metrics=metrics,
        results=card_over_speed(ran, found),
        tables=tuple(tables),
    )


def ramp_to_efficiency(policy: Policy, setup: DeepSetup) -> Ramp:
    """Return the command's ramp to the top speed, held for `HOLD` s by default, or
    `QUICK_HOLD` in the quick version."""
    return ramp_to_topspeed(policy, setup, hold=QUICK_HOLD if setup.quick else HOLD)


def account_energy(ramp: Ramp, run: Trajectory) -> EfficiencyAtSpeed:
    """Return the speed and the energy balance of a run's whole strides at the held
    command."""
    chosen = steady_strides(run, ramp)
    part, strides = chosen or (run, 0)
    energy = measure_energy(part, replay(part)[0], strides) if chosen else None
    speed = float(np.mean(part.ground_velocity[:, 0]))
    return EfficiencyAtSpeed(ramp.target[0], speed, run.fell_at, energy)


def say_cost(metrics: EfficiencyMetrics) -> str:
    """Return a sentence with the fastest run's mechanical and electrical cost of
    transport."""
    if not metrics.found:
        return "No speed was run through: nothing to account for."
    at, energy = metrics.found[-1]
    electrical = energy.electrical
    return (
        f"{at.speed:.1f} m/s cost {energy.positive:.2f} of m g d in work, and {electrical.everything:.2f} to "
        f"{electrical.nothing:.2f} of the battery."
    )


@styled
def draw_efficiency(metrics: EfficiencyMetrics) -> Figure:
    """Draw over speed the cost of transport, the energy losses by cause, the springs'
    share and the motors' efficiency."""
    figure = Figure(figsize=(1.3 * WIDTH, 4.0), layout="constrained")
    costs, causes, shares = figure.subplots(1, 3)
    speeds = [at.speed for at, _ in metrics.found]
    energies = [energy for _, energy in metrics.found]
    _draw_costs(costs, speeds, energies)
    lost = [energy.lost for energy in energies]
    happens = {
        c: color for c, color in CAUSE_COLORS.items() if any(e[c] > 0.0 for e in lost)
    }
    draw_stacks(causes, speeds, lost, happens)
    causes.set(title="Where it goes", ylabel="Power / (m g v)")
    draw_lines(
        shares,
        speeds,
        [
            Line("springs' share", [e.spring_share for e in energies], INK),
            Line("motors' efficiency, driving", [e.efficiency for e in energies], FALL),
        ],
    )
    shares.set(title="Springs and motors", ylabel="Share", ylim=(0.0, 1.0))
    letter([costs, causes, shares])
    return figure


def _draw_costs(axes: Axes, speeds: list[float], energies: list[Energy]) -> None:
    least = [e.electrical.everything for e in energies]
    most = [e.electrical.nothing for e in energies]
    axes.fill_between(speeds, least, most, color=FALL, alpha=0.18, linewidth=0)
    half = [e.electrical.half for e in energies]
    shared = [e.electrical.bus for e in energies]
    lines = [
        Line("electrical, half returned", half, FALL),
        Line("shared by motors", shared, FALL, "--"),
        Line("mechanical", [e.positive for e in energies], POLICY),
        Line("mechanical, net", [e.net for e in energies], POLICY, "--"),
    ]
    draw_lines(axes, speeds, lines)
    axes.set(title="Cost of transport", ylabel="Power / (m g v)")
    axes.set_ylim(0.0, 1.35 * max(most))
