"""Solve trajectory problems: a problem is transcribed by direct collocation, and IPOPT
solves the nonlinear program."""

import contextlib
import io
import sys
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bp2_rl.base.errors import UserError
from bp2_rl.optimiser.links import hip_and_knee, hip_of, leg_of
from bp2_rl.optimiser.problem import TRUNK, Problem, Stride
from bp2_rl.optimiser.program import Optimum
from bp2_rl.optimiser.sagittal import DESIGN_PARAMETERS, ca
from bp2_rl.optimiser.solution import Motion, NotSolved, Solution, resample
from bp2_rl.optimiser.transcription import SolveOptions, Transcription, transcribe
from bp2_rl.robot import conventions

# what CasADi makes of Ctrl-C within IPOPT
INTERRUPTED = ("NonIpopt_Exception_Thrown", "User_Requested_Stop")
STANDARD = SolveOptions()
GREATEST_SPEED = SolveOptions(speed_weight=100.0)
"""Options with which a solve looks for the greatest speed: the cost hardly matters
beside it."""


class Optimised(NamedTuple):
    """A solution, the program that it solves, and that program's multipliers."""

    solution: Solution
    transcription: Transcription
    optimum: Optimum


def solve(
    problem: Problem, start: Motion | None = None, options: SolveOptions = STANDARD
) -> Solution:
    """Solve a trajectory problem with IPOPT, from the guess `start`, and return the
    solution.

    Args:
        problem: what is asked for.
        start: a guess on the problem's own mesh; None for the cold one.
        options: what is asked for beside the problem, such as a free speed.

    Raises:
        NotSolved: IPOPT stopped anywhere but at a point that satisfies its tolerances.
        UserError: this CasADi has no IPOPT.
    """
    return optimise(problem, start, options).solution


def optimise(
    problem: Problem, start: Motion | None = None, options: SolveOptions = STANDARD
) -> Optimised:
    """Solve a trajectory problem as `solve` does, and return the nonlinear program and
    its multipliers as well."""
    if not ca.has_nlpsol("ipopt"):
        raise UserError(
            "this build of CasADi has no IPOPT: pip install --force-reinstall casadi"
        )
    began = time.perf_counter()
    transcription = transcribe(
        problem, cold_guess(problem) if start is None else start, options
    )
    with contextlib.redirect_stderr(io.StringIO()) as errors:
        optimum = transcription.program.solve(
            options.time_limit, options.perhaps_infeasible
        )
    stats = optimum.statistics
    if stats["return_status"] in INTERRUPTED:  # of which CasADi warns
        raise KeyboardInterrupt
    sys.stderr.write(errors.getvalue())
    if not stats["success"]:
        how = stats["return_status"].replace("_", " ").lower()
        raise NotSolved(
            f"no trajectory at {problem.speed:g} m/s: IPOPT ended with '{how}'; lower the speed, relax a "
            "limit, or start from a solution nearby"
        )
    found = transcription.design, transcription.speed, transcription.cost
    design, speed, cost = transcription.program.values(found, optimum.point)
    hardware = {
        name: float(value)
        for name, value in zip(DESIGN_PARAMETERS, design[0], strict=True)
        if name in options.free
    }
    solution = Solution(
        problem=problem.on(**hardware).at(
            speed.item() if options.speed_weight > 0.0 else problem.speed
        ),
        motion=transcription.motion(optimum.point),
        cost=cost.item(),
        violation=optimum.violation,
        iterations=stats["iter_count"],
        seconds=time.perf_counter() - began,
    )
    return Optimised(solution, transcription, optimum)


def solve_best(
    problem: Problem,
    starts: int = 3,
    near: Sequence[Solution] = (),
    time_limit: float = STANDARD.time_limit,
) -> Solution:
    """Return the cheapest of several solves: from the cold guess, `starts - 1` varied
    ones, and other solutions.

    Each may take `time_limit` seconds.

    Raises:
        NotSolved: none of them succeeded; the message is the cold guess's.
    """
    if starts < 1 and not near:
        raise UserError(f"starts must be at least 1, got {starts}")
    guesses = [cold_guess(problem, seed=seed or None) for seed in range(starts)]
    guesses += [resample(other.problem, other.motion, problem) for other in near]
    solved, failures = [], []
    for guess in guesses:
        try:
            solved.append(solve(problem, guess, SolveOptions(time_limit=time_limit)))
        except NotSolved as failure:
            failures.append(failure)
    if not solved:
        raise failures[0]
    return min(solved, key=lambda solution: solution.cost)


