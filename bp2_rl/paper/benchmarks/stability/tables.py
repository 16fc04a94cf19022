"""What the stability benchmark says: in one sentence, in rows and tables, and on a
policy's card."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from bp2_rl.evaluation.benchmarks.outcome import NOT_MEASURED, Row, Table, rounded, show
from bp2_rl.paper.benchmarks.stability.measured import (
    LandingMetrics,
    RadiusMetrics,
    SectionMetrics,
    SignalMetrics,
    SpeedMetrics,
    StabilityMetrics,
)

TILES = (
    "Fell",
    "D_c*",
    "Radius under noise",
    "Touchdown jitter",
    "Inliers",
    "Weakest push",
)
PAPER_DRIFT, PAPER_VARIABILITY = 0.071, 0.006  # of the paper, at its speed outdoors


def section_of(speed: SpeedMetrics) -> SectionMetrics | None:
    """Return the section at the clock's phase 0."""
    return speed.sections[0] if speed.sections else None


def steady(speed: SpeedMetrics) -> bool:
    """Whether no robot fell and the map under noise, if it was found, contracts with
    its whole interval."""
    found = speed.returns
    return speed.fell == 0 and (found is None or found.under_noise.high < 1.0)


def verdict(metrics: StabilityMetrics) -> str:
    """All speeds in one sentence."""

    def said(speed: SpeedMetrics) -> str:
        section = section_of(speed)
        if speed.fell or section is None:
            return f"{speed.fell} of {speed.robots} fell"
        if speed.returns is None:
            return f"no fall, D_c* {middle(section.over_scatter):.2f}"
        return f"radius {show_radius(speed.returns.under_noise)}"

    return "; ".join(
        f"{speed.commanded:.2f} m/s: {said(speed)}" for speed in metrics.speeds
    )


def stability_rows(metrics: StabilityMetrics) -> tuple[Row, ...]:
    """The figures of merit at the first speed for a reader, each with what it means."""
    speed = metrics.speeds[0]
    section, returns = section_of(speed), speed.returns
    variability = max((landing.variability for landing in speed.landings), default=None)
    floor = max((landing.floor for landing in speed.landings), default=0.0)
    pitch, roll = (signal(speed, name) for name in ("pitch rate", "roll rate"))
    noise = returns and returns.under_noise
    alone = returns and returns.unsteered
    return (
        Row(
            "Commanded speed",
            f"{speed.commanded:.2f} m/s",
            f"a stride of {speed.ticks} control steps",
        ),
        Row("Mean speed", show(speed.speed, ".2f", "m/s"), "made good"),
        Row("Fell", f"{speed.fell}", f"of {speed.robots} robots with noise"),
        Row(
            "Strides",
            show(section and section.strides, "d"),
            "a robot, transient dropped",
        ),
        Row(
            "D_c*",
            show(section and middle(section.over_scatter), ".3f"),
            floor_of(section),
        ),
        Row(
            "Drift",
            show(section and middle(section.moved), ".3f", "rad/s"),
            "the same, not divided",
        ),
        Row(
            "Drift over orbit",
            show(section and middle(section.over_orbit), ".3f"),
            "over the RMS rate all along",
        ),
        Row(
            "Scatter",
            show(section and middle(section.scatter), ".3f", "rad/s"),
            quiet_scatter(section),
        ),
        Row("Inliers", show(section and section.inliers, ".1%"), inlier_floor(section)),
        Row(
            "Radius under noise",
            show(noise and noise.radius, ".3f"),
            interval_of(noise),
        ),
        Row(
            "... by differences",
            show(returns and returns.by_differences, ".3f"),
            "without noise",
        ),
        Row("... unsteered", show(alone and alone.radius, ".3f"), interval_of(alone)),
        Row(
            "Touchdown jitter",
            show(ms(worst_jitter(speed)), ".2f", "ms"),
            quiet_jitter(speed),
        ),
        Row(
            "CV_f",
            show(variability, ".4f"),
            f"worst leg; sampling alone makes {floor:.4f}",
        ),
        Row(
            "Pitch beats",
            show(pitch and pitch.peak, ".2f"),
            f"a stride; {leak(pitch)} at odd harmonics",
        ),
        Row(
            "Roll beats",
            show(roll and roll.peak, ".2f"),
            f"a stride; {leak(roll)} at even harmonics",
        ),
        Row(
            "Weakest push",
            show(speed.weakest_push, ".2f", "m/s"),
            "largest survived at any phase and angle",
        ),
        Row(
            "... as an impulse",
            show(impulse(metrics, speed), ".0f", "N s"),
            "on the whole robot at once",
        ),
    )


def stability_tables(metrics: StabilityMetrics) -> tuple[Table, ...]:
    """Beside the paper; then each speed."""
    return (
        paper_table(metrics),
        *(table for speed in metrics.speeds for table in speed_tables(speed)),
    )


