"""A task: a user's Python file with reward rows, terminations, observation entries and
changed settings.

    TASK = Task(rows=[TaskRow("level_trunk", level_trunk, imitation=0.1)])

A run keeps the text of the file, and of the modules beside it that the file imports, in
its folder `task`. Its settings, and the cards of its policies, hold a `TaskConfig`:
names, numbers and a hash, without code. Only somebody who names a task runs its code.
"""

import ast
import contextlib
import dataclasses
import functools
import hashlib
import importlib.abc
import importlib.machinery
import importlib.util
import re
import sys
import traceback
from collections.abc import Callable, Generator, Iterable
from pathlib import Path, PurePosixPath
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING, Annotated

import numpy as np

from bp2_rl.base.arrays import Array
from bp2_rl.base.bounds import UNWRITTEN, Bounded, Within
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import BadFileError, read_bytes, write_text
from bp2_rl.robot import observation
from bp2_rl.robot.observation import ENTRIES, Entry, Mirror, Moment

if TYPE_CHECKING:
    from bp2_rl.env.observations import Unsensed
    from bp2_rl.settings.training import Stage, TrainConfig

Coefficient = Annotated[float, Within(-1000.0, 1000.0)]
NAME = "TASK"
"""Name of the task in its file, where no other is given."""
FOLDER = "task"
"""Folder of a run that holds the sources of its task."""
LARGEST_SOURCE = 1 << 20
"""Bytes of the largest source that is read."""
ON_BOARD = "math", "numpy", "bp2_rl.robot.conventions", "bp2_rl.robot.observation"
"""Modules that an entry of a policy may use: a robot's computer has them."""
MOMENT = MappingProxyType(
    {
        "command": observation.COMMAND,
        "clock": observation.CLOCK,
        "joint_position": observation.JOINTS,
        "joint_velocity": observation.JOINTS,
        "up": observation.VECTOR,
        "angular_velocity": observation.ROTATION,
        "last_action": observation.JOINTS,
        "stand": observation.JOINTS,
    }
)
"""Mirror images of the fields of a `Moment`."""


@dataclasses.dataclass(frozen=True)
class TaskRow:
    """A row of the reward: coefficient x read(inputs, config, shared).

    `read` takes `env.rewards.RewardInputs`, `RewardConfig` and `SharedTerms`, and
    returns one number, without unit.
    """

    name: str
    read: Callable[..., Array]
    imitation: Coefficient  # the coefficient in the imitation stage
    relaxed: Coefficient | None = None  # None: as in the imitation stage


@dataclasses.dataclass(frozen=True)
class TaskTermination:
    """A reason to end an episode, which then counts as a fall.

    `read` takes `env.observations.Unsensed`, and returns one truth value.
    """

    name: str
    read: Callable[..., Array]


@dataclasses.dataclass(frozen=True)
class Task:
    """What a user adds to the training of `EnvConfig`; every part may be left out.

    Args:
        rows: of the reward.
        terminations: of an episode.
        entries: of the policy's observation, functions of the sensors and the command
            (`Moment`) that use NumPy alone, since the robot's computer runs them.
        privileged: entries of the critic's observation (`env.observations.Unsensed`).
        settings: returns a stage's settings, changed: commands, randomisation, PPO.
            Flags change them afterwards.

    Raises:
        UserError: a name is wrong or there twice, a part is no function, or an entry
            has no mirror image.
    """

    rows: Iterable[TaskRow] = ()
    terminations: Iterable[TaskTermination] = ()
    entries: Iterable[Entry[Moment]] = ()
    privileged: "Iterable[Entry[Unsensed]]" = ()
    settings: "Callable[[TrainConfig], TrainConfig] | None" = None

    def __post_init__(self) -> None:
        """Make tuples of the parts, and refuse what cannot be."""
        for field, kind in (
            ("rows", TaskRow),
            ("terminations", TaskTermination),
            ("entries", Entry),
            ("privileged", Entry),
        ):
            parts = tuple(getattr(self, field))
            object.__setattr__(self, field, parts)
            names = [one.name for one in parts if isinstance(one, kind)]
            if len(names) < len(parts):
                raise UserError(f"Task: {field} takes entries of type {kind.__name__}")
            for one in parts:
                if not re.fullmatch(r"[a-z][a-z0-9_]*", one.name):
                    raise UserError(
                        f"Task: {field}: {one.name!r} is no name: use a-z, 0-9 and _"
                    )
                if names.count(one.name) > 1:
                    raise UserError(f"Task: {field} has {one.name} twice: rename one")
                if not callable(one.read):
                    raise UserError(f"Task: {field}: {one.name} has no function")
        for entry in (*self.entries, *self.privileged):
            _require_mirror(entry)


