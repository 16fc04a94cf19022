"""What the race may be told."""

import dataclasses
from pathlib import Path


@dataclasses.dataclass(frozen=True)
class RaceSettings:
    """Draw speed over distance of BP2 and of athletes, their starts and their times (paper, Fig. 6 B-D, Table S2).

    Shown are Bolt's splits, what the paper says of the others, and the runs of policies.
    """

    runs: tuple[Path, ...] = ()
    """folders of reports of eval.py --benchmark sprint"""
    athletes: Path | None = None
    """splits of more athletes, CSV with the columns: athlete,distance [m],time [s],reaction [s]"""
