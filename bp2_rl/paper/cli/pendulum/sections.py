"""`bp2 paper pendulum sections`: one path or two."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Literal

from bp2_rl.base.bounds import check_bounds
from bp2_rl.cli import app
from bp2_rl.paper.cli.pendulum import output
from bp2_rl.paper.cli.pendulum.arguments import OUT, Angle, Folder, MassRatio, Periods, check_list


@dataclasses.dataclass(frozen=True)
class PendulumSectionsArguments:
    """Let one of two pendulums go and look at both once a cycle: Poincare sections by mass ratio (paper, Fig. 3D)."""

    mass_ratio: tuple[MassRatio, ...] = (0.5, 1.0, 5.0, 20.0, 25.0, 100.0)
    """the beam's mass over one pendulum's; a panel each, at most 12"""
    amplitude: Angle = math.pi / 3.0
    """from which the first is let go; the paper's 60 deg by default"""
    periods: Periods = 200.0
    instant: Literal["beam", "pendulum"] = "beam"
    """when: as the beam turns from left to right, or as pendulum 1 passes the vertical to the right"""
    out: Folder = OUT / "sections"

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self, "--")
        check_list("--mass-ratio", self.mass_ratio, 12)


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: _sections(app.parse(PendulumSectionsArguments, argv, "bp2 paper pendulum sections")))


def _sections(arguments: PendulumSectionsArguments) -> None:
    """Print how far apart the two paths are, and leave the report."""
    output.open_folder(arguments.out, "sections")

    from bp2_rl.paper.pendulum.figures.sections import sections_figure
    from bp2_rl.paper.pendulum.sections import sections

    with output.spinner("swinging"):
        found = sections(arguments.amplitude, arguments.mass_ratio, arguments.periods, arguments.instant)
    rows = []
    for section in found:
        path = section.path
        angles = (f"{low:+.2f} to {high:+.2f}" for low, high in path.angles)
        apart = "-" if path.apart is None else f"{path.apart:.3f}"
        rows.append((f"{path.mass_ratio:g}", str(path.points), *angles, apart))
    output.tabulate(("R", "points", "angles of 1, rad", "angles of 2, rad", "paths apart"), rows)
    arrays = {}
    for row, section in enumerate(found):
        arrays |= {f"theta_{row}": section.theta, f"rate_{row}": section.rate}
    results = {"mass_ratios": [section.path for section in found]}
    output.leave(arguments.out, "sections", arguments, results, arrays, sections_figure(found, arguments.instant))
