"""How the paper's numbers move with what had to be assumed, and which combinations of
that they see.

The Jacobian is of logarithms: a row is a number of the paper over how well it is known,
a column an assumption over half its range. Its singular values say by how many times
their uncertainty the paper's numbers move as a combination of assumptions goes through
half its range. Below one, next to nothing is learned of it.

The rows come from three places: trajectories at one speed, optimised again with each
assumption changed (Fig. 4, and the heat of what they ask of a hip); greatest speeds, by
the multipliers of their programs (`trajopt.prices`); closed forms.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

from bp2_rl.optimiser.collocation import fastest, solve
from bp2_rl.optimiser.cycle import whole_cycle
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.solution import Solution
from bp2_rl.paper.figures.assumed import ASSUMED, HEAT, LOST, MECHANICAL
from bp2_rl.paper.figures.settings import IdentifiabilitySettings
from bp2_rl.paper.motor_heat import Network, Temperatures, advance
from bp2_rl.paper.thermal_specs import AMBIENT, MotorHeat
from bp2_rl.paper.trajectories.decomposition import decompose, peak_velocity_force
from bp2_rl.paper.trajectories.shadow_prices import find_shadow_prices
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.actuator import copper_loss, stall_torque
from bp2_rl.robot.hardware import BUILT

SHARE = 0.1  # of a unit, by which an assumption is changed to either side
TORQUE, VELOCITY_FORCE, REVERSAL, POWERS = (
    "main torque",
    "C_z",
    "thigh reverses",
    "lesser power",
)
GREATEST, BELT, OUTDOORS = "greatest power", "belt", "outdoors"
SPRINT, LAUNCH, HEATING = "100 m", "launch", "heating"


@dataclasses.dataclass(frozen=True)
class Printed:
    """A number of the paper."""

    name: str
    value: float
    unit: str
    rounding: float  # half a unit of its last digit
    where: str


PRINTED = (
    Printed(TORQUE, 250.0, "Nm", 5.0, "Fig. 4 B"),
    Printed(VELOCITY_FORCE, 1.19, "m g", 0.005, "Fig. 4 A"),
    Printed(REVERSAL, 0.21, "T", 0.005, "Fig. 4 B"),
    Printed(POWERS, bp2.HIND_PEAK_POWERS[0], "W", 0.5, "Fig. 5 E"),
    Printed(GREATEST, bp2.HIND_PEAK_POWERS[1], "W", 0.5, "Fig. 5 E"),
    Printed(BELT, bp2.TREADMILL_TOP_SPEED, "m/s", 0.05, "Results"),
    Printed(OUTDOORS, bp2.OUTDOOR_TOP_SPEED, "m/s", 0.005, "Abstract"),
    Printed(SPRINT, bp2.SPRINT_100M_TIME, "s", 0.05, "Abstract"),
    Printed(LAUNCH, bp2.LAUNCH_ACCELERATION, "m/s2", 0.005, "Results"),
    Printed(HEATING, bp2.HEATING_RATE, "K/s", 0.05, "Fig. 7"),
)


@dataclasses.dataclass(frozen=True)
class RowNumbers:
    """A number of the paper, ours, and how ours moves."""

    name: str
    unit: str
    where: str  # in the paper
    printed: float
    ours: float | None  # None: no model of ours gives it
    uncertainty: float  # relative: rounding and the model's error
    slopes: dict[str, float]  # d ln / d ln, by assumption
    # largest difference between slopes to either side, of the largest slope; 0 where
    # there is one alone
    bend: float


@dataclasses.dataclass(frozen=True)
class Combination:
    """A direction in which assumptions move together, and what the paper's numbers see
    of it."""

    singular: float  # uncertainties of the paper's numbers for a unit
    assumptions: dict[str, float]  # units, of length 1 in all
    seen_in: dict[str, float]  # by the row of the index; none of one that is not seen


@dataclasses.dataclass(frozen=True)
class IdentifiabilityNumbers:
    """All that the figure shows."""

    rows: tuple[RowNumbers, ...]
    combinations: tuple[Combination, ...]  # the strongest first
    pinned: int  # of them, with a singular value of one or more
    by_rounding: int  # if the model had no error
    assumptions: int
    # of each assumption's range, once the paper's numbers are taken into account
    left: dict[str, float]
    grip: float  # friction that the launch needs at the least
    launch_torque: float  # Nm of a hip, that it needs on two legs


def measure(settings: IdentifiabilitySettings) -> IdentifiabilityNumbers:
    """Solve, differentiate and decompose."""
    problem = Problem(speed=settings.speed, intervals=settings.intervals)
    cruise = solve(problem)
    ours, slopes, bends = _analysed(cruise)
    for name, speed, gains in _greatest(cruise):
        ours[name], slopes[name] = speed, gains
    ours[GREATEST] = bp2.PEAK_TORQUE * bp2.CORNER_SPEED
    slopes[GREATEST] = {"peak torque": 1.0, "corner speed": 1.0}
    v, a = bp2.OUTDOOR_TOP_SPEED, bp2.LAUNCH_ACCELERATION
    ours[SPRINT] = sprint(v, a)
    share = v * (0.5 / a - TRACK / v**2) / ours[SPRINT]  # d ln t / d ln v
    slopes[SPRINT] = {name: share * slope for name, slope in slopes[OUTDOORS].items()}
    slopes[LAUNCH] = {}
    rows = tuple(
        RowNumbers(
            printed.name,
            printed.unit,
            printed.where,
            printed.value,
            ours.get(printed.name),
            settings.model_error + printed.rounding / printed.value,
            slopes[printed.name],
            bends.get(printed.name, 0.0),
        )
        for printed in PRINTED
    )
    J = jacobian(rows)
    exact = J * np.array(
        [[row.uncertainty / (row.uncertainty - settings.model_error)] for row in rows]
    )
    combinations = decompose_jacobian(J)
    return IdentifiabilityNumbers(
        rows=rows,
        combinations=combinations,
        pinned=sum(one.singular >= 1.0 for one in combinations),
        by_rounding=int(np.sum(np.linalg.svd(exact, compute_uv=False) >= 1.0)),
        assumptions=len(ASSUMED),
        left=dict(
            zip(
                [one.name for one in ASSUMED], map(float, left_of_range(J)), strict=True
            )
        ),
        grip=a / conventions.GRAVITY,
        launch_torque=bp2.TOTAL_MASS * a * bp2.STANDING_HEIGHT / 2.0,
    )


# --- The decomposition ----------------------------------------------------------------


def jacobian(rows: tuple[RowNumbers, ...]) -> Float[np.ndarray, "rows columns"]:
    """Slopes in units: of half a range, and of a row's uncertainty."""
    return np.array(
        [
            [
                row.slopes.get(one.name, 0.0) * one.reach / row.uncertainty
                for one in ASSUMED
            ]
            for row in rows
        ]
    )


