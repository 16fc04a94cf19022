"""Measure a training's parts, and report them for `bp2 bench`.

Every number is in bench.json, which grows with every part that is measured; a table
and remarks go to the terminal.
"""

import dataclasses
import itertools
import os
import platform
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
from rich.console import Console
from rich.table import Table

from bp2_rl.base.errors import UserError
from bp2_rl.base.folders import open_report
from bp2_rl.base.serialization import package_versions, save_config, utc_now
from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.learning.monitor import count
from bp2_rl.settings.training import TrainConfig
from bp2_rl.tools.throughput import (
    PartName,
    PartTiming,
    TooManyRobotsError,
    share_out,
    time_parts,
)

NUMBERS = "bench.json"
HEADINGS = (
    "",
    "robots",
    "devices",
    "control/s",
    "physics/s",
    "±",
    "trace",
    "compile",
    "memory",
)


@dataclasses.dataclass(frozen=True)
class Bench:
    """The report of a bench, as bench.json holds it: bytes and seconds."""

    created: str  # UTC
    versions: dict[str, str]
    platform: str
    device_kind: str
    device_count: int
    cpu_cores: int
    config: TrainConfig
    seconds: float  # of timed calls, for each part
    timings: tuple[PartTiming, ...] = ()
    errors: tuple[str, ...] = ()  # of sizes that could not be measured


def run_bench(
    config: TrainConfig,
    sizes: Sequence[tuple[int, int]],
    parts: Sequence[PartName],
    seconds: float,
    folder: Path,
) -> None:
    """Measure a training, print its timings, and leave the report.

    Args:
        config: the training.
        sizes: (robots, devices); none is tried above one that ran out of memory.
        parts: what is measured.
        seconds: of timed calls, for each part.
        folder: of the report.

    Raises:
        UserError: nothing could be measured, or the folder holds other files.
    """
    console = Console()
    report = empty_report(config, seconds)
    open_report(folder, NUMBERS, "bench")
    save_config(folder / NUMBERS, report)
    full: dict[int, int] = {}  # devices -> robots that they could not hold
    for robots, devices in sizes:
        if robots >= full.get(devices, robots + 1):
            continue
        try:
            for timing in measure(config, robots, devices, parts, seconds):
                _tell(console, in_a_line(timing))
                report = dataclasses.replace(report, timings=(*report.timings, timing))
                save_config(folder / NUMBERS, report)
        except UserError as reason:
            if isinstance(reason, TooManyRobotsError):
                full[devices] = robots
            error = f"{describe_size(robots, devices)}: {reason}"
            _tell(console, error)
            report = dataclasses.replace(report, errors=(*report.errors, error))
    save_config(folder / NUMBERS, report)
    print_table(report, console)
    if not report.timings:
        raise UserError(f"nothing could be measured: {report.errors[0]}")
    console.print(f"report: {folder / NUMBERS}", soft_wrap=True)


def empty_report(config: TrainConfig, seconds: float) -> Bench:
    """Return a report with the versions and devices of this machine, and no
    measurements yet."""
    device = jax.devices()[0]
    return Bench(
        created=utc_now(),
        versions={
            "python": platform.python_version(),
            "backend": " ".join(device.client.platform_version.split()),
            **package_versions(),
        },
        platform=device.platform,
        device_kind=device.device_kind,
        device_count=jax.device_count(),
        cpu_cores=os.cpu_count() or 1,
        config=config,
        seconds=seconds,
    )


def measure(
    config: TrainConfig,
    robots: int,
    devices: int,
    parts: Sequence[PartName],
    seconds: float,
) -> Iterator[PartTiming]:
    """Measure the parts of a training with `robots` robots on the first `devices`."""
    ppo = dataclasses.replace(config.ppo, num_envs=robots)
    return time_parts(
        lambda most: make_env(config, most),
        ppo,
        jax.devices()[:devices],
        parts,
        seconds,
    )


def make_env(config: TrainConfig, robots: int) -> BP2Env:
    """Make the environment of a training with at most `robots` robots on a device."""
    return BP2Env(config.env, impl=config.impl, num_robots=robots)


# --- On the terminal ------------------------------------------------------------------


def in_a_line(m: PartTiming) -> str:
    """Describe a timing in one line."""
    return (
        f"{m.part}, {describe_size(m.robots, m.devices)}: {count(m.control_steps_per_second)} control steps/s, "
        f"compiled in {m.compile_seconds:.1f} s{' (from the cache)' if m.from_cache else ''}"
    )


def print_table(bench: Bench, console: Console) -> None:
    """Print a bench's table of timings, then the remarks on them."""
    table = Table(
        title=f"{bench.device_kind}, {bench.config.impl}",
        title_justify="left",
        title_style="bold",
        box=None,
        padding=(0, 1, 0, 0),
    )
    for heading in HEADINGS:
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    for m in bench.timings:
        table.add_row(
            m.part,
            str(m.robots),
            str(m.devices),
            count(m.control_steps_per_second),
            count(m.physics_steps_per_second),
            f"{m.spread / 2:.1%}",
            f"{m.trace_seconds:.1f}",
            f"{m.compile_seconds:.1f}{'*' if m.from_cache else ''}",
            "-" if m.program_bytes is None else f"{count(m.program_bytes)}B",
            style="bold" if m.part == "training" else None,
        )
    console.print(table)
    console.print(
        "all robots together; seconds; memory on each device; *: read from the cache",
        style="dim",
    )
    for line in remarks(bench):
        console.print(line, soft_wrap=True, highlight=False, markup=False)


def remarks(bench: Bench) -> list[str]:
    """Return one line for each fact of a bench that its table does not show, such as
    errors and time shares."""
    lines = list(bench.errors)
    groups = itertools.groupby(bench.timings, lambda m: (m.robots, m.devices))
    for size, timings in groups:
        of_size = list(timings)
        shares = [f"{name} {share:.0%}" for name, share in share_out(of_size).items()]
        if shares:
            lines.append(f"{describe_size(*size)}, a train step: {', '.join(shares)}")
        lines += [
            f"{describe_size(*size)}, {m.part}: compiled {m.compilations} programs while it was timed"
            for m in of_size
            if m.compilations
        ]
    return lines


def describe_size(robots: int, devices: int) -> str:
    """Return in words how many robots there are on how many devices."""
    return f"{robots} robots on {devices} device{'s' if devices > 1 else ''}"


def _tell(console: Console, line: str) -> None:
    console.print(line, style="dim", soft_wrap=True, highlight=False, markup=False)
    console.file.flush()