def fastest(start: Solution) -> Solution:
    """Return a trajectory of the greatest speed that the robot and gait of the solution
    `start` can run.

    The speed is a local optimum, as the cost of every solution is.

    Raises:
        NotSolved: IPOPT did not find one.
    """
    return solve(start.problem, start.motion, GREATEST_SPEED)


def refine(
    solution: Solution, intervals: int, options: SolveOptions = STANDARD
) -> Solution:
    """Solve the problem of `solution` on another mesh, starting from `solution`.

    Raises:
        NotSolved: IPOPT found no trajectory on the new mesh.
    """
    problem = solution.problem.on_mesh(intervals)
    return solve(problem, resample(solution.problem, solution.motion, problem), options)


# --- A guess where there is no solution yet --------------------------------------------


def cold_guess(problem: Problem, seed: int | None = None) -> Motion:
    """Return a guess with constant trunk speed, feet on arcs and half-sine forces; a
    seed varies all of these."""
    vary = (
        (lambda low, high: 1.0) if seed is None else np.random.default_rng(seed).uniform
    )
    stride = problem.stride
    speed = problem.speed
    size = problem.hardware.size
    anatomy = problem.hardware.anatomy
    stance = vary(0.8, 1.25) * min(0.6 * size.length / speed, 0.25 * size.time)
    flight = vary(0.8, 1.25) * 0.12 * size.time * speed / (speed + 2.0 * size.speed)
    height = vary(0.95, 1.05) * 1.42 * anatomy.leg_length
    lift = vary(0.7, 1.5) * 0.12 * size.length
    durations = np.array([stance if feet else flight for feet in stride.standing])
    starts = np.concatenate([[0.0], np.cumsum(durations)])
    cycle = starts[-1] / stride.cycles
    mean_force = (
        problem.hardware.mass_scale
        * anatomy.mass
        / 4.0
        * conventions.GRAVITY
        * cycle
        / stance
    )

    q = np.zeros((len(durations), len(problem.points), stride.nq))
    force = np.zeros((*q.shape[:2], 2 * len(stride.legs)))
    for i, feet in enumerate(stride.standing):
        t = starts[i] + durations[i] * problem.points
        q[i, :, 0], q[i, :, 1] = speed * t, height
        for index, name in enumerate(stride.legs):
            leg = leg_of(anatomy, name)
            since = (
                t - starts[i]
                if name in feet
                else (t - _landing(stride, name, starts)) % cycle
            )
            s = np.clip((since - stance) / (cycle - stance), 0.0, 1.0)
            back = np.minimum(since, stance) - stance / 2.0
            x = speed * (stance * s**2 * (3.0 - 2.0 * s) - back)
            z = 16.0 * lift * (s * (1.0 - s)) ** 2 - height - hip_of(leg)[1]
            pulse = (
                np.sin(np.pi * since / stance) if name in feet else np.zeros_like(since)
            )
            force[i, :, 2 * index + 1] = np.pi / 2.0 * mean_force * pulse
            block, lower = TRUNK + stride.per_leg * index, leg.lower_length
            if anatomy.sprung:
                most = 0.4 * anatomy.leg_length
                q[i, :, block + 2] = np.clip(
                    force[i, :, 2 * index + 1] / problem.hardware.spring_stiffness,
                    0.0,
                    most,
                )
                lower = lower - q[i, :, block + 2]
            q[i, :, block], q[i, :, block + 1] = hip_and_knee(
                x, z, leg.thigh_length, lower, leg.bend
            )
    v = np.stack(
        [
            np.gradient(x, T * problem.points, axis=0)
            for x, T in zip(q, durations, strict=True)
        ]
    )
    nothing = np.zeros_like(force)
    return Motion(durations, q, v, np.zeros_like(v), nothing, force, nothing[:, 0])


def _landing(stride: Stride, leg: str, starts: Float[np.ndarray, " edges"]) -> float:
    """Time of a leg's first touchdown, s; in the next stride if it does not stand in
    this one."""
    for i in range(len(stride.standing)):
        if leg in stride.standing[i]:
            return float(starts[i])
    return float(starts[-1]) + _landing(
        stride, stride.then[stride.legs.index(leg)], starts
    )
