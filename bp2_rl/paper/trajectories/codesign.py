"""Hardware and trajectory found together (paper, "Co-optimization of Hardware and
Trajectory").

The motors stay; gear ratio, leg length and spring stiffness become unknowns of the
trajectory's program. A program as this one has many local optima, so each is sought
from several starts.

Everything is a chain of problems, each started from the last one's solution. What is
solved is kept in a folder under the hash of its chain, so whatever was interrupted goes
on where it stood.
"""

import contextlib
import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from bp2_rl.base.bounds import Bounded
from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import metric
from bp2_rl.base.processes import spawned
from bp2_rl.base.serialization import config_hash
from bp2_rl.optimiser.problem import (
    CostWeights,
    Intervals,
    Problem,
    Starts,
)
from bp2_rl.optimiser.solution import (
    NotSolved,
    Solution,
    is_saved,
    load_solution,
    resample,
    save_solution,
)
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.hardware import IDEAL

Parameter = Literal["gear_ratio", "leg_length", "spring_stiffness"]
PARAMETERS: tuple[Parameter, ...] = get_args(Parameter)


@dataclasses.dataclass(frozen=True)
class DesignBounds:
    """Least and greatest values of the design parameters; the shortest leg holds shank,
    toe and the spring's travel."""

    gear_ratio: tuple[float, float] = (5.0, 14.0)
    # m; see CodesignSettings
    leg_length: tuple[float, float] = (0.29, bp2.HIP_FORE_AFT)
    spring_stiffness: tuple[float, float] = (2500.0, 15000.0)  # N/m

    def __post_init__(self) -> None:
        """Refuse bounds between which there is no design, or one that cannot be
        built."""
        for name in PARAMETERS:
            low, high = getattr(self, name)
            if not (math.isfinite(low) and math.isfinite(high) and 0.0 < low < high):
                raise UserError(
                    f"bounds.{name} must be two numbers with 0 < low < high, got {low:g} and {high:g}"
                )
            for value, ends in ((low, "begins too low"), (high, "ends too high")):
                try:
                    IDEAL.changed(**{name: value})
                except UserError as error:
                    raise UserError(f"bounds.{name} {ends}: {error}") from error

    def of(self, names: Iterable[Parameter]) -> dict[str, tuple[float, float]]:
        """Return the bounds of the named design parameters."""
        return {name: getattr(self, name) for name in names}


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


# --- Problems that are solved one after another ----------------------------------------

TIME_LIMIT = 20.0  # s an interval: several times what a solution takes


@dataclasses.dataclass(frozen=True)
class Chain:
    """Problems solved one after another, each from the last solution; the first from a
    cold guess.

    Free parameters are found within `bounds`, starting from the last solution's, or
    else from the problem's own.
    """

    problems: tuple[Problem, ...]
    free: tuple[Parameter, ...]
    bounds: DesignBounds
    seed: int = 0  # of the cold guess; 0 is the one that is not varied

    def then(self, problem: Problem) -> "Chain":
        """Return the chain with one more problem."""
        return dataclasses.replace(self, problems=(*self.problems, problem))

    @property
    def parts(self) -> list["Chain"]:
        """All chains that end with the first problem, with the second, and so on."""
        return [
            dataclasses.replace(self, problems=self.problems[: i + 1])
            for i in range(len(self.problems))
        ]


def solve_chain(chain: Chain, folder: Path) -> Solution | None:
    """Solve the problems of a chain, keep their solutions in `folder`, and return the
    last one's; None if IPOPT failed.

    A solution in the folder is not sought again. A problem that cannot be solved is
    passed over: the next one starts from the last solution before it.
    """
    last = solution = None
    for part in chain.parts:
        solution = keep_best(
            _path(part, folder),
            [lambda part=part, last=last: _solve_end(part, last)],
            lambda solution: -solution.cost,
        )
        last = solution or last
    return solution


def read_solution(chain: Chain, folder: Path) -> Solution | None:
    """Read what `solve_chain` stored of a chain's last problem; None where IPOPT
    failed."""
    path = _path(chain, folder)
    return load_solution(path) if is_saved(path) else None


def solve_chains(chains: Sequence[Chain], folder: Path, workers: int) -> None:
    """Solve the chains that are not in `folder` yet in `workers` processes, or in this
    process if `workers` is 1."""
    with contextlib.ExitStack() as stack:
        run = map if workers == 1 else stack.enter_context(spawned(workers)).map
        for done, _ in enumerate(run(solve_chain, chains, itertools.repeat(folder))):
            print(f"solved {done + 1} of {len(chains)}", flush=True)


