"""The figure of how the paper's numbers depend on assumed parameters, and how far they
determine these.

The Jacobian is of logarithms: a row is a number of the paper over how well it is known,
a column an assumption over half its range. Its singular values say by how many times
their uncertainty the paper's numbers move as a combination of assumptions goes through
half its range. Below one, next to nothing is learned of it.

The rows come from three places: trajectories at one speed, optimised again with each
assumption changed (Fig. 4, and the heat of what they ask of a hip); greatest speeds, by
the multipliers of their programs (`shadow_prices`); closed forms.
"""

import dataclasses
import math
from typing import cast

import numpy as np
from jaxtyping import Float
from matplotlib.colors import SymLogNorm
from matplotlib.figure import Figure
from scipy.optimize import root_scalar

from bp2_rl.base.metric import Table
from bp2_rl.base.plotting import INK, WIDTH, styled
from bp2_rl.evaluation.races import TRACK
from bp2_rl.optimiser.collocation import fastest, solve
from bp2_rl.optimiser.cycle import whole_cycle
from bp2_rl.optimiser.problem import CostWeights, Problem
from bp2_rl.optimiser.solution import Solution
from bp2_rl.paper.figures.drawn import Drawn
from bp2_rl.paper.figures.settings import IdentifiabilityFigureSettings
from bp2_rl.paper.motor_heat import Network, Temperatures, advance
from bp2_rl.paper.thermal_specs import AMBIENT, MotorHeat
from bp2_rl.paper.trajectories.decomposition import decompose, peak_velocity_force
from bp2_rl.paper.trajectories.shadow_prices import (
    LIMIT_CHANGES,
    LOSS_CHANGES,
    Change,
    find_shadow_prices,
    times_fields,
)
from bp2_rl.robot import bp2
from bp2_rl.robot.actuator import copper_loss, stall_torque
from bp2_rl.robot.hardware import BUILT

# --- What had to be assumed, and how far off it may be --------------------------------

F_BAR = CostWeights().force  # N


@dataclasses.dataclass(frozen=True)
class Assumed:
    """A positive parameter that had to be assumed. Its range, what published machines
    or the paper's silence leave, is ASSUMED, too."""

    name: str
    unit: str
    low: float
    value: float
    high: float
    change: Change | None = None  # of a problem; None: of the motors' heat alone
    heat: str = ""  # field of `MotorHeat`

    @property
    def reach(self) -> float:
        """Half of the parameter's range in its logarithm: one unit of the analysis."""
        return 0.5 * math.log(self.high / self.low)


def _foot_radius(problem: Problem, factor: float) -> Problem:
    return dataclasses.replace(problem, foot_radius=factor * bp2.FOOT_RADIUS)


_MOTOR = MotorHeat()
MECHANICAL = (
    Assumed(
        "F bar",
        "N",
        F_BAR,
        F_BAR,
        3.0 * F_BAR,
        times_fields("weights.force"),
    ),
    # the text, and Table S1
    Assumed(
        "peak torque", "Nm", 100.0, bp2.PEAK_TORQUE, 120.0, LIMIT_CHANGES["peak torque"]
    ),
    Assumed(
        "corner speed",
        "rad/s",
        bp2.CORNER_SPEED,
        bp2.CORNER_SPEED,
        18.0,
        LIMIT_CHANGES["corner speed"],
    ),
    Assumed(
        "rotor inertia",
        "kg m2",
        1e-4,
        bp2.ROTOR_INERTIA,
        4e-4,
        LIMIT_CHANGES["rotor inertia"],
    ),
    # for the spring's rest length
    Assumed(
        "leg length", "m", 0.32, bp2.THIGH_LENGTH, 0.38, LIMIT_CHANGES["leg length"]
    ),
    Assumed(
        "spring travel",
        "m",
        0.10,
        bp2.SPRING_TRAVEL,
        0.15,
        LIMIT_CHANGES["spring travel"],
    ),
    Assumed(
        "stops' stiffness",
        "N/m",
        15e3,
        bp2.SPRING_STOP_STIFFNESS,
        60e3,
        LIMIT_CHANGES["stops' stiffness"],
    ),
    Assumed("foot radius", "m", 0.01, bp2.FOOT_RADIUS, 0.04, _foot_radius),
    Assumed("friction", "-", 0.6, bp2.FOOT_FRICTION, 1.2, LIMIT_CHANGES["friction"]),
)
"""Assumptions about the robot's mechanics and about the optimiser's objective."""

