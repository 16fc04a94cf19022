"""Results of a bench, against numbers chosen so that the answer is known."""

import io

import pytest
from rich.console import Console

from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.settings.presets import preset
from bp2_rl.tools.bench import (
    Bench,
    Startup,
    peer_ratio,
    print_table,
    remarks,
)
from bp2_rl.tools.playground import PlaygroundRate
from bp2_rl.tools.throughput import Case, PartName, PartTiming

BASE = preset("imitation", "gpu").ppo.num_envs


def measurement(
    part: PartName, robots: int, devices: int, rate: float, **others
) -> PartTiming:
    values = {
        "seconds": 24 * robots / rate,
        "best_seconds": 23 * robots / rate,
        "spread": 0.02,
        "repeats": 5,
        "compilations": 0,
        "trace_seconds": 6.4,
        "compile_seconds": 41.2,
        "from_cache": False,
        "program_bytes": 1_250_000_000,
    } | others
    return PartTiming(part, robots, devices, rate, 5 * rate, **values)


def case(robots: int, devices: int, **rates: float) -> Case:
    rows = tuple(
        measurement(part, robots, devices, rate)  # pyright: ignore[reportArgumentType]
        for part, rate in rates.items()
    )
    return Case(robots, devices, rows)


def bench(*cases: Case, **others) -> Bench:
    return Bench(
        created="2026-11-21T00:00:00Z",
        versions={},
        platform="gpu",
        device_kind="NVIDIA H200",
        device_count=4,
        cpu_cores=16,
        config=preset("imitation", "gpu"),
        seconds=2.0,
        cases=cases,
        **others,
    )


@pytest.fixture
def report():
    return bench(case(BASE, 1, training=267e3, environment=400e3))


def show(report: Bench) -> str:
    console = Console(record=True, width=80, file=io.StringIO())
    print_table(report, console)
    return console.export_text()


def test_the_table_fits_a_terminal_and_has_every_row(report):
    failed = Case(131072, 1, error="out of memory")
    text = show(bench(*report.cases, failed))
    table = text.split("all robots together")[0].splitlines()
    assert max(map(len, table)) <= 80
    assert "…" not in text
    row = next(
        line.split() for line in table if line.split()[:3] == ["training", "8192", "1"]
    )
    assert row[3:] == ["267k", "1.33M", "1.0%", "6.4", "41.2", "1.25GB"]
    assert next(line.split() for line in table if "131072" in line) == [
        "failed",
        "131072",
        "1",
    ]
    assert "131072 robots on 1 device: out of memory" in text


def test_a_program_from_the_cache_is_marked():
    cached = measurement("sgd", 64, 1, 1e3, from_cache=True, program_bytes=None)
    assert "41.2*" in show(bench(Case(64, 1, (cached,))))


def test_the_remarks_say_what_the_table_does_not():
    odd = Case(
        64,
        2,
        (measurement("training", 64, 2, 1e3, compilations=3),),
        shares={"physics": 0.75, "bookkeeping": 0.25},
    )
    starts = {
        "cold_start": Startup(5, 15, 85, 90, 91),
        "warm_start": Startup(5, 6, 9, 18, 18.2),
    }
    said = remarks(bench(odd, **starts))
    assert said == [
        "64 robots on 2 devices, a train step: physics 75%, bookkeeping 25%",
        "64 robots on 2 devices, training: compiled 3 programs while it was timed",
        "cold start: imported 5.0 s, traced 15.0 s, compiled 85.0 s, first step 90.0 s, first policy 91.0 s "
        "after the process began",
        "warm start: imported 5.0 s, traced 6.0 s, compiled 9.0 s, first step 18.0 s, first policy 18.2 s "
        "after the process began",
    ]


def test_playgrounds_training_is_compared_with_ours_on_one_device():
    theirs = PlaygroundRate("jax", 64, 0.02, 12_800, 50.0)
    line = "MuJoCo Playground's Go1, MJX jax, 64 robots: 50 control steps/s of 20 ms"
    larger, ours = case(128, 1, training=900.0), case(64, 1, training=200.0)
    assert line in remarks(bench(larger, playground=theirs))
    beside = bench(ours, larger, peer=ours, playground=theirs)
    assert peer_ratio(beside) == pytest.approx(4.0)
    assert f"{line}; ours, 64 robots, make 4.00 times as many, of 5 ms" in remarks(
        beside
    )
    # what is a case of its own is not shown twice
    assert show(beside).count("training     64") == 1


def test_the_peer_is_a_ratio_of_acting_loops():
    report = bench(case(64, 1, acting=1.0), peer=case(64, 1, acting=300.0, brax=120.0))
    assert peer_ratio(report) == pytest.approx(2.5)
    assert "the learner acts 2.50 times as fast as stock Brax" in remarks(report)
    assert peer_ratio(bench(peer=case(64, 1, acting=300.0))) is None


def test_a_report_is_read_as_it_was_written(report):
    whole = bench(
        *report.cases,
        peer=case(64, 1, brax=1.0),
        cold_start=Startup(1.0, 2.0, 3.0, 4.0, 5.0),
    )
    assert from_json(Bench, to_json(whole)) == whole
