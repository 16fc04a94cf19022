"""The commands whose numbers and pictures the index shows, and their inputs."""

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from bp2_rl.base.assets import asset_path
from bp2_rl.base.files import read_bytes
from bp2_rl.robot.bp2 import OUTDOOR_TOP_SPEED

KEY = "key.json"
"""In a command's folder: what it was made of."""


@dataclasses.dataclass(frozen=True)
class Source:
    """One command, which leaves a folder with its numbers and pictures."""

    name: str  # of its folder
    words: tuple[str, ...]  # of the command, after `bp2`
    reads: tuple[str, ...] = ()  # of the package's assets, files and folders
    benchmark: str | None = None  # it runs the policy on this one
    film: bool = False  # it leaves a film, where that can be made
    quick: bool = False  # it has a short version
    # names of the sources whose folders it is told with --runs
    runs: tuple[str, ...] = ()
    numbers: str = "metrics.json"  # the file of its numbers

    @property
    def command(self) -> str:
        """As a user types it."""
        return " ".join(
            ("bp2", *self.words, *(("--runs", "REPORT ...") if self.runs else ()))
        )


ROBOT = "bp2_mjcf"
LIBRARY = "reference_motions"
PUBLISHED = "published"


def _figure(name: str, reads: tuple[str, ...] = (), *runs: str) -> Source:
    return Source(name, ("paper", "figures", name), reads, runs=runs)


def _evaluated(
    benchmark: str, *words: str, name: str = "", film: bool = False
) -> Source:
    told = ("eval", "--benchmark", benchmark, *words)
    return Source(name or benchmark, told, (ROBOT,), benchmark=benchmark, film=film)


def _deeply_evaluated(benchmark: str) -> Source:
    told = ("paper", "eval", "--benchmark", benchmark)
    return Source(benchmark, told, (ROBOT,), benchmark=benchmark, quick=True)


SOURCES = (
    *map(_figure, ("exchange", "sections", "torque", "map", "trapping", "gaits")),
    Source(
        "trajopt",
        ("paper", "trajectories", "figures"),
        (LIBRARY,),
        numbers="coupling.json",
    ),
    _evaluated("topspeed", film=True),
    _evaluated("topspeed", "--robot", "ideal", "--no-video", name="topspeed_ideal"),
    _evaluated("sprint", film=True),
    _evaluated("losses", "--no-video"),
    _evaluated("sprint", "--robot", "ideal", "--no-video", name="sprint_ideal"),
    _figure("scaling", (PUBLISHED,), "topspeed", "topspeed_ideal"),
    _figure("race", (PUBLISHED,), "sprint", "sprint_ideal"),
    _figure("robot", (ROBOT,)),
    _figure("rewards"),
    _figure("strides", (), "topspeed"),
    _evaluated(
        "topspeed",
        "--speed",
        f"{OUTDOOR_TOP_SPEED:g}",
        "--hold",
        "6",
        "--no-video",
        name="topspeed_outdoors",
    ),
    _figure("operating", (), "topspeed_outdoors", "topspeed"),
    _figure("identifiability"),
    _figure("binding", (), "topspeed_ideal"),
    _deeply_evaluated("mechanism"),
    _deeply_evaluated("stability"),
    _deeply_evaluated("efficiency"),
    _deeply_evaluated("endurance"),
)
"""In the order in which they run: one that is told others' reports comes after them."""


@dataclasses.dataclass(frozen=True)
class Choice:
    """The choices that hold for all commands."""

    policy: Path  # of those that run one
    quick: bool = False
    film: bool = True


def arguments(source: Source, choice: Choice, folder: Path) -> list[str]:
    """The words of a command, after `bp2`, but for where its report goes."""
    told = list(source.words)
    if source.benchmark is not None:
        told.insert(told.index("--benchmark"), str(choice.policy))
    if source.film and not choice.film:
        told.append("--no-video")
    if source.quick and choice.quick:
        told.append("--quick")
    if source.runs:
        told += ["--runs", *(str(folder / name) for name in source.runs)]
    return told


def key_of(
    source: Source, choice: Choice, version: str, others: Mapping[str, str]
) -> str:
    """Twelve hex digits that change with whatever a command's report is made of.

    That is: the package's version, the command's words, the shipped files that it
    reads, the policy's files, and the reports that it is told. Where these lie does not
    count, nor does code that has changed within a version.

    Args:
        source: the command.
        choice: what is chosen for all.
        version: of the package.
        others: the keys of the sources before it.
    """
    shown = dataclasses.replace(choice, policy=Path("POLICY"))
    made_of = {
        "version": version,
        "words": arguments(source, shown, Path("REPORTS")),
        "assets": [digest(asset_path(name)) for name in source.reads],
        "policy": digest(choice.policy) if source.benchmark is not None else None,
        "runs": [others[name] for name in source.runs],
    }
    return hashlib.sha256(json.dumps(made_of, sort_keys=True).encode()).hexdigest()[:12]


def digest(path: Path) -> str:
    """The checksum of a file, or of all files in a folder with their names."""
    found = hashlib.sha256()
    for file in (
        sorted(each for each in path.rglob("*") if each.is_file())
        if path.is_dir()
        else [path]
    ):
        found.update(f"{file.relative_to(path)}\0".encode())
        found.update(hashlib.sha256(read_bytes(file)).digest())
    return found.hexdigest()


@dataclasses.dataclass(frozen=True)
class Key:
    """The key, checksum and duration that a command's folder holds."""

    key: str
    numbers: str  # checksum of the file of its numbers
    seconds: float  # that the command took
