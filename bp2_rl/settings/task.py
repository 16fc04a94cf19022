"""A task: a user's Python file with reward terms, terminations, observation terms and
changed settings.

    TASK = Task(rewards=[RewardTerm("level_trunk", level_trunk, imitation=0.1)])

A run keeps the text of the file, and of the modules beside it that the file imports, in
its folder `task`. Its settings, and the cards of its policies, hold a `TaskConfig`:
names, numbers and a hash, without code. Only somebody who names a task, or goes on with
its run, runs its code.
"""

import ast
import contextlib
import dataclasses
import functools
import hashlib
import importlib.util
import re
import sys
import traceback
from collections.abc import Callable, Generator, Iterable
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated

import numpy as np

from bp2_rl.base.arrays import Array
from bp2_rl.base.bounds import UNWRITTEN, Bounded, Within
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import read_bytes, write_text
from bp2_rl.robot.observation import (
    JOINTS,
    OBSERVATION_TERMS,
    Mirror,
    ObservationInputs,
    ObservationTerm,
)

if TYPE_CHECKING:
    from bp2_rl.env.observations import PrivilegedInputs
    from bp2_rl.settings.training import Stage, TrainConfig

Coefficient = Annotated[float, Within(-1000.0, 1000.0)]
FOLDER = "task"
"""Folder of a run that holds the sources of its task."""


@dataclasses.dataclass(frozen=True)
class RewardTerm:
    """A reward term: coefficient x read(inputs, config, shared).

    `read` takes `env.rewards.RewardInputs`, `RewardConfig` and `SharedValues`, and
    returns one number, without unit.
    """

    name: str
    read: Callable[..., Array]
    imitation: float  # the coefficient in the imitation stage
    relaxed: float | None = None  # None: as in the imitation stage


@dataclasses.dataclass(frozen=True)
class TerminationTerm:
    """A reason to end an episode, which then counts as a fall.

    `read` takes `env.observations.PrivilegedInputs`, and returns one truth value.
    """

    name: str
    read: Callable[..., Array]


@dataclasses.dataclass(frozen=True)
class Task:
    """A user's additions to a training; every part may be left out.

    Args:
        rewards: terms of the reward.
        terminations: of an episode.
        observations: terms of the policy's observation, functions of `ObservationInputs`,
            which a robot's computer can run.
        privileged: terms of the critic's observation alone, functions of
            `env.observations.PrivilegedInputs`.
        settings: takes and returns a stage's settings: commands, randomisation, PPO.
            Flags change them afterwards.

    Raises:
        UserError: a name is wrong or there twice, or a term has no mirror image.
    """

    rewards: Iterable[RewardTerm] = ()
    terminations: Iterable[TerminationTerm] = ()
    observations: Iterable[ObservationTerm[ObservationInputs]] = ()
    privileged: "Iterable[ObservationTerm[PrivilegedInputs]]" = ()
    settings: "Callable[[TrainConfig], TrainConfig] | None" = None

    def __post_init__(self) -> None:
        """Make tuples of the parts, and raise `UserError` for invalid names or
        mirrors."""
        for field in ("rewards", "terminations", "observations", "privileged"):
            parts = tuple(getattr(self, field))
            object.__setattr__(self, field, parts)
            names = [part.name for part in parts]
            for name in names:
                if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
                    raise UserError(f"{name!r} is no name in {field}: use a-z, 0-9, _")
                if names.count(name) > 1:
                    raise UserError(f"{field} has {name} twice: rename one")
        for term in (*self.observations, *self.privileged):
            _require_mirror(term.name, term.mirror)
            if term.name in {builtin.name for builtin in OBSERVATION_TERMS}:
                raise UserError(f"the policy sees {term.name} already: rename yours")


def _require_mirror(name: str, mirror: object) -> None:
    """Raise `UserError` unless an observation term has a mirror image, whose own is the term."""
    if not isinstance(mirror, Mirror):
        raise UserError(
            f"observation {name} has no mirror image, which symmetric networks and the symmetry term need: give it SCALAR, "
            "VECTOR, JOINTS or another Mirror of bp2_rl.robot.observation"
        )
    order, sign = mirror
    if (
        {type(order), type(sign)} != {tuple}
        or sorted(order) != [*range(len(sign))]
        or any(
            (order[order[i]], sign[i] * sign[order[i]], abs(sign[i])) != (i, 1, 1)
            for i in order
        )
    ):
        raise UserError(
            f"the mirror image of observation {name}, taken twice, is not the observation: correct its order or signs"
        )


