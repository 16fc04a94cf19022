"""The efficiency benchmark: cost of transport over speed, and where the energy goes.

The paper prints no cost of transport. It says that all motors work within their
high-efficiency regions, and that the springs relieve them; both are asked here.
"""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.metric import Table, table_of
from bp2_rl.base.plotting import FALL, INK, LEG_COLORS, WIDTH, styled
from bp2_rl.optimiser.figure import letter
from bp2_rl.paper.benchmarks.efficiency.measured import (
    EfficiencyAtSpeed,
    EfficiencyMetrics,
    Energy,
    measure_energy,
)
from bp2_rl.paper.benchmarks.speeds import (
    Line,
    SpeedBenchmark,
    draw_lines,
    draw_stacks,
    metrics_table,
    shares_table,
)
from bp2_rl.robot import bp2
from bp2_rl.simulation.account import replay
from bp2_rl.simulation.trajectory import Trajectory

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


def account_energy(strides: Trajectory, count: int) -> Energy | None:
    """Account for the energy of whole strides; None where they go nowhere."""
    return measure_energy(strides, replay(strides)[0], count)


def tabulate_efficiency(metrics: EfficiencyMetrics) -> list[Table]:
    """Return the tables of all metrics, of where the work goes, and of the motors."""
    found = metrics.found
    title = "Where the work goes, as cost of transport"
    tables = [
        metrics_table("At each speed; costs are power / (m g v)", found),
        shares_table(title, found, [energy.lost for _, energy in found]),
    ]
    if found:
        paper = " and ".join(f"{power:g}" for power in bp2.HIND_PEAK_POWERS)
        title = f"One motor at the top speed (paper, hind legs: peaks of {paper} W)"
        tables.append(table_of(title, found[-1][1].joints))
    return tables


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


EFFICIENCY = SpeedBenchmark(
    name="efficiency",
    speeds=(2.0, 4.0, 6.0, 8.0, bp2.OUTDOOR_TOP_SPEED, 12.0, 14.0),
    short=(bp2.OUTDOOR_TOP_SPEED,),
    holds=(10.0, 3.0),
    part="accounted for are the whole strides of that, but of its first 1.5 s at the most",
    measure=account_energy,
    at_speed=EfficiencyAtSpeed,
    gather=EfficiencyMetrics,
    say=say_cost,
    tiles=("Mechanical cost", "Electrical cost", "All returned", "Spring share"),
    tabulate=tabulate_efficiency,
    picture=("efficiency", CAPTION),
    draw=draw_efficiency,
)
