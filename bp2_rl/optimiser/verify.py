"""The independent verifier of a solution: it measures figures without the solver's code
and checks their limits.

The model is `planar`'s, built in MuJoCo, and time runs through the stride between the
mesh's points as well:

    at the points        do the equations of motion, contacts, impacts and the cycle's closing hold?
    between the points   forces that push, feet that clear the ground, motors within their envelope
    over the stride      energy in = energy out, and the ground carries the weight
    simulated again      the solution's torques from its first state, by an error-controlled integrator
"""

import dataclasses
import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

from bp2_rl.base.metric import metric
from bp2_rl.optimiser import verifier_laws
from bp2_rl.optimiser.planar import PlanarModel
from bp2_rl.optimiser.problem import Problem, contact_rows
from bp2_rl.optimiser.solution import Motion, Solution, StrideMoment, sample

UNITS = {
    "speed": "m/s",
    # At the mesh's points: |M a + h - B u - tau_p - J^T F| (paper, Eq.
    # continuous_dynamics), |J v| of standing feet, and how far these feet are from
    # where they landed, or from the ground. Each figure is the largest of its kind, or,
    # where its name says so, the least.
    "dynamics_residual": "N or Nm",
    "foot_speed": "m/s",
    "foot_drift": "m",
    # From segment to segment, around the cycle: |M (v+ - v-) - J^T Lambda| (paper, Eq.
    # hybrid), steps of a coordinate, and steps of a velocity where no foot lands.
    "impact_residual": "N s or N m s",
    "position_jump": "m or rad",
    "velocity_jump": "m/s or rad/s",
    # Over the stride: |W_motor - W_lost - impact losses| with W_lost in springs,
    # slides, gears, joints and air; the impulse of contact forces and air along the
    # track; and that of contact forces less the weight's, upwards.
    "energy_residual": "of the positive motor work",
    "impulse_residual_x": "of the weight's impulse",
    "impulse_residual_z": "of the weight's impulse",
    # Between the points as at them: the vertical force of a standing foot, the height
    # of a swinging one, torque beyond the motors' envelope, power beyond what the bus
    # gives or takes back (both 0 within), the speed of the fastest joint, and |F_x| /
    # (mu F_z), impulses included.
    "stance_force_min": "N",
    "swing_clearance_min": "m",
    "torque_excess": "Nm",
    "bus_excess": "W",
    "joint_speed_max": "rad/s",
    "friction_use": "of the friction cone",
    # At the points: |q - q_simulated| and |v - v_simulated|.
    "position_error": "m or rad",
    "velocity_error": "m/s or rad/s",
    # What the motors do in the simulated stride, less what they do in the solution.
    "energy_error": "of the positive motor work",
}
"""Units of the figures that `verify` measures, in its order."""
LIMITS = {
    # these four are what the program makes zero: the limit is what IPOPT leaves of it
    "dynamics_residual": 1e-3,
    "impact_residual": 1e-5,
    "position_jump": 1e-6,
    "velocity_jump": 1e-5,
    # these and all others are what stands between a discretised stride and a true one
    "energy_residual": 1e-3,
    "impulse_residual_x": 1e-4,
    "impulse_residual_z": 1e-4,
    "stance_force_min": -1.0,
    "swing_clearance_min": -1e-3,
    "torque_excess": 1.0,
    "bus_excess": 50.0,
    "foot_speed": 0.01,
    "foot_drift": 1e-4,
    # between the points of a coarse mesh, where the program does not look
    "friction_use": 1.1,
    "position_error": 1e-3,
    "velocity_error": 0.05,
    "energy_error": 0.01,
}
"""Limits of the figures that `verify` measures; speed and the fastest joint's speed
have none."""
# m/s, speeds at which the re-simulation must agree; elsewhere it is reported
RESIMULATED = (4.0, 13.2)
# figures that the shipped libraries lack, and what stands for them
UNTOLD = {"bus_excess": 0.0, "energy_error": 0.0}
# figures that must not be below their limit; others not above
LEAST = ("stance_force_min", "swing_clearance_min")

FINER = 10  # samples between two points of the mesh
QUADRATURE = 8  # Gauss points an interval
LIGHT = 0.01  # of the weight: a force below says nothing about friction