@dataclasses.dataclass(frozen=True)
class TaskSources:
    """The texts of a task's file and of the modules beside it that the file imports."""

    name: str  # the task in its file
    files: tuple[tuple[str, str], ...]  # names and texts; each after those it imports

    @property
    def main(self) -> str:
        """Name of the task's file."""
        return self.files[-1][0]

    @property
    def sha256(self) -> str:
        """Checksum of all names and texts."""
        return hashlib.sha256(repr((self.name, self.files)).encode()).hexdigest()

    def write(self, folder: Path) -> None:
        """Write the files into a new folder."""
        folder.mkdir()
        for name, text in self.files:
            write_text(folder / name, text)


@dataclasses.dataclass(frozen=True)
class TaskConfig(Bounded, path="task."):
    """The data of a task, in a run's settings and in a policy's card."""

    source: str = ""  # my_task.py:TASK; empty: there is no task
    sha256: str = ""  # of the sources
    rewards: tuple[tuple[str, Coefficient], ...] = ()  # coefficients in the stage
    observations: tuple[tuple[str, int], ...] = ()  # of the policy: names and sizes
    code: TaskSources | Task | None = dataclasses.field(
        default=None, repr=False, metadata=UNWRITTEN
    )
    """the task's code, if the user gave it; it is not saved in files"""

    @property
    def task(self) -> Task:
        """The task itself; an empty task if there is none, or if its code was not given
        and the policy does not see it.

        Raises:
            UserError: the code of the task's observation terms was not given.
        """
        if self.code is None and self.observations:
            raise UserError(
                f"the policy sees {', '.join(dict(self.observations))}, which its task {self.source} computes: name the file "
                f"with --task, or RUN/{FOLDER}/{self.source}"
            )
        return Task() if self.code is None else run_task(self.code)

    def with_code(self, code: TaskSources | Task) -> "TaskConfig":
        """Return this config with the code that it was made with.

        Raises:
            UserError: the code is another.
        """
        if isinstance(code, TaskSources) and code.sha256 != self.sha256:
            raise UserError(
                f"the task {code.main} is not as in training: the checksum of its sources is {code.sha256[:12]}, not "
                f"{self.sha256[:12] or 'that of any task'}; use the run's own copy, RUN/{FOLDER}, or train again"
            )
        return dataclasses.replace(self, code=code)


def task_config(code: TaskSources | Task, stage: "Stage") -> TaskConfig:
    """Return a task for the settings of a stage, with the coefficients of the stage.

    Raises:
        UserError: the task's file fails, or a term cannot be computed on board.
    """
    task = run_task(code)
    source, sha256 = "a Task", ""
    if isinstance(code, TaskSources):
        source, sha256 = f"{code.main}:{code.name}", code.sha256
    _check_observations(task, code)
    coefficients = tuple(
        (term.name, term.imitation if term.relaxed is None else getattr(term, stage))
        for term in task.rewards
    )
    observations = tuple((term.name, term.size) for term in task.observations)
    return TaskConfig(source, sha256, coefficients, observations, code)


# --- The code -------------------------------------------------------------------------


def read_task(where: Path | str) -> TaskSources:
    """Read the sources of a task, without running them.

    Args:
        where: FILE.py, FILE.py:NAME or package.module:NAME. NAME is TASK by default.

    Raises:
        UserError: there is no such file, or a source cannot be read.
    """
    place, name = str(where), "TASK"
    if not place.endswith(".py"):
        place, _, name = place.rpartition(":")
    if not place.endswith(".py"):
        with contextlib.suppress(ImportError, ValueError):
            place = str(getattr(importlib.util.find_spec(place), "origin", None))
    if not place.endswith(".py"):
        raise UserError(
            f"no task {where}: name FILE.py, FILE.py:NAME or package.module:NAME"
        )
    texts: dict[str, str] = {}
    _gather(Path(place), texts)
    return TaskSources(name, tuple(texts.items()))


def _gather(file: Path, texts: dict[str, str]) -> None:
    """Add to `texts` a source, after the modules beside it that it imports."""
    with user_code(str(file)):
        text = read_bytes(file, 1 << 20).decode("utf-8-sig")
        nodes = [*ast.walk(ast.parse(text, file.name))]
    names = {
        a.name for node in nodes if isinstance(node, ast.Import) for a in node.names
    }
    names |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    texts[file.name] = ""  # modules that import each other are read once
    for name in sorted(names):
        beside = file.with_name(f"{name}.py")
        if beside.name not in texts and beside.is_file():
            _gather(beside, texts)
    del texts[file.name]  # it comes after those
    texts[file.name] = text


