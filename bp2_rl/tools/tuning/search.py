"""The search for better settings: Optuna proposes, train.py trains, C MuJoCo judges.

A folder of runs, trial-NUMBER, and Optuna's SQLite file. What is there is not done again: a trial that was stopped on
the way goes on where it stands.
"""

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from pathlib import Path
from typing import Any

from bp2_rl.base.folders import lock_folder, make_folder
from bp2_rl.base.serialization import claim_folder, config_hash
from bp2_rl.robot.specs import RobotName
from bp2_rl.settings.training import Preset, make_config
from bp2_rl.tools.study.measuring import PolicyMeasurement, measure_policies
from bp2_rl.tools.study.places import Place, Resources
from bp2_rl.tools.tuning.space import Dimension

SETTINGS, STORAGE = "search.json", "tune.db"
STUDY = "bp2"


@dataclasses.dataclass(frozen=True)
class Search:
    """What is looked for, and with which trainings."""

    space: tuple[Dimension, ...]
    preset: Preset
    robot: RobotName
    steps: int  # control steps of a trial's imitation stage
    seed: int  # of every trial and of the sampler

    def flags(self, values: dict[str, Any]) -> list[str]:
        """A point of the space as flags of train.py."""
        return [word for one in self.space for word in (f"--{one.flag}", one.word(values[one.flag]))]

    def command(self, flags: Sequence[str], run_dir: Path) -> list[str]:
        """The arguments of train.py."""
        words = ["--stage", "imitation", "--preset", self.preset, "--robot", self.robot, "--out", str(run_dir), *flags]
        # What is saved is judged here, in its own way.
        return [*words, "--run.judged", "0", "--run.seed", str(self.seed), "--run.steps", str(self.steps)]


@dataclasses.dataclass(frozen=True)
class Trial:
    """What came of a point of the space."""

    number: int
    flags: tuple[str, ...]
    top_speed: float | None  # m/s, of its fastest policy, 0 if all fell; None where the training failed


@dataclasses.dataclass(frozen=True)
class _Settings:
    """What all trials of a folder have in common."""

    search: Search
    settings: str  # hash of the preset's, by which a change of the defaults is seen


def run(search: Search, folder: Path, trials: int, resources: Resources) -> list[Trial]:
    """Search until the folder holds so many trials, earlier calls' included; return all, the fastest first.

    An interruption ends the trainings, which save what they have; their trials go on at the next call.

    Raises:
        UserError: the folder holds another search, or another process is at work on it.
    """
    make_folder(folder)
    with lock_folder(folder, f"another search is at work in {folder}: wait for it, or name another --out") as lock:
        settings = config_hash(make_config("imitation", search.preset, robot=search.robot))
        claim_folder(folder, SETTINGS, _Settings(search, settings), "a search")
        study = _study(search, folder)
        with resources.open(folder, lock) as (place, measuring, threads):
            searcher = _Searcher(study, search, folder, resources.say)
            searcher.search(trials, place, measuring, threads)
        return _ranked(study, search)


class _Searcher:
    """Asks Optuna for trials, and tells it their results, from one thread; other threads wait for the trainings."""

    def __init__(self, study: Any, search: Search, folder: Path, say: Callable[[str], None]):
        self._study, self._search, self._folder, self._say = study, search, folder, say

    def search(self, trials: int, place: Place, measuring: Executor, threads: Executor) -> None:
        """Go on with trials that were stopped, then ask for more; run as many at a time as `place` has slots."""
        known = self._study.get_trials(deepcopy=False)
        waiting = [(trial.number, trial.params) for trial in known if trial.state.name == "RUNNING"]
        asked = len(known)
        at_work: dict[Future[Any], int] = {}  # trainings and measurements -> number of the trial
        while at_work or waiting or asked < trials:
            while len(at_work) < place.slots and (waiting or asked < trials):
                if waiting:
                    number, values = waiting.pop(0)
                else:
                    trial = self._study.ask(_distributions(self._search.space))
                    number, values, asked = trial.number, trial.params, asked + 1
                flags, run_dir = self._search.flags(values), self._folder / run_name(number)
                self._say(f"{run_name(number)}: {' '.join(flags)}")
                at_work[threads.submit(place.train, self._search.command(flags, run_dir), run_dir)] = number
            done, _ = wait(at_work, return_when=FIRST_COMPLETED)
            for one in done:
                number, result = at_work.pop(one), one.result()
                if result is True:
                    at_work[measuring.submit(measure_policies, self._folder / run_name(number))] = number
                else:
                    self._tell(number, result)

    def _tell(self, number: int, measured: bool | list[PolicyMeasurement]) -> None:
        """Tell Optuna how a trial ended: with measured policies, or with a training that failed."""
        from optuna.trial import TrialState

        name = run_name(number)
        if not isinstance(measured, list) or not measured:
            self._say(f"{name} failed: see {self._folder / name}.txt")
            self._study.tell(number, state=TrialState.FAIL)
        else:
            speed = max(one.top_speed for one in measured)
            self._say(f"{name}: {speed:.2f} m/s")
            self._study.tell(number, speed)


def run_name(number: int) -> str:
    """The folder's name of a trial."""
    return f"trial-{number}"


def _study(search: Search, folder: Path) -> Any:
    """Optuna's, in its SQLite file."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    storage = f"sqlite:///{folder.resolve() / STORAGE}"
    study = optuna.create_study(storage=storage, study_name=STUDY, load_if_exists=True, direction="maximize")
    known = len(study.get_trials(deepcopy=False))  # a later call must not propose the points of the first again
    study.sampler = optuna.samplers.TPESampler(seed=search.seed + known)
    return study


def _distributions(space: Sequence[Dimension]) -> dict[str, Any]:
    from optuna import distributions

    def of(one: Dimension) -> Any:
        if one.kind == "choice":
            return distributions.CategoricalDistribution(one.choices)
        if one.kind == "int":
            return distributions.IntDistribution(round(one.low), round(one.high))
        return distributions.FloatDistribution(one.low, one.high, log=one.kind == "log")

    return {one.flag: of(one) for one in space}


def _ranked(study: Any, search: Search) -> list[Trial]:
    known = study.get_trials(deepcopy=False)
    found = [Trial(one.number, tuple(search.flags(one.params)), one.value) for one in known]
    return sorted(found, key=lambda trial: -1.0 if trial.top_speed is None else trial.top_speed, reverse=True)