def decompose_jacobian(J: Float[np.ndarray, "rows columns"]) -> tuple[Combination, ...]:
    """Return a Jacobian's singular values and vectors, the null space included."""
    U, values, V = np.linalg.svd(J)
    combinations = []
    for place, direction in enumerate(V):
        singular = float(values[place]) if place < len(values) else 0.0
        sign = np.sign(direction[np.argmax(np.abs(direction))])
        along = {
            one.name: float(sign * part)
            for one, part in zip(ASSUMED, direction, strict=True)
        }
        seen = {}
        if singular > 1e-9:
            seen = {
                row.name: float(sign * part)
                for row, part in zip(PRINTED, U[:, place], strict=True)
            }
        combinations.append(Combination(singular, along, seen))
    return tuple(combinations)


def left_of_range(
    J: Float[np.ndarray, "rows columns"],
) -> Float[np.ndarray, " columns"]:
    """Standard deviation of each assumption that the rows leave of one unit, all
    normal: 1 where nothing is learned."""
    return np.sqrt(np.diag(np.linalg.inv(np.eye(J.shape[1]) + J.T @ J)))


# --- The rows -------------------------------------------------------------------------


def _analysed(
    cruise: Solution,
) -> tuple[dict[str, float], dict[str, dict[str, float]], dict[str, float]]:
    """Fig. 4's numbers and a hip's heat, how they move, and how much the slopes to
    either side differ."""
    network = Network.from_spec(
        MotorHeat(), next(one.value for one in HEAT if one.heat == "winding_to_case")
    )
    found: Any = brentq(
        lambda heat: heating_rate(network, heat) - bp2.HEATING_RATE, 1.0, 5e3
    )
    power = float(found)
    base, cool = _figures(cruise), hip_heat(cruise)

    def described(solution: Solution) -> dict[str, float]:
        return _figures(solution) | {
            HEATING: heating_rate(network, power * hip_heat(solution) / cool)
        }

    before = described(cruise)
    slopes: dict[str, dict[str, float]] = {name: {} for name in before}
    bends: dict[str, list[float]] = {name: [] for name in before}
    for one in MECHANICAL:
        assert one.change is not None
        h = SHARE * one.reach
        sides = [
            described(
                solve(one.change(cruise.problem, math.exp(way * h)), cruise.motion)
            )
            for way in (-1.0, 1.0)
        ]
        for name, middle in before.items():
            low, high = (np.log(side[name] / middle) / h for side in sides)
            slopes[name][one.name] = float(high - low) / 2.0
            bends[name].append(abs(float(high + low)))
    for one in HEAT:
        h = SHARE * one.reach

        def rate(factor: float, field: str = one.heat) -> float:
            return heating_rate(
                network.replace(**{field: factor * getattr(network, field)}), power
            )

        slopes[HEATING][one.name] = float(
            np.log(rate(math.exp(h)) / rate(math.exp(-h))) / (2.0 * h)
        )
    largest = {name: max(map(abs, slopes[name].values())) for name in before}
    # Slopes are of a heat that is scaled to the paper's rate; what is ours is not.
    ours = base | {HEATING: heating_rate(network, cool)}
    return ours, slopes, {name: max(bends[name]) / largest[name] for name in before}


