"""A trajectory problem: speed, robot, sequence of contacts, limits, cost and mesh. This
module needs no CasADi."""

import dataclasses
import math
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float, Int

from bp2_rl.base.bounds import Bounded, Within, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.hardware import IDEAL, HardwareSpec

TRUNK = 3  # coordinates of the trunk: x, z, pitch
PER_LEG = 3  # coordinates of a leg: hip, knee and, where the shank is not rigid, spring
# m, ASSUMED: a spring's rubber stop takes hold over this depth, not at a corner
STOP_ROUNDING = 5e-3
# Friction changes sign with the speed, and a gear's loss has a corner at no torque. A
# mesh cannot follow that, so both go smoothly, by a tanh, over a small share of the 21
# rad/s, the 8 m/s and the 120 Nm that occur. All three halved or doubled change the
# greatest speed of a robot with friction and gear by less than 1e-3 m/s. Robots of
# another size take them in proportion.
JOINT_ROUNDING = 0.5  # rad/s, ASSUMED
SLIDE_ROUNDING = 0.1  # m/s, ASSUMED
GEAR_ROUNDING = 2.0  # Nm, ASSUMED

Scheme = Literal["hermite-simpson", "trapezoid", "paper"]
Gait = Literal["trot", "two-leg", "pronk", "half-bound", "gallop"]
Speed = Annotated[float, Within(0.01, 100.0)]
"""A speed, m/s; in this range names of files put speeds in their order."""
SpeedStep = Annotated[float, Within(0.0, 100.0, open_below=True)]
MOST_SPEEDS = 1000
"""Most speeds of a family; more of them are a slip of the pen: at a minute each they
take a day."""
SOLVE_TIME = 300.0
"""Time limit of a solve, s of a processor's time."""
Intervals = Annotated[int, Within(2, 500)]
Starts = Annotated[int, Within(1, 1000)]


def per_leg(hardware: HardwareSpec) -> int:
    """Return the number of coordinates of a leg of this robot: 3 with a spring, else
    2."""
    return PER_LEG if hardware.anatomy.sprung else PER_LEG - 1


def motor_coordinates(
    legs: tuple[str, ...], per_leg: int = PER_LEG
) -> Int[np.ndarray, " motors"]:
    """Return the indices into q of hips and knees, which have motors, leg by leg."""
    return np.array(
        [TRUNK + per_leg * leg + joint for leg in range(len(legs)) for joint in (0, 1)]
    )


def spring_coordinates(legs: tuple[str, ...]) -> Int[np.ndarray, " legs"]:
    """Indices into q that are a spring's compression, of legs with springs."""
    return TRUNK + PER_LEG * np.arange(len(legs)) + 2


def contact_rows(legs: tuple[str, ...], feet: tuple[str, ...]) -> list[int]:
    """Return the rows of some feet among contact coordinates and forces, which are (x,
    z) leg by leg."""
    return [2 * legs.index(foot) + axis for foot in feet for axis in (0, 1)]


@dataclasses.dataclass(frozen=True)
class Stride:
    """Segments of a stride, with the feet that stand in each; the next stride has the
    same segments, with `then` as its legs."""

    legs: tuple[str, ...]
    standing: tuple[tuple[str, ...], ...]
    then: tuple[str, ...]
    per_leg: int = PER_LEG  # coordinates

    @property
    def nq(self) -> int:
        """Number of the model's coordinates: the trunk's, then hip, knee and, unless
        the shank is rigid, spring of every leg."""
        return TRUNK + self.per_leg * len(self.legs)

    @property
    def motors(self) -> Int[np.ndarray, " motors"]:
        """Indices into q of the coordinates that have a motor."""
        return motor_coordinates(self.legs, self.per_leg)

    @property
    def cycles(self) -> float:
        """Share of a gait cycle that the segments cover."""
        return 1.0 if self.then == self.legs else 0.5

    def stands(self, leg: str, segment: int) -> bool:
        """Return whether a leg stands in a segment; segments outside the stride are
        other strides'."""
        strides, segment = divmod(segment, len(self.standing))
        # The next stride's feet have other names; at most left and right change places,
        # so also on the way back.
        name = self.then[self.legs.index(leg)] if strides % 2 else leg
        return name in self.standing[segment]

    def touchdowns(self, segment: int) -> tuple[str, ...]:
        """Return the feet that land as a segment begins."""
        return tuple(
            leg for leg in self.standing[segment] if not self.stands(leg, segment - 1)
        )

    def liftoffs(self, segment: int) -> tuple[str, ...]:
        """Return the feet that leave the ground as a segment ends."""
        return tuple(
            leg for leg in self.standing[segment] if not self.stands(leg, segment + 1)
        )

    @property
    def next_coordinates(self) -> Int[np.ndarray, " nq"]:
        """Indices by which the stride's final q becomes the next stride's initial q
        (but for x)."""
        blocks = [TRUNK + self.per_leg * self.legs.index(leg) for leg in self.then]
        return np.array(
            [
                *range(TRUNK),
                *(block + i for block in blocks for i in range(self.per_leg)),
            ]
        )

    @property
    def next_motors(self) -> Int[np.ndarray, " motors"]:
        """Indices by which the stride's final motor or contact values become the next
        stride's initial ones."""
        return np.array(
            [2 * self.legs.index(leg) + i for leg in self.then for i in (0, 1)]
        )


