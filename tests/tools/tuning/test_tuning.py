"""The search with the real Optuna: what it keeps, what a second call goes on with, and
what it refuses at once."""

import sqlite3
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.cli import tune as command
from bp2_rl.tools.study import places
from bp2_rl.tools.study.measuring import PolicyMeasurement
from bp2_rl.tools.tuning import search as tuning
from bp2_rl.tools.tuning.search import Search, Trial
from bp2_rl.tools.tuning.space import parse_dimension

SPACE = tuple(
    map(
        parse_dimension,
        ("env.reward.tracking=0:4", "ppo.num-epochs=1:3", "ppo.activation=swish,elu"),
    )
)
SEARCH = Search(SPACE, "smoke", "built", 1024, 0)


class Place:
    """A training takes no time; the `stop_at`th is interrupted, those of elu fail."""

    slots = 2

    def __init__(self, stop_at: int | None = None):
        self.trained: list[tuple[Path, list[str]]] = []
        self._stop_at = stop_at

    def train(self, arguments, run_dir: Path) -> bool:
        self.trained.append((run_dir, list(arguments)))
        if len(self.trained) == self._stop_at:
            raise KeyboardInterrupt
        return "elu" not in arguments

    def stop(self) -> None:
        pass


@pytest.fixture
def search(tmp_path, monkeypatch):
    """Searches in one folder; a robot is as fast as the error of tracking is near 3,
    and slower with each epoch."""
    pytest.importorskip("optuna", reason="Optuna is not installed (the extra `tune`)")

    def judged(run_dir: Path) -> list[PolicyMeasurement]:
        words = next(words for where, words in place.trained if where == run_dir)
        tracking, epochs = (
            float(words[words.index(f"--{one.flag}") + 1]) for one in SPACE[:2]
        )
        speed = 10.0 - abs(tracking - 3.0) - epochs
        return [PolicyMeasurement(1, "", speed, 0), PolicyMeasurement(2, "", 0.0, 3)]

    def run(trials: int, here: Place, sought: Search = SEARCH) -> list[Trial]:
        nonlocal place
        place = here
        return tuning.run(
            sought, tmp_path / "tune", trials, places.Resources((), 1, lambda _: None)
        )

    place = Place()
    monkeypatch.setattr(places, "Here", lambda *_: place)
    monkeypatch.setattr(
        places, "spawned", lambda count, initializer: ThreadPoolExecutor(count)
    )
    monkeypatch.setattr(tuning, "measure_policies", judged)
    return run


def test_a_search_ranks_its_trials_and_goes_on_where_it_was_stopped(search, tmp_path):
    stopped, second = Place(stop_at=4), Place()
    with pytest.raises(KeyboardInterrupt):
        search(6, stopped)
    ranked = search(6, second)
    assert sorted(trial.number for trial in ranked) == list(range(6))
    # The interrupted ones come first, as they were; nothing else is trained twice.
    before, after = dict(stopped.trained), dict(second.trained)
    again = before.keys() & after.keys()
    assert stopped.trained[-1][0] in again
    assert all(before[run_dir] == after[run_dir] for run_dir in again)
    assert before.keys() | after.keys() == {
        tmp_path / "tune" / f"trial-{n}" for n in range(6)
    }
    speeds = [trial.top_speed for trial in ranked if trial.top_speed is not None]
    assert speeds == sorted(speeds, reverse=True)
    assert all(("elu" in trial.flags) == (trial.top_speed is None) for trial in ranked)
    with sqlite3.connect(tmp_path / "tune" / "tune.db") as kept:
        states = [state for (state,) in kept.execute("select state from trials")]
        values = [
            value
            for (value,) in kept.execute(
                "select value from trial_values order by value desc"
            )
        ]
    kept.close()
    assert states.count("COMPLETE") == len(speeds) == 6 - states.count("FAIL")
    assert values == pytest.approx(speeds)
    third = Place()
    assert search(6, third) == ranked
    assert third.trained == []