def paper_table(metrics: StabilityMetrics) -> Table:
    """What the paper says of its stability, and what comes out here; at the first
    speed."""
    speed = metrics.speeds[0]
    section, landings = section_of(speed), speed.landings
    pitch, roll = (signal(speed, name) for name in ("pitch rate", "roll rate"))
    need = 6.0 / PAPER_DRIFT**2
    return Table(
        "Beside the paper (Fig. 5D)",
        ("What", "Paper", "Here", "How"),
        [
            (
                "D_c*",
                f"{PAPER_DRIFT}",
                show(section and middle(section.over_scatter), ".3f"),
                f"not comparable: no definition is printed; with ours independent strides have {PAPER_DRIFT} after "
                f"{need:.0f} of them, and {show(section and section.floor, '.2f')} here",
            ),
            (
                "Inliers",
                "high",
                show(section and section.inliers, ".1%"),
                f"not comparable: any Gaussian has 95 % ± {show(section and section.inlier_error, '.1%')}",
            ),
            (
                "CV_f",
                f"{PAPER_VARIABILITY}",
                f"{max((landing.variability for landing in landings), default=math.nan):.4f}",
                "no measure of stability: the policy is given the clock, so the stride's frequency is the clock's",
            ),
            (
                "Body frequency over the stride's",
                "2",
                f"pitch {show(pitch and pitch.peak, '.2f')}, roll {show(roll and roll.peak, '.2f')}",
                "same for pitch; roll and yaw cannot: left and right make it 1",
            ),
        ],
        words=True,
    )


def speed_tables(speed: SpeedMetrics) -> tuple[Table, ...]:
    """Sections, signals, touchdowns, maps and pushes of one speed."""
    at = f"{speed.commanded:.2f} m/s"
    tables = [
        Table(
            f"Sections of the trunk's angular velocity, {at}",
            (
                "When",
                "Strides",
                "Drift [rad/s]",
                "D_c*",
                "Floor",
                "Over the orbit",
                "Scatter [rad/s]",
                "... no noise [rad/s]",
                "Inliers",
                "Over 95 %",
            ),
            [section_line(section) for section in speed.sections],
        ),
        Table(
            f"What the trunk repeats at, {at}",
            (
                "Signal",
                "Peak over stride",
                "Leakage",
                "Between",
                "Peak, no noise",
                "Leakage, no noise",
                "Between, no noise",
                "A symmetric gait has",
            ),
            [signal_line(one) for one in speed.signals],
            words=True,
        ),
        Table(
            f"Touchdowns, {at}",
            (
                "Leg",
                "Phase",
                "Jitter [ms]",
                "... no noise [ms]",
                "CV_f",
                "... no noise",
                "Sampling alone",
            ),
            [landing_line(landing) for landing in speed.landings],
        ),
    ]
    if speed.returns is not None:
        tables += map_tables(speed, at)
    if speed.pushes:
        tables.append(push_table(speed, at))
    return tuple(tables)


def section_line(section: SectionMetrics) -> Sequence[str]:
    """One section."""
    return (
        section.taken,
        f"{section.strides}",
        f"{middle(section.moved):.3f}",
        f"{middle(section.over_scatter):.3f}",
        f"{section.floor:.3f}",
        f"{middle(section.over_orbit):.3f}",
        f"{middle(section.scatter):.3f}",
        show(section.quiet_scatter, ".3f"),
        f"{section.inliers:.1%}",
        f"{section.inliers - 0.95:+.1%} ± {section.inlier_error:.1%}",
    )


def signal_line(one: SignalMetrics) -> Sequence[str]:
    """One signal."""
    return (
        one.name,
        f"{one.peak:.2f}",
        f"{one.leakage:.1%}",
        f"{one.between:.1%}",
        show(one.quiet_peak, ".2f"),
        show(one.quiet_leakage, ".1%"),
        show(one.quiet_between, ".1%"),
        f"{one.symmetric} harmonics alone",
    )


def landing_line(landing: LandingMetrics) -> Sequence[str]:
    """One leg."""
    return (
        landing.leg,
        f"{landing.phase:.3f}",
        f"{1e3 * landing.jitter:.2f}",
        show(ms(landing.quiet_jitter), ".2f"),
        f"{landing.variability:.4f}",
        show(landing.quiet_variability, ".4f"),
        f"{landing.floor:.4f}",
    )