STRIDES: dict[Gait, Stride] = {
    # Half a cycle of the whole robot, then left and right change sides.
    "trot": Stride(conventions.LEGS, (("FL", "RR"), ()), ("FL", "FR", "RL", "RR")),
    # The paper's words taken literally: half a robot on one fore and one hind limb,
    # half a cycle apart.
    "two-leg": Stride(("F", "H"), (("F",), (), ("H",), ()), ("F", "H")),
    # All legs at once: half a robot, too.
    "pronk": Stride(("F", "H"), (("F", "H"), ()), ("F", "H")),
    # The whole robot, which is no mirror image of itself half a cycle later. A foot
    # takes over as another leaves.
    "half-bound": Stride(
        conventions.LEGS, (("RL", "RR"), (), ("FL",), ("FR",), ()), conventions.LEGS
    ),
    "gallop": Stride(
        conventions.LEGS, (("RL",), ("RR",), (), ("FL",), ("FR",), ()), conventions.LEGS
    ),
}


@dataclasses.dataclass(frozen=True)
class CostWeights(Bounded, path="weights."):
    """Weights of the paper's running cost R, and the numbers by which its terms are
    divided. All ASSUMED."""

    power: Annotated[float, Within(0.0, 1e6)] = 1.0  # omega_p
    load: Annotated[float, Within(0.0, 1e6)] = 1.0  # omega_f
    # omega_s, on changes within `smoothness_time`
    smoothness: Annotated[float, Within(0.0, 1e6)] = 1.0
    force: Annotated[float, Within(1.0, 1e6)] = round(
        bp2.TOTAL_MASS * conventions.GRAVITY, 0
    )  # N, F bar: one body weight
    smoothness_time: Annotated[float, Within(0.0, 1.0)] = conventions.CONTROL_STEP  # s


@dataclasses.dataclass(frozen=True)
class Form(Bounded, path="form."):
    """Limits on a stride's form beyond the limits of physics; the defaults are none."""

    # share of the cycle that each foot stands
    least_duty: Annotated[float, Within(0.0, 0.5, open_above=True)] = 0.0
    # s, of a gait cycle
    longest_period: Annotated[float, Within(0.01, 10.0, infinite=True)] = math.inf
    # m, its centre above the ground at any time
    highest_trunk: Annotated[float, Within(0.01, 2.0)] = 2.0
    # m, of a swinging sole
    highest_step: Annotated[float, Within(0.001, 2.0, infinite=True)] = math.inf
    hardest_landing: Annotated[float, Within(0.01, 100.0, infinite=True)] = math.inf
    """m/s, of a sole before touchdown, downwards as well as along"""
    fastest_release: Annotated[float, Within(0.01, 100.0, infinite=True)] = math.inf
    """m/s, of a spring's extension as its foot lifts off: what then meets the rebound
    stop"""
    greatest_share: Annotated[float, Within(0.5, 1.0)] = 1.0
    """largest share of a stance's mean vertical force that one of its feet bears"""
    greatest_impact: Annotated[float, Within(0.0, 1.0)] = 1.0
    """largest share of the weight's impulse over the stride that landings bear"""


