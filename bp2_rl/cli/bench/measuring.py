"""What `bp2 bench` does once it knows what it is asked for."""

import dataclasses
import datetime
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
from rich.console import Console

from bp2_rl.base.errors import UserError
from bp2_rl.base.folders import open_report
from bp2_rl.base.plotting import save_figure
from bp2_rl.base.processes import keep_compiled
from bp2_rl.base.serialization import from_json, package_versions, save_config, utc_now
from bp2_rl.cli.bench import STEP, BenchArguments, parse
from bp2_rl.cli.runtime import require_accelerator
from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.learning.loop import make_card
from bp2_rl.learning.networks import dense_layers
from bp2_rl.learning.policy import make_policy
from bp2_rl.learning.run import make_learner
from bp2_rl.tools.throughput.measure import (
    OUT_OF_MEMORY,
    BenchOptions,
    Case,
    PartName,
    measure_case,
)
from bp2_rl.tools.throughput.playground import measure_playground, playground_settings
from bp2_rl.tools.throughput.report import (
    NUMBERS,
    PICTURE,
    Bench,
    Startup,
    describe_size,
    print_table,
    say,
    scaling_figure,
)

FIRST_STEP = """import sys; from bp2_rl.cli import bench; bench.import_jax(sys.argv[1:])
from bp2_rl.base import processes; processes.keep_compiled()
from bp2_rl.cli import runtime; runtime.wake_device()
from bp2_rl.cli.bench.measuring import first_step; first_step()"""
"""The program whose start `--startup` times."""


def bench(argv: list[str]) -> None:
    """Measure as the command line says; the report on disk grows with every size
    measured."""
    keep_compiled()
    arguments = parse(argv)
    if not arguments.startup:  # whose training refuses by itself
        require_accelerator(arguments.preset)
    sizes = list(choose_sizes(arguments))
    robots = arguments.main_robots if arguments.robots else None
    theirs = playground_settings(robots) if arguments.peer == "playground" else None
    folder = (
        arguments.out
        or Path("reports") / f"bench-{datetime.datetime.now():%Y%m%d-%H%M%S}"
    )
    console, report = Console(), describe(arguments)
    _open(folder, report)
    if arguments.startup:  # before this process takes the devices' memory
        cold, warm = time_startup(argv, console)
        report = dataclasses.replace(report, cold_start=cold, warm_start=warm)
    if theirs:
        _tell(console, "MuJoCo Playground's training compiles, for a minute or more")
        report = dataclasses.replace(
            report, playground=measure_playground(theirs, arguments.seconds)
        )
    for case in measure_all(arguments, sizes, console):
        report = dataclasses.replace(
            report, cases=(*report.cases, case), host_peak_bytes=_host_peak()
        )
        save_config(folder / NUMBERS, report)
    if arguments.peer is not None:
        case = _measure_peer(arguments, report.cases, console)
        report = dataclasses.replace(report, peer=case, host_peak_bytes=_host_peak())
    save_config(folder / NUMBERS, report)
    print_table(report, console)
    if not any(case.measurements for case in report.cases):
        raise UserError(f"nothing could be measured: {report.cases[0].error}")
    if arguments.scaling:
        save_figure(scaling_figure(report), folder / PICTURE)
    console.print(f"report: {folder / NUMBERS}", soft_wrap=True)


def describe(arguments: BenchArguments) -> Bench:
    """A report with nothing measured yet."""
    device = jax.devices()[0]
    backend = " ".join(device.client.platform_version.split())
    return Bench(
        created=utc_now(),
        versions={
            "python": platform.python_version(),
            "backend": backend,
            **package_versions(),
        },
        platform=device.platform,
        device_kind=device.device_kind,
        device_count=jax.device_count(),
        cpu_cores=os.cpu_count() or 1,
        config=arguments.config,
        seconds=arguments.seconds,
    )


