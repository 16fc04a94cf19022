"""The efficiency benchmark in words and tables."""

from typing import Any

from bp2_rl.evaluation.benchmarks.conditions import describe_rise
from bp2_rl.evaluation.benchmarks.outcome import Row, Table, rounded, show, show_fall
from bp2_rl.evaluation.benchmarks.run import ENERGY
from bp2_rl.paper.benchmarks.efficiency.measured import (
    RETURNED,
    EfficiencyMetrics,
    Energy,
)
from bp2_rl.robot import bp2
from bp2_rl.simulation.schedule import Ramp

TILES = (
    "Mechanical cost",
    "Electrical cost",
    "All returned",
    "Spring share",
    "Peak power",
)


def verdict(metrics: EfficiencyMetrics) -> str:
    """What the fastest run costs, in one sentence."""
    if not metrics.found:
        return "No speed was run through: nothing to account for."
    at, energy = metrics.found[-1]
    electrical = energy.electrical
    return (
        f"{at.speed:.1f} m/s cost {energy.positive:.2f} of m g d in work, and {electrical.everything:.2f} to "
        f"{electrical.nothing:.2f} of the battery."
    )


def efficiency_rows(metrics: EfficiencyMetrics) -> tuple[Row, ...]:
    """The figures of merit: of the fastest run, where nothing else is said."""
    fell = [at.fell_at for at in metrics.speeds if at.fell_at is not None]
    said = (
        Row("Speeds", f"{len(metrics.found)} of {len(metrics.speeds)}", "run through"),
        Row("Fall", show_fall(min(fell, default=None)), "at any of the speeds, first"),
    )
    if not metrics.found:
        return said
    at, e = metrics.found[-1]
    cheapest, least = min(metrics.found, key=lambda one: one[1].positive)
    peak = max(e.joints, key=lambda joint: joint.peak)
    brake = max(e.joints, key=lambda joint: joint.hardest)
    closure = max(energy.closure for _, energy in metrics.found)
    steps = max(
        abs(energy.integration) / energy.positive for _, energy in metrics.found
    )
    costliest = max(
        (cause for cause in e.lost if cause != "copper"),
        key=lambda cause: e.lost[cause],
    )
    return (
        *said,
        Row("Speed", f"{at.speed:.2f} m/s", "the fastest; all below are of it"),
        Row(
            "Mechanical cost",
            f"{e.positive:.3f}",
            "positive motor work / (m g distance)",
        ),
        Row("Braking", f"{e.braking:.3f}", "negative motor work / (m g distance)"),
        Row("Net cost", f"{e.net:.3f}", "positive less negative: what is lost"),
        Row(
            "Electrical cost",
            f"{e.electrical.nothing:.3f}",
            "no braking returned, copper heat included",
        ),
        Row("Half returned", f"{e.electrical.half:.3f}", "half of braking returned"),
        Row(
            "All returned", f"{e.electrical.everything:.3f}", "net cost and copper heat"
        ),
        Row(
            "Shared by motors",
            f"{e.electrical.bus:.3f}",
            "brakes feed drives, battery takes none",
        ),
        Row("Costliest", f"{e.lost[costliest]:.3f}", f"of what resists: {costliest}"),
        Row("Spring share", f"{e.spring_share:.0%}", "of what springs and motors give"),
        Row(
            "Motors' efficiency",
            show(e.efficiency, ".0%"),
            "driving: work / (work + copper heat)",
        ),
        Row(
            "Peak power", f"{peak.peak:.0f} W", f"{peak.name}, one motor, mean of a ms"
        ),
        Row(
            "Hardest braking",
            f"{brake.hardest:.0f} W",
            f"{brake.name}, one motor, mean of a ms",
        ),
        Row(
            "Cheapest",
            f"{least.positive:.3f}",
            f"mechanical cost, at {cheapest.speed:.1f} m/s",
        ),
        Row(
            "... optimiser",
            _optimised(metrics),
            "mechanical cost, nearest speed, lossless",
        ),
        Row("Closure", f"{closure:.0e}", "gap / largest term, any ms and speed"),
        Row(
            "Lost by steps", f"{steps:.1e}", "of positive work; no loss of the robot's"
        ),
    )


def _optimised(metrics: EfficiencyMetrics) -> str:
    one = metrics.optimiser[-1]
    return f"{one.positive:.3f} at {one.speed:g}"


