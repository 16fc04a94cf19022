import io
import json
import math
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from tensorboardX.proto import event_pb2

from bp2_rl.base.errors import UserError
from bp2_rl.learning import writers
from bp2_rl.learning.monitor import Monitor, count, duration
from bp2_rl.learning.writers import read_metrics

SHOW_CURSOR = "\x1b[?25h"
HEADLINES = {
    "reward": 12.345,
    "falls": 0.0312,
    "speed_error": 0.409,
    "curriculum_level": 0.625,
    "steps_per_second": 500_000.0,
}


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def pipe(clock: Callable[[], float] = time.monotonic) -> Console:
    return Console(file=io.StringIO(), width=80, get_time=clock)


def terminal(clock: Callable[[], float]) -> Console:
    return Console(
        file=io.StringIO(),
        width=80,
        force_terminal=True,
        color_system=None,
        get_time=clock,
    )


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def console(clock: Clock) -> Console:
    """Return a console that is a pipe and whose time is the clock's."""
    return pipe(clock)


def shown(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def scalars(run_dir: Path) -> list[tuple[str, int, float]]:
    """Return (tag, step, value) of every TensorBoard scalar."""
    return [
        (value.tag, event.step, value.simple_value)
        for event in events(run_dir)
        for value in event.summary.value
    ]


def events(run_dir: Path) -> list:
    """Return TensorBoard's events, read by the TFRecord format: length, crc, data,
    crc."""
    found = []
    for path in sorted(run_dir.glob("events.*")):
        data = path.read_bytes()
        while data:
            (length,) = struct.unpack("<Q", data[:8])
            found.append(event_pb2.Event.FromString(data[12 : 12 + length]))  # pyright: ignore[reportAttributeAccessIssue]
            data = data[16 + length :]
    return found


def test_every_finite_number_is_in_both_files_at_once(tmp_path: Path):
    path = tmp_path / "run" / "metrics.jsonl"
    with Monitor(tmp_path / "run", 100, console=pipe()) as monitor:
        monitor.log(10, {"reward": 1.5, "loss/value": 0.25})
        assert path.read_text().count("\n") == 1
        monitor.log(20, {"reward": math.nan, "loss/value": math.inf})
        monitor.log(30, {"reward": math.nan, "loss/value": 0.5})
    first, second, _ = map(json.loads, path.read_text().splitlines())
    assert first.pop("wall_time") > 1.7e9
    assert first == {"step": 10, "reward": 1.5, "loss/value": 0.25}
    assert second["reward"] is second["loss/value"] is None
    assert scalars(tmp_path / "run") == [
        ("reward", 10, 1.5),
        ("loss/value", 10, 0.25),
        ("loss/value", 30, 0.5),
    ]


def test_the_monitor_of_a_clusters_further_process_leaves_no_trace(
    tmp_path: Path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    with Monitor(None, 100, title="imitation") as monitor:
        monitor.log(10, {"reward": 1.5})
        monitor.log(5, {"judged/speed": 1.0}, late=True)
        monitor.show("a remark")
        monitor.note("a note")
    assert capsys.readouterr().out == ""
    assert list(tmp_path.iterdir()) == []


def test_resuming_drops_what_was_logged_after_the_checkpoint(tmp_path: Path):
    with Monitor(tmp_path, 100, console=pipe()) as monitor:
        for step in (10, 20, 30, 40):
            monitor.log(step, {"reward": step})
    with (tmp_path / "metrics.jsonl").open("a") as file:
        file.write('{"step": 20, "reward": 9}')  # killed before the line's end
    with Monitor(tmp_path, 100, start_step=20, console=pipe()) as monitor:
        monitor.log(30, {"reward": -30.0})
    assert [(r["step"], r["reward"]) for r in read_metrics(tmp_path)] == [
        (10, 10.0),
        (20, 20.0),
        (30, -30.0),
    ]


def test_without_a_terminal_there_is_a_line_every_ten_seconds_and_one_at_the_end(
    tmp_path: Path, clock: Clock, console: Console
):
    with Monitor(tmp_path, 50_000_000, console=console) as monitor:
        for second in range(25):
            clock.now = float(second)
            monitor.log((second + 1) * 500_000, HEADLINES)
    first, *lines = shown(console).splitlines()
    assert first == "training: waiting for the first step"
    assert [line.split()[0] for line in lines] == ["1%", "11%", "21%", "25%"]
    assert (
        lines[-1]
        == " 25% 12.5M/50.0M 500k/s 1:15 left reward 12.3 falls 3.1% error 0.41 level 0.62"
    )
    assert all(len(line) <= 80 for line in lines)
    assert "\x1b" not in shown(console)


def test_a_terminal_shows_a_bar_metrics_and_remark(tmp_path: Path, clock: Clock):
    console = terminal(clock)
    with Monitor(tmp_path, 50_000_000, title="imitation", console=console) as monitor:
        assert "waiting for the first step (0:00)" in shown(console)
        monitor.log(13_000_000, HEADLINES)
        monitor.show("judged: 12.3 m/s at 300")
    bar, headlines, remark = (
        line.rstrip()
        for line in shown(console).replace(SHOW_CURSOR, "").splitlines()[-3:]
    )
    bar = bar[bar.index("imitation ━") :]
    assert bar.endswith(" 26% 13.0M/50.0M 500k/s 1:14 left")
    assert len(bar) <= 80
    assert headlines == "reward 12.3 falls 3.1% error 0.41 level 0.62"
    assert remark == "judged: 12.3 m/s at 300"


@pytest.mark.parametrize(
    ("total", "start", "logs", "line"),
    [
        (10, 0, {83: 10}, "100% 10/10 1/s in 1:23 reward 12.3 "),
        (1000, 500, {0: 510, 10: 520}, " 52% 520/1.00k 1/s 8:00 left "),
    ],
    ids=["one line", "resumed"],
)
def test_a_line_says_how_far_how_fast_and_how_long(
    tmp_path: Path,
    clock: Clock,
    console: Console,
    total: int,
    start: int,
    logs: dict[int, int],
    line: str,
):
    with Monitor(tmp_path, total, start_step=start, console=console) as monitor:
        for second, step in logs.items():
            clock.now = float(second)
            monitor.log(step, HEADLINES | {"steps_per_second": 1.0})
    last = shown(console).splitlines()[-1]
    assert last.startswith(line)
    assert shown(console).count(last) == 1


def test_a_note_goes_to_console_and_log_as_it_is_and_a_record_to_the_log_alone(
    tmp_path: Path, console: Console
):
    text = "checkpoint [red]saved[/red] to /a/very/long/path" + "/and" * 20
    with Monitor(tmp_path, 10, console=console) as monitor:
        monitor.note(text)
        monitor.record("saving step 4")
    assert shown(console).splitlines()[-1] == text
    noted, recorded = (tmp_path / "log.txt").read_text().splitlines()
    assert noted.endswith(f"Z {text}")
    assert recorded.endswith("Z saving step 4")


def test_tensorboard_hides_what_a_resume_repeats(tmp_path: Path):
    """By its rule: a session that starts at a step purges what earlier files hold from
    there on."""
    for start in (0, 20):
        with Monitor(tmp_path, 100, start_step=start, console=pipe()) as monitor:
            monitor.log(start + 10, {"reward": 1.0})
    starts = [
        (event.step, event.session_log.status)
        for event in events(tmp_path)
        if event.HasField("session_log")
    ]
    assert starts == [(21, 1)]  # START


def test_a_full_disk_is_an_error_of_the_writing_and_not_of_the_closing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    class Full(io.StringIO):
        def flush(self) -> None:
            raise OSError(28, "No space left on device")

        def close(self) -> None:
            super().close()
            raise OSError(28, "No space left on device")

    def log() -> None:
        with Monitor(tmp_path, 10, console=pipe()) as monitor:
            lines: Any = monitor._writers[1]
            lines.close()
            monkeypatch.setattr(lines, "_file", Full())
            monitor.log(1, HEADLINES)

    with pytest.raises(OSError, match="No space left") as error:
        log()
    assert error.value.__context__ is None


def test_a_failing_run_still_leaves_its_last_line(tmp_path: Path, console: Console):

    def train() -> None:
        with Monitor(tmp_path, 10, console=console) as monitor:
            monitor.log(1, HEADLINES)
            monitor.log(2, HEADLINES)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        train()
    assert [line.split()[1] for line in shown(console).splitlines()[1:]] == [
        "1/10",
        "2/10",
    ]
    assert len(read_metrics(tmp_path)) == 2


def test_a_run_folder_that_cannot_be_made_is_the_users_mistake(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"cannot write to run folder .*file/run"):
        Monitor(tmp_path / "file" / "run", 10, console=pipe())


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (0, "0"),
        (7.4, "7"),
        (999, "999"),
        (999.6, "1.00k"),
        (1000, "1.00k"),
        (9994, "9.99k"),
        (9996, "10.0k"),
        (12_345, "12.3k"),
        (99_960, "100k"),
        (312_345, "312k"),
        (999_600, "1.00M"),
        (4e6, "4.00M"),
        (50e6, "50.0M"),
        (1.234e9, "1.23G"),
        (9.9999e11, "1.0e+12"),
    ],
)
def test_counts_are_short(number: float, text: str):
    assert count(number) == text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0, "0:00"),
        (42.4, "0:42"),
        (59.6, "1:00"),
        (187, "3:07"),
        (8100, "2:15:00"),
        (3 * 86400 + 4 * 3600, "3d 4h"),
        (-3, "0:00"),
    ],
)
def test_durations_are_short(seconds: float, text: str):
    assert duration(seconds) == text