LOST = tuple(
    # BP2's joints are alike
    Assumed(name, unit, low, cast(float, value), high, LOSS_CHANGES[name])
    for name, unit, low, value, high in (
        ("drag area", "m2", 0.1, BUILT.losses.drag_area, 0.3),
        ("gear loss", "-", 0.03, 1.0 - BUILT.losses.gear_efficiency, 0.15),
        ("joint friction", "Nm", 1.0, BUILT.losses.joint_friction, 4.0),
        ("joint viscosity", "Nm s/rad", 0.025, BUILT.losses.joint_viscosity, 0.1),
        ("slide friction", "N", 10.0, BUILT.losses.spring_friction, 40.0),
        ("bus sag", "1/kW", 0.00625, BUILT.losses.bus_sag, 0.025),
        ("bus power", "W", 6e3, BUILT.losses.bus_power_out, 10e3),
    )
)
"""Assumptions about a machine's losses, which the paper's analysis leaves out."""

HEAT = tuple(
    Assumed(name, unit, low, value, high, heat=field)
    for name, unit, low, value, high, field in (
        (
            "winding's capacity",
            "J/K",
            50.0,
            _MOTOR.winding_capacity,
            152.0,
            "winding_capacity",
        ),
        # the straightest rise has 1.5 K/W
        ("winding to case", "K/W", 0.5, 1.5, 4.5, "winding_to_case"),
        ("case's capacity", "J/K", 200.0, _MOTOR.case_capacity, 600.0, "case_capacity"),
        ("case to air", "K/W", 0.5, _MOTOR.case_to_air, 2.0, "case_to_air"),
        ("magnets' loss", "1/K", 0.9e-3, _MOTOR.magnet_loss, 1.2e-3, "magnet_loss"),
    )
)
"""Assumptions about the motors' heat."""

ASSUMED = (*MECHANICAL, *LOST, *HEAT)


# --- The paper's numbers --------------------------------------------------------------

SHARE = 0.1  # of a unit, by which an assumption is changed to either side


@dataclasses.dataclass(frozen=True)
class RowNumbers:
    """A number of the paper, our model's value, and the value's slopes over the
    assumptions."""

    name: str
    unit: str
    where: str  # in the paper
    printed: float
    ours: float | None  # None: no model of ours gives it
    uncertainty: float  # relative: rounding and the model's error
    slopes: dict[str, float]  # d ln / d ln, by assumption


PRINTED = tuple(
    RowNumbers(name, unit, where, printed, None, rounding / printed, {})
    # rounding: half a unit of the last digit
    for name, printed, unit, rounding, where in (
        ("main torque", 250.0, "Nm", 5.0, "Fig. 4 B"),
        ("C_z", 1.19, "m g", 0.005, "Fig. 4 A"),
        ("thigh reverses", 0.21, "T", 0.005, "Fig. 4 B"),
        ("lesser power", bp2.HIND_PEAK_POWERS[0], "W", 0.5, "Fig. 5 E"),
        ("greatest power", bp2.HIND_PEAK_POWERS[1], "W", 0.5, "Fig. 5 E"),
        ("belt", bp2.TREADMILL_TOP_SPEED, "m/s", 0.05, "Results"),
        ("outdoors", bp2.OUTDOOR_TOP_SPEED, "m/s", 0.005, "Abstract"),
        ("100 m", bp2.SPRINT_100M_TIME, "s", 0.05, "Abstract"),
        ("launch", bp2.LAUNCH_ACCELERATION, "m/s2", 0.005, "Results"),
        ("heating", bp2.HEATING_RATE, "K/s", 0.05, "Fig. 7"),
    )
)
"""The paper's numbers, without ours."""


@dataclasses.dataclass(frozen=True)
class IdentifiabilityNumbers:
    """All numbers of the figure: slopes over the assumptions, and what is left of their
    ranges."""

    rows: tuple[RowNumbers, ...]
    # combinations of assumptions with a singular value of one or more
    pinned: int
    assumptions: int
    # of each assumption's range, once the paper's numbers are taken into account
    left: dict[str, float]


def identifiability(settings: IdentifiabilityFigureSettings) -> Drawn:
    """Draw and tabulate how far the paper's numbers determine the assumed
    parameters."""
    numbers = identify(settings)
    title = "What is assumed, and what the paper's numbers leave of it"
    head = ("Assumed", "Value", "From", "To", "Unit", "Left of its range")
    lines = [
        (
            one.name,
            *(f"{number:g}" for number in (one.value, one.low, one.high)),
            one.unit,
            f"{numbers.left[one.name]:.0%}",
        )
        for one in ASSUMED
    ]
    table = Table(title, head, lines)
    picture = identifiability_figure(numbers)
    return Drawn(numbers, (table,), {"identifiability": picture})