@dataclasses.dataclass(frozen=True)
class TaskSources:
    """The texts of a task's file and of the modules beside it that the file imports."""

    main: str  # the task's file, relative to the folder of all, with slashes
    name: str  # the task in that file
    files: tuple[tuple[str, str], ...]  # paths, as `main`, and texts

    @property
    def sha256(self) -> str:
        """Checksum of all names and texts."""
        return hashlib.sha256(repr((self.name, self.files)).encode()).hexdigest()

    def write(self, folder: Path) -> None:
        """Write the files below a folder."""
        for path, text in self.files:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            write_text(folder / path, text)


@dataclasses.dataclass(frozen=True)
class TaskConfig(Bounded, path="task."):
    """A task in a run's settings and in a policy's card: all of it but the code."""

    source: str  # the file, relative to a run's folder `task`, and a name: task.py:TASK
    sha256: str  # of the sources
    rows: tuple[tuple[str, Coefficient], ...] = ()  # coefficients of the stage
    entries: tuple[tuple[str, int], ...] = ()  # names and sizes; of the policy
    privileged: tuple[tuple[str, int], ...] = ()  # of the critic
    code: TaskSources | Task | None = dataclasses.field(
        default=None, repr=False, metadata=UNWRITTEN
    )
    """the task's code, where somebody has named it; no file has it"""

    @property
    def task(self) -> Task:
        """The task itself.

        Raises:
            UserError: nobody has named its code.
        """
        if self.code is None:
            names = ", ".join(name for name, _ in self.entries)
            raise UserError(
                f"the policy sees {names} of the task {self.source}: name that file with --task, or as task="
            )
        return run_task(self.code)

    def with_code(self, code: TaskSources) -> "TaskConfig":
        """Return this config with the code that it was made with.

        Raises:
            UserError: the code is another.
        """
        if code.sha256 != self.sha256:
            raise UserError(
                f"the task {code.main} is not as it was trained with: its sources have the checksum "
                f"{code.sha256[:12]}, not {self.sha256[:12]}; name the one in the run's folder {FOLDER}, or train anew"
            )
        return dataclasses.replace(self, code=code)


def task_config(code: TaskSources | Task, stage: "Stage") -> TaskConfig:
    """Return a task for the settings of a stage, with the coefficients of the stage.

    Raises:
        UserError: the task's file fails, or an entry cannot be computed on board.
    """
    task = run_task(code)
    source, sha256 = "", ""
    if isinstance(code, TaskSources):
        source, sha256 = f"{code.main}:{code.name}", code.sha256
    _check_entries(task, code)
    return TaskConfig(
        source,
        sha256,
        tuple(
            (row.name, row.imitation if row.relaxed is None else getattr(row, stage))
            for row in task.rows
        ),
        tuple((entry.name, entry.size) for entry in task.entries),
        tuple((entry.name, entry.size) for entry in task.privileged),
        code,
    )


# --- Files ----------------------------------------------------------------------------


def read_task(where: Path | str, root: Path | None = None) -> TaskSources:
    """Read the sources of a task, without running them.

    Args:
        where: FILE.py, FILE.py:NAME or package.module:NAME.
        root: the folder that a file and the modules beside it are in; by default the
            file's own.

    Raises:
        UserError: there is no such file, or a source cannot be read.
    """
    place, colon, name = str(where).rpartition(":")
    if not colon or str(where).endswith(".py"):
        place, name = str(where), NAME
    if place.endswith(".py"):
        file = Path(place)
        root = file.parent if root is None else root
    else:
        root, file = _find_module(place)
    texts: dict[str, str] = {}
    _gather(root, file.relative_to(root), texts)
    main = file.relative_to(root).as_posix()
    return TaskSources(main, name, tuple(sorted(texts.items())))


def read_run_task(run_dir: Path, config: TaskConfig) -> TaskConfig:
    """Return a run's task with the code that is kept in the run's folder.

    Raises:
        UserError: a source is missing, or is not as the run was begun with.
    """
    folder = Path(run_dir) / FOLDER
    return config.with_code(read_task(folder / config.source, folder))


def _find_module(name: str) -> tuple[Path, Path]:
    """Return the folder of an installed module's package, and the module's file."""
    top, *rest = name.split(".")
    try:
        found = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        found = None
    if found is None or found.origin is None:
        raise UserError(
            f"no task {name}: name a file, my_task.py, or a module and a name in it, package.module:{NAME}"
        )
    origin = Path(found.origin)
    if found.submodule_search_locations is None:
        return origin.parent, origin
    root = origin.parents[1]
    file = root.joinpath(top, *rest)
    return root, file / "__init__.py" if file.is_dir() else file.with_suffix(".py")


