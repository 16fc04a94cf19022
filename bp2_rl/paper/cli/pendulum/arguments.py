"""What several of the commands are told."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.base.bounds import Within
from bp2_rl.base.errors import UserError
from bp2_rl.paper.pendulum.bp2 import reduced_frequency

OUT = Path("reports/pendulum")
Folder = Annotated[Path, tyro.conf.arg(metavar="DIR")]
MassRatio = Annotated[float, Within(0.05, 1e4)]
"""The beam's mass over one pendulum's. A lighter beam whirls so fast that the integration takes minutes."""
Angle = Annotated[float, Within(1e-3, 3.1), tyro.conf.arg(metavar="RAD")]
"""To which a pendulum is lifted, or swings."""
Periods = Annotated[float, Within(2.0, 1000.0), tyro.conf.arg(metavar="T0")]
"""How long a motion is watched, in periods of one small swing."""
Hertz = Annotated[float, Within(0.01, 1000.0), tyro.conf.arg(metavar="HZ")]
Length = Annotated[float, Within(0.001, 1000.0), tyro.conf.arg(metavar="M")]


def check_list(flag: str, values: Sequence[float], most: int) -> None:
    """Refuse an empty list, one longer than a picture holds, and one that says something twice."""
    if not 1 <= len(values) <= most:
        raise UserError(f"{flag} takes 1 to {most} values, got {len(values)}")
    if len(set(values)) < len(values):
        raise UserError(f"{flag}: {' '.join(f'{value:g}' for value in values)} has a value twice")


def driven_frequency(frequency: float, length: float) -> float:
    """W, a frequency over a pendulum's own.

    Raises:
        UserError: it is the pendulum's own, where a fixed beam asks for hardly any torque to compare with.
    """
    reduced = reduced_frequency(frequency, length)
    if abs(reduced - 1.0) < 1e-3:
        raise UserError(
            f"{frequency:g} Hz is a pendulum's own frequency at a length of {length:g} m, where a fixed beam asks for "
            "no torque to compare with: choose another --frequency or --length"
        )
    return reduced
