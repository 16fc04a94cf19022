"""The mechanism benchmark in words and tables."""

from typing import Any

from bp2_rl.evaluation.benchmarks.conditions import describe_rise
from bp2_rl.evaluation.benchmarks.outcome import (
    NOT_MEASURED,
    Row,
    Table,
    rounded,
    show,
    show_fall,
)
from bp2_rl.paper.benchmarks.mechanism.forces import THROUGH, WITHIN
from bp2_rl.paper.benchmarks.mechanism.measured import Decomposed, MechanismMetrics
from bp2_rl.paper.trajectories.decomposition import KINDS
from bp2_rl.simulation.schedule import Ramp

SMALL = 0.05  # of a hip's main torque: what other legs cover is small below
TILES = "Covered", "By the leg itself", "By other legs", "Trunk saves, hips", "Closure"


def verdict(metrics: MechanismMetrics) -> str:
    """What the numbers say of coupling, in one sentence: shares of the hips' main
    torque at its peaks."""
    if not metrics.decomposed:
        return "No speed was run through: nothing to take apart."
    own, legs = (
        [100 * getattr(forces, name) for _, forces in metrics.decomposed]
        for name in ("own", "legs")
    )
    most = max(map(abs, legs))
    small = "small" if most < 100 * SMALL else "not small"
    return f"Within a leg coupling covers {span(own, '.0f')} %, between legs {span(legs, '+.1f')} %: {small}."


def span(values: list[float], form: str) -> str:
    """From the least to the greatest."""
    least, greatest = (format(end(values), form) for end in (min, max))
    return least if least == greatest else f"{least} to {greatest}"


def mechanism_rows(metrics: MechanismMetrics) -> tuple[Row, ...]:
    """The figures of merit."""
    found = [forces for _, forces in metrics.decomposed]
    optimiser = metrics.optimiser

    def over(values: list[float | None], form: str) -> str:
        known = [value for value in values if value is not None]
        return span(known, form) if known else NOT_MEASURED

    fell = [at.fell_at for at in metrics.speeds if at.fell_at is not None]
    return (
        Row("Speeds", f"{len(found)} of {len(metrics.speeds)}", "run through"),
        Row("Fall", show_fall(min(fell, default=None)), "at any of the speeds, first"),
        Row(
            "Closure",
            show(max((f.closure for f in found), default=None), ".0e"),
            "gap / largest term, any ms",
        ),
        Row(
            "Covered",
            over([f.covered for f in found], ".0%"),
            "of the hips' main torque at its peaks",
        ),
        Row(
            "By the leg itself",
            over([f.own for f in found], ".0%"),
            "own knee, spring, abduction",
        ),
        Row(
            "By other legs", over([f.legs for f in found], "+.1%"), "through the trunk"
        ),
        Row(
            "... of its pair",
            over([f.through["same pair"] for f in found], "+.1%"),
            "the leg across",
        ),
        Row(
            "... optimiser",
            over([one.legs for one in optimiser], "+.1%"),
            "the library's, nearest speeds",
        ),
        Row(
            "... optimiser, own",
            over([one.own for one in optimiser], ".0%"),
            "by the leg itself, nearest speeds",
        ),
        Row(
            "Up to 8 harmonics",
            over([f.cuts[-2].covered for f in found], ".0%"),
            "covered, without chatter",
        ),
        Row(
            "Up to 2 harmonics",
            over([f.cuts[0].covered for f in found], ".0%"),
            "covered, by the stride alone",
        ),
        Row(
            "Above 8 harmonics",
            over([f.cuts[-2].variance_above for f in found], ".0%"),
            "of main torque's variance",
        ),
        Row(
            "Trunk saves, hips",
            over([saved(f, "hip") for f in found], "+.0%"),
            "of u~'s peak",
        ),
        Row(
            "Trunk saves, knees",
            over([saved(f, "knee") for f in found], "+.0%"),
            "of u~'s peak",
        ),
        Row(
            "... in RMS, hips",
            over([saved(f, "hip", "rms") for f in found], "+.1%"),
            "of u~'s root mean square",
        ),
        Row(
            "C_z / (m g)",
            over([f.velocity_force for f in found], ".2f"),
            "greatest, up to 8 harmonics",
        ),
    )


def saved(forces: Decomposed, joint: str, what: str = "peak") -> float:
    """What the trunk's acceleration saves of the greatest u~ of a kind of joint, as a
    share of it."""
    motors = [motor for name, motor in forces.motors.items() if name.endswith(joint)]
    fixed = max(getattr(motor, f"fixed_{what}") for motor in motors)
    return (
        1.0 - max(getattr(motor, what) for motor in motors) / fixed
        if fixed > 0.0
        else 0.0
    )


