"""What the efficiency benchmark measures: the motors' work at a speed, and where it
goes.

Means over whole strides. Of the motors' mechanical powers P_i, of which there are
twelve, and their windings' heat C,

    positive    sum_i mean max(P_i, 0)                braking    sum_i mean max(-P_i, 0)
    net         positive - braking, which is what is lost in gears, friction, dampers, air, ground and stops
    electrical  positive + C - r braking              r: the share of the braking that is returned
    bus         mean max(sum_i P_i + C_i, 0)          motors that brake feed those that drive; nothing is stored

Each over m g v is a cost of transport.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from bp2_rl.optimiser.cycle import robot_mass, whole_cycle
from bp2_rl.optimiser.problem import motor_coordinates
from bp2_rl.optimiser.solution import Solution
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator, winding_heat
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.hardware import IDEAL
from bp2_rl.simulation.account import Ledger
from bp2_rl.simulation.trajectory import Trajectory

RETURNED = 0.0, 0.5, 1.0  # shares of the braking
ENDS = {"fore": "F", "hind": "R"}  # and how their legs' names begin
KINDS = tuple(f"{end} {joint}" for end in ENDS for joint in conventions.JOINTS)
SLOWEST = 0.1  # m/s, of which a cost of transport is worth to be told


@dataclasses.dataclass(frozen=True)
class Electrical:
    """Costs of transport at the battery, by what becomes of the motors' braking."""

    nothing: float  # is returned: as topspeed has it
    half: float
    everything: float
    bus: float  # motors that brake feed those that drive, and the battery takes nothing

    @classmethod
    def of(
        cls, positive: float, braking: float, copper: float, bus: float
    ) -> "Electrical":
        """From the four parts, in one unit."""
        nothing, half, everything = (
            positive + copper - share * braking for share in RETURNED
        )
        return cls(nothing, half, everything, bus)


@dataclasses.dataclass(frozen=True)
class Joint:
    """The motors of a kind of joint, fore or hind, both sides together; W."""

    name: str  # as in `KINDS`
    peak: float  # greatest power of one motor in a ms, driving ...
    hardest: float  # ... and braking, as a positive number
    positive: float  # mean of one motor, driving
    braking: float  # mean power while braking, as a positive number
    copper: float  # mean heat of the windings
    # of what the windings are given while driving, the share that becomes work
    efficiency: float | None


@dataclasses.dataclass(frozen=True)
class Energy:
    """A speed's balance over whole strides. But for shares, everything is a cost of
    transport: power / (m g v)."""

    strides: int
    weight_speed: float  # W, m g v: what a cost of 1 is
    positive: float  # mechanical work of the motors while they drive ...
    braking: float  # ... and while they brake, as a positive number
    electrical: Electrical
    lost: dict[str, float]  # by cause, as `account.CAUSES`
    # more in motion, height and springs at the end than at the beginning, by C MuJoCo's
    # own energies
    stored: float
    # what is then left of the motors' net work: steps of a millisecond lose (or gain)
    # it
    integration: float
    # of the ledger, which books that as well: largest gap in any ms over the largest
    # term
    closure: float
    spring: float  # what springs give
    efficiency: float | None  # of all motors, as `Joint.efficiency`
    joints: tuple[Joint, ...]

    @property
    def net(self) -> float:
        """Mechanical work of the motors."""
        return self.positive - self.braking

    @property
    def spring_share(self) -> float:
        """Return the springs' share of the work that springs and motors give."""
        return self.spring / (self.spring + self.positive)


@dataclasses.dataclass(frozen=True)
class EfficiencyAtSpeed:
    """One command."""

    commanded_speed: float  # m/s
    speed: float  # m/s, over the strides, or the mean of a run that has none
    fell_at: float | None  # s
    # None of a run that fell, went nowhere or made no two strides
    energy: Energy | None


@dataclasses.dataclass(frozen=True)
class OptimisedEfficiency:
    """The shipped library's stride at the speed nearest to a run's: in the plane, of a
    robot that loses nothing."""

    speed: float  # m/s
    positive: float  # costs of transport, as in `Energy`
    braking: float
    copper: float
    electrical: Electrical


@dataclasses.dataclass(frozen=True)
class EfficiencyMetrics:
    """All of it."""

    speeds: tuple[EfficiencyAtSpeed, ...]
    optimiser: tuple[OptimisedEfficiency, ...]  # one a speed that was run through

    @property
    def found(self) -> tuple[tuple[EfficiencyAtSpeed, Energy], ...]:
        """The speeds that were run through."""
        return tuple((at, at.energy) for at in self.speeds if at.energy is not None)