def verify(solution: Solution) -> dict[str, float]:
    """Measure a solution with the independent verifier, and return the figures that
    `UNITS` names and explains."""
    model, (q, v) = PlanarModel.of(solution.problem), resimulate(solution)
    return {
        "speed": solution.problem.speed,
        **_at_points(model, solution),
        **_at_events(model, solution),
        **_over_stride(model, solution),
        **_between_points(model, solution),
        "position_error": float(np.max(np.abs(q - solution.motion.q))),
        "velocity_error": float(np.max(np.abs(v - solution.motion.v))),
        "energy_error": _work_error(solution, v),
    }


def _work_error(
    solution: Solution, v: Float[np.ndarray, "segments points nq"]
) -> float:
    """Return the difference of the motors' work at other velocities from the
    solution's, over the solution's positive work."""
    motion, motors = solution.motion, solution.problem.stride.motors
    weights = (motion.durations[:, None] * solution.problem.quadrature)[..., None]
    power = motion.tau * motion.v[..., motors]
    error = np.sum(weights * motion.tau * (v - motion.v)[..., motors])
    return float(abs(error) / np.sum(weights * np.maximum(power, 0.0)))


def failures(figures: dict[str, float], *, exact: bool = True) -> list[str]:
    """Return a line for each figure that is beyond its limit; no lines if the solution
    is sound.

    If `exact`, the simulated stride must agree at every point, else in its energy
    alone: a stride in which feet are not held back by springs is an unstable thing to
    simulate from torques.

    A figure that is NaN or missing counts as beyond its limit, except a missing figure
    in `UNTOLD`.
    """
    lines = []
    speed = figures.get("speed", math.nan)
    for figure, limit in LIMITS.items():
        point_by_point = figure in ("position_error", "velocity_error")
        if point_by_point and (
            not exact or speed < RESIMULATED[0] or speed > RESIMULATED[1]
        ):
            continue
        value = figures.get(figure, UNTOLD.get(figure, math.nan))
        least = figure in LEAST
        if not (value >= limit if least else value <= limit):
            side = "below" if least else "above"
            lines.append(
                f"{figure} is {value:.3g} {UNITS[figure]}, {side} its limit of {limit:g}"
            )
    return lines


def resimulate(
    solution: Solution, rtol: float = 1e-9
) -> tuple[
    Float[np.ndarray, "segments points nq"], Float[np.ndarray, "segments points nq"]
]:
    """Simulate a solution's torques and durations from its first state; return q and v
    at the mesh's points.

    From the solution's own state after the first impact, standing feet held exactly,
    every landing a perfectly inelastic impact; DOP853, interval by interval, as torques
    have corners where intervals meet. NaN from where the integrator gives up.
    """
    model, stride = PlanarModel.of(solution.problem), solution.problem.stride
    q, v = (np.full_like(x, math.nan) for x in (solution.motion.q, solution.motion.v))
    q_now, v_now = solution.motion.q[0, 0], solution.motion.v[0, 0]
    for i in range(len(stride.standing)):
        if i > 0 and (landing := contact_rows(stride.legs, stride.touchdowns(i))):
            v_now, _ = model.land(q_now, v_now, landing)
        q[i], v[i] = _simulate_segment(model, solution, i, q_now, v_now, rtol)
        q_now, v_now = q[i, -1], v[i, -1]
    return q, v


@dataclasses.dataclass(frozen=True, kw_only=True)
class StrideSummary:
    """Period, duty, peak torque and peak force of a stride, whose peaks are between the
    mesh's points, too."""

    period: float = metric("Period", "s", ".3f")
    duty: float = metric("Duty", form=".3f")
    peak_torque: float = metric("Peak torque", "Nm", ".0f")
    peak_force: float = metric("Force", "N", ".0f")  # vertical, of a foot


def summarise(solution: Solution) -> StrideSummary:
    """Summarise the stride of a solution."""
    moments = [moment for _, moment in _on_fine_grid(solution.problem, solution.motion)]
    return StrideSummary(
        period=solution.period,
        duty=solution.duty,
        peak_torque=float(max(np.max(np.abs(moment.tau)) for moment in moments)),
        peak_force=float(max(np.max(moment.force[:, 1::2]) for moment in moments)),
    )


