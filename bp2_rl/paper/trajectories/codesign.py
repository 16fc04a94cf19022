"""Hardware and trajectory found together (paper, "Co-optimization of Hardware and
Trajectory").

The motors stay; gear ratio, leg length and spring stiffness become unknowns of the
trajectory's program. A program as this one has many local optima, so each is sought
from several starts.
"""

import contextlib
import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterable, Iterator
from typing import Annotated, Any

import numpy as np

from bp2_rl.base.bounds import POSITIVE, Bounded, Range
from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import metric
from bp2_rl.base.processes import spawned
from bp2_rl.optimiser.problem import (
    CostWeights,
    Intervals,
    Problem,
    Starts,
)
from bp2_rl.optimiser.solution import NotSolved, Solution
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.hardware import IDEAL

TIME_LIMIT = 20.0  # s an interval: several times what a solution takes
PositiveRange = Annotated[Range, POSITIVE]


@dataclasses.dataclass(frozen=True)
class DesignBounds(Bounded, path="bounds."):
    """Least and greatest values of the design parameters; the shortest leg holds shank,
    toe and the spring's travel."""

    gear_ratio: PositiveRange = (5.0, 14.0)
    # m; see CodesignSettings
    leg_length: PositiveRange = (0.29, bp2.HIP_FORE_AFT)
    spring_stiffness: PositiveRange = (2500.0, 15000.0)  # N/m

    def __post_init__(self) -> None:
        """Refuse bounds out of order, and a design that cannot be built."""
        super().__post_init__()
        for name, (low, high) in vars(self).items():
            for value, ends in ((low, "begins too low"), (high, "ends too high")):
                try:
                    IDEAL.changed(**{name: value})
                except UserError as error:
                    raise UserError(f"bounds.{name} {ends}: {error}") from error


@dataclasses.dataclass(frozen=True)
class CodesignSettings(Bounded):
    """Settings of the co-design: the problem, the bounds of its design parameters, and
    the effort.

    Cost and dynamics alone do not decide the design: a leg weighs nothing more for
    being longer, long legs move their joints slower, and slow joints allow any gear.
    Unbounded, length and gear run away together, to 0.45 m and 14. What holds them here
    is stated, and ASSUMED:

    - Leg length up to 0.35 m, half the distance between the hips: then a fore and a
      hind thigh cannot meet. The length found is this bound; at BP2's gear legs of 0.37
      to 0.42 m are cheaper by 2 %.
    - Joint speeds up to 0.6 of the no-load speed. The same motors run 13.2 m/s, and do
      so on a battery that may sag to 0.8 of its voltage: 10 / 13.2 x 0.8 = 0.61. This
      margin sets the gear, all but in proportion: 7.2 for 0.5, 8.5 for 0.6, 9.2 for
      0.65, 11.2 for 0.8, 13.7 for 1.
    - F bar of three body weights, the largest force of a foot at 10 m/s; so forces,
      like torques, are shares of their greatest. It sets the stiffness: 3.6, 4.7, 6.1
      and 6.1 kN/m for 1, 2, 3 and 4 body weights.
    """

    problem: Problem = Problem(
        intervals=8,
        speed_margin=0.6,
        weights=CostWeights(force=round(3.0 * bp2.TOTAL_MASS * conventions.GRAVITY)),
    )
    bounds: DesignBounds = DesignBounds()
    starts: Starts = 4  # of the optimum
    # on which the optimum is solved again, one after another
    confirm: tuple[Intervals, ...] = (16, 24, 32, 48)


@dataclasses.dataclass(frozen=True)
class DesignRow:
    """The optimal design on one mesh, and its gait."""

    intervals: int = metric("Intervals", form="d")  # of each segment of the mesh
    gear_ratio: float = metric("Gear")
    leg_length: float = metric("Length", "m", ".3f")
    spring_stiffness: float = metric("Stiffness", "N/m", ".0f")
    cost: float = metric("Cost", form=".4f")
    period: float = metric("Period", "s", ".3f")
    duty: float = metric("Duty", form=".3f")
    peak_torque: float = metric("Torque", "Nm", ".1f")  # of the joints
    peak_speed: float = metric("Speed", "rad/s", ".1f")
    # of the no-load speed behind this gear
    speed_share: float = metric("Of top", form=".0%")


