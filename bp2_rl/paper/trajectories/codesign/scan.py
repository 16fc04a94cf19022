"""What one parameter costs: the cheapest trajectory for each of its values, the others
as in BP2 or free."""

import dataclasses
from pathlib import Path

import numpy as np

from bp2_rl.optimiser.solution import NotSolved
from bp2_rl.paper.trajectories.codesign.chain import Chain, solve_chains
from bp2_rl.paper.trajectories.codesign.search import DesignRow, cheapest
from bp2_rl.paper.trajectories.codesign.settings import (
    PARAMETERS,
    CodesignSettings,
    Others,
    Parameter,
)

# a parameter is as good as its optimum where it costs at most this share more
FLAT = 0.02


@dataclasses.dataclass(frozen=True)
class Scan:
    """The cheapest trajectory for every value of one parameter that could be solved, in
    order of the value."""

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
        """Least and greatest value that cost at most a share `FLAT` more than the
        cheapest."""
        good = [
            v
            for v, row in zip(self.values, self.rows, strict=True)
            if row.cost <= (1.0 + FLAT) * self.best.cost
        ]
        return min(good), max(good)


def scan_chains(
    settings: CodesignSettings, parameter: Parameter, others: Others
) -> tuple[Chain, Chain]:
    """One parameter over a grid, upwards and downwards, the others at the problem's
    values or free."""
    free: tuple[Parameter, ...] = tuple(
        p for p in PARAMETERS if p != parameter and others == "free"
    )
    low, high = getattr(settings.scanned, parameter)
    grid = np.linspace(low, high, settings.grid)
    problems = tuple(settings.problem.on(**{parameter: float(value)}) for value in grid)
    return Chain(problems, free, settings.bounds), Chain(
        problems[::-1], free, settings.bounds
    )


def scan_design(
    settings: CodesignSettings,
    parameter: Parameter,
    others: Others,
    folder: Path,
    workers: int = 1,
) -> Scan:
    """The cost over one parameter: by continuation from both ends of the grid, the
    cheaper kept at each value.

    Raises:
        NotSolved: there was a trajectory for no value.
    """
    up, down = scan_chains(settings, parameter, others)
    solve_chains((up, down), folder, workers, f"{parameter}, others {others}")
    pairs = zip(up.parts, reversed(down.parts), strict=True)
    rows = cheapest(
        (
            (f"{one.problems[-1].hardware.parameter(parameter):g}", (one, two))
            for one, two in pairs
        ),
        folder,
    )
    if not rows:
        raise NotSolved(f"no trajectory for any {parameter} of the scan")
    return Scan(parameter, others, rows)
