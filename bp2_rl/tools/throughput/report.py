"""What `bp2 bench` leaves: every number in bench.json, a table on the terminal, and a
picture of how it scales."""

import dataclasses
from collections.abc import Iterable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, MaxNLocator, NullLocator
from rich.console import Console
from rich.table import Table

from bp2_rl.base.plotting import INK, LEG_COLORS, WIDTH, styled
from bp2_rl.learning.monitor import count
from bp2_rl.settings.training import TrainConfig
from bp2_rl.tools.throughput.measure import Case, PartName, PartTiming
from bp2_rl.tools.throughput.playground import PlaygroundRate

NUMBERS, PICTURE = "bench.json", "scaling.png"
DRAWN: tuple[PartName, ...] = ("physics", "environment", "acting", "training")


@dataclasses.dataclass(frozen=True)
class Startup:
    """When a fresh process got how far, in seconds since it was started."""

    imported: float
    traced: float  # the programs are traced and lowered, or read from the disk
    # they are compiled, or read from the disk, and the first episodes begun
    compiled: float
    first_step: float  # first train step done
    first_policy: float  # its policy made, to be exported


@dataclasses.dataclass(frozen=True)
class Bench:
    """What bench.json holds. Memory in bytes, times in seconds."""

    created: str  # UTC
    versions: dict[str, str]
    platform: str
    device_kind: str
    device_count: int
    cpu_cores: int
    config: TrainConfig
    seconds: float  # of timed calls, for each part
    cases: tuple[Case, ...] = ()
    # on one device our acting loop and stock Brax's or, beside Playground, our training
    peer: Case | None = None
    playground: PlaygroundRate | None = None
    cold_start: Startup | None = None  # nothing compiled before
    warm_start: Startup | None = None  # everything in the cache on disk
    host_peak_bytes: int | None = None  # of this process since it began


# --- On the terminal ------------------------------------------------------------------


def say(measurement: PartTiming) -> str:
    """A measurement in a line."""
    m = measurement
    devices = f" on {m.devices} devices" if m.devices > 1 else ""
    return (
        f"{m.part}, {m.robots} robots{devices}: {count(m.control_steps_per_second)} control steps/s, "
        f"compiled in {m.compile_seconds:.1f} s{' (from the cache)' if m.from_cache else ''}"
    )


def print_table(bench: Bench, console: Console) -> None:
    """Every measurement, and what they say together."""
    title = f"{bench.device_kind}, {bench.config.impl}"
    table = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=None,
        padding=(0, 1, 0, 0),
    )
    for heading in (
        "",
        "robots",
        "devices",
        "control/s",
        "physics/s",
        "±",
        "trace",
        "compile",
        "memory",
    ):
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    for case in _cases(bench):
        for m in case.measurements:
            table.add_row(*_cells(m), style="bold" if m.part == "training" else None)
        if case.error:
            table.add_row("failed", str(case.robots), str(case.devices), style="red")
    console.print(table)
    console.print(
        "all robots together; seconds; memory on each device; *: read from the cache",
        style="dim",
    )
    for line in remarks(bench):
        console.print(line, soft_wrap=True, highlight=False, markup=False)


def _cells(m: PartTiming) -> Iterable[str]:
    return (
        m.part,
        str(m.robots),
        str(m.devices),
        count(m.control_steps_per_second),
        count(m.physics_steps_per_second),
        f"{m.spread / 2:.1%}",
        f"{m.trace_seconds:.1f}",
        f"{m.compile_seconds:.1f}{'*' if m.from_cache else ''}",
        "-" if m.program_bytes is None else f"{count(m.program_bytes)}B",
    )


def remarks(bench: Bench) -> list[str]:
    """What the table does not show, a line each."""
    lines = []
    for case in _cases(bench):
        if case.error:
            lines.append(f"{describe_size(case)}: {case.error}")
        if case.shares:
            lines.append(
                f"{describe_size(case)}, a train step: {', '.join(f'{n} {s:.0%}' for n, s in case.shares.items())}"
            )
        late = {m.part: m.compilations for m in case.measurements if m.compilations}
        lines += [
            f"{describe_size(case)}, {part}: compiled {n} programs while it was timed"
            for part, n in late.items()
        ]
    lines += _memory(bench)
    for name, start in (("cold", bench.cold_start), ("warm", bench.warm_start)):
        if start is not None:
            moments = (
                f"{moment.replace('_', ' ')} {s:.1f} s"
                for moment, s in dataclasses.asdict(start).items()
            )
            lines.append(f"{name} start: {', '.join(moments)} after the process began")
    ratio, theirs = peer_ratio(bench), bench.playground
    if theirs is not None:
        rate = f"{count(theirs.control_steps_per_second)} control steps/s of {1000 * theirs.control_period:g} ms"
        lines.append(
            f"MuJoCo Playground's Go1, MJX {theirs.impl}, {theirs.robots} robots: {rate}"
        )
        if bench.peer is not None and ratio is not None:
            lines[-1] += (
                f"; ours, {bench.peer.robots} robots, make {ratio:.2f} times as many, of 5 ms"
            )
    elif ratio is not None:
        lines.append(f"the learner acts {ratio:.2f} times as fast as stock Brax")
    return lines


