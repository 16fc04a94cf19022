"""Direct collocation: periodic running written down as a nonlinear program (paper, Eqs.
obj_func, R, Physical Constraints, Motion Constraints and other constraints).

A stride is a sequence of segments, each with its own feet on the ground and a free
duration. At every point of a segment the unknowns are q, v, a, tau and the forces F of
the standing feet. The equations of motion hold there as inverse dynamics, and the
scheme ties the points of an interval together:

    hermite-simpson   points at both ends and in the middle; q and v are cubic, each by its own derivative
    trapezoid         points at the ends; q and v by the trapezoidal rule
    paper             points at the ends; v by the explicit Euler rule, q by the trapezoidal rule

A standing foot lands at height zero and with velocity zero, and its acceleration is
zero at every point. Beyond the paper's constraints, forces vanish at lift-off, torques
do not jump between segments, and a swinging foot clears a bump of height `clearance`; a
problem's `form` may ask for more. As in the paper, every segment counts alike in the
cost, however long it is; within one, the sum over nodes is a quadrature, so that the
cost does not drift with the mesh.
"""

import dataclasses
import functools
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bp2_rl.base.arrays import hermite_and_rate, parabola
from bp2_rl.optimiser import sagittal
from bp2_rl.optimiser.links import leg_of
from bp2_rl.optimiser.problem import SOLVE_TIME, TRUNK, Problem, Stride, contact_rows
from bp2_rl.optimiser.program import Program
from bp2_rl.optimiser.sagittal import DESIGN_PARAMETERS, SagittalModel, ca
from bp2_rl.optimiser.solution import Motion
from bp2_rl.robot.actuator import copper_loss, stall_torque

# What unknowns and constraints are divided by inside the program.
TIME_SCALE = 0.1  # s
POSITION_SCALE = 1.0  # m, rad
VELOCITY_SCALE = 10.0  # m/s, rad/s
ACCELERATION_SCALE = 1000.0  # m/s2, rad/s2
TORQUE_SCALE = 100.0  # Nm
FORCE_SCALE = 500.0  # N
IMPULSE_SCALE = 10.0  # N s
POWER_SCALE = 1000.0  # W

SHORTEST, LONGEST = 0.005, 0.6  # s, of a segment
LOWEST_TRUNK = 0.25  # m
SPRING_OVERTRAVEL = 0.03  # m, by which a spring may press into its stops


@dataclasses.dataclass(frozen=True)
class SolveOptions:
    """Options of a solve beside its problem: nearness to the guess, free parameters, a
    weight on speed, a time limit.

    The solution's problem has what was found as well: the speed, an unknown if
    `speed_weight` is positive, and the hardware parameters that are `free`.
    """

    proximity: float = 0.0
    """weight of the mean square distance from the guess (rad, m, and relative
    durations), beside the cost"""
    free: Mapping[str, tuple[float, float]] = dataclasses.field(
        default_factory=dict[str, tuple[float, float]]
    )
    """lower and upper bounds of the hardware parameters of `sagittal.DESIGN_PARAMETERS` that are
    unknowns"""
    speed_weight: float = 0.0
    """units of the cost that a metre per second is worth; above 0 the speed is an
    unknown"""
    time_limit: float = SOLVE_TIME
    """s, of a processor's time"""
    perhaps_infeasible: bool = False
    """look for a point of local infeasibility as soon as multipliers diverge, instead
    of factorising ever longer"""


class Unknowns(NamedTuple):
    """Unknowns of a segment. A row is a coordinate, a motor or a contact coordinate, a
    column a point."""

    T: ca.MX  # s: the segment's duration
    q: ca.MX  # m, rad
    v: ca.MX  # m/s, rad/s
    a: ca.MX  # m/s2, rad/s2
    tau: ca.MX  # Nm
    force: ca.MX  # N: zero in swing
    # N s, one column: at the touchdown with which the segment begins, zero if there is
    # none
    impulse: ca.MX