def measure_energy(run: Trajectory, ledger: Ledger, strides: int) -> Energy | None:
    """The balance of a run over so many whole strides; None of one that goes
    nowhere."""
    speed = float(np.mean(run.ground_velocity[:, 0]))
    if speed <= SLOWEST:
        return None
    weight_speed = run.mass * conventions.GRAVITY * speed

    # the last millisecond's end has no energy in the ledger: it is left out
    def cost(power: np.ndarray) -> float:
        return (
            float(np.mean(np.reshape(power[:-1], (len(power) - 1, -1)).sum(axis=-1)))
            / weight_speed
        )

    driving, braking = np.maximum(ledger.motors, 0.0), np.maximum(-ledger.motors, 0.0)
    lost = {cause: cost(power) for cause, power in ledger.lost.items()}
    stored = (
        float(ledger.energy[-1] - ledger.energy[0])
        / ((len(ledger.energy) - 1) * run.dt)
        / weight_speed
    )
    resisted = sum(lost.values()) - lost["copper"]
    terms = np.abs(np.stack([ledger.bus, ledger.stored, *ledger.lost.values()]))
    return Energy(
        strides=strides,
        weight_speed=weight_speed,
        positive=cost(driving),
        braking=cost(braking),
        electrical=Electrical.of(
            cost(driving),
            cost(braking),
            lost["copper"],
            cost(np.maximum(ledger.bus, 0.0)),
        ),
        lost=lost,
        stored=stored,
        integration=cost(ledger.motors) - resisted - stored,
        closure=float(np.max(np.abs(ledger.error) / np.max(terms, axis=0))),
        spring=cost(np.maximum(ledger.springs, 0.0)),
        efficiency=_efficiency(ledger.motors, ledger.copper),
        joints=tuple(_joint(name, ledger) for name in KINDS),
    )


def measure_optimiser(solution: Solution) -> OptimisedEfficiency:
    """Measure a stride of the optimiser's; the windings are those of the robot without
    the library's reserve."""
    cycle, problem = whole_cycle(solution), solution.problem
    tau, speed = (
        cycle.motion.tau,
        cycle.motion.v[..., motor_coordinates(problem.stride.legs)],
    )
    heat = np.sum(winding_heat(Actuator.from_hardware(IDEAL), tau), axis=-1)
    total = np.sum(tau * speed, axis=-1)

    def cost(power: np.ndarray) -> float:
        distance = problem.speed * cycle.period
        return float(np.sum(cycle.weights * power)) / (
            robot_mass(problem) * conventions.GRAVITY * distance
        )

    positive, braking = (
        cost(np.sum(np.maximum(sign * tau * speed, 0.0), axis=-1))
        for sign in (1.0, -1.0)
    )
    copper, bus = cost(heat), cost(np.maximum(total + heat, 0.0))
    return OptimisedEfficiency(
        problem.speed,
        positive,
        braking,
        copper,
        Electrical.of(positive, braking, copper, bus),
    )


def motors_of(kind: str) -> list[int]:
    """Return the motors of a kind, `hind hip`, right and left."""
    end, joint = kind.split()
    return [
        3 * leg + conventions.JOINTS.index(joint)
        for leg, name in enumerate(LEGS)
        if name.startswith(ENDS[end])
    ]


def _joint(name: str, ledger: Ledger) -> Joint:
    chosen = motors_of(name)
    power, copper = ledger.motors[:, chosen], ledger.copper[:, chosen]
    return Joint(
        name=name,
        peak=max(float(np.max(power)), 0.0),
        hardest=max(-float(np.min(power)), 0.0),
        positive=float(np.mean(np.maximum(power, 0.0))),
        braking=float(np.mean(np.maximum(-power, 0.0))),
        copper=float(np.mean(copper)),
        efficiency=_efficiency(power, copper),
    )


def _efficiency(
    power: Float[np.ndarray, "N M"], copper: Float[np.ndarray, "N M"]
) -> float | None:
    """Work over what the windings are given, while motors drive; None of motors that
    never do."""
    driving = power > 0.0
    work = float(np.sum(power[driving]))
    return work / (work + float(np.sum(copper[driving]))) if work > 0.0 else None
