"""Time the parts of a training, its start, and a peer's training; write the report of
`bp2 bench`.

Every number is in bench.json, which grows with every size that is measured; a table
and remarks go to the terminal.
"""

import dataclasses
import json
import os
import platform
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

import jax
from rich.console import Console
from rich.table import Table

from bp2_rl.base.errors import UserError
from bp2_rl.base.folders import open_report
from bp2_rl.base.processes import keep_compiled
from bp2_rl.base.serialization import from_json, package_versions, save_config, utc_now
from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.learning.loop import make_card
from bp2_rl.learning.monitor import count
from bp2_rl.learning.networks import dense_layers
from bp2_rl.learning.policy import make_policy
from bp2_rl.learning.run import make_learner
from bp2_rl.settings.training import TrainConfig
from bp2_rl.tools.playground import (
    PlaygroundRate,
    measure_playground,
    playground_settings,
)
from bp2_rl.tools.throughput import (
    OUT_OF_MEMORY,
    Case,
    PartName,
    PartTiming,
    measure_case,
)

NUMBERS = "bench.json"


@dataclasses.dataclass(frozen=True)
class BenchRequest:
    """The settings of a bench: which training, parts and sizes are timed, and the
    report's folder."""

    config: TrainConfig  # the training
    sizes: tuple[tuple[int, int], ...]  # (robots, devices)
    parts: tuple[PartName, ...]
    seconds: float  # of timed calls, for each part
    peer: Literal["brax", "playground"] | None
    peer_robots: int | None  # of Playground; None: its own number
    start: tuple[str, ...]  # a command that calls `start_training`; empty: not timed
    folder: Path


@dataclasses.dataclass(frozen=True)
class Startup:
    """Times from the start of a fresh process to the stages of its training, up to the
    first policy, s."""

    imported: float
    traced: float  # the programs are traced and lowered, or read from the disk
    # they are compiled, or read from the disk, and the first episodes begun
    compiled: float
    first_step: float  # first train step done
    first_policy: float  # its policy made, to be exported


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
    cases: tuple[Case, ...] = ()
    # on one device our acting loop and stock Brax's or, beside Playground, our training
    peer: Case | None = None
    playground: PlaygroundRate | None = None
    cold_start: Startup | None = None  # nothing compiled before
    warm_start: Startup | None = None  # everything in the cache on disk


def run_bench(request: BenchRequest) -> None:
    """Run all measurements of a request, print them as a table, and write bench.json.

    Raises:
        UserError: nothing could be measured, or the folder holds other files.
    """
    theirs = (
        playground_settings(request.peer_robots)
        if request.peer == "playground"
        else None
    )
    console, report = Console(), empty_report(request)
    open_report(request.folder, NUMBERS, "bench")
    save_config(request.folder / NUMBERS, report)
    if request.start:  # before this process takes the devices' memory
        cold, warm = time_starts(request.start, console)
        report = dataclasses.replace(report, cold_start=cold, warm_start=warm)
    if theirs:
        _tell(console, "MuJoCo Playground's training compiles, for a minute or more")
        report = dataclasses.replace(
            report, playground=measure_playground(theirs, request.seconds)
        )
    for case in measure_sizes(request, console):
        report = dataclasses.replace(report, cases=(*report.cases, case))
        save_config(request.folder / NUMBERS, report)
    if request.peer is not None:
        case = _measure_peer(request, report.cases, console)
        report = dataclasses.replace(report, peer=case)
    save_config(request.folder / NUMBERS, report)
    print_table(report, console)
    if not any(case.measurements for case in report.cases):
        raise UserError(f"nothing could be measured: {report.cases[0].error}")
    console.print(f"report: {request.folder / NUMBERS}", soft_wrap=True)


def empty_report(request: BenchRequest) -> Bench:
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
        config=request.config,
        seconds=request.seconds,
    )


def measure_sizes(request: BenchRequest, console: Console) -> Iterator[Case]:
    """Yield the timings for every size; skip sizes above one that ran out of memory on
    as many devices."""
    full: dict[int, int] = {}  # devices -> robots that they could not hold
    for robots, devices in request.sizes:
        if robots >= full.get(devices, robots + 1):
            why = f"not tried: {full[devices]} robots were out of memory"
            yield Case(robots, devices, error=why)
            continue
        case = _measure(request, (robots, devices), request.parts, console)
        if case.error == OUT_OF_MEMORY:
            full[devices] = robots
        yield case