@dataclasses.dataclass(frozen=True)
class Problem:
    """A trajectory to find: speed, robot, gait, limits, cost and mesh."""

    speed: Speed = 10.0  # m/s
    gait: Gait = "trot"
    scheme: Scheme = "hermite-simpson"
    intervals: Intervals = 16  # of each segment
    hardware: HardwareSpec = IDEAL
    foot_radius: Annotated[float, Within(0.0, 0.05)] | None = None
    """m, in place of the robot's own; 0 is the paper's point foot"""
    rotor_coupling: bool = False
    """rotors couple their joints to the links that hold them, too (paper, Fig. S1): 2 %
    of what couples hip and knee"""
    # m, of a swinging foot in mid-swing
    clearance: Annotated[float, Within(0.0, 0.5)] = 0.04
    # Largest joint speed, as a share of the no-load speed.
    speed_margin: Annotated[float, Within(0.01, 10.0)] = 1.0
    torque_rate: Annotated[float, Within(1.0, 1e9)] = 15e3  # Nm/s, ASSUMED
    force_rate: Annotated[float, Within(1.0, 1e9)] = 100e3  # N/s, ASSUMED
    pitch_limit: Annotated[float, Within(0.001, 1.5)] = 0.3  # rad
    form: Form = Form()
    weights: CostWeights = CostWeights()

    def __post_init__(self) -> None:
        """Refuse impossible values with a line that names the field."""
        check_bounds(self)
        if not self.rotor_coupling:
            return
        hardware = self.hardware
        held = hardware.parameter("rotor_inertia")
        thigh = hardware.mass_scale * hardware.bp2.thigh_inertia
        if held >= thigh:
            raise UserError(
                f"rotor_coupling: hardware.rotor_inertia ({held:g}) must be below the inertia of the thigh that holds "
                f"a rotor, {thigh:g} kg m2"
            )

    @property
    def stride(self) -> Stride:
        """Segments of the gait's stride, with the feet that stand in each."""
        return dataclasses.replace(STRIDES[self.gait], per_leg=per_leg(self.hardware))

    @property
    def share(self) -> float:
        """Share of the robot that is modelled: legs in the model, over four."""
        return len(self.stride.legs) / len(conventions.LEGS)

    @property
    def points(self) -> Float[np.ndarray, " points"]:
        """Places of the mesh's points in a segment, as shares of its duration."""
        return np.linspace(
            0.0,
            1.0,
            2 * self.intervals + 1
            if self.scheme == "hermite-simpson"
            else self.intervals + 1,
        )

    @property
    def quadrature(self) -> Float[np.ndarray, " points"]:
        """Weights of the mean over a segment's points: Simpson's rule, the trapezoidal
        rule or, in the paper's scheme, which takes forces for velocities, the left
        ends."""
        weights = np.ones(len(self.points))
        if self.scheme == "hermite-simpson":
            weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
        elif self.scheme == "trapezoid":
            weights[1:-1] = 2.0
        else:
            weights[-1] = 0.0
        return weights / np.sum(weights)

    def at(self, speed: float) -> "Problem":
        """Return this problem with another speed, m/s."""
        return dataclasses.replace(self, speed=speed)

    def sized(self, hardware: HardwareSpec) -> "Problem":
        """Return this problem, which is written for BP2, scaled to a robot by dynamic
        similarity; for a BP2 nothing is scaled."""
        size, weights = hardware.size, self.weights
        return dataclasses.replace(
            self,
            hardware=hardware,
            speed=size.speed * self.speed,
            clearance=size.length * self.clearance,
            torque_rate=size.torque / size.time * self.torque_rate,
            force_rate=size.mass / size.time * self.force_rate,
            weights=dataclasses.replace(
                weights,
                force=size.mass * weights.force,
                smoothness_time=size.time * weights.smoothness_time,
            ),
        )

    def on(self, **hardware: float) -> "Problem":
        """Return this problem with other hardware parameters."""
        return dataclasses.replace(self, hardware=self.hardware.changed(**hardware))

    def on_mesh(self, intervals: int) -> "Problem":
        """Return this problem with another number of intervals in each segment."""
        return dataclasses.replace(self, intervals=intervals)
