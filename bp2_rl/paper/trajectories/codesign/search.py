"""The best design: hardware and trajectory found together, from several starts."""

import dataclasses
import functools
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from bp2_rl.optimiser.problem import motor_coordinates
from bp2_rl.optimiser.solution import NotSolved, Solution
from bp2_rl.paper.trajectories.codesign.chain import Chain, read_solution, solve_chains
from bp2_rl.paper.trajectories.codesign.settings import PARAMETERS, CodesignSettings


@dataclasses.dataclass(frozen=True)
class DesignRow:
    """The cheapest trajectory under one setting."""

    case: str
    gear_ratio: float
    leg_length: float  # m
    spring_stiffness: float  # N/m
    cost: float
    period: float  # s
    duty: float
    peak_torque: float  # Nm, of the joints
    peak_speed: float  # rad/s
    speed_share: float  # of the no-load speed behind this gear
    at_bounds: tuple[str, ...]  # free parameters that a bound holds
    # of the costs from all starts that were solved: dearest over cheapest, less 1
    spread: float
    solved: int  # starts from which there was a trajectory
    starts: int


def find_designs(
    settings: CodesignSettings, folder: Path, workers: int = 1
) -> list[tuple[Chain, Solution]]:
    """The optima from every start, cheapest first, on the mesh of `settings.problem`.

    The first start is BP2 and the cold guess; the others have designs drawn from within
    the bounds, and varied guesses.

    Raises:
        NotSolved: no start led to a trajectory.
    """
    chains = [start_chain(settings, seed) for seed in range(settings.starts)]
    solve_chains(chains, folder, workers, "designs")
    found = _solved(chains, folder)
    if not found:
        raise NotSolved(
            f"no design for {settings.problem.speed:g} m/s from {settings.starts} starts"
        )
    return found


def optimise_design(
    settings: CodesignSettings, folder: Path, workers: int = 1
) -> Chain:
    """Solve the cheapest of `find_designs` again on the meshes of `settings.confirm`,
    and return the whole chain.

    The parameters stay free.

    Raises:
        NotSolved: no start led to a trajectory, or the finest mesh lost it.
    """
    chain, _ = find_designs(settings, folder, workers)[0]
    chain = functools.reduce(
        Chain.then, (settings.problem.on_mesh(n) for n in settings.confirm), chain
    )
    solve_chains([chain], folder, workers, "finer meshes")
    if read_solution(chain, folder) is None:
        raise NotSolved(
            f"the design was lost on {chain.problems[-1].intervals} intervals"
        )
    return chain


def start_chain(settings: CodesignSettings, seed: int) -> Chain:
    """The free problem by itself, from a start of its own for each seed."""
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


def _solved(chains: Iterable[Chain], folder: Path) -> list[tuple[Chain, Solution]]:
    """The chains that ended in a solution, cheapest first."""
    ends = [(chain, read_solution(chain, folder)) for chain in chains]
    return sorted(
        ((chain, end) for chain, end in ends if end is not None),
        key=lambda pair: pair[1].cost,
    )


def cheapest(
    ways: Iterable[tuple[str, Sequence[Chain]]], folder: Path
) -> tuple[DesignRow, ...]:
    """Return a row of the cheapest of each case's ways to its problem, as read from
    `folder`.

    A case that no way has solved has no row.
    """
    ends = [(case, _solved(chains, folder), len(chains)) for case, chains in ways]
    return tuple(_row(case, found, starts) for case, found, starts in ends if found)


def _row(case: str, found: Sequence[tuple[Chain, Solution]], starts: int) -> DesignRow:
    """Return the row of the first of several solutions, which are in the order of their
    costs."""
    chain, best = found[0]
    hardware, motors = (
        best.problem.hardware,
        motor_coordinates(best.problem.stride.legs),
    )
    speed = float(np.max(np.abs(best.motion.v[..., motors])))
    return DesignRow(
        case=case,
        **{name: float(hardware.parameter(name)) for name in PARAMETERS},
        cost=best.cost,
        period=best.period,
        duty=best.duty,
        peak_torque=float(np.max(np.abs(best.motion.tau))),
        peak_speed=speed,
        speed_share=speed / hardware.joint_no_load_speed,
        at_bounds=chain.bounds.touched(hardware, chain.free),
        spread=found[-1][1].cost / best.cost - 1.0,
        solved=len(found),
        starts=starts,
    )