def _measure(
    request: BenchRequest,
    size: tuple[int, int],
    parts: Sequence[PartName],
    console: Console,
) -> Case:
    robots, devices = size
    case = measure_case(
        lambda robots: make_env(request.config, robots),
        request.config.ppo,
        robots,
        jax.devices()[:devices],
        parts,
        request.seconds,
        lambda timing: _tell(console, in_a_line(timing)),
    )
    if case.error:
        _tell(console, f"{describe_size(case)}: {case.error}")
    return case


def _measure_peer(
    request: BenchRequest, cases: Sequence[Case], console: Console
) -> Case:
    """Time, on one device, what is compared with the peer; reuse a training's timing if
    there is one."""
    alone = (request.sizes[0][0], 1)
    if request.peer == "brax":
        return _measure(request, alone, ("acting", "brax"), console)
    known = (
        case
        for case in cases
        if (case.robots, case.devices) == alone and case.rate("training")
    )
    return next(known, None) or _measure(request, alone, ("training",), console)


def make_env(config: TrainConfig, robots: int) -> BP2Env:
    """Make the environment of a training with at most `robots` robots on a device."""
    return BP2Env(config.env, impl=config.impl, num_robots=robots)


# --- From the start of a process ------------------------------------------------------


def time_starts(command: Sequence[str], console: Console) -> tuple[Startup, Startup]:
    """Time two fresh processes up to their first train step: without and with a
    compilation cache.

    Raises:
        UserError: one of them failed.
    """
    with tempfile.TemporaryDirectory(prefix="bp2-bench-") as cache:
        starts: list[Startup] = []
        for name in ("cold", "warm"):
            began = time.time()
            ended = subprocess.run(
                command,
                env={**os.environ, "BP2_CACHE": cache},
                capture_output=True,
                text=True,
            )
            if ended.returncode:
                said = " ".join(ended.stderr.strip().splitlines()[-1:])
                raise UserError(f"--startup: the {name} start failed: {said}")
            moments = json.loads(ended.stdout.splitlines()[-1])
            since = {key: moment - began for key, moment in moments.items()}
            starts.append(from_json(Startup, since))
            _tell(
                console,
                f"{name} start: first train step {starts[-1].first_step:.1f} s after the process began",
            )
    return starts[0], starts[1]


def start_training(config: TrainConfig, imported: float) -> None:
    """Take a training's first step and make its policy; print when every stage ended, s
    since 1970."""
    moments = {"imported": imported}
    learner = make_learner(config, keep_compiled())
    moments["traced"] = time.time()
    with learner.compiling():
        state = jax.block_until_ready(learner.init(0))
    moments["compiled"] = time.time()
    state, _ = jax.block_until_ready(learner.train_step(state))
    moments["first_step"] = time.time()
    params, normalizer = jax.device_get((state.average, state.normalizer))
    layers = dense_layers(params, learner.mirrors)
    make_policy(layers, normalizer, make_card(config, 0, {}))
    moments["first_policy"] = time.time()
    print(json.dumps(moments))


# --- On the terminal ------------------------------------------------------------------


def in_a_line(m: PartTiming) -> str:
    """Describe a timing in one line."""
    devices = f" on {m.devices} devices" if m.devices > 1 else ""
    return (
        f"{m.part}, {m.robots} robots{devices}: {count(m.control_steps_per_second)} control steps/s, "
        f"compiled in {m.compile_seconds:.1f} s{' (from the cache)' if m.from_cache else ''}"
    )


def print_table(bench: Bench, console: Console) -> None:
    """Print a bench's table of timings, then the remarks on them."""
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


def _cells(m: PartTiming) -> tuple[str, ...]:
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
    """Return one line for each fact of a bench that its table does not show, such as
    errors and time shares."""
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
    """Return our speed over the peer's: acting for Brax, training for Playground; None
    if not measured."""
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


def _cases(bench: Bench) -> tuple[Case, ...]:
    return (
        bench.cases
        if bench.peer is None or bench.peer in bench.cases
        else (*bench.cases, bench.peer)
    )


def describe_size(case: Case) -> str:
    """Describe the numbers of robots and devices of a case."""
    return f"{case.robots} robots on {case.devices} device{'s' if case.devices > 1 else ''}"


def _tell(console: Console, line: str) -> None:
    console.print(line, style="dim", soft_wrap=True, highlight=False, markup=False)
    console.file.flush()