def _greatest(cruise: Solution) -> list[tuple[str, float, dict[str, float]]]:
    """Greatest speeds of the built robot on the belt (no air) and outdoors, and their d
    ln v / d ln p."""
    start, found = fastest(cruise), []
    for name, hardware in (
        (
            BELT,
            dataclasses.replace(
                BUILT, losses=dataclasses.replace(BUILT.losses, drag_area=0.0)
            ),
        ),
        (OUTDOORS, BUILT),
    ):
        changes = {
            one.name: one.change
            for one in (*MECHANICAL, *LOST)
            if one.change is not None and one.name != "F bar"
        }
        problem = dataclasses.replace(start.problem, hardware=hardware)
        priced = find_shadow_prices(
            dataclasses.replace(start, problem=problem), changes, greatest=True
        )
        start, speed = priced.solution, priced.solution.problem.speed
        found.append(
            (name, speed, {key: price / speed for key, price in priced.prices.items()})
        )
    return found


def _figures(solution: Solution) -> dict[str, float]:
    """Fig. 4's numbers of a trajectory."""
    terms = decompose(solution)
    hips = [terms.along("main inertial", f"{leg} hip") for leg in terms.legs]
    return {
        TORQUE: float(max(np.max(np.abs(hip)) for hip in hips)),
        VELOCITY_FORCE: peak_velocity_force(terms),
        REVERSAL: reversal(solution),
        POWERS: min(
            float(np.max(of_hind(solution, joint, np.multiply))) for joint in (0, 1)
        ),
    }


# --- Numbers that are read off a trajectory or a law ----------------------------------


STEP = 1.0  # s, of the motor's heat
TRACK = 100.0  # m


def sprint(speed: float, acceleration: float) -> float:
    """Time for the 100 m at a constant acceleration and then a constant speed, s."""
    return TRACK / speed + 0.5 * speed / acceleration


def of_hind(
    solution: Solution, joint: int, what: Callable[..., Float[np.ndarray, " N"]]
) -> Float[np.ndarray, " N"]:
    """Something of torque and speed of a hind leg's hip (0) or knee (1) along the
    cycle."""
    cycle = whole_cycle(solution)
    leg = cycle.problem.stride.legs.index(cycle.hind_leg)
    torque = cycle.motion.tau[..., 2 * leg + joint].ravel()
    return what(torque, cycle.motion.v[..., 3 + 3 * leg + joint].ravel())


def reversal(solution: Solution) -> float:
    """When the hind leg that stands first stops swinging back and begins to swing
    forward, in periods since it landed: where its hip's speed falls through zero, the
    steepest time."""
    cycle = whole_cycle(solution)
    speed, time = of_hind(solution, 0, lambda torque, speed: speed), cycle.time.ravel()
    falls = [
        i
        for i in range(len(speed) - 1)
        if speed[i] > 0.0 >= speed[i + 1] and time[i + 1] > time[i]
    ]
    steepest = min(
        falls, key=lambda i: (speed[i + 1] - speed[i]) / (time[i + 1] - time[i])
    )
    part = speed[steepest] / (speed[steepest] - speed[steepest + 1])
    return float(
        (time[steepest] + part * (time[steepest + 1] - time[steepest])) / cycle.period
    )


def hip_heat(solution: Solution) -> float:
    """Mean copper loss of that leg's hip, cold, W."""
    cycle, hardware = whole_cycle(solution), solution.problem.hardware
    squares = of_hind(solution, 0, lambda torque, speed: torque**2)
    stall = stall_torque(
        hardware.joint_peak_torque,
        hardware.joint_corner_speed,
        hardware.joint_no_load_speed,
    )
    mean = float(cycle.weights.ravel() @ squares) / cycle.period
    return float(copper_loss(1.0, hardware.joint_no_load_speed, stall)) * mean


def heating_rate(network: Network, cold_heat: float) -> float:
    """Mean rise of a winding over the paper's 86 s under a constant torque, K/s."""
    temperatures = Temperatures.uniform(AMBIENT, (1,))
    for _ in range(round(bp2.ENDURANCE_TIME / STEP)):
        temperatures = advance(network, temperatures, np.array([cold_heat]), STEP)
    return float(temperatures.winding[0] - AMBIENT) / bp2.ENDURANCE_TIME