def map_tables(speed: SpeedMetrics, at: str) -> list[Table]:
    """Radii; how deviations grow."""
    found = speed.returns
    if found is None:
        return []
    radii = [
        found.under_noise,
        *found.deviations,
        *([found.unsteered] if found.unsteered else []),
    ]
    lines = [
        (
            one.what,
            f"{one.states}",
            f"{one.radius:.3f}",
            f"{one.low:.3f} to {one.high:.3f}",
            f"{one.unexplained:.1%}",
        )
        for one in radii
    ]
    if found.widths:
        plateau = ", ".join(
            f"{100 * change:.0f} %" if change is not None and change < 10.0 else "none"
            for change in found.changes[:-1]
        )
        lines.append(
            (
                f"central differences of {found.width or 0:g}",
                f"{2 * found.coordinates}",
                show(found.by_differences, ".3f"),
                f"slope changes per decade: {plateau}",
                NOT_MEASURED,
            )
        )
    tables = [
        Table(
            f"Largest multiplier of the map from stride to stride, {at}, {found.coordinates} coordinates",
            ("Fitted to", "States", "Radius", "95 % interval", "Not explained"),
            lines,
        )
    ]
    if found.sizes:
        shown = [
            stride
            for stride in (0, 1, 2, 4, 8, len(found.growth[0]) - 1)
            if stride < len(found.growth[0])
        ]
        tables.append(
            Table(
                f"Distance of robots that begin side by side, over the first one, {at}",
                (
                    "First distance",
                    *(f"after {stride}" for stride in dict.fromkeys(shown)),
                ),
                [
                    (
                        f"{size:g}",
                        *(f"{growth[stride]:.3g}" for stride in dict.fromkeys(shown)),
                    )
                    for size, growth in zip(found.sizes, found.growth, strict=True)
                ],
            )
        )
    return tables


def push_table(speed: SpeedMetrics, at: str) -> Table:
    """The largest pushes survived: phases down, directions across."""
    phases = sorted({push.phase for push in speed.pushes})
    ways = sorted({push.direction for push in speed.pushes})
    by = {(push.phase, push.direction): push.survived for push in speed.pushes}
    return Table(
        f"Largest push survived [m/s], {at}",
        ("Phase of the clock", *(f"{np.degrees(way):.0f}°" for way in ways)),
        [
            (f"{phase:.2f}", *(f"{by[phase, way]:.2f}" for way in ways))
            for phase in phases
        ],
    )


def stability_results(metrics: StabilityMetrics) -> dict[str, Any]:
    """What a policy's card says."""
    said: dict[str, Any] = {}
    for speed in metrics.speeds:
        section, found = section_of(speed), speed.returns
        said[f"at {speed.commanded:.2f} m/s"] = {
            "strides": section and section.strides,
            "robots": speed.robots,
            "fell": speed.fell,
            "drift_over_scatter": section and middle(section.over_scatter),
            "floor": section and section.floor,
            "drift": section and middle(section.moved),
            "inliers": section and section.inliers,
            "radius_under_noise": found and found.under_noise.radius,
            "radius_interval": found
            and (found.under_noise.low, found.under_noise.high),
            "touchdown_jitter": worst_jitter(speed),
            "weakest_push": speed.weakest_push,
        }
    return rounded(said)


# --- Parts ----------------------------------------------------------------------------


def middle(values: Sequence[float]) -> float:
    """Median."""
    return float(np.median(values))


def ms(seconds: float | None) -> float | None:
    """In milliseconds."""
    return None if seconds is None else 1e3 * seconds


def worst_jitter(speed: SpeedMetrics) -> float | None:
    """Return the jitter of the leg that jitters most, s."""
    return max((landing.jitter for landing in speed.landings), default=None)


def signal(speed: SpeedMetrics, name: str) -> SignalMetrics | None:
    """By its name."""
    return next((one for one in speed.signals if one.name == name), None)


def show_radius(found: RadiusMetrics | None) -> str:
    """With its interval."""
    return (
        NOT_MEASURED
        if found is None
        else f"{found.radius:.2f} ({found.low:.2f} to {found.high:.2f})"
    )


def interval_of(found: RadiusMetrics | None) -> str:
    """What stands beside a radius."""
    return (
        ""
        if found is None
        else f"stride to stride; 95 %: {found.low:.2f} to {found.high:.2f}"
    )


def impulse(metrics: StabilityMetrics, speed: SpeedMetrics) -> float | None:
    """Return the impulse of the weakest push, N s."""
    return None if speed.weakest_push is None else metrics.mass * speed.weakest_push


def floor_of(section: SectionMetrics | None) -> str:
    """What stands beside D_c*."""
    return (
        "" if section is None else f"median; independent strides: {section.floor:.2f}"
    )


def quiet_scatter(section: SectionMetrics | None) -> str:
    """What stands beside the scatter."""
    return f"median; without noise {show(section and section.quiet_scatter, '.3f')}"


def inlier_floor(section: SectionMetrics | None) -> str:
    """What stands beside the inliers."""
    return "" if section is None else f"any Gaussian: 95 % ± {section.inlier_error:.1%}"


def quiet_jitter(speed: SpeedMetrics) -> str:
    """What stands beside the jitter."""
    quiet = max(
        (
            landing.quiet_jitter
            for landing in speed.landings
            if landing.quiet_jitter is not None
        ),
        default=None,
    )
    return f"worst leg; without noise {show(ms(quiet), '.2f', 'ms')}"


def leak(one: SignalMetrics | None) -> str:
    """Return a signal's leakage as text."""
    return show(one and one.leakage, ".1%")
