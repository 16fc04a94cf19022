"""Periodic running as a nonlinear program: direct collocation of the sagittal model, solved with IPOPT (paper, Eqs.
obj_func, R, Physical Constraints, Motion Constraints and other constraints).

A stride is a sequence of segments, each with its own feet on the ground and a free duration. At every point of a
segment the unknowns are q, v, a, tau and the forces F of the standing feet. The equations of motion hold there as
inverse dynamics, and the scheme ties the points of an interval together:

    hermite-simpson   points at both ends and in the middle; q and v are cubic, each by its own derivative
    trapezoid         points at the ends; q and v by the trapezoidal rule
    paper             points at the ends; v by the explicit Euler rule, q by the trapezoidal rule

A standing foot lands at height zero and with velocity zero, and its acceleration is zero at every point. Beyond the
paper's constraints, forces vanish at lift-off, torques do not jump between segments, and a swinging foot clears a
bump of height `clearance`; a problem's `form` may ask for more. As in the paper, every segment counts alike in the
cost, however long it is; within one, the sum over nodes is a quadrature, so that the cost does not drift with the mesh.
"""

import math
import time
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bp2_rl.base.errors import UserError
from bp2_rl.base.polynomials import hermite_and_rate, parabola
from bp2_rl.optimiser import sagittal
from bp2_rl.optimiser.guess import cold_guess
from bp2_rl.optimiser.problem import Problem, Scheme, Stride, contact_rows, motor_coordinates
from bp2_rl.optimiser.program import Optimum, Program
from bp2_rl.optimiser.sagittal import DESIGN, ca
from bp2_rl.optimiser.solution import Motion, NotSolved, Solution, resample
from bp2_rl.robot import specs
from bp2_rl.robot.actuator import copper_loss, stall_torque
from bp2_rl.robot.specs import HardwareSpec

# What a quantity is divided by inside the program.
TIME, POSITION, VELOCITY, ACCELERATION, TORQUE, FORCE, IMPULSE = 0.1, 1.0, 10.0, 1000.0, 100.0, 500.0, 10.0
POWER = 1000.0
SHORTEST, LONGEST = 0.005, 0.6  # s, of a segment
INTERRUPTED = ("NonIpopt_Exception_Thrown", "User_Requested_Stop")  # what CasADi makes of Ctrl-C within IPOPT
RANGES = "hip range", "knee range", "spring range"  # what a leg's coordinates are within
HASTE = 100.0  # units of cost for 1 m/s, where the greatest speed is looked for
SLACK = 0.03  # m, by which a spring may press into its stops


class Optimised(NamedTuple):
    """A solution, and the program that it solves."""

    solution: Solution
    program: Program
    optimum: Optimum


def solve(
    problem: Problem,
    start: Motion | None = None,
    *,
    proximity: float = 0.0,
    free: Mapping[str, tuple[float, float]] | None = None,
    haste: float = 0.0,
    time_limit: float = 300.0,
) -> Solution:
    """The trajectory that IPOPT finds from `start`.

    Args:
        problem: what is asked for.
        start: a guess on the problem's own mesh; None for the cold one.
        proximity: weight, beside the cost, of the mean square distance from `start` (rad, m, and relative durations).
        free: hardware parameters of `sagittal.DESIGN` to be found as well, with their bounds; the solution's problem
            has the hardware that was found.
        haste: what a metre per second is worth, in units of cost. If positive, the speed is to be found as well, and
            the solution's problem has it.
        time_limit: s.

    Raises:
        NotSolved: it stopped anywhere but at a point that satisfies its tolerances.
        UserError: this CasADi has no IPOPT.
    """
    return optimise(problem, start, proximity=proximity, free=free, haste=haste, time_limit=time_limit).solution


