"""`bp2 paper pendulum simulate`: who has the energy."""

import dataclasses
import math
from collections.abc import Sequence

from bp2_rl.base.bounds import check_bounds
from bp2_rl.cli import app
from bp2_rl.paper.cli.pendulum import output
from bp2_rl.paper.cli.pendulum.arguments import OUT, Angle, Folder, MassRatio, Periods, check_list


@dataclasses.dataclass(frozen=True)
class PendulumSimulateArguments:
    """Let one of two pendulums go, the other hanging: who has the energy over time (paper, Fig. 3C)."""

    mass_ratio: tuple[MassRatio, ...] = (1.0, 2.0, 5.0)
    """the beam's mass over one pendulum's; a row of the picture each, at most 6"""
    amplitude: Angle = math.pi / 3.0
    """from which the first is let go; the paper's 60 deg by default"""
    periods: Periods = 40.0
    out: Folder = OUT / "simulate"

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self, "--")
        check_list("--mass-ratio", self.mass_ratio, 6)


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: _simulate(app.parse(PendulumSimulateArguments, argv, "bp2 paper pendulum simulate")))


def _simulate(arguments: PendulumSimulateArguments) -> None:
    """Print how evenly the energy is shared, and leave the report."""
    output.open_folder(arguments.out, "simulate")

    from bp2_rl.paper.pendulum.exchange import EVEN, exchanges
    from bp2_rl.paper.pendulum.figures.exchange import exchange_figure

    with output.spinner("swinging"):
        runs = exchanges(arguments.amplitude, arguments.mass_ratio, arguments.periods)
    rows = []
    for run in runs:
        one = run.sharing
        even = "never" if one.even_after is None else f"{one.even_after:.1f} T0"
        means, moving = (" / ".join(f"{mean:.3f}" for mean in pair) for pair in (one.mean, one.mean_in_beam_frame))
        kept = f"{one.energy_drift:.0e} / {one.momentum_drift:.0e}"
        rows.append((f"{one.mass_ratio:g}", means, f"{one.mean_beam:.3f}", even, f"{one.beat:.2f} T0", moving, kept))
    columns = ["R", "means of 1 / 2, m g l", "of the beam", f"within {EVEN:g} after"]
    columns += ["small beat", "seen from the beam", "drift of E / p"]
    output.tabulate(columns, rows)
    arrays = {"time": runs[0].time}
    for row, run in enumerate(runs):
        arrays |= {f"{name}_{row}": values for name, values in run.arrays().items()}
    results = {"mass_ratios": [run.sharing for run in runs]}
    output.leave(arguments.out, "simulate", arguments, results, arrays, exchange_figure(runs))
