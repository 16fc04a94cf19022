"""The ground of a training and of a run."""

import dataclasses
from typing import Annotated, Literal, get_args

from bp2_rl.base.bounds import Bounded, Range, Within
from bp2_rl.base.errors import UserError

TerrainKind = Literal["flat", "rough", "waves", "stairs", "slope"]
"""rough: heights drawn evenly at the points of a grid, planes between them. waves:
along x and y, each eight cells long. stairs: flights of ten along x, up and down in
turn, with landings between. slope: a plane, over which gravity tilts."""
KINDS: dict[TerrainKind, float] = {
    "flat": 0.0,
    "rough": 0.2,
    "waves": 0.2,
    "stairs": 0.3,
    "slope": 0.5,
}
"""The kinds of ground with their largest sizes: an amplitude or the height of a step, m,
or an angle, rad."""
TREAD = 0.3
"""m, the run of a tread where none is named."""


@dataclasses.dataclass(frozen=True)
class Terrain(Bounded, path="terrain."):
    """The ground of one run; by default a flat floor."""

    kind: TerrainKind = "flat"
    # m: heights are within this of the start's, or steps as high; of a slope rad, positive where the
    # ground rises ahead
    size: float = 0.0
    # m, between the points of the grid, or the run of a tread
    cell: Annotated[float, Within(0.05, 1.0)] = 0.2
    seed: Annotated[int, Within(0, 2**32 - 1)] = 0  # of rough ground

    def __post_init__(self) -> None:
        """Raise `UserError` for values out of bounds."""
        super().__post_init__()
        most = KINDS[self.kind]
        least = -most if self.kind == "slope" else 0.0
        if not least <= self.size <= most:
            raise UserError(
                f"terrain.size must be from {least:g} to {most:g} for {self.kind}, got {self.size:g}"
            )

    def __str__(self) -> str:
        """Describe the ground in a few words."""
        if self.kind == "slope":
            return f"slope of {self.size:g} rad"
        if self.kind == "stairs":
            return f"stairs of {self.size:g} m with treads of {self.cell:g} m, flights of ten, up and down"
        return f"{self.kind}, within {self.size:g} m of the start's height, points {self.cell:g} m apart, seed {self.seed}"

    @classmethod
    def of(cls, text: str) -> "Terrain":
        """Return the ground that `KIND:SIZE` names, such as `rough:0.05`; a third number
        is the cell, or the run of a tread, m.

        Raises:
            UserError: the text names no ground.
        """
        name, *words = text.split(":")
        kind = next((each for each in get_args(TerrainKind) if each == name), None)
        try:
            numbers = [float(word) for word in words]
        except ValueError:
            kind, numbers = None, []
        if kind is None or len(numbers) > 2 or (kind == "flat") == bool(numbers):
            raise UserError(
                "--terrain takes flat, or KIND:SIZE or KIND:SIZE:CELL, KIND one of rough, waves, stairs and slope, such as "
                f"rough:0.05; got {text}"
            )
        usual = TREAD if kind == "stairs" else cls.cell
        size, cell, *_ = [*numbers, usual] if numbers else [0.0, usual]
        return cls(kind, size, cell)

    def another(self, number: int) -> "Terrain":
        """Return rough ground from another seed, `number` on, and other ground as it
        is."""
        if self.kind != "rough":
            return self
        return dataclasses.replace(self, seed=(self.seed + number) % 2**32)


@dataclasses.dataclass(frozen=True)
class TerrainConfig:
    """The ground of training: flat, or drawn for each robot at each reset.

    A robot's size is drawn evenly between the least one and a most that rises with the
    robot's curriculum level, from the least at level 0 to the greatest at level 1.
    """

    kind: TerrainKind = "flat"
    size: Annotated[Range, Within(0.0, 0.5)] = (0.0, 0.04)
    """least and greatest amplitude of rough ground and waves or height of a step, m, or
    angle of a slope, rad"""
    cell: Annotated[Range, Within(0.05, 1.0)] = (0.15, 0.4)
    """m, between the points of the grid, or the run of a tread"""

    @property
    def hardest(self) -> Terrain:
        """The ground of the greatest size, with cells of the mean size."""
        return Terrain(
            self.kind,
            self.size[1] if self.kind != "flat" else 0.0,
            sum(self.cell) / 2.0,
        )