def test_readable_lines_after_a_damaged_one_are_kept(tmp_path: Path):
    lines = [
        b'{"step": 10, "reward": 1}',
        b'{"step": 2\xff, "rew',
        b"[3]",
        b"[" * 9999,
        b'{"step": 20, "reward": 2}',
        b'{"step": 30, "reward": 3}',
    ]
    path = tmp_path / "metrics.jsonl"
    path.write_bytes(b"".join(line + b"\n" for line in lines))
    with Monitor(tmp_path, 100, start_step=20, console=pipe()):
        pass
    assert [r["step"] for r in read_metrics(tmp_path)] == [10, 20]
    assert path.read_bytes().splitlines() == lines[:-1]


def test_what_is_known_late_is_recorded_at_its_step_and_leaves_the_progress_alone(
    tmp_path: Path, console: Console
):
    with Monitor(tmp_path, 1000, console=console) as monitor:
        monitor.log(500, HEADLINES)
        monitor.log(300, {"judged/speed": 12.5, "judged/falls": math.nan}, late=True)
    late = read_metrics(tmp_path)[-1]
    assert (late["step"], late["judged/speed"], late["judged/falls"]) == (
        300,
        12.5,
        None,
    )
    assert shown(console).splitlines()[-1].split()[:2] == ["50%", "500/1.00k"]


def test_a_remark_stands_below_the_progress_and_is_printed_once(
    tmp_path: Path, clock: Clock, console: Console
):
    with Monitor(tmp_path, 1000, console=console) as monitor:
        for second in (0, 10, 20):
            clock.now = float(second)
            monitor.show("judged: 12.3 m/s at 300")
            monitor.log(100 + second, HEADLINES)
        monitor.show("judged: 12.9 m/s at 300")
    lines = shown(console).splitlines()[1:]
    assert [line for line in lines if line.startswith("judged")] == [
        "judged: 12.3 m/s at 300",
        "judged: 12.9 m/s at 300",
    ]
    assert lines[1] == "judged: 12.3 m/s at 300"
    assert lines[-1] == "judged: 12.9 m/s at 300"


def test_more_metrics_than_a_run_makes_are_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(writers, "LARGEST_METRICS", 10)
    (tmp_path / "metrics.jsonl").write_text('{"step": 1}\n')
    with pytest.raises(UserError, match=r"jsonl has 12 bytes, 10 at most are read"):
        read_metrics(tmp_path)