def efficiency_tables(metrics: EfficiencyMetrics) -> tuple[Table, ...]:
    """Costs by speed, where the work goes, the motors' powers, and the optimiser's
    costs."""
    found = metrics.found
    if not found:
        return ()
    head = ("Speed [m/s]", *(f"{at.speed:.2f}" for at, _ in found))
    energies = [energy for _, energy in found]

    def line(name: str, values: list[float], form: str = ".3f") -> tuple[str, ...]:
        return (name, *(format(value, form) for value in values))

    costs = [
        line("mechanical, positive", [e.positive for e in energies]),
        line("mechanical, braking", [e.braking for e in energies]),
        line("mechanical, net", [e.net for e in energies]),
        *(
            line(
                f"electrical, {share:.0%} of braking returned",
                [_electrical(e)[i] for e in energies],
            )
            for i, share in enumerate(RETURNED)
        ),
        line(
            "electrical, shared by motors, none stored",
            [e.electrical.bus for e in energies],
        ),
        line("springs give", [e.spring for e in energies]),
        line("springs' share", [e.spring_share for e in energies], ".0%"),
        ("motors' efficiency, driving", *(show(e.efficiency, ".0%") for e in energies)),
        line("m g v [W]", [e.weight_speed for e in energies], ".0f"),
    ]
    causes = [
        line(ENERGY[cause], [e.lost[cause] for e in energies])
        for cause in energies[0].lost
    ]
    causes.append(line(ENERGY["stored"], [e.stored for e in energies]))
    causes.append(line(ENERGY["integration"], [e.integration for e in energies]))
    return (
        Table("Costs of transport", head, costs),
        Table("Where the work goes, as cost of transport", head, causes),
        _joint_table(found[-1][0].speed, energies[-1]),
        _optimiser_table(metrics),
    )


def _electrical(energy: Energy) -> tuple[float, float, float]:
    e = energy.electrical
    return e.nothing, e.half, e.everything


def _joint_table(speed: float, energy: Energy) -> Table:
    """The motors at one speed."""
    paper = " and ".join(f"{power:g}" for power in bp2.HIND_PEAK_POWERS)
    head = (
        "Motors",
        "Peak [W]",
        "Hardest braking [W]",
        "Drives [W]",
        "Brakes [W]",
        "Heat [W]",
        "Efficiency, driving",
    )
    lines = [
        (
            joint.name,
            *(
                f"{watts:.0f}"
                for watts in (
                    joint.peak,
                    joint.hardest,
                    joint.positive,
                    joint.braking,
                    joint.copper,
                )
            ),
            show(joint.efficiency, ".0%"),
        )
        for joint in energy.joints
    ]
    return Table(
        f"One motor at {speed:.2f} m/s (paper, hind legs: peaks of {paper} W)",
        head,
        lines,
    )


def _optimiser_table(metrics: EfficiencyMetrics) -> Table:
    """The policy's costs beside those of the library's strides."""
    head = (
        "Speed [m/s]",
        "Positive",
        "Braking",
        "Copper",
        "Nothing returned",
        "All returned",
        "Positive over optimiser's",
    )
    lines = []
    for (at, e), one in zip(metrics.found, metrics.optimiser, strict=True):
        ours = (
            e.positive,
            e.braking,
            e.lost["copper"],
            e.electrical.nothing,
            e.electrical.everything,
        )
        theirs = (
            one.positive,
            one.braking,
            one.copper,
            one.electrical.nothing,
            one.electrical.everything,
        )
        gap = f"{e.positive / one.positive:.2f}"
        lines.append(
            (f"policy, {at.speed:.2f}", *(f"{cost:.3f}" for cost in ours), gap)
        )
        lines.append(
            (f"optimiser, {one.speed:g}", *(f"{cost:.3f}" for cost in theirs), "")
        )
    return Table(
        "Beside the optimiser's stride, in the plane and without losses; costs of transport",
        head,
        lines,
    )


def efficiency_results(metrics: EfficiencyMetrics) -> dict[str, Any]:
    """What a policy's card says."""
    energies = [energy for _, energy in metrics.found]
    return rounded(
        {
            "speeds": [at.speed for at, _ in metrics.found],
            "mechanical_cost": [energy.positive for energy in energies],
            "net_cost": [energy.net for energy in energies],
            "electrical_cost": [energy.electrical.nothing for energy in energies],
            "electrical_cost_all_returned": [
                energy.electrical.everything for energy in energies
            ],
            "electrical_cost_shared": [energy.electrical.bus for energy in energies],
            "spring_share": [energy.spring_share for energy in energies],
            "motor_efficiency": [energy.efficiency for energy in energies],
            "falls": sum(at.fell_at is not None for at in metrics.speeds),
        }
    )


def describe_runs(ramp: Ramp, commands: tuple[float, ...]) -> str:
    """The schedules in one line."""
    return (
        f"from a stand to {', '.join(f'{speed:g}' for speed in commands)} m/s {describe_rise(ramp)}, then hold "
        f"for {ramp.hold:g} s; accounted for are the whole strides of that, but of its first 1.5 s at the most"
    )