def test_another_search_is_not_mixed_in(search):
    search(1, Place())
    with pytest.raises(UserError, match="holds a search with another search "):
        search(1, Place(), Search(SPACE[:2], "smoke", "built", 1024, 0))


def test_the_kept_trials_are_not_written_through_a_link(search, tmp_path):
    victim = tmp_path / "victim.db"
    victim.touch()
    (tmp_path / "tune").mkdir()
    (tmp_path / "tune" / "tune.db").symlink_to(victim)
    with pytest.raises(UserError, match=r"tune\.db is a link to elsewhere: remove it"):
        search(1, Place())
    assert victim.read_bytes() == b""


def test_the_command_ranks_and_says_how_to_train_with_the_best(
    search, tmp_path, capsys
):
    folder = tmp_path / "tune"
    flags = [
        "--search",
        "env.reward.tracking=0:4",
        "ppo.num-epochs=1:3",
        "ppo.activation=swish,elu",
    ]
    flags += [
        "--preset",
        "smoke",
        "--steps",
        "1024",
        "--out",
        str(folder),
        "--trials",
        "4",
    ]
    assert command.main(flags) == 0
    printed = capsys.readouterr().out
    assert (folder / "table.md").read_text() in printed
    best = search(4, Place())[0]
    assert (
        f"| {best.number} | {best.top_speed:.2f} | {' '.join(best.flags)} |\n"
        in printed
    )
    assert (
        printed.splitlines()[-1]
        == f"python train.py --preset smoke {' '.join(best.flags)}"
    )


def test_nothing_is_recommended_among_policies_that_all_fall(
    search, tmp_path, monkeypatch, capsys
):
    fallen = PolicyMeasurement(1, "", 0.0, 3)
    monkeypatch.setattr(tuning, "measure_policies", lambda run_dir: [fallen])
    flags = [
        "--search",
        "env.reward.tracking=0:4",
        "--preset",
        "smoke",
        "--out",
        str(tmp_path / "tune"),
        "--trials",
        "2",
    ]
    assert command.main([*flags, "--out", str(tmp_path / "tune")]) == 1
    printed = capsys.readouterr()
    assert printed.err.startswith("all policies fell in every launch")
    assert "| 0.00 |" in printed.out
    assert "python train.py" not in printed.out


def test_values_are_words_that_train_py_reads():
    tracking, epochs, activation = SPACE
    rate = parse_dimension("--ppo.learning-rate=1e-5:1e-2:log")
    assert [one.kind for one in (tracking, epochs, activation, rate)] == [
        "int",
        "int",
        "choice",
        "log",
    ]
    assert SEARCH.flags(
        {"env.reward.tracking": 2, "ppo.num-epochs": 3, "ppo.activation": "elu"}
    ) == [
        "--env.reward.tracking",
        "2",
        "--ppo.num-epochs",
        "3",
        "--ppo.activation",
        "elu",
    ]
    assert rate.word(1.25e-4) == "0.000125"


@pytest.mark.parametrize(
    ("search", "words"),
    [
        ("ppo.learning-rate", "--search takes FLAG=LOW:HIGH"),
        ("ppo.learning-rate=1:0", "with LOW < HIGH"),
        ("ppo.learning-rate=0:1:log", "for log above 0"),
        ("ppo.learning-rate=a:b", "a to b are not numbers"),
        ("ppo.activation=elu", "name two values or more"),
        ("ppo.learning-speed=1e-4:1e-3", "ppo.learning-speed"),
        ("ppo.learning-rate=-1.0:1e-3", "ppo.learning_rate"),
        (
            "ppo.activation=elu,sine",
            "--ppo.activation takes elu, relu, swish or tanh; got sine",
        ),
    ],
)
def test_a_search_that_cannot_be_is_refused_in_a_line(
    search, words, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert command.main(["--search", search, "--preset", "smoke"]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