def optimise(
    problem: Problem,
    start: Motion | None = None,
    *,
    proximity: float = 0.0,
    free: Mapping[str, tuple[float, float]] | None = None,
    haste: float = 0.0,
    time_limit: float = 300.0,
) -> Optimised:
    """Solve a problem as `solve` does, and return the program and its multipliers as well."""
    if not ca.has_nlpsol("ipopt"):
        raise UserError("this build of CasADi has no IPOPT: pip install --force-reinstall casadi")
    began = time.perf_counter()
    guess = cold_guess(problem) if start is None else start
    program, unknowns = transcribe(problem, guess, proximity=proximity, free=free or {}, haste=haste)
    optimum = program.solve(time_limit)
    stats = optimum.statistics
    if stats["return_status"] in INTERRUPTED:
        raise KeyboardInterrupt
    if not stats["success"]:
        how = stats["return_status"].replace("_", " ").lower()
        raise NotSolved(
            f"no trajectory at {problem.speed:g} m/s: IPOPT ended with '{how}'; lower the speed, relax a "
            "limit, or start from a solution nearby"
        )
    durations, q, v, a, tau, force, impulse, design, speed, cost = program.values(unknowns, optimum.point)
    found = {name: float(value) for name, value in zip(DESIGN, design[0, 0], strict=True) if name in (free or {})}
    motion = Motion(durations[:, 0, 0], q, v, a, tau, force, impulse[:, 0])
    seconds = time.perf_counter() - began
    solved = problem.on(**found).at(speed.item() if haste > 0.0 else problem.speed)
    solution = Solution(solved, motion, cost.item(), optimum.violation, stats["iter_count"], seconds)
    return Optimised(solution, program, optimum)