@dataclasses.dataclass(frozen=True)
class Transcription:
    """A problem as a nonlinear program in the unknowns of its segments."""

    problem: Problem
    program: Program
    model: SagittalModel
    design: ca.MX  # p, the design vector
    speed: ca.MX  # m/s
    segments: tuple[Unknowns, ...]

    @property
    def gear(self) -> ca.MX:
        """Gear ratio, over the ratio at which the motors' numbers are given."""
        return (
            self.design[DESIGN_PARAMETERS.index("gear_ratio")]
            / self.problem.hardware.anatomy.gear_ratio
        )

    def of_motors(self, name: str) -> ca.DM:
        """Return a hardware parameter of hips and knees, a number for each motor, at
        the gear ratio for which it is given."""
        each = np.broadcast_to(self.problem.hardware.parameter(name), 3)[1:]
        return ca.DM(np.tile(each, len(self.problem.stride.legs)))

    @property
    def peak_torque(self) -> ca.MX:
        """Greatest torques of the motors at their joints, Nm."""
        return self.of_motors("peak_torque") * self.gear

    @property
    def no_load_speed(self) -> ca.MX:
        """No-load speeds of the motors at their joints, rad/s."""
        return self.of_motors("no_load_speed") / self.gear

    @property
    def stall_torque(self) -> ca.MX:
        """Torques of the motors where the envelope's falling line meets standstill,
        Nm."""
        return stall_torque(
            self.peak_torque,
            self.of_motors("corner_speed"),
            self.of_motors("no_load_speed"),
        )

    @property
    def motors(self) -> list[int]:
        """Rows of q that have a motor."""
        return self.problem.stride.motors.tolist()

    @functools.cached_property
    def cost(self) -> ca.MX:
        """Mean of the running cost R (paper, Eq. R) over the stride; every segment
        counts alike."""
        return sum(
            (
                _mean_running_cost(self, segment) / len(self.segments)
                for segment in self.segments
            ),
            ca.MX(0),
        )

    def motion(self, point: Float[np.ndarray, " n"]) -> Motion:
        """Return the stride at a point of the program's unknowns."""
        segments = [self.program.values(segment, point) for segment in self.segments]
        T, q, v, a, tau, force, impulse = (
            np.stack(parts) for parts in zip(*segments, strict=True)
        )
        return Motion(T[:, 0, 0], q, v, a, tau, force, impulse[:, 0])


def transcribe(problem: Problem, guess: Motion, options: SolveOptions) -> Transcription:
    """Write a problem down as a nonlinear program whose unknowns start at a guess on
    the problem's mesh."""
    nlp = _add_unknowns(problem, guess, options)
    for i in range(len(nlp.segments)):
        _require_dynamics(nlp, i)
        _require_standing_feet_to_stand(nlp, i)
    # the stride begins at x = 0
    nlp.program.require(nlp.segments[0].q[0, 0], POSITION_SCALE)
    for i in range(len(nlp.segments)):
        _join_to_segment_before(nlp, i)
    _limit_form(nlp)
    for i in range(len(nlp.segments)):
        _limit_release(nlp, i)
        _limit_friction(nlp, i)
        _limit_swing(nlp, i)
        _limit_motors(nlp, i)
        _limit_rates(nlp, i)
    nlp.program.objective = nlp.cost - options.speed_weight * nlp.speed
    if options.proximity > 0.0:
        nlp.program.objective += options.proximity * _distance(nlp, guess)
    return nlp


# --- Variables ------------------------------------------------------------------------


def _add_unknowns(
    problem: Problem, guess: Motion, options: SolveOptions
) -> Transcription:
    """Begin a program with the design vector and the speed, known or not, and with the
    unknowns of all segments."""
    program = Program()
    stride = problem.stride
    segments = range(len(problem.stride.standing))
    p = _design(program, problem, options.free)
    speed = ca.MX(problem.speed)
    if options.speed_weight > 0.0:
        speed = program.unknown(np.array([[problem.speed]]), VELOCITY_SCALE, 0.0)
    lower, upper = _range_of_motion(problem)
    least = SHORTEST * problem.hardware.size.time
    most = LONGEST * problem.hardware.size.time
    T = [
        program.unknown(np.array([[duration]]), TIME_SCALE, least, most)
        for duration in guess.durations
    ]
    q = [
        program.unknown(guess.q[i].T, POSITION_SCALE, lower[:, None], upper[:, None])
        for i in segments
    ]
    v = [program.unknown(guess.v[i].T, VELOCITY_SCALE) for i in segments]
    a = [program.unknown(guess.a[i].T, ACCELERATION_SCALE) for i in segments]
    tau = [program.unknown(guess.tau[i].T, TORQUE_SCALE) for i in segments]
    force = [
        _push(
            program,
            stride,
            guess.force[i].T,
            FORCE_SCALE,
            feet=stride.standing[i],
            lifting=stride.liftoffs(i),
        )
        for i in segments
    ]
    impulse = [
        _push(
            program,
            stride,
            guess.impulse[i][:, None],
            IMPULSE_SCALE,
            feet=stride.touchdowns(i),
        )
        for i in segments
    ]
    unknowns = tuple(map(Unknowns, T, q, v, a, tau, force, impulse))
    return Transcription(
        problem, program, sagittal.model_of(problem), p, speed, unknowns
    )


