"""Damaged files of every kind, given to every command that reads them: a command reads
the same, or refuses in one line with status 2 and leaves all files as they were."""

import importlib
import os
import random
import shutil
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from aim import StandIn
from aim_run import SMALL
from damage import flipped_bits
from refusals import begin
from rich.progress import Progress

from bp2_rl.base.serialization import save_config
from bp2_rl.cli.trajopt import load_family
from bp2_rl.evaluation.report.folder import Report
from bp2_rl.learning import run
from bp2_rl.learning.policy import load_policy
from bp2_rl.learning.ppo import PPO
from bp2_rl.optimiser.family import FamilyConfig
from bp2_rl.optimiser.solution import save_solution
from bp2_rl.settings.reference import CollocationConfig

pytestmark = pytest.mark.attack

LONGEST = 20.0  # s, for an answer
FLIPS = 12  # of one bit, for each file
POLICY_FILES = ("run/policies/128/card.json", "run/policies/128/weights.npz")
SOLUTION = ("family/speed-00.50.json", "family/speed-00.50.npz")
RUN_FILES = (
    "run/config.json",
    "run/checkpoints/2/metadata.json",
    "run/checkpoints/2/state.npz",
)


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """Return a folder with a run of two train steps, a report of its policy, a library
    of trots and a family."""
    folder = tmp_path_factory.mktemp("original")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            run, "make_learner", lambda config, _=None: PPO(StandIn(), config.ppo)
        )
        words = [
            *SMALL,
            "--out",
            str(folder / "run"),
            "--run.steps",
            "128",
            "--run.checkpoints",
            "1",
        ]
        assert importlib.import_module("bp2_rl.cli.train").main(words) == 0
    weights = load_policy(folder / "run").card.weights_sha256
    (folder / "report").mkdir()
    report = Report(
        "topspeed", {"weights_sha256": weights}, {"topspeed": {"best_speed": 9.5}}, {}
    )
    save_config(folder / "report/metrics.json", report)
    shutil.copy(CollocationConfig().file, folder / "library.npz")
    keep_solved(folder)
    return folder


def keep_solved(folder: Path) -> None:
    """Write a family of one solution to the folder: the library's slowest trot."""
    slowest = load_family(folder / "library.npz")[0]
    save_solution(folder / "family/speed-00.50", slowest)
    save_config(folder / "family/family.json", FamilyConfig())


@pytest.fixture
def cut_off(monkeypatch):
    """Make commands end once they have read all their files."""
    monkeypatch.setattr(
        run, "make_learner", lambda config, _=None: PPO(StandIn(), config.ppo)
    )
    for place in (
        "bp2_rl.learning.loop.train",
        "bp2_rl.learning.run.Saver",
        "bp2_rl.evaluation.report.folder.open_folder",
        "bp2_rl.optimiser.verify.verify",
        "bp2_rl.paper.trajectories.decomposition.decompose",
        "bp2_rl.optimiser.family.spawned",
    ):
        monkeypatch.setattr(place, begin)
    monkeypatch.setattr(
        "bp2_rl.cli.trajopt.progress_bar", lambda: Progress(disable=True)
    )


Damage = Callable[[Path], object]
"""Function that puts something damaged in the place of a deleted file."""
NO_FILES: dict[str, Damage] = {
    "a pipe": os.mkfifo,
    "a device": lambda path: path.symlink_to("/dev/zero"),
    "a folder": os.mkdir,
    "a link to itself": lambda path: path.symlink_to(path.name),
    "nothing": lambda path: None,
}


def damages(content: bytes) -> Iterator[tuple[str, Damage]]:
    """Yield ways to damage a file of this content, each with a name."""
    rng = random.Random(0)
    contents = (
        *flipped_bits(content, FLIPS),
        content[: len(content) // 2],
        content[:-1],
        content + b"\0",
        b"",
        rng.randbytes(500),
        b"[" * 10_000,
    )
    for case, damaged in enumerate(contents):
        yield f"case {case}", partial(Path.write_bytes, data=damaged)
    yield from NO_FILES.items()


COMMANDS = {
    "resume": ("cli.train", ["--resume", "run"], RUN_FILES),
    "relaxed": (
        "cli.train",
        ["--stage", "relaxed", "--preset", "smoke", "--from", "run", "--out", "new"],
        RUN_FILES,
    ),
    "eval": ("cli.eval", ["run", "--no-video"], POLICY_FILES),
    "export": ("cli.export", ["run", "--to", "copy"], POLICY_FILES),
    "export a report": (
        "cli.export",
        ["run", "--to", "copy", "--report", "report"],
        ("report/metrics.json",),
    ),
    "build": (
        "cli.trajopt",
        ["library", "build", "--out", "family"],
        ("family/family.json",),
    ),
    "verify solutions": ("cli.trajopt", ["verify", "family"], SOLUTION),
    "figures": (
        "paper.cli.trajectories",
        ["figures", "family", "--speed", "0.5"],
        SOLUTION,
    ),
    "verify": ("cli.trajopt", ["verify", "library.npz"], ("library.npz",)),
}


@pytest.fixture
def answer(original, cut_off, tmp_path, monkeypatch, capsys):
    """Return a function that runs a command of `COMMANDS` in a copy of the folder and
    returns its exit status and errors."""
    shutil.copytree(original, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)

    def give(name: str) -> tuple[int, str]:
        module, words, _ = COMMANDS[name]
        status = importlib.import_module(f"bp2_rl.{module}").main(list(words))
        return status, capsys.readouterr().err

    return give


@pytest.mark.parametrize("name", COMMANDS)
def test_files_that_are_whole_are_taken(name, answer):
    status, error = answer(name)
    assert status == 0 or "AcceptedError" in error


@pytest.mark.parametrize(
    ("name", "file"),
    [(name, Path(file)) for name, (*_, files) in COMMANDS.items() for file in files],
)
def test_a_damaged_file_is_read_all_the_same_or_refused_in_one_line(name, file, answer):
    """What is no file is not waited for either."""
    wrong = []
    for case, damage in damages(file.read_bytes()):
        file.rmdir() if file.is_dir() else file.unlink(missing_ok=True)
        damage(file)
        before, began = snapshot(), time.monotonic()
        status, error = answer(name)
        took = time.monotonic() - began
        refused = status == 2 and error.startswith("error: ") and error.count("\n") == 1
        mistakes = {
            f"status {status}, {error[:300]!a}": not (
                refused or "AcceptedError" in error or status == 0
            ),
            "something was lost or left behind": refused and snapshot() != before,
            f"took {took:.0f} s": took > LONGEST,
        }
        wrong += [f"{case}: {what}" for what, so in mistakes.items() if so]
        shutil.rmtree("new", ignore_errors=True)
        shutil.rmtree("copy", ignore_errors=True)
    assert not wrong, "\n".join(wrong)


def snapshot() -> dict[str, int]:
    """Return every file of a folder but locks, with its size."""
    found = (Path(folder, name) for folder, _, names in os.walk(".") for name in names)
    return {str(path): path.lstat().st_size for path in found if path.name != ".lock"}