def _gather(root: Path, path: Path, texts: dict[str, str]) -> None:
    """Add to `texts` the source at a path below `root` and the modules below `root`
    that it imports."""
    key = path.as_posix()
    if key in texts:
        return
    try:
        texts[key] = read_bytes(root / path, LARGEST_SOURCE).decode()
        tree = ast.parse(texts[key])
    except (BadFileError, UnicodeDecodeError) as error:
        raise UserError(f"task {error}") from error
    except (SyntaxError, ValueError) as error:
        line = f", line {error.lineno}" if isinstance(error, SyntaxError) else ""
        raise UserError(f"task {root / path}{line}: {error}") from error
    package = path.parent.parts
    for start in range(len(package)):
        inner = Path(*package[: start + 1]) / "__init__.py"
        if (root / inner).is_file():
            _gather(root, inner, texts)
        else:
            texts.setdefault(inner.as_posix(), "")
    for name in _imported(tree, package):
        beside = Path(*name)
        for candidate in (beside.with_suffix(".py"), beside / "__init__.py"):
            if name[0] != "bp2_rl" and (root / candidate).is_file():
                _gather(root, candidate, texts)


def _imported(tree: ast.Module, package: tuple[str, ...]) -> set[tuple[str, ...]]:
    """Return the modules that a source of a package may import, as parts of names."""
    names = set[tuple[str, ...]]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {tuple(each.name.split(".")) for each in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) + 1 - node.level] if node.level else ()
            module = (*above, *(node.module.split(".") if node.module else ()))
            names |= {module, *((*module, each.name) for each in node.names)}
    return {name for name in names if name}


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.InspectLoader):
    """Imports the modules of a task from their texts."""

    def __init__(self, sources: TaskSources):
        self._texts = {_module_name(path): (path, text) for path, text in sources.files}

    def find_spec(
        self, fullname: str, path: object = None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        del path, target
        if fullname not in self._texts:
            return None
        origin = self._texts[fullname][0]
        return importlib.util.spec_from_loader(fullname, self, origin=origin)

    def is_package(self, fullname: str) -> bool:
        return self._texts[fullname][0].endswith("__init__.py")

    def get_source(self, fullname: str) -> str:
        return self._texts[fullname][1]

    def get_code(self, fullname: str) -> object:
        path, text = self._texts[fullname]
        return compile(text, path, "exec")


def _module_name(path: str) -> str:
    return ".".join(
        PurePosixPath(path.removesuffix("/__init__.py")).with_suffix("").parts
    )


@functools.cache
def run_task(code: TaskSources | Task) -> Task:
    """Run a task's file, once in a process, and return the task.

    Raises:
        UserError: the file raises, or has no such task.
    """
    if isinstance(code, Task):
        return code
    finder, main = _Finder(code), _module_name(code.main)
    names = {_module_name(path) for path, _ in code.files}
    before = {name: sys.modules.pop(name) for name in names & sys.modules.keys()}
    sys.meta_path.insert(0, finder)
    try:
        with user_code(code.main):
            module = importlib.import_module(main)
    finally:
        sys.meta_path.remove(finder)
        for name in names & sys.modules.keys():
            del sys.modules[name]
        sys.modules.update(before)
    task = getattr(module, code.name, None)
    if not isinstance(task, Task):
        raise UserError(
            f"task {code.main} has no {code.name}: let it say {code.name} = Task(...), or name another, "
            f"{code.main}:NAME"
        )
    return task


@contextlib.contextmanager
def user_code(what: str) -> Generator[None]:
    """Raise a `UserError` for any error in the block; `what`: whose code it runs."""
    try:
        yield
    except (Exception, SystemExit) as error:
        lines = [
            f" ({frame.filename}, line {frame.lineno})"
            for frame in traceback.extract_tb(error.__traceback__)
            if frame.filename.endswith(".py") and not Path(frame.filename).is_absolute()
        ]
        said = str(error) if isinstance(error, UserError) else repr(error)
        raise UserError(f"task: {what}: {said}{lines[-1] if lines else ''}") from error


# --- Entries --------------------------------------------------------------------------


def _require_mirror(entry: Entry[Moment] | "Entry[Unsensed]") -> None:
    """Raise `UserError` unless the mirror image of an entry's mirror image is the
    entry."""
    if not isinstance(entry.mirror, Mirror):  # pyright: ignore[reportUnnecessaryIsInstance]  # a user's
        raise UserError(
            f"Task: entry {entry.name} has no mirror image, which symmetric networks and the symmetry term need: give "
            "SCALAR, VECTOR, ROTATION, LEG, JOINTS or another Mirror of bp2_rl.robot.observation"
        )
    order, sign = entry.mirror
    places = range(len(order))
    twice = [order[order[i]] for i in places] if sorted(order) == [*places] else []
    if len(sign) != len(twice) or any(
        (twice[i], sign[i] * sign[order[i]], abs(sign[i])) != (i, 1, 1) for i in places
    ):
        raise UserError(
            f"Task: the mirror image of entry {entry.name}, taken twice, is not the entry: mend its order or signs"
        )


def _check_entries(task: Task, code: TaskSources | Task) -> None:
    """Raise `UserError` for an entry of the policy that a robot's computer cannot
    compute, or whose mirror image is not the entry of the mirrored robot."""
    known = {entry.name for entry in ENTRIES}
    for entry in (*task.entries, *task.privileged):
        if entry.name in known:
            raise UserError(f"Task: the policy sees {entry.name} already: rename it")
    on_board = task.entries
    if isinstance(code, TaskSources) and task.entries:
        module: dict[str, tuple[Entry[Moment], ...]] = {}
        exec(onboard_source(code, task), module)
        on_board = module["TASK_ENTRIES"]
    draw = np.random.default_rng(0)
    drawn = {name: draw.normal(size=len(m.sign)) for name, m in MOMENT.items()}
    drawn["up"] /= np.linalg.norm(drawn["up"])
    now = Moment(**drawn)
    mirrored = Moment(**{name: reflect(m, drawn[name]) for name, m in MOMENT.items()})
    for entry, same in zip(task.entries, on_board, strict=True):
        with user_code(f"entry {entry.name}"):
            value, again, image = (
                np.asarray(read(moment), float)
                for read, moment in (
                    (entry.read, now),
                    (same.read, now),
                    (entry.read, mirrored),
                )
            )
        if value.shape != (entry.size,):
            raise UserError(
                f"task: entry {entry.name} has the shape {value.shape}, its mirror image ({entry.size},)"
            )
        if not np.allclose(value, again, equal_nan=True):
            raise UserError(
                f"task: entry {entry.name} depends on more than its sensors and on what its file sets once"
            )
        if not np.allclose(image, reflect(entry.mirror, value), equal_nan=True):
            raise UserError(
                f"task: entry {entry.name} of a mirrored robot is {image.round(3)}, its mirror image says "
                f"{reflect(entry.mirror, value).round(3)}: mend its Mirror"
            )


def reflect(mirror: Mirror, values: np.ndarray) -> np.ndarray:
    """Return the mirror image of an array (n)."""
    return values[list(mirror.order)] * np.array(mirror.sign)


def onboard_source(code: TaskSources, task: Task) -> str:
    """Return a module of Python for a robot's computer, whose `TASK_ENTRIES` are the
    policy's entries: their functions and all that those use in the task's file.

    Raises:
        UserError: an entry uses what a robot's computer does not have.
    """
    body = ast.parse(dict(code.files)[code.main]).body
    homes = {name: node for node in body for name in _bound(node)}
    kept = set[ast.stmt]()
    for entry in task.entries:
        place = f"task {code.main}: the policy's entry {entry.name}"
        waiting = [homes.get(getattr(entry.read, "__name__", ""))]
        if not isinstance(waiting[0], ast.FunctionDef):
            raise UserError(
                f"{place}: write its function as a def at the top level of the file"
            )
        while waiting:
            node = waiting.pop()
            if node is None or node in kept:
                continue
            kept.add(node)
            for module in _modules_of(node):
                if module not in ON_BOARD:
                    raise UserError(
                        f"{place} uses {module}, which a robot's computer does not have: compute it by NumPy's "
                        "functions, now.up.__array_namespace__(), or give it to the critic (privileged)"
                    )
            for inner in ast.walk(node):
                if isinstance(inner, ast.arg):
                    inner.annotation = None
                elif isinstance(inner, ast.FunctionDef):
                    inner.returns = None
            names = [one.id for one in ast.walk(node) if isinstance(one, ast.Name)]
            waiting += [homes.get(name) for name in names]
    entries = (
        f"    Entry({entry.name!r}, Mirror{tuple(entry.mirror)}, {entry.read.__name__}),"
        for entry in task.entries
    )
    return "\n".join(
        [
            f'"""The entries of the observation that the task {code.main} adds."""',
            "from bp2_rl.robot.observation import Entry, Mirror",
            *(ast.unparse(node) for node in body if node in kept),
            "TASK_ENTRIES = (",
            *entries,
            ")\n",
        ]
    )


def _bound(node: ast.stmt) -> list[str]:
    """Return the names that a statement of a module binds."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return [node.name]
    if isinstance(node, ast.Import | ast.ImportFrom):
        return [(each.asname or each.name).partition(".")[0] for each in node.names]
    return [
        one.id
        for one in ast.walk(node)
        if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)
    ]


def _modules_of(node: ast.stmt) -> list[str]:
    """Return the modules that an import imports from; none for another statement."""
    if isinstance(node, ast.ImportFrom):
        return [node.module or "."]
    return [each.name for each in node.names] if isinstance(node, ast.Import) else []