def _design(
    program: Program, problem: Problem, free: Mapping[str, tuple[float, float]]
) -> ca.MX:
    """Return the design vector: the hardware's own numbers, or unknowns where a
    parameter is free."""
    values = []
    for name, number in zip(
        DESIGN_PARAMETERS, sagittal.design_vector(problem.hardware), strict=True
    ):
        guess = np.array([[number]])
        values.append(
            program.unknown(guess, number, *free[name])
            if name in free
            else ca.MX(guess)
        )
    return ca.vertcat(*values)


def _range_of_motion(
    problem: Problem,
) -> tuple[Float[np.ndarray, " nq"], Float[np.ndarray, " nq"]]:
    """Least and greatest q: joints in their ranges, the trunk off the ground and all
    but level."""
    size, hardware, pitch = problem.hardware.size, problem.hardware, problem.pitch_limit
    over = SPRING_OVERTRAVEL * size.length
    low = [-np.inf, LOWEST_TRUNK * size.length, -pitch]
    high = [np.inf, problem.form.highest_trunk, pitch]
    for name in problem.stride.legs:
        ends = [*leg_of(hardware.anatomy, name).ranges[1:]]
        if hardware.anatomy.sprung:
            ends.append((-over, hardware.spring_travel + over))
        low += [end[0] for end in ends]
        high += [end[1] for end in ends]
    return np.array(low), np.array(high)


def _push(
    program: Program,
    stride: Stride,
    guess: Float[np.ndarray, "contacts points"],
    scale: float,
    *,
    feet: tuple[str, ...],
    lifting: tuple[str, ...] = (),
) -> ca.MX:
    """Return forces or impulses of all legs as unknowns: upward on `feet`, else zero,
    and zero at the end of `lifting` feet."""
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


# --- Dynamics -------------------------------------------------------------------------


def _require_dynamics(nlp: Transcription, i: int) -> None:
    """Require M a + C + G = B (tau - tau_r) + tau_p + J^T F at each point, and the
    scheme's rule from point to point."""
    T, q, v, a, tau, force, _ = nlp.segments[i]
    residual = nlp.model.residual.map(q.shape[1])
    nlp.program.require(residual(q, v, a, tau, force, nlp.design), TORQUE_SCALE)
    h = T / nlp.problem.intervals
    if nlp.problem.scheme == "hermite-simpson":
        for x, rate, scale in ((q, v, POSITION_SCALE), (v, a, VELOCITY_SCALE)):
            left, middle, right = x[:, :-1:2], x[:, 1::2], x[:, 2::2]
            out, centre, into = rate[:, :-1:2], rate[:, 1::2], rate[:, 2::2]
            nlp.program.require(
                right - left - h / 6.0 * (out + 4.0 * centre + into), scale
            )
            nlp.program.require(
                middle - (left + right) / 2.0 - h / 8.0 * (out - into), scale
            )
        return
    mean_a = (
        a[:, :-1] if nlp.problem.scheme == "paper" else (a[:, :-1] + a[:, 1:]) / 2.0
    )
    nlp.program.require(
        q[:, 1:] - q[:, :-1] - h / 2.0 * (v[:, :-1] + v[:, 1:]), POSITION_SCALE
    )
    nlp.program.require(v[:, 1:] - v[:, :-1] - h * mean_a, VELOCITY_SCALE)


# --- Contact and impacts --------------------------------------------------------------


