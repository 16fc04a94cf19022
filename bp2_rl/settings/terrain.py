"""The ground of a training and of a run."""

import dataclasses
import math
from typing import Annotated, Literal

from bp2_rl.base.bounds import Bounded, Range, Within
from bp2_rl.base.errors import UserError

TerrainKind = Literal["flat", "rough", "waves", "slope"]
"""rough: heights drawn evenly at the points of a grid, planes between them. waves:
along x and y, each eight cells long. slope: a plane, over which gravity tilts."""
KINDS = {"flat": 0.0, "rough": 0.2, "waves": 0.2, "slope": 0.5}
"""The kinds of ground with their largest sizes: an amplitude, m, or an angle, rad."""


@dataclasses.dataclass(frozen=True)
class Terrain(Bounded, path="terrain."):
    """The ground of one run; by default a flat floor."""

    kind: TerrainKind = "flat"
    # m: heights are within this of the floor's; of a slope rad, positive where the
    # ground rises ahead
    size: float = 0.0
    # m, between the points of the grid
    cell: Annotated[float, Within(0.05, 1.0)] = 0.2
    seed: Annotated[int, Within(0, 2**32 - 1)] = 0  # of rough ground

    def __post_init__(self) -> None:
        """Raise `UserError` for values out of bounds."""
        super().__post_init__()
        least, most = -KINDS["slope"] * (self.kind == "slope"), KINDS[self.kind]
        if not least <= self.size <= most:
            raise UserError(
                f"terrain.size must be from {least:g} to {most:g} for {self.kind}, got {self.size:g}"
            )

    @classmethod
    def of(cls, text: str) -> "Terrain":
        """Return the ground that `KIND:SIZE` names, such as `rough:0.05`; a third number
        is the cell, m.

        Raises:
            UserError: the text names no ground.
        """
        kind, *numbers = text.split(":")
        try:
            size, cell = (*map(float, numbers), 0.2)[:2]
        except ValueError:
            size, cell = math.nan, 0.2
        if kind not in KINDS or not 1 <= len(numbers) <= 2 or math.isnan(size):
            raise UserError(
                f"--terrain takes KIND:SIZE or KIND:SIZE:CELL, such as rough:0.05, of {', '.join(KINDS)}; got {text}"
            )
        return cls(kind, size, cell)  # pyright: ignore[reportArgumentType]  # one of KINDS


@dataclasses.dataclass(frozen=True)
class TerrainConfig:
    """The ground of training: flat, or drawn for each robot at each reset.

    A robot's size is drawn evenly between the least one and a most that rises with the
    robot's curriculum level, from the least at level 0 to the greatest at level 1.
    """

    kind: TerrainKind = "flat"
    size: Annotated[Range, Within(0.0, 0.5)] = (0.0, 0.04)
    """least and greatest amplitude of rough ground and waves, m, or angle of a slope,
    rad"""
    cell: Annotated[Range, Within(0.05, 1.0)] = (0.15, 0.4)
    """m, between the points of the grid"""
