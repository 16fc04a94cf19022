"""`bp2 paper pendulum trapping`: how heavy a beam must be."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Annotated

import tyro

from bp2_rl.base.bounds import Within, check_bounds
from bp2_rl.cli import app
from bp2_rl.paper.cli.pendulum import output
from bp2_rl.paper.cli.pendulum.arguments import OUT, Folder, Periods, check_list

Swing = Annotated[float, Within(0.3, 1.5), tyro.conf.arg(metavar="RAD")]
"""Below, an exchange takes hundreds of periods and the search minutes; above, the law is no guide for it."""


@dataclasses.dataclass(frozen=True)
class PendulumTrappingArguments:
    """Sweep the mass ratio from 0.25 to 200: when a swing stays with the pendulum that has it (beyond the paper)."""

    amplitude: tuple[Swing, ...] = (math.pi / 3.0, 0.5)
    """from which the first is let go, of each sweep; at most 4"""
    thresholds: tuple[Swing, ...] = (0.5, 0.6, 0.8, math.pi / 3.0, 1.2, 1.4)
    """amplitudes whose threshold is searched for; at most 12"""
    periods: Periods = 300.0
    """of a sweep"""
    points: Annotated[int, Within(5, 200)] = 40
    """mass ratios of a sweep"""
    out: Folder = OUT / "trapping"

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self, "--")
        check_list("--amplitude", self.amplitude, 4)
        check_list("--thresholds", self.thresholds, 12)


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: _trapping(app.parse(PendulumTrappingArguments, argv, "bp2 paper pendulum trapping")))


def _trapping(arguments: PendulumTrappingArguments) -> None:
    """Print the thresholds, and leave the report."""
    output.open_folder(arguments.out, "trapping")

    import numpy as np

    from bp2_rl.paper.pendulum.figures.trapping import trapping_figure
    from bp2_rl.paper.pendulum.trapping import MASS_RATIOS, sweep_ratios, thresholds

    ratios = np.geomspace(*MASS_RATIOS, arguments.points)
    with output.spinner("swinging"):
        sweeps = [sweep_ratios(amplitude, ratios, arguments.periods) for amplitude in arguments.amplitude]
        found = list(thresholds(sorted(arguments.thresholds)))
    output.tabulate(
        ("amplitude, rad", "still exchanges at R", "is trapped at R", "law, 32 / A^2", "measured / law"),
        [
            (f"{one.amplitude:.3f}", *(f"{x:.1f}" for x in (one.exchanges, one.traps, one.law)), f"{one.off_law:.2f}")
            for one in found
        ],
    )
    arrays = {"mass_ratio": ratios}
    for column, one in enumerate(sweeps):
        arrays |= {f"mean_{column}": one.mean, f"mean_beam_{column}": one.mean_beam, f"greatest_{column}": one.greatest}
    results = {"sweeps": sweeps, "thresholds": found}
    output.leave(arguments.out, "trapping", arguments, results, arrays, trapping_figure(sweeps, found))