def _require_standing_feet_to_stand(nlp: Transcription, i: int) -> None:
    """Require d2 phi / dt2 = 0 of the standing feet at each point."""
    stride, (_, q, v, a, *_) = nlp.problem.stride, nlp.segments[i]
    if standing := contact_rows(stride.legs, stride.standing[i]):
        acceleration = nlp.model.contact_acceleration.map(q.shape[1])
        nlp.program.require(
            acceleration(q, v, a, nlp.design)[standing, :], ACCELERATION_SCALE
        )


def _join_to_segment_before(nlp: Transcription, i: int) -> None:
    """Require that q, tau and v do not jump between segments; where feet land, M (v+ -
    v-) = J^T Lambda, z = 0 and J v+ = 0.

    Before the first segment is the last one, with the legs of `Stride.then` and a
    stride's length behind.
    """
    problem, program, model, p = nlp.problem, nlp.program, nlp.model, nlp.design
    stride, here, before = problem.stride, nlp.segments[i], nlp.segments[i - 1]
    q, v, tau = here.q[:, 0], here.v[:, 0], here.tau[:, 0]
    q_before, v_before, tau_before = before.q[:, -1], before.v[:, -1], before.tau[:, -1]
    if i == 0:
        travelled = ca.vertcat(
            nlp.speed * sum(segment.T for segment in nlp.segments),
            ca.MX.zeros(stride.nq - 1),
        )
        q_before = q_before[stride.next_coordinates.tolist()] - travelled
        v_before = v_before[stride.next_coordinates.tolist()]
        tau_before = tau_before[stride.next_motors.tolist()]
    program.require(q - q_before, POSITION_SCALE)
    program.require(tau - tau_before, TORQUE_SCALE)
    landing = contact_rows(stride.legs, stride.touchdowns(i))
    if not landing:
        program.require(v - v_before, VELOCITY_SCALE)
        return
    program.require(model.impact(q_before, v_before, v, here.impulse, p), IMPULSE_SCALE)
    program.require(model.contact(q, p)[landing[1::2]], POSITION_SCALE)
    soles = model.contact_jacobian(q, p)[landing, :]
    program.require(soles @ v, VELOCITY_SCALE)
    if math.isfinite(problem.form.hardest_landing):
        program.within(soles @ v_before, problem.form.hardest_landing, VELOCITY_SCALE)


# --- Limits ---------------------------------------------------------------------------


def _limit_form(nlp: Transcription) -> None:
    """Limit the cycle's period, the impulse of landings, and in each stance its
    duration and how its feet share the load."""
    stride, form, program = nlp.problem.stride, nlp.problem.form, nlp.program
    duration = ca.sum1(ca.vertcat(*(segment.T for segment in nlp.segments)))
    period = duration / stride.cycles
    if form.greatest_impact < 1.0:
        # on the trunk's z, which carries all
        weight = nlp.model.gravity(nlp.segments[0].q[:, 0], nlp.design)[1]
        landing = sum(
            (ca.sum1(segment.impulse[1::2]) for segment in nlp.segments), ca.MX(0)
        )
        program.at_least_zero(
            form.greatest_impact * weight * duration - landing, IMPULSE_SCALE
        )
    if math.isfinite(form.longest_period):
        program.at_least_zero(form.longest_period - period, TIME_SCALE)
    for segment, feet in zip(nlp.segments, stride.standing, strict=True):
        if feet and form.least_duty > 0.0:
            program.at_least_zero(segment.T - form.least_duty * period, TIME_SCALE)
        if feet and form.greatest_share < 1.0:
            loads = (
                segment.force[contact_rows(stride.legs, feet)[1::2], :]
                @ nlp.problem.quadrature
            )
            program.at_least_zero(
                form.greatest_share * ca.sum1(loads) - loads,
                FORCE_SCALE,
            )


def _limit_release(nlp: Transcription, i: int) -> None:
    """Limit the speed at which springs extend as their feet lift off."""
    stride = nlp.problem.stride
    fastest = nlp.problem.form.fastest_release
    v = nlp.segments[i].v[:, -1]
    if math.isfinite(fastest) and stride.per_leg == 3:
        for leg in stride.liftoffs(i):
            rate = v[TRUNK + stride.per_leg * stride.legs.index(leg) + 2]
            nlp.program.at_least_zero(rate + fastest, VELOCITY_SCALE)