def solve_best(problem: Problem, starts: int = 3, near: Sequence[Solution] = ()) -> Solution:
    """The cheapest of several solves: from the cold guess, from `starts - 1` varied ones, and from other solutions.

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
            solved.append(solve(problem, guess))
        except NotSolved as failure:
            failures.append(failure)
    if not solved:
        raise failures[0]
    return min(solved, key=lambda solution: solution.cost)


def fastest(start: Solution) -> Solution:
    """The greatest speed at which the start's robot and gait have any trajectory at all, and that trajectory.

    A local optimum, like every solution. The cost stays in with a weight that does not matter for the speed.

    Raises:
        NotSolved: IPOPT did not find one.
    """
    return solve(start.problem, start.motion, haste=HASTE)


def refine(solution: Solution, intervals: int) -> Solution:
    """Solve the problem of `solution` on another mesh, starting from `solution`.

    Raises:
        NotSolved: IPOPT found no trajectory on the new mesh.
    """
    problem = solution.problem.on_mesh(intervals)
    return solve(problem, resample(solution.problem, solution.motion, problem))


def transcribe(
    problem: Problem, guess: Motion, *, proximity: float, free: Mapping[str, tuple[float, float]], haste: float
) -> tuple[Program, list[list[ca.MX]]]:
    """The nonlinear program and its unknowns: durations, q, v, a, tau, force, impulse (one each for every segment),
    design vector, speed, cost."""
    stride, hardware, legs = problem.stride, problem.hardware, problem.stride.legs
    model = sagittal.model_of(problem)
    segments, points, motors = range(len(stride.standing)), len(problem.points), motor_coordinates(legs).tolist()
    program = Program()

    # --- Unknowns ---
    p = _design(program, problem, free)
    gear = p[DESIGN.index("gear_ratio")] / specs.GEAR_RATIO
    peak, no_load = hardware.peak_torque * gear, hardware.no_load_speed / gear
    lower, upper = _range_of_motion(problem)
    speed = program.unknown(np.array([[problem.speed]]), VELOCITY, 0.0) if haste > 0.0 else ca.MX(problem.speed)
    T = [program.unknown(np.array([[duration]]), TIME, SHORTEST, LONGEST) for duration in guess.durations]
    names = ("", "trunk height", "pitch", *RANGES * len(legs))
    q = [program.unknown(guess.q[i].T, POSITION, lower[:, None], upper[:, None], names) for i in segments]
    v = [program.unknown(guess.v[i].T, VELOCITY) for i in segments]
    a = [program.unknown(guess.a[i].T, ACCELERATION) for i in segments]
    tau = [program.unknown(guess.tau[i].T, TORQUE) for i in segments]
    force = [
        _on_feet(program, stride, stride.standing[i], stride.liftoffs(i), guess.force[i].T, FORCE) for i in segments
    ]
    impulse = [
        _on_feet(program, stride, stride.touchdowns(i), (), guess.impulse[i][:, None], IMPULSE) for i in segments
    ]

    # --- The equations of motion, and standing feet that stand ---
    residual, acceleration = model.residual.map(points), model.contact_acceleration.map(points)
    for i in segments:
        program.require(residual(q[i], v[i], a[i], tau[i], force[i], p), TORQUE)
        for defect, scale in _defects(problem.scheme, T[i] / problem.intervals, q[i], v[i], a[i]):
            program.require(defect, scale)
        if standing := contact_rows(legs, stride.standing[i]):
            program.require(acceleration(q[i], v[i], a[i], p)[standing, :], ACCELERATION)

    # --- Around the cycle: touchdowns, lift-offs, speed ---
    program.require(q[0][0, 0], POSITION)
    for i in segments:
        q_before, v_before, tau_before = q[i - 1][:, -1], v[i - 1][:, -1], tau[i - 1][:, -1]
        if i == 0:
            travelled = ca.vertcat(speed * sum(T), ca.MX.zeros(stride.nq - 1))
            q_before = q_before[stride.next_coordinates.tolist()] - travelled
            v_before = v_before[stride.next_coordinates.tolist()]
            tau_before = tau_before[stride.next_motors.tolist()]
        program.require(q[i][:, 0] - q_before, POSITION)
        program.require(tau[i][:, 0] - tau_before, TORQUE)
        if landing := contact_rows(legs, stride.touchdowns(i)):
            program.require(model.impact(q_before, v_before, v[i][:, 0], impulse[i], p), IMPULSE)
            program.require(model.contact(q[i][:, 0], p)[landing[1::2]], POSITION)
            soles = model.contact_jacobian(q[i][:, 0], p)[landing, :]
            program.require(soles @ v[i][:, 0], VELOCITY)
            if math.isfinite(problem.form.hardest_landing):
                limit = ca.repmat(ca.MX(problem.form.hardest_landing), len(landing))
                program.within(soles @ v_before, limit, VELOCITY, "landing")
        else:
            program.require(v[i][:, 0] - v_before, VELOCITY)

    # --- The stride's form ---
    form, period = problem.form, ca.sum1(ca.vertcat(*T)) / stride.cycles
    if math.isfinite(form.longest_period):
        program.at_least_zero(form.longest_period - period, TIME, "period")
    for i in (i for i in segments if stride.standing[i]):
        if form.least_duty > 0.0:
            program.at_least_zero(T[i] - form.least_duty * period, TIME, "duty")
        if form.greatest_share < 1.0:
            loads = force[i][contact_rows(legs, stride.standing[i])[1::2], :] @ problem.quadrature
            program.at_least_zero(form.greatest_share * ca.sum1(loads) - loads, FORCE, "shares of the load")

    # --- Friction, swing, motors, smoothness ---
    for i in segments:
        for leg in stride.standing[i]:
            x, z = contact_rows(legs, (leg,))
            end = -1 if leg in stride.liftoffs(i) else None  # where the force is zero, there is no cone
            program.within(force[i][x, :end], hardware.friction * force[i][z, :end], FORCE, "friction")
            if leg in stride.touchdowns(i):
                program.within(impulse[i][x], hardware.friction * impulse[i][z], IMPULSE, "friction at touchdown")
        height = model.contact.map(points)(q[i], p)
        for leg in (leg for leg in legs if leg not in stride.standing[i]):
            share = _swing_share(stride, leg, i, T, problem.points)
            bump = problem.clearance * (4.0 * share * (1.0 - share)) ** 2  # no slope at lift-off: feet leave at rest
            # Where it has just left or is about to land, its height is zero anyway.
            begin = 1 if stride.stands(leg, i - 1) else 0
            end = -1 if stride.stands(leg, i + 1) else None
            sole = height[2 * legs.index(leg) + 1, :]
            program.at_least_zero((sole - bump)[begin:end], POSITION, "clearance")
            if math.isfinite(problem.form.highest_step):
                program.at_least_zero((problem.form.highest_step - sole)[begin:end], POSITION, "step")
        for speed_at, torque_at in _motor_states(problem, T[i], v[i][motors, :], a[i][motors, :], tau[i]):
            program.within(
                speed_at, ca.repmat(problem.speed_margin * no_load, *speed_at.shape), VELOCITY, "joint speed"
            )
            program.within(torque_at, ca.repmat(peak, *torque_at.shape), TORQUE, "peak torque")
            stall = stall_torque(peak, hardware.corner_speed, hardware.no_load_speed)
            program.at_least_zero(stall * (1.0 - speed_at / no_load) - torque_at, TORQUE, "falling line", 0.5)
            program.at_least_zero(stall * (1.0 + speed_at / no_load) + torque_at, TORQUE, "falling line", 0.5)
            _limit_braking(program, hardware, gear, speed_at, torque_at)
            _limit_bus(program, problem, no_load, stall, speed_at, torque_at)
        dt = T[i] / (points - 1)
        steps = ca.repmat(problem.torque_rate * dt, len(motors), points - 1)
        program.within(tau[i][:, 1:] - tau[i][:, :-1], steps, TORQUE, "torque rate")
        if rows := contact_rows(legs, stride.standing[i]):
            steps = ca.repmat(problem.force_rate * dt, len(rows), points - 1)
            program.within(force[i][rows, 1:] - force[i][rows, :-1], steps, FORCE, "force rate")

    # --- Cost ---
    for i in segments:
        program.cost += _cost(problem, T[i], v[i][motors, :] / no_load, tau[i] / peak, force[i]) / len(segments)
    cost = program.cost
    program.cost -= haste * speed
    if proximity > 0.0:
        for i in segments:
            away = (q[i] - guess.q[i].T)[1:, :]
            program.cost += proximity * (ca.sumsqr(away) / points + (T[i] / guess.durations[i] - 1.0) ** 2)
    return program, [T, q, v, a, tau, force, impulse, [p], [speed], [cost]]


def _design(program: Program, problem: Problem, free: Mapping[str, tuple[float, float]]) -> ca.MX:
    """The design vector: the hardware's own numbers, or unknowns where they are free."""
    values = []
    for name, number in zip(DESIGN, sagittal.design_vector(problem.hardware), strict=True):
        guess = np.array([[number]])
        values.append(program.unknown(guess, number, *free[name]) if name in free else ca.MX(guess))
    return ca.vertcat(*values)


