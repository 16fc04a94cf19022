"""Solutions from wherever they are kept: this is where trajopt's family and the gait's
library file meet."""

from pathlib import Path

from bp2_rl.base.errors import UserError
from bp2_rl.optimiser.family import FamilyConfig, arrays_of, family_of, provenance_of
from bp2_rl.optimiser.solution import Solution, load_solution
from bp2_rl.reference.library.file import (
    MotionLibrary,
    broken,
    load_library,
    save_library,
)
from bp2_rl.settings.reference import CollocationConfig


def load_solutions(path: Path | None) -> list[Solution]:
    """The solutions at `path`: a library, a folder of solutions, or a single one; None
    is the library that ships.

    Raises:
        UserError: there are none, or they cannot be read.
    """
    path = CollocationConfig().file if path is None else path
    try:
        if path.is_dir():
            return _load_folder(path)
        if path.suffix == ".npz" and not path.with_suffix(".json").is_file():
            return load_family(path)
    except OSError as error:
        raise UserError(f"{path} cannot be read: {error.strerror or error}") from error
    return [
        load_solution(
            path.with_suffix("") if path.suffix in (".npz", ".json") else path
        )
    ]


def save_family(path: Path, family: list[Solution], settings: FamilyConfig) -> None:
    """Write a family as a motion library."""
    save_library(
        path,
        MotionLibrary(**arrays_of(family), provenance=provenance_of(family, settings)),
    )


def load_family(path: Path) -> list[Solution]:
    """The solutions in a motion library, slowest first.

    Raises:
        UserError: it cannot be read, or its provenance is not that of its arrays.
    """
    library = load_library(path)
    try:
        return family_of(library.arrays, library.provenance)
    except UserError as error:
        raise broken(path, f"holds a provenance that does not fit ({error})") from error


def _load_folder(folder: Path) -> list[Solution]:
    """Return the cheapest solution of each speed in a folder, slowest first."""
    cards = sorted(folder.glob("speed-*.npz"))
    if not cards:
        raise UserError(
            f"{folder} holds no solutions: run `bp2 trajopt library build --out {folder}`"
        )
    best: dict[float, Solution] = {}
    for solution in (load_solution(card.with_suffix("")) for card in cards):
        speed = solution.problem.speed
        if speed not in best or solution.cost < best[speed].cost:
            best[speed] = solution
    return [best[speed] for speed in sorted(best)]