def _limit_friction(nlp: Transcription, i: int) -> None:
    """Require |F_x| <= mu F_z of standing feet, and of the impulses of landing ones."""
    stride = nlp.problem.stride
    mu = nlp.problem.hardware.friction
    *_, force, impulse = nlp.segments[i]
    for leg in stride.standing[i]:
        x, z = contact_rows(stride.legs, (leg,))
        # where the force is zero, there is no cone
        end = -1 if leg in stride.liftoffs(i) else None
        nlp.program.within(force[x, :end], mu * force[z, :end], FORCE_SCALE)
        if leg in stride.touchdowns(i):
            nlp.program.within(impulse[x], mu * impulse[z], IMPULSE_SCALE)


def _limit_swing(nlp: Transcription, i: int) -> None:
    """Keep swinging soles above a bump of height `clearance`, and below the form's
    highest step."""
    problem, stride, q = nlp.problem, nlp.problem.stride, nlp.segments[i].q
    height = nlp.model.contact.map(q.shape[1])(q, nlp.design)
    for leg in (leg for leg in stride.legs if leg not in stride.standing[i]):
        share = _swing_share(nlp, leg, i)
        # no slope at lift-off: feet leave at rest
        bump = problem.clearance * (4.0 * share * (1.0 - share)) ** 2
        # Where it has just left or is about to land, its height is zero anyway.
        begin = 1 if stride.stands(leg, i - 1) else 0
        end = -1 if stride.stands(leg, i + 1) else None
        sole = height[contact_rows(stride.legs, (leg,))[1], :]
        nlp.program.at_least_zero((sole - bump)[begin:end], POSITION_SCALE)
        if math.isfinite(problem.form.highest_step):
            nlp.program.at_least_zero(
                (problem.form.highest_step - sole)[begin:end], POSITION_SCALE
            )


def _swing_share(nlp: Transcription, leg: str, i: int) -> ca.MX:
    """Return the share of a leg's swing, from 0 to 1, that has gone by at each point of
    a segment in the midst of the swing."""
    T = [segment.T for segment in nlp.segments]

    def rest(at: int, step: int) -> ca.MX:
        """Time for which the leg goes on swinging, walking from segment to segment."""
        at += step
        return (
            ca.MX(0)
            if nlp.problem.stride.stands(leg, at)
            else T[at % len(T)] + rest(at, step)
        )

    before, after = rest(i, -1), rest(i, +1)
    return (before + T[i] * ca.DM(nlp.problem.points).T) / (before + T[i] + after)


def _limit_motors(nlp: Transcription, i: int) -> None:
    """Keep joint speeds within the margin, torques within the motors' envelope, and
    power within the bus's limits."""
    program, margin = nlp.program, nlp.problem.speed_margin
    stall, no_load = nlp.stall_torque, nlp.no_load_speed
    for speed, torque in _motor_states(nlp, i):
        program.within(speed, margin * no_load, VELOCITY_SCALE)
        program.within(torque, nlp.peak_torque, TORQUE_SCALE)
        _keep_below_line(program, stall, speed / no_load, torque)
        _limit_braking(nlp, speed, torque)
        _limit_bus(nlp, speed, torque)


def _keep_below_line(
    program: Program,
    stall: ca.MX,
    speed: ca.MX,
    torque: ca.MX,
    voltage: ca.MX | float = 1.0,
) -> None:
    """Require torque <= stall (voltage - speed), and the same in the other sense of
    turning; speed and voltage are shares."""
    program.at_least_zero(stall * (voltage - speed) - torque, TORQUE_SCALE)
    program.at_least_zero(stall * (voltage + speed) + torque, TORQUE_SCALE)