def _solve_end(chain: Chain, start: Solution | None) -> Solution:
    """Solve a chain's last problem from a solution, or else from a cold guess."""
    # CasADi only where something is solved
    from bp2_rl.optimiser.collocation import cold_guess, solve
    from bp2_rl.optimiser.transcription import SolveOptions

    problem = chain.problems[-1]
    if start is None:
        guess = cold_guess(problem, seed=chain.seed or None)
    else:
        problem = problem.on(
            **{name: start.problem.hardware.parameter(name) for name in chain.free}
        )
        guess = resample(start.problem, start.motion, problem)
    options = SolveOptions(
        free=chain.bounds.of(chain.free), time_limit=TIME_LIMIT * problem.intervals
    )
    return solve(problem, guess, options)


def keep_best(
    path: Path,
    tries: Sequence[Callable[[], Solution]],
    worth: Callable[[Solution], float],
) -> Solution | None:
    """Return the solution stored at `path`, or else the best of all `tries` by `worth`,
    which is then stored."""
    if is_saved(path):
        return load_solution(path)
    found: list[Solution] = []
    for solve_it in tries:
        with contextlib.suppress(NotSolved):
            found.append(solve_it())
    best = max(found, key=worth, default=None)
    if best is not None:
        save_solution(path, best)
    return best


def _path(chain: Chain, folder: Path) -> Path:
    return folder / "solutions" / config_hash(chain)


# --- The best design, from several starts ----------------------------------------------


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


def find_designs(
    settings: CodesignSettings, folder: Path, workers: int = 1
) -> list[tuple[Chain, Solution]]:
    """Return the optimal designs from every start, cheapest first, on the mesh of
    `settings.problem`.

    The first start is BP2 and the cold guess; the others have designs drawn from within
    the bounds, and varied guesses.

    Raises:
        NotSolved: no start led to a trajectory.
    """
    chains = [start_chain(settings, seed) for seed in range(settings.starts)]
    solve_chains(chains, folder, workers)
    ends = [(chain, read_solution(chain, folder)) for chain in chains]
    found = [(chain, end) for chain, end in ends if end is not None]
    if not found:
        raise NotSolved(
            f"no design for {settings.problem.speed:g} m/s from {settings.starts} starts"
        )
    return sorted(found, key=lambda pair: pair[1].cost)


def optimise_design(
    settings: CodesignSettings, folder: Path, workers: int = 1
) -> tuple[DesignRow, ...]:
    """Solve the cheapest of `find_designs` again on the meshes of `settings.confirm`,
    the parameters still free, and return the design on each mesh.

    Raises:
        NotSolved: no start led to a trajectory, or the finest mesh lost it.
    """
    chain, _ = find_designs(settings, folder, workers)[0]
    meshes = (settings.problem.on_mesh(n) for n in settings.confirm)
    chain = functools.reduce(Chain.then, meshes, chain)
    solve_chains([chain], folder, workers)
    ends = [read_solution(part, folder) for part in chain.parts]
    if ends[-1] is None:
        raise NotSolved(
            f"the design was lost on {chain.problems[-1].intervals} intervals"
        )
    return tuple(describe_design(end) for end in ends if end is not None)


def start_chain(settings: CodesignSettings, seed: int) -> Chain:
    """Return a chain of the co-design problem alone, from a start drawn by `seed`."""
    problem = settings.problem
    if seed > 0:
        draw = np.random.default_rng(seed).uniform
        problem = problem.on(
            **{
                name: float(draw(*bounds))
                for name, bounds in settings.bounds.of(PARAMETERS).items()
            }
        )
    return Chain((problem,), PARAMETERS, settings.bounds, seed)


def describe_design(best: Solution) -> DesignRow:
    """Return the design and the gait of a solution."""
    hardware, motors = best.problem.hardware, best.problem.stride.motors
    speed = float(np.max(np.abs(best.motion.v[..., motors])))
    return DesignRow(
        intervals=best.problem.intervals,
        **{name: float(hardware.parameter(name)) for name in PARAMETERS},
        cost=best.cost,
        period=best.period,
        duty=best.duty,
        peak_torque=float(np.max(np.abs(best.motion.tau))),
        peak_speed=speed,
        speed_share=speed / hardware.joint_no_load_speed,
    )