def mechanism_tables(metrics: MechanismMetrics) -> tuple[Table, ...]:
    """Shares by source, torques, cut-offs and average forces by speed."""
    found = metrics.decomposed
    speeds = tuple(f"{at.speed:.2f}" for at, _ in found)
    within = [
        ("covered", *(f"{f.covered:.3f}" for _, f in found)),
        *((name, *(f"{f.within[name]:+.3f}" for _, f in found)) for name in WITHIN),
    ]
    through = [
        (name, *(f"{f.through[name]:+.3f}" for _, f in found)) for name in THROUGH
    ]
    names = found[0][1].motors if found else ()
    torques = [
        (
            f"{name}, {label}",
            *(f"{getattr(f.motors[name], what):.1f}" for _, f in found),
        )
        for name in names
        for label, what in (
            ("u peak", "peak"),
            ("ũ peak", "fixed_peak"),
            ("u rms", "rms"),
            ("ũ rms", "fixed_rms"),
        )
    ]
    cuts = [
        (
            f"up to {cut.harmonics}" if cut.harmonics else "all",
            *(
                f"{f.cuts[i].largest:.0f} Nm, {show(f.cuts[i].covered, '.2f')}"
                for _, f in found
            ),
        )
        for i, cut in enumerate(found[0][1].cuts if found else ())
    ]
    tables = [
        Table(
            "Of the hips' main torque at its peaks, by source",
            ("Speed [m/s]", *speeds),
            within,
        ),
        Table(
            "... the trunk's part, by what accelerates it",
            ("Speed [m/s]", *speeds),
            through,
        ),
        Table(
            "Torque at joints [Nm]; ũ: on a trunk that is not accelerated",
            ("Speed [m/s]", *speeds),
            torques,
        ),
        Table(
            "Harmonics of the stride: largest main torque, covered",
            ("Speed [m/s]", *speeds),
            cuts,
        ),
    ]
    if metrics.optimiser:
        tables.append(optimiser_table(metrics))
    if found:
        tables += [_average_table(metrics, kind) for kind in KINDS]
    return tuple(tables)


def optimiser_table(metrics: MechanismMetrics) -> Table:
    """The policy's gait beside the library's trot."""
    head = "Speed [m/s]", "Covered", "Own", "Other legs", "Trunk", "u, ũ [Nm]"
    lines = []
    for (at, forces), one in zip(metrics.decomposed, metrics.optimiser, strict=True):
        hips = [motor for name, motor in forces.motors.items() if name.endswith("hip")]
        trunk = sum(forces.within[name] for name in WITHIN[3:])
        peaks = (
            f"{max(m.peak for m in hips):.0f}, {max(m.fixed_peak for m in hips):.0f}"
        )
        ours = (forces.covered, forces.own, forces.legs, trunk)
        lines.append(
            (f"policy, {at.speed:.2f}", *(f"{share:+.3f}" for share in ours), peaks)
        )
        theirs = (one.covered, one.own, one.legs, one.trunk)
        shown = (f"{share:+.3f}" for share in theirs)
        lines.append(
            (
                f"optimiser, {one.speed:g}",
                *shown,
                f"{one.peak:.0f}, {one.fixed_peak:.0f}",
            )
        )
    return Table(
        "Beside the optimiser; shares of the hips' main torque at its peaks",
        head,
        lines,
    )


def _average_table(metrics: MechanismMetrics, kind: str) -> Table:
    found = metrics.decomposed
    unit = "N" if kind in ("x", "z") else "Nm"
    lines = [
        (
            term,
            *(
                f"{f.average[kind][term]:.1f} ({f.share[kind][term]:.2f})"
                for _, f in found
            ),
        )
        for term in found[0][1].average[kind]
    ]
    head = ("Speed [m/s]", *(f"{at.speed:.2f}" for at, _ in found))
    return Table(f"Mean magnitude, {kind} [{unit}] (share of all)", head, lines)


def mechanism_results(metrics: MechanismMetrics) -> dict[str, Any]:
    """What a policy's card says."""
    return rounded(
        {
            "speeds": [at.speed for at, _ in metrics.decomposed],
            "covered": [forces.covered for _, forces in metrics.decomposed],
            "covered_by_own_leg": [forces.own for _, forces in metrics.decomposed],
            "covered_by_other_legs": [forces.legs for _, forces in metrics.decomposed],
            "trunk_saves_of_hip_peak": [
                saved(forces, "hip") for _, forces in metrics.decomposed
            ],
            "closure": max(
                (forces.closure for _, forces in metrics.decomposed), default=None
            ),
            "falls": sum(at.fell_at is not None for at in metrics.speeds),
        }
    )


def describe_runs(ramp: Ramp, commands: tuple[float, ...]) -> str:
    """The schedules in one line."""
    return (
        f"from a stand to {', '.join(f'{speed:g}' for speed in commands)} m/s {describe_rise(ramp)}, then hold "
        f"for {ramp.hold:g} s; looked at are the last whole strides of that, at most 8"
    )
