"""What may be chosen about a benchmark; read before JAX is imported, so that a mistake
is answered at once."""

import dataclasses
from typing import Annotated

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.base.errors import UserError
from bp2_rl.robot.operator import HEADING_HOLD, HeadingHold
from bp2_rl.settings.training import LARGEST_SEED, RobotWish
from bp2_rl.simulation.backend import Backend, DrakeContact

LEAST_HOLD = 0.1  # s: twenty control steps to take a mean of


@dataclasses.dataclass(frozen=True)
class Setup(Bounded, path="--"):
    """The flags of a benchmark; None leaves the choice to it."""

    backend: Backend = "mujoco"
    robot: RobotWish = None
    speed: Annotated[float, Within(0.01, 100.0)] | None = None  # m/s
    acceleration: Annotated[float, Within(0.05, 1000.0)] | None = None  # m/s2
    hold: Annotated[float, Within(LEAST_HOLD, 600.0)] | None = None  # s
    robots: Annotated[int, Within(1, 2**20)] | None = None
    seed: Annotated[int, Within(0, LARGEST_SEED)] | None = None
    sensor_noise: bool = False
    operator: HeadingHold = HEADING_HOLD
    drake: DrakeContact = DrakeContact()

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        super().__post_init__()
        if self.backend != "drake" and self.drake != DrakeContact():
            raise UserError(
                f"--drake.* is of --backend drake; got --backend {self.backend}"
            )

    @property
    def noise_seed(self) -> int | None:
        """What the sensors' noise is drawn from; None: sensors without noise."""
        return (self.seed or 0) if self.sensor_noise else None

    @property
    def chosen(self) -> tuple[str, ...]:
        """The flags that are not at their default."""
        return tuple(
            f.name
            for f in dataclasses.fields(self)
            if getattr(self, f.name) != f.default
        )

    def only(self, flags: tuple[str, ...]) -> "Setup":
        """Return these flags alone; every other one is left to the benchmark."""
        return type(self)(**{name: getattr(self, name) for name in flags})
