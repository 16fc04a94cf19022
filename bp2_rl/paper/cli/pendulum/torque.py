"""`bp2 paper pendulum torque`: what it takes to move them."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Annotated

import tyro

from bp2_rl.base.bounds import Within, check_bounds
from bp2_rl.cli import app
from bp2_rl.paper.cli.pendulum import output
from bp2_rl.paper.cli.pendulum.arguments import OUT, Angle, Folder, Hertz, Length, MassRatio, driven_frequency


@dataclasses.dataclass(frozen=True)
class PendulumTorqueArguments:
    """Move two pendulums as the paper does: their torques with the beam free and with it fixed (paper, Fig. 3E)."""

    mass_ratio: MassRatio = 1.0
    """the beam's mass over one pendulum's"""
    amplitude: Angle = 1.0
    frequency: Hertz = 5.0
    phase: Annotated[float, Within(-2.0 * math.pi, 2.0 * math.pi), tyro.conf.arg(metavar="RAD")] = math.pi / 4.0
    """by which the second is ahead of the first"""
    length: Length = 1.0
    """of a pendulum: the paper gives none, and in Hz the frequency needs one"""
    out: Folder = OUT / "torque"

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self, "--")
        driven_frequency(self.frequency, self.length)


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: _torque(app.parse(PendulumTorqueArguments, argv, "bp2 paper pendulum torque")))


def _torque(arguments: PendulumTorqueArguments) -> None:
    """Print what the free beam takes off the torques, and leave the report."""
    output.open_folder(arguments.out, "torque")

    from bp2_rl.paper.pendulum.figures.torque import torque_figure
    from bp2_rl.paper.pendulum.prescribed import prescribe

    case = prescribe(arguments.mass_ratio, arguments.amplitude, arguments.phase, arguments.frequency, arguments.length)
    rows = []
    for row in case.rows:
        ratios = (" / ".join(f"{ratio:.3f}" for ratio in pair) for pair in (row.peak, row.root_mean_square))
        rows.append((f"{row.length:g}", f"{row.frequency:.2f}", *ratios))
    output.tabulate(("length, m", "W", "peak free / fixed, 1 / 2", "root mean square likewise"), rows)
    output.leave(arguments.out, "torque", arguments, {"lengths": case.rows}, case.arrays(), torque_figure(case))