def _range_of_motion(problem: Problem) -> tuple[Float[np.ndarray, " nq"], Float[np.ndarray, " nq"]]:
    """Least and greatest q: joints in their ranges, the trunk off the ground and all but level."""
    hardware, legs = problem.hardware, len(problem.stride.legs)
    lower = [-np.inf, 0.25, -problem.pitch_limit, *(specs.HIP_RANGE[0], specs.KNEE_RANGE[0], -SLACK) * legs]
    travel = hardware.spring_travel + SLACK
    upper = [
        np.inf,
        problem.form.highest_trunk,
        problem.pitch_limit,
        *(specs.HIP_RANGE[1], specs.KNEE_RANGE[1], travel) * legs,
    ]
    return np.array(lower), np.array(upper)


def _on_feet(
    program: Program,
    stride: Stride,
    feet: tuple[str, ...],
    lifting: tuple[str, ...],
    guess: Float[np.ndarray, "contacts points"],
    scale: float,
) -> ca.MX:
    """Forces or impulses of all legs: zero but for those of `feet`, which push up, and end at zero if `lifting`."""
    rows = []
    for leg in stride.legs:
        row = guess[contact_rows(stride.legs, (leg,))]
        if leg not in feet:
            rows.append(ca.MX.zeros(*row.shape))
            continue
        lower, upper = np.full(row.shape, -np.inf), np.full(row.shape, np.inf)
        lower[1] = 0.0
        if leg in lifting:
            lower[:, -1] = upper[:, -1] = 0.0
        rows.append(program.unknown(row, scale, lower, upper))
    return ca.vertcat(*rows)


def _defects(scheme: Scheme, h: ca.MX, q: ca.MX, v: ca.MX, a: ca.MX) -> list[tuple[ca.MX, float]]:
    """What the scheme makes zero, and its scale; h is an interval's length."""
    if scheme == "hermite-simpson":
        defects = []
        for x, rate, scale in ((q, v, POSITION), (v, a, VELOCITY)):
            left, middle, right = x[:, :-1:2], x[:, 1::2], x[:, 2::2]
            out, centre, into = rate[:, :-1:2], rate[:, 1::2], rate[:, 2::2]
            defects.append((right - left - h / 6.0 * (out + 4.0 * centre + into), scale))
            defects.append((middle - (left + right) / 2.0 - h / 8.0 * (out - into), scale))
        return defects
    mean_a = a[:, :-1] if scheme == "paper" else (a[:, :-1] + a[:, 1:]) / 2.0
    return [
        (q[:, 1:] - q[:, :-1] - h / 2.0 * (v[:, :-1] + v[:, 1:]), POSITION),
        (v[:, 1:] - v[:, :-1] - h * mean_a, VELOCITY),
    ]


