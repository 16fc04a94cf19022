"""The ground of a training and of a run."""

import dataclasses
from typing import Annotated, Literal, get_args

import tyro

from bp2_rl.base.bounds import Bounded, Range, Within
from bp2_rl.base.errors import UserError

TerrainFlag = Annotated[
    str,
    tyro.conf.arg(
        metavar="KIND:SIZE",
        help="The ground: rough:0.05 and waves:0.05 are within 5 cm of the start's height, stairs:0.1 has steps of 10 "
        "cm, slope:0.1 rises 0.1 rad; a third number is the cell, or the run of a tread, m.",
    ),
]
"""A ground as `Terrain.of` takes it."""
TerrainKind = Literal["flat", "rough", "waves", "stairs"]
"""rough: heights drawn evenly at the points of a grid, planes between them. waves:
along x and y, each eight cells long. stairs: flights of ten along x, up and down in
turn, with landings between."""
LARGEST: dict[TerrainKind, float] = {
    "flat": 0.0,
    "rough": 0.2,
    "waves": 0.2,
    "stairs": 0.3,
}
"""The kinds of ground with their largest sizes, m."""
TREAD = 0.3
"""m, default run of a tread."""


@dataclasses.dataclass(frozen=True)
class Terrain(Bounded, path="terrain."):
    """The ground of a run; by default a flat floor."""

    kind: TerrainKind = "flat"
    # m: greatest difference from the height at the start, or height of a step
    size: float = 0.0
    # m, between the points of the grid, or the run of a tread
    cell: Annotated[float, Within(0.05, 1.0)] = 0.2
    seed: Annotated[int, Within(0, 2**32 - 1)] = 0  # of rough ground
    # rad, by which the ground rises along x, whatever its kind: gravity tilts
    slope: Annotated[float, Within(-0.5, 0.5)] = 0.0

    def __post_init__(self) -> None:
        """Raise `UserError` for values out of bounds."""
        super().__post_init__()
        most = LARGEST[self.kind]
        if not 0.0 <= self.size <= most:
            raise UserError(
                f"terrain.size must be from 0 to {most:g} for {self.kind}, got {self.size:g}"
            )

    def __str__(self) -> str:
        """Describe the ground in a few words."""
        rising = f", slope of {self.slope:g} rad" if self.slope else ""
        if self.kind == "flat":
            return f"flat{rising}"
        if self.kind == "stairs":
            return (
                f"stairs of {self.size:g} m with treads of {self.cell:g} m, flights of ten, up and "
                f"down{rising}"
            )
        return (
            f"{self.kind}, within {self.size:g} m of the start's height, points {self.cell:g} m apart, seed "
            f"{self.seed}{rising}"
        )

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
        if name == "slope" and len(numbers) == 1:
            return cls(slope=numbers[0])
        if kind is None or len(numbers) > 2 or (kind == "flat") == bool(numbers):
            raise UserError(
                "--terrain takes flat, slope:ANGLE, KIND:SIZE or KIND:SIZE:CELL, KIND one of rough, waves and stairs, such as "
                f"rough:0.05; got {text}"
            )
        usual = TREAD if kind == "stairs" else cls.cell
        size, cell, *_ = [*(numbers or [0.0]), usual]
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

    A robot's size and slope are drawn evenly between the least one and a most that rises
    with the robot's curriculum level, from the least at level 0 to the greatest at level
    1.
    """

    kind: TerrainKind = "flat"
    # m, amplitude of rough ground and waves, or height of a step
    size: Annotated[Range, Within(0.0, 0.3)] = (0.0, 0.04)
    # m, between the points of the grid, or the run of a tread
    cell: Annotated[Range, Within(0.05, 1.0)] = (0.15, 0.4)
    slope: Annotated[Range, Within(0.0, 0.5)] = (0.0, 0.0)
    """rad, by which the ground of any kind rises in a direction that is drawn"""

    @property
    def hardest(self) -> Terrain:
        """The ground of the greatest size and slope, uphill, with cells of the mean
        size."""
        size = 0.0 if self.kind == "flat" else self.size[1]
        return Terrain(self.kind, size, sum(self.cell) / 2.0, slope=self.slope[1])