def peer_ratio(bench: Bench) -> float | None:
    """How many times as fast as stock Brax we act, or as Playground we train; None
    where that was not measured."""
    if bench.peer is None:
        return None
    if bench.playground is None:
        ours, theirs = bench.peer.rate("acting"), bench.peer.rate("brax")
    else:
        ours, theirs = (
            bench.peer.rate("training"),
            bench.playground.control_steps_per_second,
        )
    return ours / theirs if ours and theirs else None


def _memory(bench: Bench) -> list[str]:
    """Return lines on the memory for each robot, in the largest case that was trained,
    and on the peaks."""
    lines = []
    trained = [
        m for case in bench.cases for m in case.measurements if m.part == "training"
    ]
    kept = {
        (case.robots, case.devices): case.state_bytes_per_robot for case in bench.cases
    }
    if trained:
        most = max(trained, key=lambda m: m.robots)
        within, between = most.bytes_per_robot, kept[most.robots, most.devices]
        if within is not None and between is not None:
            lines.append(
                f"memory a robot: {count(between)}B kept, {count(within)}B within a train step"
            )
    peak = max(
        (case.device_peak_bytes for case in _cases(bench) if case.device_peak_bytes),
        default=None,
    )
    device = "" if peak is None else f"{count(peak)}B on a device, "
    if bench.host_peak_bytes is not None:
        lines.append(
            f"peak memory: {device}{count(bench.host_peak_bytes)}B on the host"
        )
    return lines


def _cases(bench: Bench) -> tuple[Case, ...]:
    return (
        bench.cases
        if bench.peer is None or bench.peer in bench.cases
        else (*bench.cases, bench.peer)
    )


def describe_size(case: Case) -> str:
    """How many robots on how many devices."""
    return f"{case.robots} robots on {case.devices} device{'s' if case.devices > 1 else ''}"


# --- The picture ----------------------------------------------------------------------


@styled
def scaling_figure(bench: Bench) -> Figure:
    """Control steps a second over robots on one device; where there are several, the
    speed-up of a train step too."""
    alone = [case for case in bench.cases if case.devices == 1]
    several = len(alone) < len(bench.cases)
    figure = Figure(figsize=(WIDTH, 3.9), layout="constrained")
    panels = figure.subplots(
        1, 1 + several, squeeze=False, width_ratios=(1.25, 1)[: 1 + several]
    )[0]
    _draw_robots(panels[0], alone)
    panels[0].set_title(f"Throughput of one {bench.device_kind}, {bench.config.impl}")
    if several:
        _draw_devices(panels[1], bench.cases, bench.config.ppo.num_envs)
    return figure


def _draw_robots(axes: Axes, cases: Sequence[Case]) -> None:
    for part, color in zip(DRAWN, reversed(list(LEG_COLORS.values())), strict=True):
        points = sorted(
            (case.robots, rate) for case in cases if (rate := case.rate(part))
        )
        if points:
            axes.plot(*zip(*points, strict=True), "o-", ms=4, color=color, label=part)
    axes.set(
        xscale="log", yscale="log", xlabel="Robots [1]", ylabel="Control steps [1/s]"
    )
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(EngFormatter(sep=""))
    _ticks(axes, [case.robots for case in cases])
    if axes.lines:
        axes.legend(loc="lower right")


def _draw_devices(axes: Axes, cases: Sequence[Case], base: int) -> None:
    rates = {
        (case.robots, case.devices): rate
        for case in cases
        if (rate := case.rate("training"))
    }
    counts = sorted({1} | {case.devices for case in cases})
    axes.plot(
        counts, counts, color=INK, linewidth=1.2, linestyle=(0, (4, 2)), label="ideal"
    )
    for label, robots, color in (
        (f"{base} robots a device", lambda n: base * n, LEG_COLORS["FR"]),
        (f"{base} robots in all", lambda n: base, LEG_COLORS["FL"]),
    ):
        points = [
            (n, rates[robots(n), n] / rates[base, 1])
            for n in counts
            if {(robots(n), n), (base, 1)} <= set(rates)
        ]
        if points:
            axes.plot(*zip(*points, strict=True), "o-", ms=4, color=color, label=label)
    axes.set(
        title="Speed-up of training",
        xlabel="Devices [1]",
        ylabel="Over one device [1]",
        ylim=(0.0, None),
    )
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    _ticks(axes, counts)
    axes.legend(loc="lower right")


def _ticks(axes: Axes, sizes: Sequence[int]) -> None:
    """A tick at every size that was measured, and no others."""
    values = sorted(set(sizes))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticks(values, [str(value) for value in values], size=8.5)