@functools.cache
def run_task(code: TaskSources | Task) -> Task:
    """Run a task's file, once in a process, and return the task.

    Raises:
        UserError: the file raises, or has no such task.
    """
    if isinstance(code, Task):
        return code
    modules = {name.removesuffix(".py"): ModuleType(name) for name, _ in code.files}
    before = {name: sys.modules[name] for name in modules if name in sys.modules}
    try:
        for (name, text), (stem, module) in zip(
            code.files, modules.items(), strict=True
        ):
            sys.modules[stem] = module
            with user_code(name):
                exec(compile(text, name, "exec"), vars(module))
    finally:
        for name in modules.keys() & sys.modules.keys():
            del sys.modules[name]
        sys.modules.update(before)
    task = vars(modules[code.main.removesuffix(".py")]).get(code.name)
    if not isinstance(task, Task):
        raise UserError(
            f"task {code.main} has no {code.name}: let it say {code.name} = Task(...), or name another, FILE.py:NAME"
        )
    return task


@contextlib.contextmanager
def user_code(what: str) -> Generator[None]:
    """Raise a `UserError` for any error in the block, where a user's code runs.

    Args:
        what: the part of the task, in words.
    """
    try:
        yield
    except (Exception, SystemExit) as error:
        lines = [
            f", line {frame.lineno} of {frame.filename}"
            for frame in traceback.extract_tb(error.__traceback__)
            if frame.filename.endswith(".py") and not Path(frame.filename).is_absolute()
        ]
        raise UserError(
            f"task: {what}{''.join(lines[-1:])}: {error if isinstance(error, UserError) else repr(error)}"
        ) from error


# --- On board -------------------------------------------------------------------------


def onboard_source(code: TaskSources, task: Task) -> str:
    """Return a module for a robot's computer, whose `TASK_OBSERVATIONS` are the task's
    terms of the policy's observation; each function stands alone, with `np` and `math`.

    Raises:
        UserError: the function of a term is no `def` at the top level of the file.
    """
    defined = {
        node.name: node
        for node in ast.parse(code.files[-1][1]).body
        if isinstance(node, ast.FunctionDef)
    }
    functions: list[str] = []
    observations: list[str] = []
    for term in task.observations:
        name = getattr(term.read, "__name__", "")
        if name not in defined:
            raise UserError(
                f"task {code.main}: a robot's computer runs the function of the policy's observation {term.name}: write it "
                "as a def in that file"
            )
        functions.append(ast.unparse(defined[name]))
        observations.append(
            f"    ObservationTerm({term.name!r}, {term.mirror!r}, {name}),"
        )
    return "\n".join(
        [
            f'"""The observation terms that the task {code.main} adds."""',
            "from __future__ import annotations",
            "import math",
            "import numpy as np",
            "from bp2_rl.robot.observation import ObservationTerm, Mirror",
            *functions,
            "TASK_OBSERVATIONS = (",
            *observations,
            ")\n",
        ]
    )


def _check_observations(task: Task, code: TaskSources | Task) -> None:
    """Raise `UserError` for a term of the policy that a robot's computer cannot
    compute, or whose mirror image is not the term of the mirrored robot."""
    module = {"TASK_OBSERVATIONS": task.observations}
    if isinstance(code, TaskSources) and task.observations:
        exec(onboard_source(code, task), module)
    now, mirrored = _draw_inputs()
    for term in module["TASK_OBSERVATIONS"]:
        with user_code(
            f"observation {term.name} on a robot's computer, which has NumPy as np, math and the sensors alone; for more, "
            "make it the critic's (privileged)"
        ):
            value, image = (
                np.reshape(term.read(inputs), term.size) for inputs in (now, mirrored)
            )
        expected = value[[*term.mirror.order]] * np.array(term.mirror.sign)
        if not np.allclose(image, expected, equal_nan=True):
            raise UserError(
                f"task: observation {term.name} of a mirrored robot is {image}, its mirror image {expected}: correct its Mirror"
            )


def _draw_inputs() -> tuple[ObservationInputs, ObservationInputs]:
    """Return a moment of random numbers, and the moment of the mirrored robot."""
    mirrors = [
        *(term.mirror for term in OBSERVATION_TERMS),
        JOINTS,
    ]  # in the order of ObservationInputs
    drawn = [
        np.random.default_rng(seed).normal(size=len(mirror.sign))
        for seed, mirror in enumerate(mirrors)
    ]
    units = [values / np.linalg.norm(values) for values in drawn]  # as `up` is
    images = [
        values[[*mirror.order]] * np.array(mirror.sign)
        for values, mirror in zip(units, mirrors, strict=True)
    ]
    return ObservationInputs(*units), ObservationInputs(*images)
