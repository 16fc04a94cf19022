"""`bp2 paper pendulum map`: where a free beam helps."""

import dataclasses
from collections.abc import Sequence

from bp2_rl.base.bounds import check_bounds
from bp2_rl.cli import app
from bp2_rl.paper.cli.pendulum import output
from bp2_rl.paper.cli.pendulum.arguments import OUT, Folder, Hertz, Length, MassRatio, check_list, driven_frequency


@dataclasses.dataclass(frozen=True)
class PendulumMapArguments:
    """Map where a free beam lowers the peak torque of two pendulums, and where it raises it; BP2 comes last."""

    mass_ratio: tuple[MassRatio, ...] = (0.5, 1.0, 4.0)
    """the beam's mass over one pendulum's; a column each beside BP2's, at most 4"""
    frequency: Hertz = 5.0
    """of the maps over amplitudes but BP2's; the paper's by default"""
    length: Length = 1.0
    """of their pendulums"""
    out: Folder = OUT / "map"

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self, "--")
        check_list("--mass-ratio", self.mass_ratio, 4)
        driven_frequency(self.frequency, self.length)


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: _map(app.parse(PendulumMapArguments, argv, "bp2 paper pendulum map")))


def _map(arguments: PendulumMapArguments) -> None:
    """Print what the maps say, and leave the report."""
    output.open_folder(arguments.out, "map")

    from bp2_rl.paper.pendulum import bp2
    from bp2_rl.paper.pendulum.figures.reduction import reduction_figure
    from bp2_rl.paper.pendulum.reduction import reduction_maps

    frequency = driven_frequency(arguments.frequency, arguments.length)
    robot = bp2.reduced_frequency(bp2.STRIDE_FREQUENCY, bp2.LEG_LENGTH)
    beams = [(ratio, frequency) for ratio in arguments.mass_ratio] + [(bp2.MASS_RATIO, robot)]
    with output.spinner("mapping"):
        maps = [reduction_maps(*beam) for beam in beams]
    rows = []
    for one in (one.reduction for one in maps):
        spots = (" ".join(f"{ratio:.2f}" for ratio in ratios) for ratios in (one.at_small_amplitude, one.at_one_radian))
        worst = f"{one.greatest:.3f} at {one.greatest_at[0]:.2f}, {one.greatest_at[1]:.2f}"
        rows.append((f"{one.mass_ratio:.3g}", f"{one.boundary:.4f}", f"{one.boundary_error:.0e}", *spots, worst))
    spots = [f"{name}, 0 to pi" for name in ("small swings", "1 rad")]
    output.tabulate(("R", "helps: W", "W^2 off", *spots, "worst, phase, rad"), rows)
    arrays = {name: getattr(maps[0], name) for name in ("phases", "frequencies", "amplitudes")}
    for column, one in enumerate(maps):
        arrays |= {f"over_frequency_{column}": one.over_frequency, f"over_amplitude_{column}": one.over_amplitude}
    results = {"mass_ratios": [one.reduction for one in maps]}
    output.leave(arguments.out, "map", arguments, results, arrays, reduction_figure(maps))
