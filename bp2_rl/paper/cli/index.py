"""`bp2 paper figures --all`: run every command that reproduces an item of the paper,
and write a page of the results."""

import dataclasses
import os
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import tyro

import bp2_rl
from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import read_json, require_name, write_text
from bp2_rl.base.folders import find_folder, new_folder, open_report
from bp2_rl.base.serialization import load_config, save_config
from bp2_rl.cli.app import Command
from bp2_rl.cli.eval import DEFAULT_POLICY
from bp2_rl.paper.index.item import IndexRow, fill, read_items
from bp2_rl.paper.index.sources import SOURCES, Source, arguments

FLAG = "--all"
OUT = Path("reports/figures/all")
PAGE, METRICS, LOG = "index.html", "metrics.json", "log.txt"
MADE = "made.json"  # in a command's folder: how its report was made


@dataclasses.dataclass(frozen=True)
class IndexArguments:
    """Make every panel of the paper that can be made, and a page with a row for every
    item.

    What a command made before is taken as it is, if the version and the command are
    the same, and the files that it read and left have not changed since.
    """

    policy: Annotated[Path | None, tyro.conf.arg(metavar="POLICY_OR_RUN")] = None
    """of all benchmarks; by default the one that ships"""
    quick: bool = False
    """the short versions of the benchmarks that have one"""
    video: bool = True
    """film the runs, where a GL library exists"""
    fresh: bool = False
    """make everything again"""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = OUT
    """the page's folder, with a folder for each command"""


@dataclasses.dataclass(frozen=True)
class IndexReport:
    """The content of the index's metrics.json."""

    version: str
    policy: str
    quick: bool
    commands: dict[str, str]  # that were run, by name of their folders
    seconds: dict[str, float]  # that they took
    missing: dict[str, str]  # why others were not
    verdicts: dict[str, str]  # by item
    numbers: dict[str, dict[str, Any]]  # of each item, by SOURCE:PATH


@dataclasses.dataclass(frozen=True)
class CommandRun:
    """How a command's report was made: the content of its folder's made.json."""

    version: str
    words: tuple[str, ...]
    seconds: float


class FailedError(Exception):
    """A command of the index failed or could not be run; the message says why."""


def _make_all(chosen: IndexArguments) -> None:
    """Run each command whose report is missing or outdated, and rewrite the page after
    each."""
    policy = chosen.policy or asset_path(DEFAULT_POLICY)
    for name in (policy, chosen.out):
        require_name(name)
    if not policy.is_dir():
        raise UserError(
            f"--policy {policy} is no folder: name a policy or a training run"
        )
    _open(chosen.out)
    missing = {source.name: "not run yet" for source in SOURCES}
    _write(chosen, missing)
    for source in SOURCES:
        try:
            if others := [name for name in source.runs if name in missing]:
                raise FailedError(f"left out, as {others[0]} failed")
            _make(source, policy, chosen)
        except FailedError as error:
            missing[source.name] = str(error)
            print(f"{source.name:14} {error}", flush=True)
        else:
            del missing[source.name]
        _write(chosen, missing)
    print(f"index: {chosen.out / PAGE}")


def _open(folder: Path) -> None:
    open_report(folder, METRICS, "index")
    if (folder / METRICS).is_file():
        try:
            load_config(IndexReport, folder / METRICS)
        except UserError:
            raise UserError(
                f"--out {folder} holds another report: name another folder"
            ) from None


def _make(source: Source, policy: Path, chosen: IndexArguments) -> None:
    """Run a command that writes its report to its folder, unless a current report is
    there.

    Raises:
        FailedError: it cannot be run, or fails; what was in its folder stays.
    """
    folder = chosen.out / source.name
    words = arguments(source, chosen.out, policy, quick=chosen.quick, film=chosen.video)
    read = [chosen.out / name / MADE for name in source.runs]
    if source.benchmark is not None:
        read += policy.rglob("*")
    inputs = (*read, folder / source.numbers)
    if not chosen.fresh and is_current(folder, words, inputs):
        print(f"{source.name:14} as it was", flush=True)
        return
    print(f"{source.name:14} {source.command} ...", flush=True)
    begun = time.monotonic()
    with new_folder(folder) as fresh:
        # The film's GL library is bound in a process of its own; a command of ours
        # inherits nothing else that counts.
        ended = subprocess.run(
            [sys.executable, "-m", "bp2_rl", *words, "--out", str(fresh)],
            capture_output=True,
            text=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )
        if ended.returncode != 0 or not (fresh / source.numbers).is_file():
            lines = ended.stderr.strip().splitlines()
            # a refused flag comes in a box
            boxed = [line.strip("│─ ") for line in lines if line.startswith("│")]
            said = boxed or lines[-1:] or [f"ended with status {ended.returncode}"]
            raise FailedError(f"failed: {' '.join(filter(None, said))}")
        write_text(fresh / LOG, ended.stdout)
        # they name the folder that they are in
        for file in (fresh / LOG, *fresh.glob("*.html")):
            write_text(
                file, file.read_text(encoding="utf-8").replace(str(fresh), str(folder))
            )
        seconds = time.monotonic() - begun
        run = CommandRun(bp2_rl.__version__, tuple(words), seconds)
        save_config(fresh / MADE, run)
    print(f"{'':14} {seconds:.0f} s", flush=True)


def is_current(folder: Path, words: list[str], inputs: Iterable[Path]) -> bool:
    """Return whether a folder holds a report by this version and command, newer than
    all `inputs`."""
    made = folder / MADE
    try:
        run = load_config(CommandRun, made)
        newest = max(file.stat().st_mtime for file in inputs)
    except (UserError, OSError):
        return False
    same = (run.version, list(run.words)) == (bp2_rl.__version__, words)
    return same and newest <= made.stat().st_mtime


def _write(chosen: IndexArguments, missing: dict[str, str]) -> None:
    """Write the index page and its numbers from the reports that are there."""
    from bp2_rl.paper.index.page import Made, index_page

    folders = {
        source: find_folder(chosen.out / source.name)
        for source in SOURCES
        if source.name not in missing
    }
    made = [
        Made(source, folder, load_config(CommandRun, folder / MADE).seconds)
        for source, folder in folders.items()
    ]
    reports = {
        source.name: read_json(folder / source.numbers)
        for source, folder in folders.items()
    }
    groups = {
        heading: [fill(item, reports, missing) for item in items]
        for heading, items in read_items().items()
    }
    commands = {source.name: source.command for source in SOURCES}
    policy = "that ships" if chosen.policy is None else chosen.policy.name
    said = f"bp2_rl {bp2_rl.__version__}; policy {policy}{', short versions' if chosen.quick else ''}"
    rows = [row for of_group in groups.values() for row in of_group]
    report = IndexReport(
        version=bp2_rl.__version__,
        policy=policy,
        quick=chosen.quick,
        commands={each.source.name: each.source.command for each in made},
        seconds={each.source.name: each.seconds for each in made},
        missing=dict(missing),
        verdicts={row.item.id: row.verdict for row in rows},
        numbers={row.item.id: _numbers(row) for row in rows if _numbers(row)},
    )
    write_text(chosen.out / PAGE, index_page(groups, made, commands, missing, said))
    save_config(chosen.out / METRICS, report)


def _numbers(row: IndexRow) -> dict[str, Any]:
    return {
        part.at: part.value
        for part in (*row.ours, *row.because)
        if not isinstance(part, str)
    }


make_all = Command(f"bp2 paper figures {FLAG}", IndexArguments, _make_all)
