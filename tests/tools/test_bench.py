"""Results of a bench, against numbers chosen so that the answer is known."""

import dataclasses
import io

import pytest
from rich.console import Console

from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.settings.presets import preset
from bp2_rl.tools.bench import Bench, print_table, remarks
from bp2_rl.tools.throughput import PartName, PartTiming

BASE = preset("imitation", "gpu").ppo.num_envs


def timing(part: PartName, robots: int, devices: int, rate: float) -> PartTiming:
    return PartTiming(
        part=part,
        robots=robots,
        devices=devices,
        control_steps_per_second=rate,
        physics_steps_per_second=5 * rate,
        seconds=24 * robots / rate,
        best_seconds=23 * robots / rate,
        spread=0.02,
        repeats=5,
        compilations=0,
        trace_seconds=6.4,
        compile_seconds=41.2,
        from_cache=False,
        program_bytes=1_250_000_000,
    )


def bench(*timings: PartTiming, **others) -> Bench:
    return Bench(
        created="2026-11-21T00:00:00Z",
        versions={},
        platform="gpu",
        device_kind="NVIDIA H200",
        device_count=4,
        cpu_cores=16,
        config=preset("imitation", "gpu"),
        seconds=2.0,
        timings=timings,
        **others,
    )


@pytest.fixture
def report():
    return bench(
        timing("training", BASE, 1, 267e3),
        timing("environment", BASE, 1, 400e3),
        errors=("131072 robots on 1 device: out of memory",),
    )


def show(report: Bench) -> str:
    console = Console(record=True, width=80, file=io.StringIO())
    print_table(report, console)
    return console.export_text()


def test_the_table_fits_a_terminal_and_has_every_row(report):
    text = show(report)
    table = text.split("all robots together")[0].splitlines()
    assert max(map(len, table)) <= 80
    assert "…" not in text
    row = next(
        line.split() for line in table if line.split()[:3] == ["training", "8192", "1"]
    )
    assert row[3:] == ["267k", "1.33M", "1.0%", "6.4", "41.2", "1.25GB"]
    assert "131072 robots on 1 device: out of memory" in text


def test_a_program_from_the_cache_is_marked():
    cached = dataclasses.replace(
        timing("sgd", 64, 1, 1e3), from_cache=True, program_bytes=None
    )
    assert "41.2*" in show(bench(cached))


def test_the_remarks_say_what_the_table_does_not():
    # rates of parts one after the other: their times add up to a train step's
    parts: dict[PartName, float] = {
        "physics": 4e3,
        "environment": 2e3,
        "resets": 10e3,
        "policy": 10e3,
        "sgd": 5e3,
    }
    whole = [timing(part, 64, 1, rate) for part, rate in parts.items()]
    late = dataclasses.replace(timing("training", 64, 2, 1e3), compilations=3)
    said = remarks(bench(*whole, timing("training", 64, 1, 1e3), late))
    assert said == [
        "64 robots on 1 device, a train step: physics 25%, resets 10%, rest of the environment 15%, policy 10%, "
        "sgd 20%, bookkeeping 20%",
        "64 robots on 2 devices, training: compiled 3 programs while it was timed",
    ]


def test_a_report_is_read_as_it_was_written(report):
    assert from_json(Bench, to_json(report)) == report
