"""The commands whose numbers and pictures the index of the paper shows."""

import dataclasses
from pathlib import Path

from bp2_rl.robot.bp2 import OUTDOOR_TOP_SPEED


@dataclasses.dataclass(frozen=True)
class Source:
    """A command of the index, which writes its numbers and pictures to a folder."""

    name: str  # of its folder
    words: tuple[str, ...]  # of the command, after `bp2`
    benchmark: str | None = None  # it runs the policy on this one
    film: bool = False  # it leaves a film, where that can be made
    quick: bool = False  # it has a short version
    # names of the sources whose folders it is told with --runs
    runs: tuple[str, ...] = ()
    numbers: str = "metrics.json"  # the file of its numbers

    @property
    def command(self) -> str:
        """The command line as a user types it."""
        return " ".join(
            ("bp2", *self.words, *(("--runs", "REPORT ...") if self.runs else ()))
        )


def _figure(name: str, *runs: str) -> Source:
    return Source(name, ("paper", "figures", name), runs=runs)


def _evaluated(
    benchmark: str, *words: str, name: str = "", film: bool = False
) -> Source:
    told = ("eval", "--benchmark", benchmark, *words)
    return Source(name or benchmark, told, benchmark=benchmark, film=film)


def _deeply_evaluated(benchmark: str) -> Source:
    told = ("paper", "eval", "--benchmark", benchmark)
    return Source(benchmark, told, benchmark=benchmark, quick=True)


SOURCES = (
    *map(_figure, ("exchange", "sections", "torque", "map", "trapping", "gaits")),
    Source(
        "trajopt",
        ("paper", "trajectories", "figures"),
        numbers="coupling.json",
    ),
    _evaluated("topspeed", film=True),
    _evaluated("topspeed", "--robot", "ideal", "--no-video", name="topspeed_ideal"),
    _evaluated("sprint", film=True),
    _evaluated("losses", "--no-video"),
    _evaluated("sprint", "--robot", "ideal", "--no-video", name="sprint_ideal"),
    _figure("scaling", "topspeed", "topspeed_ideal"),
    _figure("race", "sprint", "sprint_ideal"),
    _figure("robot"),
    _figure("rewards"),
    _figure("strides", "topspeed"),
    _evaluated(
        "topspeed",
        "--speed",
        f"{OUTDOOR_TOP_SPEED:g}",
        "--hold",
        "6",
        "--no-video",
        name="topspeed_outdoors",
    ),
    _figure("operating", "topspeed_outdoors", "topspeed"),
    _figure("identifiability"),
    _figure("binding", "topspeed_ideal"),
    _deeply_evaluated("mechanism"),
    _deeply_evaluated("stability"),
    _deeply_evaluated("efficiency"),
    _deeply_evaluated("endurance"),
)
"""All commands of the index, in the order of running: a command comes after those whose
reports it reads."""


def arguments(
    source: Source,
    folder: Path,
    policy: Path,
    *,
    quick: bool = False,
    film: bool = True,
) -> list[str]:
    """Return a command's words after `bp2`, without the flag for the report's folder.

    Args:
        source: the command.
        folder: of all commands' folders.
        policy: of those that run one.
        quick: short versions, where there are some.
        film: films, where there are some.
    """
    told = list(source.words)
    if source.benchmark is not None:
        told.insert(told.index("--benchmark"), str(policy))
    if source.film and not film:
        told.append("--no-video")
    if source.quick and quick:
        told.append("--quick")
    if source.runs:
        told += ["--runs", *(str(folder / name) for name in source.runs)]
    return told
