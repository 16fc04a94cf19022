"""Shadow prices: how much a little more of a limit gains a trajectory.

At an optimum x* of   minimise f(x)  subject to  lower(p) <= g(x, p) <= upper(p)   with multipliers lambda

    d f* / dp = lambda^T (dg/dp - d bound/dp),   the bound that holds

to first order, with nothing solved again (the envelope theorem). Where the speed itself
is looked for, f is -speed_weight times the speed, but for a cost that does not matter,
and the same gives what the greatest speed gains. How p enters the cost itself, as the
peak torque does by which torques are divided there, is left out: it is no limit.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from bp2_rl.optimiser.collocation import GREATEST_SPEED, STANDARD, Optimised, optimise
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.program import Bounds
from bp2_rl.optimiser.solution import Solution
from bp2_rl.optimiser.transcription import SolveOptions, transcribe
from bp2_rl.robot.hardware import times

STEP = 1e-4  # relative, of a parameter, to either side
Change = Callable[[Problem, float], Problem]
"""Function that returns a problem with one parameter multiplied by a factor."""


def times_fields(*fields: str, law: Callable[[float, Any], Any] = times) -> Change:
    """Return a change that multiplies the named fields of a problem by a factor, or
    applies another law of factor and value to them."""

    def changed(config: Any, field: str, factor: float) -> Any:
        name, _, inner = field.partition(".")
        value = getattr(config, name)
        return dataclasses.replace(
            config,
            **{name: changed(value, inner, factor) if inner else law(factor, value)},
        )

    return lambda problem, factor: functools.reduce(
        lambda one, field: changed(one, field, factor), fields, problem
    )


LIMIT_CHANGES: dict[str, Change] = {
    "peak torque": times_fields("hardware.peak_torque"),
    "corner speed": times_fields("hardware.corner_speed"),
    "no-load speed": times_fields("hardware.no_load_speed"),
    "joint speed's limit alone": times_fields("speed_margin"),
    "friction": times_fields("hardware.friction"),
    "spring travel": times_fields("hardware.spring_travel"),
    "stops' stiffness": times_fields(
        "hardware.spring_stop_stiffness", "hardware.rebound_stiffness"
    ),
    "spring stiffness": times_fields("hardware.spring_stiffness"),
    "rotor inertia": times_fields("hardware.rotor_inertia"),
    "leg length": times_fields("hardware.body.leg_length"),
    "torque rate": times_fields("torque_rate"),
    "force rate": times_fields("force_rate"),
    "foot clearance": times_fields("clearance"),
    "pitch limit": times_fields("pitch_limit"),
}
"""Changes of limits that a designer or a problem's settings may choose, by name."""

LOSS_CHANGES: dict[str, Change] = {
    "drag area": times_fields("hardware.losses.drag_area"),
    "gear loss": times_fields(
        "hardware.losses.gear_efficiency",
        law=lambda factor, kept: 1.0 - factor * (1.0 - kept),
    ),
    "joint friction": times_fields("hardware.losses.joint_friction"),
    "joint viscosity": times_fields("hardware.losses.joint_viscosity"),
    "slide friction": times_fields("hardware.losses.spring_friction"),
    "bus sag": times_fields("hardware.losses.bus_sag"),
    "bus power": times_fields(
        "hardware.losses.bus_power_out", "hardware.losses.bus_power_in"
    ),
}
"""Changes of a robot's losses, by name."""


@dataclasses.dataclass(frozen=True)
class ShadowPrices:
    """An optimum, and the shadow prices of its problem's parameters."""

    solution: Solution
    # d objective / d ln p, by parameter: in units of cost or, where that is looked for,
    # m/s
    prices: dict[str, float]


def find_shadow_prices(
    start: Solution, changes: Mapping[str, Change], *, greatest: bool = False
) -> ShadowPrices:
    """Find the optimum next to a solution, and the shadow prices of changes of its
    problem.

    Args:
        start: where the search begins; a solution that is at its optimum stays there.
        changes: by name.
        greatest: look for the greatest speed instead of the least cost.

    Raises:
        NotSolved: IPOPT lost it.
    """
    options = GREATEST_SPEED if greatest else STANDARD
    optimised = optimise(start.problem, start.motion, options)
    unit = -1.0 / options.speed_weight if greatest else 1.0
    prices = {
        name: unit * _slope(optimised, change, options)
        for name, change in changes.items()
    }
    return ShadowPrices(optimised.solution, prices)


def _slope(optimised: Optimised, change: Change, options: SolveOptions) -> float:
    """Return d f* / d ln p of the objective, by the multipliers."""
    optimum = optimised.optimum
    sides = []
    for factor in (1.0 - STEP, 1.0 + STEP):
        problem = change(optimised.solution.problem, factor)
        program = transcribe(problem, optimised.solution.motion, options).program
        sides.append(program.conditions(optimum.point))
    less, more = sides
    change_of_f = optimum.constraint_multipliers @ (more.values - less.values)
    change_of_f -= _bound_term(
        optimum.constraint_multipliers, less.constraint_bounds, more.constraint_bounds
    )
    change_of_f -= _bound_term(
        optimum.unknown_multipliers, less.unknown_bounds, more.unknown_bounds
    )
    return float(change_of_f / (2.0 * STEP))


def _bound_term(
    multipliers: Float[np.ndarray, " k"], less: Bounds, more: Bounds
) -> float:
    """Return the bounds' part of the slope: each bound's shift by the multiplier of the
    side that holds."""
    lower, upper = (
        np.subtract(b, a, out=np.zeros_like(a), where=np.isfinite(a))
        for a, b in zip(less, more, strict=True)
    )
    return float(np.sum(multipliers * np.where(multipliers > 0.0, upper, lower)))