def choose_sizes(arguments: BenchArguments) -> Iterator[tuple[int, int]]:
    """Yield (robots, devices), each once; raise UserError where there are fewer devices
    than asked for."""
    there = jax.device_count()
    if max(arguments.devices, default=1) > there:
        raise UserError(f"--devices {max(arguments.devices)}: JAX sees {there}")
    base = arguments.ppo.num_envs
    if not arguments.scaling:
        sizes = [
            (n, d)
            for n in arguments.robots or (base,)
            for d in arguments.devices or (there,)
        ]
    else:
        most = arguments.max_robots or 8 * base
        devices = arguments.devices or tuple(2**k for k in range(there.bit_length()))
        fewest = max(arguments.ppo.num_minibatches, base // 16)
        doublings = tuple(fewest * 2**k for k in range((most // fewest).bit_length()))
        sizes = [(n, 1) for n in arguments.robots or doublings]
        sizes += [size for d in devices for size in ((base, d), (base * d, d))]
    yield from dict.fromkeys(sizes)


def measure_all(
    arguments: BenchArguments, sizes: Sequence[tuple[int, int]], console: Console
) -> Iterator[Case]:
    """One size after the other; no larger ones than the first that ran out of memory on
    as many devices."""
    parts = arguments.parts or (("training",) if arguments.scaling else STEP)
    full: dict[int, int] = {}  # devices -> robots that they could not hold
    for robots, devices in sizes:
        if robots >= full.get(devices, robots + 1):
            yield Case(
                robots,
                devices,
                error=f"not tried: {full[devices]} robots were out of memory",
            )
            continue
        case = _measure(arguments, (robots, devices), parts, console)
        if case.error == OUT_OF_MEMORY:
            full[devices] = robots
        yield case


def _measure(
    arguments: BenchArguments,
    size: tuple[int, int],
    parts: Sequence[PartName],
    console: Console,
) -> Case:
    robots, devices = size
    case = measure_case(
        lambda robots: make_env(arguments, robots),
        arguments.ppo,
        robots,
        jax.devices()[:devices],
        BenchOptions(
            parts,
            arguments.seconds,
            arguments.profile,
            lambda timing: _tell(console, say(timing)),
        ),
    )
    if case.error:
        _tell(console, f"{describe_size(case)}: {case.error}")
    return case


def _measure_peer(
    arguments: BenchArguments, cases: Sequence[Case], console: Console
) -> Case:
    """Measure ours on one device, and stock Brax's; a training measured before is not
    measured again."""
    alone = (arguments.main_robots, 1)
    if arguments.peer == "brax":
        return _measure(arguments, alone, ("acting", "brax"), console)
    known = (
        case
        for case in cases
        if (case.robots, case.devices) == alone and case.rate("training")
    )
    return next(known, None) or _measure(arguments, alone, ("training",), console)


def make_env(arguments: BenchArguments, robots: int) -> BP2Env:
    """The environment that is measured, for at most so many robots a device."""
    return BP2Env(arguments.env, impl=arguments.impl, num_robots=robots)


# --- From the start of a process ------------------------------------------------------


def time_startup(argv: Sequence[str], console: Console) -> tuple[Startup, Startup]:
    """Two fresh processes up to their first train step: the first compiles, the second
    finds that on disk.

    Raises:
        UserError: one of them failed.
    """
    with tempfile.TemporaryDirectory(prefix="bp2-bench-") as cache:
        starts = []
        for name in ("cold", "warm"):
            began = time.time()
            command = [sys.executable, "-c", FIRST_STEP, *argv]
            ended = subprocess.run(
                command,
                env={**os.environ, "BP2_CACHE": cache},
                capture_output=True,
                text=True,
                check=False,
            )
            if ended.returncode:
                raise UserError(
                    f"--startup: the {name} start failed: {' '.join(ended.stderr.strip().splitlines()[-1:])}"
                )
            moments = json.loads(ended.stdout.splitlines()[-1])
            starts.append(
                from_json(
                    Startup, {key: moment - began for key, moment in moments.items()}
                )
            )
            _tell(
                console,
                f"{name} start: first train step {starts[-1].first_step:.1f} s after the process began",
            )
    return starts[0], starts[1]


def first_step() -> None:
    """Start the training that the command line describes; print when what was done,
    seconds since 1970."""
    moments = {"imported": time.time()}
    programs = keep_compiled()
    arguments = parse(sys.argv[1:])
    ppo = dataclasses.replace(arguments.ppo, num_envs=arguments.main_robots)
    config = dataclasses.replace(arguments.config, ppo=ppo)
    learner = make_learner(config, programs)
    moments["traced"] = time.time()
    with learner.compiling():
        state = jax.block_until_ready(learner.init(0))
    moments["compiled"] = time.time()
    state, _ = jax.block_until_ready(learner.train_step(state))
    moments["first_step"] = time.time()
    params, normalizer = jax.device_get((state.average, state.normalizer))
    make_policy(
        dense_layers(params, learner.mirrors), normalizer, make_card(config, 0, {})
    )
    moments["first_policy"] = time.time()
    print(json.dumps(moments))


# --- Details --------------------------------------------------------------------------


def _open(folder: Path, report: Bench) -> None:
    """Begin the report; raises UserError where the folder holds anything but one, or
    cannot be written."""
    open_report(folder, NUMBERS, "bench")
    (folder / PICTURE).unlink(missing_ok=True)
    save_config(folder / NUMBERS, report)


def _host_peak() -> int | None:
    """The most memory that this process has held, bytes; None where the system does not
    tell it, as Windows."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def _tell(console: Console, line: str) -> None:
    console.print(line, style="dim", soft_wrap=True, highlight=False, markup=False)
    console.file.flush()
