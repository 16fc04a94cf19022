"""The search for better settings: Optuna proposes, train.py trains, C MuJoCo judges.

A folder of runs, trial-NUMBER, and Optuna's SQLite file. What is there is not done
again: a trial that was stopped on the way goes on where it stands.
"""

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import Any

from bp2_rl.base.files import open_in_place
from bp2_rl.base.folders import lock_folder, make_folder
from bp2_rl.base.serialization import claim_folder, config_hash
from bp2_rl.settings.presets import preset
from bp2_rl.settings.training import Preset
from bp2_rl.tools.study.measuring import PolicyMeasurement, measure_policies
from bp2_rl.tools.study.places import Resources
from bp2_rl.tools.tuning.space import Dimension

SETTINGS, STORAGE = "search.json", "tune.db"
STUDY = "bp2"


@dataclasses.dataclass(frozen=True)
class Search:
    """What is looked for, and with which trainings."""

    space: tuple[Dimension, ...]
    preset: Preset
    robot: str
    steps: int  # control steps of a trial's imitation stage
    seed: int  # of every trial and of the sampler

    def flags(self, values: dict[str, Any]) -> list[str]:
        """A point of the space as flags of train.py."""
        return [
            word
            for one in self.space
            for word in (f"--{one.flag}", one.word(values[one.flag]))
        ]

    def command(self, flags: Sequence[str], run_dir: Path) -> list[str]:
        """The arguments of train.py."""
        words = [
            "--stage",
            "imitation",
            "--preset",
            self.preset,
            "--robot",
            self.robot,
            "--out",
            str(run_dir),
            *flags,
        ]
        # What is saved is judged here, in its own way.
        return [
            *words,
            "--run.judged",
            "0",
            "--run.seed",
            str(self.seed),
            "--run.steps",
            str(self.steps),
        ]


@dataclasses.dataclass(frozen=True)
class Trial:
    """What came of a point of the space."""

    number: int
    flags: tuple[str, ...]
    # m/s, of its fastest policy, 0 if all fell; None where the training failed
    top_speed: float | None


@dataclasses.dataclass(frozen=True)
class _Settings:
    """What all trials of a folder have in common."""

    search: Search
    settings: str  # hash of the preset's, by which a change of the defaults is seen


def run(search: Search, folder: Path, trials: int, resources: Resources) -> list[Trial]:
    """Search until the folder holds so many trials, earlier calls' included; return
    all, the fastest first.

    An interruption ends the trainings, which save what they have; their trials go on at
    the next call.

    Raises:
        UserError: the folder holds another search, or another process is at work on it.
    """
    make_folder(folder)
    with lock_folder(
        folder,
        f"another search is at work in {folder}: wait for it, or name another --out",
    ) as lock:
        settings = config_hash(preset("imitation", search.preset, robot=search.robot))
        claim_folder(folder, SETTINGS, _Settings(search, settings), "a search")
        study = _study(search, folder)
        with resources.open(folder, lock) as (place, measuring, threads):
            known = study.get_trials(deepcopy=False)
            waiting, asked = (
                [trial for trial in known if trial.state.name == "RUNNING"],
                len(known),
            )  # stopped ones first
            # trainings and measurements -> number of the trial
            at_work: dict[Future[Any], int] = {}
            while at_work or waiting or asked < trials:
                while len(at_work) < place.slots and (waiting or asked < trials):
                    if not waiting:
                        waiting, asked = (
                            [study.ask(_distributions(search.space))],
                            asked + 1,
                        )
                    trial = waiting.pop(0)
                    flags, run_dir = (
                        search.flags(trial.params),
                        folder / run_name(trial.number),
                    )
                    resources.say(f"{run_dir.name}: {' '.join(flags)}")
                    at_work[
                        threads.submit(
                            place.train, search.command(flags, run_dir), run_dir
                        )
                    ] = trial.number
                for one in wait(at_work, return_when=FIRST_COMPLETED).done:
                    number, result = at_work.pop(one), one.result()
                    if result is True:  # trained
                        at_work[
                            measuring.submit(
                                measure_policies, folder / run_name(number)
                            )
                        ] = number
                    else:
                        _tell(
                            study,
                            folder / run_name(number),
                            number,
                            result or [],
                            resources.say,
                        )
        return _ranked(study, search)


def _tell(
    study: Any,
    run_dir: Path,
    number: int,
    measured: list[PolicyMeasurement],
    say: Callable[[str], None],
) -> None:
    """Tell Optuna how a trial ended: with measured policies, or with a training that
    failed."""
    from optuna.trial import TrialState

    if measured:
        speed = max(one.top_speed for one in measured)
        say(f"{run_dir.name}: {speed:.2f} m/s")
        study.tell(number, speed)
    else:
        say(f"{run_dir.name} failed: see {run_dir}.txt")
        study.tell(number, state=TrialState.FAIL)


def run_name(number: int) -> str:
    """The folder's name of a trial."""
    return f"trial-{number}"


def _study(search: Search, folder: Path) -> Any:
    """Optuna's, in its SQLite file."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    open_in_place(folder / STORAGE).close()  # SQLite would follow a link
    storage = f"sqlite:///{folder.resolve() / STORAGE}"
    study = optuna.create_study(
        storage=storage, study_name=STUDY, load_if_exists=True, direction="maximize"
    )
    # a later call must not propose the points of the first again
    known = len(study.get_trials(deepcopy=False))
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
    found = [
        Trial(one.number, tuple(search.flags(one.params)), one.value) for one in known
    ]
    return sorted(
        found,
        key=lambda trial: -1.0 if trial.top_speed is None else trial.top_speed,
        reverse=True,
    )