def _motor_states(nlp: Transcription, i: int) -> list[tuple[ca.MX, ca.MX]]:
    """Speeds and torques of the motors at the points and, where the polynomials bend in
    between, halfway as well."""
    T, _, v, a, tau, *_ = nlp.segments[i]
    qd, qdd = v[nlp.motors, :], a[nlp.motors, :]
    states = [(qd, tau)]
    if nlp.problem.scheme == "hermite-simpson":
        h = T / nlp.problem.intervals
        left, middle, right = tau[:, :-1:2], tau[:, 1::2], tau[:, 2::2]
        for s in (0.25, 0.75):
            speed, _ = hermite_and_rate(
                s, h, qd[:, :-1:2], qd[:, 2::2], qdd[:, :-1:2], qdd[:, 2::2]
            )
            states.append((speed, parabola(s, left, middle, right)))
    return states


def _limit_braking(nlp: Transcription, speed: ca.MX, torque: ca.MX) -> None:
    """Keep braking torque below a line that falls to zero at the braking speed, if the
    motors have a braking speed.

    Beyond that speed the line asks for driving torque, so a motor whose braking ends
    before its no-load speed is limited by more than it should be.
    """
    corner, end = (nlp.of_motors(name) for name in ("corner_speed", "braking_speed"))
    if np.any(np.isinf(np.array(end))):
        return
    stall = stall_torque(nlp.peak_torque, corner, end)
    _keep_below_line(nlp.program, stall, speed * nlp.gear / end, -torque)


def _limit_bus(nlp: Transcription, speed: ca.MX, torque: ca.MX) -> None:
    """Keep the power of all motors together within the bus's limits, and driving torque
    within what its voltage leaves.

    The voltage never rises: where power flows back, the envelope without sag, which
    holds anyway, is the narrower one.
    """
    program, losses, share = nlp.program, nlp.problem.hardware.losses, nlp.problem.share
    stall, no_load = nlp.stall_torque, nlp.no_load_speed
    power = ca.sum1(speed * torque + copper_loss(torque, no_load, stall))  # W
    if not (math.isinf(losses.bus_power_out) and math.isinf(losses.bus_power_in)):
        least, most = -share * losses.bus_power_in, share * losses.bus_power_out
        program.require(power, POWER_SCALE, least / POWER_SCALE, most / POWER_SCALE)
    if losses.bus_sag > 0.0:
        voltage = ca.repmat(
            1.0 - losses.bus_sag / share * power / 1e3, speed.shape[0], 1
        )
        _keep_below_line(program, stall, speed / no_load, torque, voltage)


def _limit_rates(nlp: Transcription, i: int) -> None:
    """Keep steps of torques and of standing feet's forces, from point to point, within
    the problem's rates."""
    problem, (T, *_, tau, force, _) = nlp.problem, nlp.segments[i]
    dt = T / (tau.shape[1] - 1)
    nlp.program.within(tau[:, 1:] - tau[:, :-1], problem.torque_rate * dt, TORQUE_SCALE)
    if standing := contact_rows(problem.stride.legs, problem.stride.standing[i]):
        steps = force[standing, 1:] - force[standing, :-1]
        nlp.program.within(steps, problem.force_rate * dt, FORCE_SCALE)


# --- Cost -----------------------------------------------------------------------------


def _mean_running_cost(nlp: Transcription, segment: Unknowns) -> ca.MX:
    """Mean of R (paper, Eq. R) over a segment; speeds and torques count as shares of
    the motors' greatest."""
    weights = nlp.problem.weights
    speed = segment.v[nlp.motors, :] / nlp.no_load_speed
    torque = segment.tau / nlp.peak_torque
    load = segment.force / weights.force
    R = weights.power * ca.sum1((speed * torque) ** 2) + weights.load * (
        ca.sum1(torque**2) + ca.sum1(load**2)
    )
    mean = R @ nlp.problem.quadrature
    steps = len(nlp.problem.points) - 1
    for value in (torque, load):
        change = (value[:, 1:] - value[:, :-1]) * (
            steps * weights.smoothness_time / segment.T
        )
        mean += weights.smoothness * ca.sumsqr(change) / steps
    return mean


def _distance(nlp: Transcription, guess: Motion) -> ca.MX:
    """Mean square distance from the guess (rad, m, and relative durations), summed over
    the segments."""
    distance = ca.MX(0)
    for i, (T, q, *_) in enumerate(nlp.segments):
        away = (q - guess.q[i].T)[1:, :]
        distance += ca.sumsqr(away) / q.shape[1] + (T / guess.durations[i] - 1.0) ** 2
    return distance