def _at_points(model: PlanarModel, solution: Solution) -> dict[str, float]:
    motion, stride = solution.motion, solution.problem.stride
    residual = speed = drift = 0.0
    for i, feet in enumerate(stride.standing):
        rows, feet_at = contact_rows(stride.legs, feet), []
        series = (motion.q, motion.v, motion.a, motion.tau, motion.force)
        for q, v, a, tau, force in zip(*(x[i] for x in series), strict=True):
            terms = model.terms(q, v)
            push = terms.passive + terms.jacobian.T @ force
            push[model.motors] += verifier_laws.joint_torque(
                model.hardware, v[model.motors], tau
            )
            residual = max(residual, np.max(np.abs(terms.mass @ a + terms.bias - push)))
            speed = max(speed, np.max(np.abs((terms.jacobian @ v)[rows]), initial=0.0))
            feet_at.append(terms.contact[rows])
        away = np.array(feet_at)
        away[:, 0::2] -= away[0, 0::2]
        drift = max(drift, np.max(np.abs(away), initial=0.0))
    return {
        "dynamics_residual": float(residual),
        "foot_speed": float(speed),
        "foot_drift": float(drift),
    }


def _at_events(model: PlanarModel, solution: Solution) -> dict[str, float]:
    stride = solution.problem.stride
    impact = step = kick = 0.0
    for i, (q_before, v_before) in enumerate(_states_before(solution)):
        q, v = solution.motion.q[i, 0], solution.motion.v[i, 0]
        step = max(step, np.max(np.abs(q - q_before)))
        if stride.touchdowns(i):
            terms = model.terms(q, v)
            residual = (
                terms.mass @ (v - v_before)
                - terms.jacobian.T @ solution.motion.impulse[i]
            )
            impact = max(impact, np.max(np.abs(residual)))
        else:
            kick = max(kick, np.max(np.abs(v - v_before)))
    return {
        "impact_residual": float(impact),
        "position_jump": float(step),
        "velocity_jump": float(kick),
    }


def _over_stride(model: PlanarModel, solution: Solution) -> dict[str, float]:
    problem, motion = solution.problem, solution.motion
    x, w = np.polynomial.legendre.leggauss(QUADRATURE)
    shares = (
        np.arange(problem.intervals)[:, None] + (x + 1.0) / 2.0
    ).ravel() / problem.intervals
    weights = np.tile(w / 2.0, problem.intervals) / problem.intervals
    net = positive = lost = 0.0
    impulse, blown = motion.impulse.sum(axis=0), 0.0
    for i, (_, v_before) in enumerate(_states_before(solution)):
        moment, dt = sample(problem, motion, i, shares), motion.durations[i] * weights
        power = moment.tau * moment.v[:, model.motors]
        net += dt @ power.sum(axis=1)
        positive += dt @ np.maximum(power, 0.0).sum(axis=1)
        lost += dt @ model.dissipation(moment.q, moment.v, moment.tau)
        impulse = impulse + dt @ moment.force
        blown += dt @ verifier_laws.drag(problem.hardware, model.share, moment.v[:, 0])
        mass = model.terms(motion.q[i, 0], v_before).mass
        lost += _kinetic(mass, v_before) - _kinetic(mass, motion.v[i, 0])
    weight = model.weight * np.sum(motion.durations)
    return {
        "energy_residual": float(abs(net - lost) / positive),
        "impulse_residual_x": float(abs(np.sum(impulse[0::2]) + blown) / weight),
        "impulse_residual_z": float(abs(np.sum(impulse[1::2]) / weight - 1.0)),
    }