def identify(settings: IdentifiabilityFigureSettings) -> IdentifiabilityNumbers:
    """Compute the paper's numbers by the model, their slopes over the assumptions, and
    what is left of the ranges."""
    problem = Problem(speed=settings.speed, intervals=settings.intervals)
    cruise = solve(problem)
    ours, slopes = _analysed(cruise)
    for name, speed, gains in _greatest(cruise):
        ours[name], slopes[name] = speed, gains
    ours["greatest power"] = bp2.PEAK_TORQUE * bp2.CORNER_SPEED
    slopes["greatest power"] = {"peak torque": 1.0, "corner speed": 1.0}
    v = bp2.OUTDOOR_TOP_SPEED
    a = bp2.LAUNCH_ACCELERATION
    ours["100 m"] = sprint_time(v, a)
    share = v * (0.5 / a - TRACK / v**2) / ours["100 m"]  # d ln t / d ln v
    slopes["100 m"] = {
        name: share * slope for name, slope in slopes["outdoors"].items()
    }
    slopes["launch"] = {}
    rows = tuple(
        dataclasses.replace(
            printed,
            ours=ours.get(printed.name),
            uncertainty=settings.model_error + printed.uncertainty,
            slopes=slopes[printed.name],
        )
        for printed in PRINTED
    )
    J = jacobian(rows)
    left = map(float, left_of_range(J))
    return IdentifiabilityNumbers(
        rows=rows,
        pinned=int(np.sum(np.linalg.svd(J, compute_uv=False) >= 1.0)),
        assumptions=len(ASSUMED),
        left=dict(zip((one.name for one in ASSUMED), left, strict=True)),
    )


def jacobian(rows: tuple[RowNumbers, ...]) -> Float[np.ndarray, "rows columns"]:
    """Return the slopes times half the assumption's range, over the row's
    uncertainty."""
    return np.array(
        [
            [
                row.slopes.get(one.name, 0.0) * one.reach / row.uncertainty
                for one in ASSUMED
            ]
            for row in rows
        ]
    )


def left_of_range(
    J: Float[np.ndarray, "rows columns"],
) -> Float[np.ndarray, " columns"]:
    """Return each assumption's standard deviation given the rows, in half ranges, all
    being normal; 1 where nothing is learned."""
    return np.sqrt(np.diag(np.linalg.inv(np.eye(J.shape[1]) + J.T @ J)))


# --- The rows -------------------------------------------------------------------------


Slopes = dict[str, dict[str, float]]
"""Slopes d ln number / d ln assumption, by number of the paper and by assumption."""


def _analysed(cruise: Solution) -> tuple[dict[str, float], Slopes]:
    """Return the numbers of Fig. 4 and a hip's heating rate, with their slopes over the
    assumptions."""
    network = Network.from_spec(
        MotorHeat(), next(one.value for one in HEAT if one.heat == "winding_to_case")
    )
    power = root_scalar(
        lambda heat: heating_rate(network, heat) - bp2.HEATING_RATE, bracket=(1.0, 5e3)
    ).root
    base = _figures(cruise)
    cool = hip_heat(cruise)

    def described(problem: Problem) -> dict[str, float]:
        solution = solve(problem, cruise.motion)
        heat = heating_rate(network, power * hip_heat(solution) / cool)
        return _figures(solution) | {"heating": heat}

    def heated(field: str, factor: float) -> dict[str, float]:
        changed = {field: factor * getattr(network, field)}
        return {"heating": heating_rate(network.replace(**changed), power)}

    slopes: Slopes = {name: {} for name in (*base, "heating")}
    for one in (*MECHANICAL, *HEAT):
        h = SHARE * one.reach
        low, high = (
            heated(one.heat, math.exp(side))
            if one.change is None
            else described(one.change(cruise.problem, math.exp(side)))
            for side in (-h, h)
        )
        for name in low:
            slopes[name][one.name] = math.log(high[name] / low[name]) / (2.0 * h)
    # Slopes are of a heat that is scaled to the paper's rate; what is ours is not.
    return base | {"heating": heating_rate(network, cool)}, slopes


