"""W&B's own files hold what the run logged, under one name for all parts of the run."""

import io
import json
import struct
import sys
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import save_config
from bp2_rl.cli import train as command
from bp2_rl.learning.monitor import Monitor
from bp2_rl.learning.writers import open_tracker
from bp2_rl.settings import tracker
from bp2_rl.settings.presets import preset
from bp2_rl.settings.tracker import TRACKED, Tracked, choose_tracker, tracked

CONFIG = preset("imitation", "smoke")


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    (tmp_path / "trot").mkdir()
    return tmp_path / "trot"


def follow(
    tracker: Any, run_dir: Path, start: int, logs: dict[int, dict[str, float]]
) -> None:
    writers = open_tracker(tracker, run_dir, CONFIG)
    with Monitor(
        run_dir,
        40,
        start_step=start,
        writers=writers,
        console=Console(file=io.StringIO()),
    ) as monitor:
        for step, metrics in logs.items():
            monitor.log(step, metrics)
        # of a policy that the run has left behind
        monitor.log(10, {"judged/speed": 3.0}, late=True)


def twice(tracker: Any, run_dir: Path) -> Tracked:
    """Track a run that is stopped after step 30 and goes on from its checkpoint at step
    20; return the names that the tracker gave it."""
    follow(
        tracker,
        run_dir,
        0,
        {
            10: {"reward": 1.0, "reward/tracking": 0.5},
            20: {"reward": 2.0},
            30: {"reward": 3.0, "kl": float("nan")},
        },
    )
    first = tracked(run_dir)
    follow(tracker, run_dir, 20, {30: {"reward": 3.0}, 40: {"reward": 4.0}})
    assert first is not None
    assert tracked(run_dir) == first
    return first


def test_wandb_offline_keeps_every_metric_once_under_one_id(run_dir, monkeypatch):
    pytest.importorskip("wandb", reason="W&B is not installed (the extra `track`)")
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.delenv("WANDB_DIR", raising=False)
    known = twice("wandb", run_dir)
    files = sorted(run_dir.glob(f"wandb/offline-run-*/run-{known.run_id}.wandb"))
    assert len(files) == 2  # a part of the run each
    lines = [line for file in files for line in wandb_history(file)]
    assert [(line["step"], line["reward"]) for line in lines if "reward" in line] == [
        (10, 1),
        (20, 2),
        (30, 3),
        (40, 4),
    ]
    assert [
        (line["step"], line["judged/speed"]) for line in lines if "judged/speed" in line
    ] == [(10, 3)]


def wandb_history(file: Path) -> list[dict[str, Any]]:
    """Read the history in W&B's own file: protobuf records in LevelDB's log format,
    after a header of 7 bytes.

    A block of 32 KiB holds pieces of records: checksum (4 bytes), length (2), kind (1:
    whole, 2 to 4: first, middle, last), then the bytes; less than a piece's head at a
    block's end is padding.
    """
    from wandb.proto import wandb_internal_pb2  # pyright: ignore[reportMissingImports]

    data, at, record, lines = file.read_bytes(), 7, b"", []
    assert data[:4] == b":W&B"
    while at < len(data):
        if 32768 - at % 32768 < 7:
            at += 32768 - at % 32768
            continue
        length, kind = struct.unpack("<HB", data[at + 4 : at + 7])
        record += data[at + 7 : at + 7 + length]
        at += 7 + length
        if kind in (1, 4):
            parsed, record = wandb_internal_pb2.Record.FromString(record), b""  # pyright: ignore[reportAttributeAccessIssue]
            if parsed.HasField("history"):
                items = parsed.history.item
                lines.append(
                    {
                        "/".join(item.nested_key) or item.key: json.loads(
                            item.value_json
                        )
                        for item in items
                    }
                )
    return lines


def test_a_server_that_is_gone_stops_the_tracking_and_not_the_training(
    run_dir, monkeypatch
):
    wandb = pytest.importorskip(
        "wandb", reason="W&B is not installed (the extra `track`)"
    )
    monkeypatch.setenv("WANDB_MODE", "offline")
    writers = open_tracker("wandb", run_dir, CONFIG)

    def gone(*_: object, **__: object) -> None:
        raise ConnectionError("no route to host")

    monkeypatch.setattr(wandb.Run, "log", gone)
    console = Console(file=io.StringIO(), width=200)
    with Monitor(run_dir, 20, writers=writers, console=console) as monitor:
        monitor.log(10, {"reward": 1.0})
        monitor.log(20, {"reward": 2.0})
    assert console.file.getvalue().count("warning: wandb has failed") == 1  # pyright: ignore[reportAttributeAccessIssue]
    assert len((run_dir / "metrics.jsonl").read_text().splitlines()) == 2


def test_wandb_without_a_key_is_a_mistake_of_the_user(run_dir, monkeypatch, tmp_path):
    wandb = pytest.importorskip(
        "wandb", reason="W&B is not installed (the extra `track`)"
    )
    wandb.teardown()  # it remembers the mode of its first run
    for name in ("WANDB_MODE", "WANDB_API_KEY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
    with pytest.raises(
        UserError,
        match="--track wandb does not work: UsageError: No API key configured",
    ):
        open_tracker("wandb", run_dir, CONFIG)
    assert list(run_dir.iterdir()) == []


def test_a_tracker_that_is_not_installed_is_one_line_before_training(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(tracker.importlib.util, "find_spec", lambda name: None)
    monkeypatch.chdir(tmp_path)
    assert (
        command.main(["--stage", "imitation", "--preset", "smoke", "--track", "wandb"])
        == 2
    )
    install = 'pip install -c constraints.txt -e ".[track]"'
    assert (
        capsys.readouterr().err
        == f"error: --track wandb needs the package wandb: {install}\n"
    )
    assert list(tmp_path.iterdir()) == []


def test_a_resumed_run_keeps_its_tracker(run_dir, monkeypatch):
    monkeypatch.setattr(tracker.importlib.util, "find_spec", lambda name: sys)
    assert choose_tracker(None, run_dir) is None
    assert choose_tracker("wandb", run_dir) == "wandb"
    save_config(run_dir / TRACKED, Tracked("wandb", "12ab", "bp2_rl"))
    assert choose_tracker(None, run_dir) == "wandb"


def test_a_damaged_tracker_file_is_a_line(run_dir):
    (run_dir / TRACKED).write_text(
        '{"tracker": "neptune", "run_id": "12ab", "place": ""}'
    )
    with pytest.raises(UserError, match=r"trot/tracker.json: tracker"):
        choose_tracker(None, run_dir)
