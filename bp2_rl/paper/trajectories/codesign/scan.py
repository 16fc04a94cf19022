"""What one parameter costs: the cheapest trajectory for each of its values, the others as in BP2 or free."""

import dataclasses
from pathlib import Path

import numpy as np
from rich.console import Console

from bp2_rl.optimiser.solution import NotSolved
from bp2_rl.paper.trajectories.codesign.chain import Chain, solve_chains
from bp2_rl.paper.trajectories.codesign.search import DesignRow, cheapest
from bp2_rl.paper.trajectories.codesign.settings import PARAMETERS, CodesignSettings, Others, Parameter, known_parameter

FLAT = 0.02  # a parameter is as good as its optimum where it costs at most this share more


@dataclasses.dataclass(frozen=True)
class Scan:
    """The cheapest trajectory for every value of one parameter that could be solved, in order of the value."""

    parameter: Parameter
    others: Others
    rows: tuple[DesignRow, ...]

    @property
    def values(self) -> tuple[float, ...]:
        """The parameter's values."""
        return tuple(getattr(row, self.parameter) for row in self.rows)

    @property
    def best(self) -> DesignRow:
        """The cheapest row."""
        return min(self.rows, key=lambda row: row.cost)

    @property
    def interior(self) -> bool:
        """Whether the minimum is one: neither end of the scan is the cheapest."""
        return self.best not in (self.rows[0], self.rows[-1])

    @property
    def flat(self) -> tuple[float, float]:
        """Least and greatest value that cost at most a share `FLAT` more than the cheapest."""
        good = [v for v, row in zip(self.values, self.rows, strict=True) if row.cost <= (1.0 + FLAT) * self.best.cost]
        return min(good), max(good)


def scan_chains(settings: CodesignSettings, parameter: str, others: Others) -> tuple[Chain, Chain]:
    """One parameter over a grid, upwards and downwards, the others at the problem's values or free.

    Raises:
        UserError: a name that is no parameter's.
    """
    name = known_parameter(parameter)
    free: tuple[Parameter, ...] = tuple(p for p in PARAMETERS if p != name and others == "free")
    grid = np.linspace(*settings.scanned.of((name,))[name], settings.grid)
    problems = tuple(settings.problem.on(**{name: float(value)}) for value in grid)
    return Chain(problems, free, settings.bounds), Chain(problems[::-1], free, settings.bounds)


def scan_design(
    settings: CodesignSettings,
    parameter: str,
    others: Others,
    folder: Path,
    workers: int = 1,
    console: Console | None = None,
) -> Scan:
    """The cost over one parameter: by continuation from both ends of the grid, the cheaper kept at each value.

    Raises:
        UserError: a name that is no parameter's.
        NotSolved: there was a trajectory for no value.
    """
    up, down = scan_chains(settings, parameter, others)
    solve_chains((up, down), folder, workers, f"{parameter}, others {others}", console or Console())
    pairs = zip(up.parts, reversed(down.parts), strict=True)
    rows = [cheapest(f"{getattr(pair[0].problems[-1].hardware, parameter):g}", pair, folder) for pair in pairs]
    kept = tuple(row for row in rows if row is not None)
    if not kept:
        raise NotSolved(f"no trajectory for any {parameter} of the scan")
    return Scan(known_parameter(parameter), others, kept)