def _greatest(cruise: Solution) -> list[tuple[str, float, dict[str, float]]]:
    """Return the built robot's greatest speeds on the belt (no air) and outdoors, m/s,
    with their slopes d ln v / d ln p."""
    start = fastest(cruise)
    found = []
    for name, hardware in (
        (
            "belt",
            dataclasses.replace(
                BUILT, losses=dataclasses.replace(BUILT.losses, drag_area=0.0)
            ),
        ),
        ("outdoors", BUILT),
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
    """Return a trajectory's values of the torque, force, instant and power that the
    paper's Figs. 4 and 5 print."""
    terms = decompose(solution)
    hips = [terms.along("main inertial", f"{leg} hip") for leg in terms.legs]
    return {
        "main torque": float(max(np.max(np.abs(hip)) for hip in hips)),
        "C_z": peak_velocity_force(terms),
        "thigh reverses": reversal(solution),
        "lesser power": min(
            float(np.max(np.multiply(*hind_motor(solution, joint)))) for joint in (0, 1)
        ),
    }


# --- Numbers that are read off a trajectory or a law ----------------------------------


STEP = 1.0  # s, of the motor's heat


def sprint_time(speed: float, acceleration: float) -> float:
    """Return the time over 100 m, s, at a constant acceleration and then a constant
    speed."""
    return TRACK / speed + 0.5 * speed / acceleration


def hind_motor(
    solution: Solution, joint: int
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Return torque, Nm, and speed, rad/s, of a hind leg's hip (0) or knee (1) along
    the cycle."""
    cycle = whole_cycle(solution)
    leg = cycle.problem.stride.legs.index(cycle.hind_leg)
    torque = cycle.motion.tau[..., 2 * leg + joint].ravel()
    return torque, cycle.motion.v[..., 3 + 3 * leg + joint].ravel()


def reversal(solution: Solution) -> float:
    """Return when the hind leg that stands first begins to swing forward, in periods
    since it landed: where its hip's speed falls through zero most steeply."""
    cycle = whole_cycle(solution)
    _, speed = hind_motor(solution, 0)
    time = cycle.time.ravel()
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
    """Return the mean copper loss of the cold hip motor of the hind leg that stands
    first, W."""
    cycle = whole_cycle(solution)
    hardware = solution.problem.hardware
    torque, _ = hind_motor(solution, 0)
    stall = stall_torque(
        hardware.joint_peak_torque,
        hardware.joint_corner_speed,
        hardware.joint_no_load_speed,
    )
    mean = float(cycle.weights.ravel() @ torque**2) / cycle.period
    return float(copper_loss(1.0, hardware.joint_no_load_speed, stall)) * mean


def heating_rate(network: Network, cold_heat: float) -> float:
    """Return the mean rise of a winding over the paper's 86 s under a constant torque,
    K/s."""
    temperatures = Temperatures.uniform(AMBIENT, (1,))
    for _ in range(round(bp2.ENDURANCE_TIME / STEP)):
        temperatures = advance(network, temperatures, np.array([cold_heat]), STEP)
    return float(temperatures.winding[0] - AMBIENT) / bp2.ENDURANCE_TIME


# --- The figure -----------------------------------------------------------------------

LINEAR = 0.1  # units: below, the map's colours are linear


@styled
def identifiability_figure(numbers: IdentifiabilityNumbers) -> Figure:
    """Draw the scaled slopes of the paper's numbers over the assumptions, as a
    matrix."""
    figure = Figure(figsize=(1.3 * WIDTH, 5.2), layout="constrained")
    axes = figure.subplots()
    J = jacobian(numbers.rows)
    top = float(np.max(np.abs(J)))
    image = axes.imshow(
        J, cmap="PuOr", norm=SymLogNorm(LINEAR, vmin=-top, vmax=top), aspect="auto"
    )
    for (i, j), value in np.ndenumerate(J):
        if abs(value) >= LINEAR:
            color = "white" if abs(value) > 3.0 else INK
            text = axes.text(j, i, f"{value:.2g}", ha="center", va="center")
            text.set(fontsize=7.5, color=color)
    columns = [one.name for one in ASSUMED]
    axes.set_xticks(range(len(columns)), columns, rotation=40, ha="right")
    rows = [f"{row.name}, {row.printed:g} {row.unit}" for row in numbers.rows]
    axes.set_yticks(range(len(rows)), rows)
    axes.grid(visible=False)
    axes.set_title(
        "What half an assumption's range does to a number of the paper, in its uncertainties"
    )
    figure.colorbar(image, ax=axes, pad=0.01, ticks=[-10, -1, 0, 1, 10])
    return figure
