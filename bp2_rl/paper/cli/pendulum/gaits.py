"""`bp2 paper pendulum gaits`: what a trot can gain."""

import dataclasses
from collections.abc import Sequence

from bp2_rl.base.bounds import check_bounds
from bp2_rl.cli import app
from bp2_rl.paper.cli.pendulum import output
from bp2_rl.paper.cli.pendulum.arguments import (
    OUT,
    Angle,
    Folder,
    Hertz,
    Length,
    MassRatio,
    check_list,
    driven_frequency,
)
from bp2_rl.paper.pendulum import bp2


@dataclasses.dataclass(frozen=True)
class PendulumGaitsArguments:
    """Hang four legs from a beam: what each gait's phases leave of the beam's help (beyond the paper)."""

    mass_ratio: tuple[MassRatio, ...] = (bp2.MASS_RATIO, 1.0)
    """the beam's mass over one leg's; BP2's trunk over its leg and the paper's by default; a panel each, at most 3"""
    amplitude: Angle = bp2.HIP_AMPLITUDE
    frequency: Hertz = bp2.STRIDE_FREQUENCY
    """of the stride; BP2's at 10 m/s by default"""
    length: Length = bp2.LEG_LENGTH
    """of the pendulum that a leg stands for; BP2's thigh by default"""
    out: Folder = OUT / "gaits"

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self, "--")
        check_list("--mass-ratio", self.mass_ratio, 3)
        driven_frequency(self.frequency, self.length)


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: _gaits(app.parse(PendulumGaitsArguments, argv, "bp2 paper pendulum gaits")))


def _gaits(arguments: PendulumGaitsArguments) -> None:
    """Print what each gait gains, and leave the report."""
    output.open_folder(arguments.out, "gaits")

    from bp2_rl.paper.pendulum.figures.gaits import gaits_figure
    from bp2_rl.paper.pendulum.gaits import compare_gaits

    frequency = driven_frequency(arguments.frequency, arguments.length)
    found = compare_gaits(arguments.mass_ratio, arguments.amplitude, frequency)
    rows = []
    for gaits in zip(*found.named, strict=True):
        peaks = (f"{one.least_peak:.3f} to {one.peak:.3f}" for one in gaits)
        phases = " ".join(f"{phase:.2f}" for phase in gaits[0].phases)
        rows.append((gaits[0].gait, phases, f"{gaits[0].order:.2f}", *peaks))
    columns = [f"peak free / fixed, R = {ratio:.3g}" for ratio in arguments.mass_ratio]
    output.tabulate(("gait", "FR FL RR RL, cycles", "order parameter", *columns), rows)
    named = [one for gaits in found.named for one in gaits]
    output.leave(arguments.out, "gaits", arguments, {"gaits": named}, found.arrays(), gaits_figure(found))