@dataclasses.dataclass(frozen=True)
class Codesign:
    """The optimal designs on finer and finer meshes."""

    settings: CodesignSettings
    meshes: tuple[DesignRow, ...]


def optimise_design(
    settings: CodesignSettings, workers: int = 1
) -> Iterator[DesignRow]:
    """Yield the cheapest design from all starts on the mesh of `settings.problem`, and
    then on the meshes of `settings.confirm`, each solved from the last.

    Raises:
        NotSolved: no start led to a trajectory, or a mesh lost it.
    """
    from bp2_rl.optimiser.collocation import refine  # CasADi
    from bp2_rl.optimiser.transcription import SolveOptions

    seeds = range(settings.starts)
    found = solve_all(find_design, itertools.repeat(settings), seeds, workers=workers)
    best = min(filter(None, found), key=lambda solution: solution.cost, default=None)
    if best is None:
        raise NotSolved(
            f"no design for {settings.problem.speed:g} m/s from {settings.starts} starts"
        )
    yield describe_design(best)
    for intervals in settings.confirm:
        limit = TIME_LIMIT * intervals
        options = SolveOptions(free=vars(settings.bounds), time_limit=limit)
        best = refine(best, intervals, options)
        yield describe_design(best)


def solve_all(
    solve: Callable[..., Solution], *arguments: Iterable[Any], workers: int
) -> list[Solution | None]:
    """Return what `solve` finds for each of its arguments, in `workers` processes, or
    in this process if `workers` is 1; None where there is no trajectory."""
    attempt = functools.partial(_attempt, solve)
    with contextlib.ExitStack() as stack:
        run = map if workers == 1 else stack.enter_context(spawned(workers)).map
        return list(run(attempt, *arguments))


def _attempt(solve: Callable[..., Solution], *arguments: Any) -> Solution | None:
    with contextlib.suppress(NotSolved):
        return solve(*arguments)


def find_design(settings: CodesignSettings, seed: int) -> Solution:
    """Return the design found from one start: BP2 and the cold guess, or for a positive
    seed a design drawn from within the bounds and a varied guess.

    Raises:
        NotSolved: the start led to no trajectory.
    """
    # CasADi only where something is solved
    from bp2_rl.optimiser.collocation import cold_guess, solve
    from bp2_rl.optimiser.transcription import SolveOptions

    problem = start_problem(settings, seed)
    guess = cold_guess(problem, seed=seed or None)
    limit = TIME_LIMIT * problem.intervals
    return solve(
        problem, guess, SolveOptions(free=vars(settings.bounds), time_limit=limit)
    )


def start_problem(settings: CodesignSettings, seed: int) -> Problem:
    """Return the problem of the start `seed`; a positive seed draws its design."""
    if seed == 0:
        return settings.problem
    draw = np.random.default_rng(seed).uniform
    bounds = vars(settings.bounds).items()
    return settings.problem.on(**{name: float(draw(*ends)) for name, ends in bounds})


def describe_design(best: Solution) -> DesignRow:
    """Return the design and the gait of a solution."""
    hardware, motors = best.problem.hardware, best.problem.stride.motors
    speed = float(np.max(np.abs(best.motion.v[..., motors])))
    return DesignRow(
        intervals=best.problem.intervals,
        **{name: float(hardware.parameter(name)) for name in vars(DesignBounds())},
        cost=best.cost,
        period=best.period,
        duty=best.duty,
        peak_torque=float(np.max(np.abs(best.motion.tau))),
        peak_speed=speed,
        speed_share=speed / hardware.joint_no_load_speed,
    )
