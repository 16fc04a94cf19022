"""The command-line flags of the benchmarks.

They are read before JAX is imported, so that a mistake is answered at once.
"""

import dataclasses
from typing import Annotated

import tyro

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.robot.operator import HEADING_HOLD, HeadingHold
from bp2_rl.settings.terrain import Terrain, TerrainFlag
from bp2_rl.settings.training import LARGEST_SEED, RobotFlag
from bp2_rl.simulation.backend import Backend

POSTERIOR = "posterior"
LEAST_HOLD = 0.1  # s: twenty control steps to take a mean of


@dataclasses.dataclass(frozen=True)
class BenchmarkOptions(Bounded, path="--"):
    """The flags of a benchmark; None leaves the choice to it."""

    robot: RobotFlag = None
    """built: BP2 with losses and solid legs; ideal: without both; real: a plausible
    BP2; by default the policy's own robot, but built for a policy trained on
    ideal"""
    backend: Backend = "mujoco"
    """mujoco: C MuJoCo. drake: Drake's dynamics and contact, for comparison."""
    speed: Annotated[
        Annotated[float, Within(0.01, 100.0)] | None, tyro.conf.arg(metavar="M/S")
    ] = None
    """Commanded speed; by default as in the result on the policy's card (robustness:
    10.74)."""
    acceleration: Annotated[
        Annotated[float, Within(0.05, 1000.0)] | None, tyro.conf.arg(metavar="M/S2")
    ] = None
    """Rate at which the commanded speed rises; by default 2.4, in a sprint the value on
    the card, else 3."""
    hold: Annotated[
        Annotated[float, Within(LEAST_HOLD, 600.0)] | None, tyro.conf.arg(metavar="S")
    ] = None
    """Time at the commanded speed; by default 20 (robustness: 15, losses: 6,
    sensitivity: 5). Not for sprint."""
    robots: Annotated[
        Annotated[int, Within(1, 2**20)] | None, tyro.conf.arg(metavar="N")
    ] = None
    """Number of random robots of the benchmarks robustness and posterior; by default
    200 and 32."""
    seed: Annotated[
        Annotated[int, Within(0, LARGEST_SEED)] | None, tyro.conf.arg(metavar="N")
    ] = None
    """Random seed of the robots, the rough ground of manoeuvres and the sensor noise;
    by default 0."""
    terrain: TerrainFlag = "flat"
    sensor_noise: bool = False
    """Add the sensor noise of training. For topspeed and sprint."""
    operator: HeadingHold = HEADING_HOLD

    def __post_init__(self) -> None:
        """Raise UserError for values out of bounds, and for an unknown kind of
        ground."""
        super().__post_init__()
        Terrain.of(self.terrain)

    @property
    def noise_seed(self) -> int | None:
        """The seed of the sensors' noise; None: sensors without noise."""
        return (self.seed or 0) if self.sensor_noise else None

    @property
    def ground(self) -> Terrain:
        """The ground that is drawn from the seed."""
        return Terrain.of(self.terrain).another(self.seed or 0)

    @property
    def chosen(self) -> tuple[str, ...]:
        """The flags that are not at their default."""
        return tuple(
            f.name
            for f in dataclasses.fields(self)
            if getattr(self, f.name) != f.default
        )

    def only(self, flags: tuple[str, ...]) -> "BenchmarkOptions":
        """Return a setup with these flags alone; all others are at their defaults."""
        return type(self)(**{name: getattr(self, name) for name in flags})
