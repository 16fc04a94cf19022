"""Damaged files of every kind, given to every command that reads them: read all the same, or refused in one line with
status 2; and what was there is there still."""

import importlib
import itertools
import os
import random
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from aim import StandIn
from aim_run import SMALL

from bp2_rl.assets import asset_path
from bp2_rl.learning import run
from bp2_rl.learning.ppo import PPO
from bp2_rl.settings.gait import SHIPPED

pytestmark = pytest.mark.attack

LONGEST = 20.0  # s, for an answer
FLIPS = 12  # of one bit, for each file
POLICY_FILES = ("run/policy/card.json", "run/policy/weights.npz")
RUN_FILES = ("run/config.json", "run/checkpoints/2/metadata.json", "run/checkpoints/2/state.npz")


class AcceptedError(Exception):
    """The command would begin its work."""


def begin(*_, **__):
    raise AcceptedError


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """A folder with a run of two train steps, a library of trots, and a policy's report."""
    folder = tmp_path_factory.mktemp("original")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "make_learner", lambda config: PPO(StandIn(), config.ppo))
        words = [*SMALL, "--out", str(folder / "run"), "--run.steps", "128", "--run.checkpoints", "1"]
        assert importlib.import_module("bp2_rl.cli.train").main(words) == 0
    shutil.copy(asset_path(SHIPPED), folder / "library.npz")
    return folder


@pytest.fixture
def cut_off(monkeypatch):
    """Commands end where they have read everything."""
    monkeypatch.setattr(run, "make_learner", lambda config: PPO(StandIn(), config.ppo))
    for place in (
        "bp2_rl.learning.loop.train",
        "bp2_rl.learning.run.save_checkpoint",
        "bp2_rl.evaluation.report.folder.open_folder",
        "bp2_rl.cli.trajopt.output.progress",
    ):
        monkeypatch.setattr(place, begin)


def damages(content: bytes) -> Iterator[bytes | None]:
    """What a file may have become; None: it is gone."""
    rng = random.Random(0)
    for _ in range(FLIPS):
        flipped = bytearray(content)
        flipped[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        yield bytes(flipped)
    yield from (
        content[: len(content) // 2],
        content[:-1],
        content + b"\0",
        b"",
        rng.randbytes(500),
        b"[" * 10_000,
        None,
    )


COMMANDS = {
    "resume": ("train", ["--resume", "run"], RUN_FILES),
    "relaxed": ("train", ["--stage", "relaxed", "--preset", "smoke", "--from", "run", "--out", "new"], RUN_FILES),
    "eval": ("eval", ["run", "--no-video"], POLICY_FILES),
    "export": ("export", ["run", "--to", "copy"], POLICY_FILES),
    "verify": ("trajopt", ["verify", "library.npz"], ("library.npz",)),
}


@pytest.mark.parametrize(("name", "file"), [(name, file) for name, (*_, files) in COMMANDS.items() for file in files])
def test_a_damaged_file_is_read_all_the_same_or_refused_in_one_line(
    name, file, original, cut_off, tmp_path, monkeypatch, capsys
):
    module, words, _ = COMMANDS[name]
    main = importlib.import_module(f"bp2_rl.cli.{module}").main
    shutil.copytree(original, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    wrong = []
    for case, damaged in zip(itertools.count(), damages((original / file).read_bytes())):
        Path(file).unlink(missing_ok=True)
        if damaged is not None:
            Path(file).write_bytes(damaged)
        before = snapshot()
        began = time.monotonic()
        status = main(list(words))
        error = capsys.readouterr().err
        refused = status == 2 and error.startswith("error: ") and error.count("\n") == 1
        if not (refused or "AcceptedError" in error or status == 0):
            wrong.append(f"case {case}: status {status}, {error[:300]!a}")
        if refused and snapshot() != before:
            wrong.append(f"case {case}: something was lost or left behind")
        if time.monotonic() - began > LONGEST:
            wrong.append(f"case {case}: took {time.monotonic() - began:.0f} s")
        shutil.rmtree("new", ignore_errors=True)
        shutil.rmtree("copy", ignore_errors=True)
    assert not wrong, "\n".join(wrong)


def snapshot() -> dict[str, int]:
    """Every file but locks, with its size."""
    found = (Path(folder, name) for folder, _, names in os.walk(".") for name in names)
    return {str(path): path.stat().st_size for path in found if path.name != ".lock"}