def _motor_states(problem: Problem, T: ca.MX, qd: ca.MX, qdd: ca.MX, tau: ca.MX) -> list[tuple[ca.MX, ca.MX]]:
    """Speeds and torques of the motors at the points and, where the polynomials bend in between, halfway as well."""
    states = [(qd, tau)]
    if problem.scheme == "hermite-simpson":
        h = T / problem.intervals
        left, middle, right = tau[:, :-1:2], tau[:, 1::2], tau[:, 2::2]
        for s in (0.25, 0.75):
            speed, _ = hermite_and_rate(s, h, qd[:, :-1:2], qd[:, 2::2], qdd[:, :-1:2], qdd[:, 2::2])
            states.append((speed, parabola(s, left, middle, right)))
    return states


def _limit_braking(program: Program, hardware: HardwareSpec, gear: ca.MX, speed: ca.MX, torque: ca.MX) -> None:
    """Braking torque below a line that falls to zero at the braking speed, where there is one.

    Beyond that speed the line asks for driving torque, so a motor whose braking ends before its no-load speed is
    limited by more than it should be.
    """
    if math.isinf(hardware.braking_speed):
        return
    stall = stall_torque(hardware.peak_torque * gear, hardware.corner_speed, hardware.braking_speed)
    share = speed * gear / hardware.braking_speed
    program.at_least_zero(stall * (1.0 - share) + torque, TORQUE, "braking line", 0.5)
    program.at_least_zero(stall * (1.0 + share) - torque, TORQUE, "braking line", 0.5)


def _limit_bus(program: Program, problem: Problem, no_load: ca.MX, stall: ca.MX, speed: ca.MX, torque: ca.MX) -> None:
    """Power of all motors together within the bus's limits, and driving torque within what its voltage leaves.

    The voltage never rises: where power flows back, the envelope without sag, which holds anyway, is the narrower one.
    """
    losses, share = problem.hardware.losses, problem.share
    power = ca.sum1(speed * torque + copper_loss(torque, no_load, stall))  # W
    if not (math.isinf(losses.bus_power_out) and math.isinf(losses.bus_power_in)):
        program.require(
            power, POWER, -share * losses.bus_power_in / POWER, share * losses.bus_power_out / POWER, "bus power"
        )
    if losses.bus_sag > 0.0:
        voltage = ca.repmat(1.0 - losses.bus_sag / share * power / 1e3, speed.shape[0], 1)
        program.at_least_zero(stall * (voltage - speed / no_load) - torque, TORQUE, "sagged line", 0.5)
        program.at_least_zero(stall * (voltage + speed / no_load) + torque, TORQUE, "sagged line", 0.5)


def _cost(problem: Problem, T: ca.MX, speed: ca.MX, torque: ca.MX, force: ca.MX) -> ca.MX:
    """Mean of R (paper, Eq. R) over a segment; speeds and torques as shares of the motors' greatest."""
    weights = problem.weights
    load = force / weights.force
    R = weights.power * ca.sum1((speed * torque) ** 2) + weights.load * (ca.sum1(torque**2) + ca.sum1(load**2))
    cost = R @ problem.quadrature
    steps = len(problem.points) - 1
    for value in (torque, load):
        change = (value[:, 1:] - value[:, :-1]) * (steps * weights.smoothness_time / T)
        cost += weights.smoothness * ca.sumsqr(change) / steps
    return cost


def _swing_share(stride: Stride, leg: str, segment: int, T: list[ca.MX], points: Float[np.ndarray, " points"]) -> ca.MX:
    """How much of a swing has gone by at each point of a segment in the midst of it, from 0 to 1."""

    def rest(i: int, step: int) -> ca.MX:
        """Time for which the leg goes on swinging, walking from segment to segment."""
        i += step
        return ca.MX(0) if stride.stands(leg, i) else T[i % len(T)] + rest(i, step)

    before, after = rest(segment, -1), rest(segment, +1)
    return (before + T[segment] * ca.DM(points).T) / (before + T[segment] + after)
