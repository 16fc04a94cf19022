"""Cost of transport of running at one speed, and where the motors' work goes.

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

from bp2_rl.base.metric import metric
from bp2_rl.paper.benchmarks.speeds import AtSpeed
from bp2_rl.robot import conventions
from bp2_rl.robot.conventions import LEGS
from bp2_rl.simulation.account import Ledger
from bp2_rl.simulation.trajectory import Trajectory

ENDS = {"fore": "F", "hind": "R"}  # and how their legs' names begin
KINDS = tuple(f"{end} {joint}" for end in ENDS for joint in conventions.JOINTS)
SLOWEST = 0.1  # m/s, of which a cost of transport is worth to be told


@dataclasses.dataclass(frozen=True)
class Electrical:
    """Electrical costs of transport under four assumptions about the motors' braking
    energy."""

    nothing: float = metric(
        "Electrical cost",
        form=".3f",
        meaning="no braking returned, copper heat included",
        card="electrical_cost",
    )
    half: float = metric("Half returned", form=".3f", meaning="half of the braking")
    everything: float = metric(
        "All returned",
        form=".3f",
        meaning="net cost and copper heat",
        card="electrical_cost_all_returned",
    )
    bus: float = metric(
        "Shared by motors",
        form=".3f",
        meaning="brakes feed drives, battery takes none",
        card="electrical_cost_shared",
    )


@dataclasses.dataclass(frozen=True)
class Joint:
    """Powers of a pair of motors, such as the hind hips, left and right together."""

    name: str = metric("Motors", form="s")  # as in `KINDS`
    peak: float = metric("Peak", "W", ".0f", "greatest power of one motor in a ms")
    hardest: float = metric("Hardest braking", "W", ".0f")  # as a positive number
    positive: float = metric("Drives", "W", ".0f", "mean of one motor")
    braking: float = metric("Brakes", "W", ".0f")  # as a positive number
    copper: float = metric("Heat", "W", ".0f", "mean, of the windings")
    efficiency: float | None = metric(
        "Efficiency, driving", form=".0%", meaning="work / (work + copper heat)"
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Energy:
    """The balance of energy at one speed over whole strides, as costs of transport."""

    strides: int
    weight_speed: float = metric("m g v", "W", ".0f", "power of a cost of 1")
    positive: float = metric(
        "Mechanical cost",
        form=".3f",
        meaning="positive motor work / (m g distance)",
        card="mechanical_cost",
    )
    braking: float = metric(
        "Braking", form=".3f", meaning="negative motor work / (m g distance)"
    )
    net: float = metric(
        "Net cost",
        form=".3f",
        meaning="positive less negative: what is lost",
        card="net_cost",
    )
    electrical: Electrical
    lost: dict[str, float]  # cost by cause, as a `Ledger` has them
    stored: float = metric(
        "Stored", form=".3f", meaning="more in motion, height and springs at the end"
    )
    integration: float = metric(
        "Lost by steps", form=".1e", meaning="of 1 ms; no loss of the robot's"
    )
    closure: float = metric("Closure", form=".0e", meaning="gap / largest term, any ms")
    spring: float = metric("Springs give", form=".3f", meaning="their positive work")
    spring_share: float = metric(
        "Spring share",
        form=".0%",
        meaning="of what springs and motors give",
        card=True,
    )
    efficiency: float | None = metric(
        "Motors' efficiency",
        form=".0%",
        meaning="driving: work / (work + copper heat)",
        card="motor_efficiency",
    )
    joints: tuple[Joint, ...]


@dataclasses.dataclass(frozen=True)
class EfficiencyAtSpeed(AtSpeed):
    """A run at one commanded speed, with its energy balance."""

    # None of a run that fell, went nowhere or made no two strides
    energy: Energy | None


@dataclasses.dataclass(frozen=True)
class EfficiencyMetrics:
    """A policy's runs at all commanded speeds, with their energy balances."""

    speeds: tuple[EfficiencyAtSpeed, ...]

    @property
    def found(self) -> tuple[tuple[EfficiencyAtSpeed, Energy], ...]:
        """Runs whose energy could be measured, each with its energy balance."""
        return tuple((at, at.energy) for at in self.speeds if at.energy is not None)


def measure_energy(run: Trajectory, ledger: Ledger, strides: int) -> Energy | None:
    """Return a run's energy balance over whole strides; None if the robot hardly
    moves."""
    speed = run.mean_speed
    if speed <= SLOWEST:
        return None
    weight_speed = run.mass * conventions.GRAVITY * speed

    # the last millisecond's end has no energy in the ledger: it is left out
    def cost(power: np.ndarray) -> float:
        of_all = np.reshape(power[:-1], (len(power) - 1, -1)).sum(axis=-1)
        return float(np.mean(of_all)) / weight_speed

    positive = cost(np.maximum(ledger.motors, 0.0))
    braking = cost(np.maximum(-ledger.motors, 0.0))
    lost = {cause: cost(power) for cause, power in ledger.lost.items()}
    copper = lost["copper"]
    spring = cost(np.maximum(ledger.springs, 0.0))
    duration = (len(ledger.energy) - 1) * run.dt
    stored = float(ledger.energy[-1] - ledger.energy[0]) / duration / weight_speed
    resisted = sum(lost.values()) - copper
    return Energy(
        strides=strides,
        weight_speed=weight_speed,
        positive=positive,
        braking=braking,
        net=positive - braking,
        electrical=Electrical(
            nothing=positive + copper,
            half=positive + copper - 0.5 * braking,
            everything=positive + copper - braking,
            bus=cost(np.maximum(ledger.bus, 0.0)),
        ),
        lost=lost,
        stored=stored,
        integration=cost(ledger.motors) - resisted - stored,
        closure=ledger.closure,
        spring=spring,
        spring_share=spring / (spring + positive),
        efficiency=_efficiency(ledger.motors, ledger.copper),
        joints=tuple(_joint(name, ledger) for name in KINDS),
    )


def motors_of(kind: str) -> list[int]:
    """Return the indices of a kind of motors, such as `hind hip`, right and left."""
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
    """Return the efficiency of motors while they drive, work / (work + copper heat);
    None if none drives."""
    driving = power > 0.0
    work = float(np.sum(power[driving]))
    return work / (work + float(np.sum(copper[driving]))) if work > 0.0 else None