def _between_points(model: PlanarModel, solution: Solution) -> dict[str, float]:
    problem, motion = solution.problem, solution.motion
    stride, hardware = problem.stride, problem.hardware
    push = math.inf
    clearance = math.inf
    excess = 0.0
    overload = 0.0
    fastest = 0.0
    friction = 0.0
    for i, moment in _on_fine_grid(problem, motion):
        standing = contact_rows(stride.legs, stride.standing[i])
        swinging = [row for row in range(2 * len(stride.legs)) if row not in standing]
        push = min(push, np.min(moment.force[:, standing[1::2]], initial=math.inf))
        heights = [
            model.terms(q, v).contact[swinging[1::2]]
            for q, v in zip(moment.q, moment.v, strict=True)
        ]
        clearance = min(clearance, np.min(heights, initial=math.inf))
        qd = moment.v[:, model.motors]
        excess = max(
            excess, verifier_laws.torque_excess(hardware, model.share, qd, moment.tau)
        )
        power = verifier_laws.bus_power(hardware, qd, moment.tau)
        overload = max(overload, verifier_laws.bus_excess(hardware, model.share, power))
        fastest = max(fastest, np.max(np.abs(qd)))
        for along, down, least in (
            (moment.force[:, 0::2], moment.force[:, 1::2], LIGHT * model.weight),
            (motion.impulse[i, 0::2], motion.impulse[i, 1::2], 0.0),
        ):
            slip = np.abs(along[down > least]) / (
                hardware.friction * down[down > least]
            )
            friction = max(friction, np.max(slip, initial=0.0))
    return {
        "stance_force_min": float(push),
        "swing_clearance_min": float(clearance),
        "torque_excess": float(excess),
        "bus_excess": overload,
        "joint_speed_max": float(fastest),
        "friction_use": float(friction),
    }


def _simulate_segment(
    model: PlanarModel,
    solution: Solution,
    segment: int,
    q: Float[np.ndarray, " nq"],
    v: Float[np.ndarray, " nq"],
    rtol: float,
) -> tuple[Float[np.ndarray, "points nq"], Float[np.ndarray, "points nq"]]:
    """Integrate a segment from its beginning; return q and v at its points."""
    problem = solution.problem
    standing = contact_rows(problem.stride.legs, problem.stride.standing[segment])
    h = solution.motion.durations[segment] / problem.intervals
    steps = (len(problem.points) - 1) // problem.intervals
    states = np.full((len(problem.points), 2 * len(q)), math.nan)
    states[0] = np.concatenate([q, v])
    for k in range(problem.intervals):
        torque = _torque_polynomial(solution, segment, k)

        def rate(
            t: float, state: np.ndarray, torque: np.ndarray = torque
        ) -> np.ndarray:
            q, v = np.split(state, 2)
            a, _ = model.accelerate(q, v, torque @ (1.0, t / h, (t / h) ** 2), standing)
            return np.concatenate([v, a])

        begin = states[k * steps]
        if not np.all(np.isfinite(begin)):
            break
        run = solve_ivp(
            rate,
            (0.0, h),
            begin,
            "DOP853",
            np.linspace(0.0, h, steps + 1),
            rtol=rtol,
            atol=rtol,
        )
        states[k * steps : k * steps + run.y.shape[1]] = run.y.T
    q, v = np.split(states, 2, axis=1)
    return q, v


def _torque_polynomial(
    solution: Solution, segment: int, interval: int
) -> Float[np.ndarray, "motors 3"]:
    """tau in one interval as coefficients of 1, s and s^2, for s from 0 to 1: no scheme
    goes beyond."""
    s = np.array([0.2, 0.5, 0.8])
    shares = (interval + s) / solution.problem.intervals
    tau = sample(solution.problem, solution.motion, segment, shares).tau
    return np.linalg.solve(np.vander(s, increasing=True), tau).T


def _states_before(
    solution: Solution,
) -> Iterator[tuple[Float[np.ndarray, " nq"], Float[np.ndarray, " nq"]]]:
    """Yield q and v just before each segment begins: the end of the segment, or of the
    stride, before it."""
    problem = solution.problem
    motion = solution.motion
    order = solution.problem.stride.next_coordinates
    q, v = motion.q[-1, -1, order].copy(), motion.v[-1, -1, order]
    q[0] -= problem.speed * np.sum(motion.durations)
    yield q, v
    yield from zip(motion.q[:-1, -1], motion.v[:-1, -1], strict=True)


def _on_fine_grid(
    problem: Problem, motion: Motion
) -> Iterator[tuple[int, StrideMoment]]:
    """Yield each segment on a grid `FINER` times as fine as the mesh."""
    shares = np.linspace(0.0, 1.0, FINER * (len(problem.points) - 1) + 1)
    for segment in range(len(motion.durations)):
        yield segment, sample(problem, motion, segment, shares)


def _kinetic(mass: Float[np.ndarray, "nq nq"], v: Float[np.ndarray, " nq"]) -> float:
    """Return the kinetic energy, J."""
    return float(v @ mass @ v) / 2.0
