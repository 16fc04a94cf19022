"""What the scaling figure may be told."""

import dataclasses
from pathlib import Path


@dataclasses.dataclass(frozen=True)
class ScalingSettings:
    """Draw greatest speed over body mass, and what is asked of the motors (paper, Fig. 1 and its inset).

    Shown are the robots of the paper's Table S1, the law of animals, and the policy that ships, as its card has it.
    """

    mammals: Path | None = None
    """a table of mammals, CSV with the columns: species,mass [kg],top speed [km/h]"""
    runs: tuple[Path, ...] = ()
    """folders of reports of eval.py --benchmark topspeed, in place of the policy that ships"""
