"""The hybrid model of BP2 in the sagittal plane (paper, Eqs. continuous_dynamics and hybrid), in CasADi.

    M(q) a + C(q, v) + G(q) = B (tau - tau_r(v, tau)) + tau_p(q, v) + J(q)^T F        in stance and flight
    M(q) (v+ - v-) = J(q)^T Lambda,  q+ = q-                        at touchdown

Coordinates q: x, z and pitch of the trunk, then for every leg hip, knee and compression of the spring. They are
those of the MuJoCo model with abduction, roll and yaw held at zero: z up, angles about +y (nose down is positive, a
positive hip swings the foot back). C is centrifugal (terms in v_i^2) plus Coriolis (terms in v_i v_j).

Motors enter by their rotor inertia and gear ratio, as r^2 I_m on the joints' own diagonal. A rotor turns with the link
that holds it as well, the trunk or the thigh: `rotor_coupling` adds what that couples, r I_m between the joint and that
link's angle (paper, Fig. S1, "complete motor inertia model"), for rotors that turn in the joint's own sense.

A spring's stops push one way each, as in the MuJoCo model, but take hold over `STOP_ROUNDING`, as polynomials of some
milliseconds cannot follow a corner.

Of what a machine loses (`Losses`) the model has the air's drag on the trunk, the friction of the springs' slides,
both in tau_p, and what gears and joints take of a motor's torque tau, tau_r. Where they change sign, friction and
gears' losses are as smooth as the stops (`JOINT_ROUNDING` and so on). It knows no current lag, no latency, no legs
that collide and no soft ground.

A foot is a sphere: it rolls. Its contact coordinates are phi = (x_c - r alpha, z_c - r) with the sphere's centre c and
the lower leg's angle alpha, so phi fixed is rolling without slip; `foot_radius = 0` is the paper's point foot.

Forces and contact coordinates stand in the order (x, z) of the first leg, (x, z) of the second, and so on.
"""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from bp2_rl.base.errors import not_installed
from bp2_rl.optimiser.links import LegLinks, down_link, hip_fore_aft, leg_bodies, leg_links
from bp2_rl.optimiser.problem import (
    GEAR_ROUNDING,
    JOINT_ROUNDING,
    PER_LEG,
    SLIDE_ROUNDING,
    STOP_ROUNDING,
    TRUNK,
    Problem,
    motor_coordinates,
    spring_coordinates,
)
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.hardware import IDEAL, HardwareSpec, Losses

try:
    import casadi as ca
except ImportError as missing:
    raise not_installed("trajectory optimisation", "casadi", "trajopt") from missing


PITCH = TRUNK - 1
DESIGN = ("gear_ratio", "leg_length", "spring_stiffness")  # parameters of a robot that the model takes as arguments


@dataclasses.dataclass(frozen=True)
class SagittalModel:
    """The model's terms as CasADi functions; `p` is the design vector of `design_vector`.

    With n = 3 + 3 legs coordinates, u = 2 legs motors and c = 2 legs contact coordinates.
    """

    legs: tuple[str, ...]
    mass: ca.Function  # (q, p) -> M, n x n
    centrifugal: ca.Function  # (q, v, p) -> n
    coriolis: ca.Function  # (q, v, p) -> n
    gravity: ca.Function  # (q, p) -> G, n
    passive: ca.Function  # (q, v, p) -> tau_p, n: springs, their damping, friction and stops, and drag
    resistance: ca.Function  # (v, tau, p) -> tau_r, u: what gears and joints take of the motors' torques
    contact: ca.Function  # (q, p) -> phi, c
    contact_jacobian: ca.Function  # (q, p) -> J, c x n
    contact_acceleration: ca.Function  # (q, v, a, p) -> d2 phi / dt2, c
    residual: ca.Function  # (q, v, a, tau, F, p) -> M a + C + G - B (tau - tau_r) - tau_p - J^T F, n
    impact: ca.Function  # (q, v before, v after, Lambda, p) -> M (v+ - v-) - J^T Lambda, n


def design_vector(hardware: HardwareSpec) -> Float[np.ndarray, "3"]:
    """The hardware parameters that the model's functions take as their last argument."""
    return np.array([hardware.parameter(name) for name in DESIGN])


def model_of(problem: Problem) -> SagittalModel:
    """The model that a problem is about."""
    return build_model(problem.stride.legs, problem.hardware, problem.foot_radius, problem.rotor_coupling)


@functools.lru_cache(maxsize=8)
def build_model(
    legs: tuple[str, ...] = conventions.LEGS,
    hardware: HardwareSpec = IDEAL,
    foot_radius: float = bp2.FOOT_RADIUS,
    rotor_coupling: bool = False,
) -> SagittalModel:
    """The model of a trunk made of as many of Table S3's quarters as there are legs.

    Args:
        legs: names; those that begin with F are at the front, the others behind.
        hardware: everything but the design parameters, which are arguments of the functions.
        foot_radius: m; 0 for a point.
        rotor_coupling: whether rotors couple their joints to the links that hold them.
    """
    n = TRUNK + PER_LEG * len(legs)
    q, v, a = (ca.SX.sym(name, n) for name in "qva")
    p = ca.SX.sym("p", len(DESIGN))
    gear_ratio, leg_length, stiffness = (p[i] for i in range(len(DESIGN)))
    tau, force = ca.SX.sym("tau", 2 * len(legs)), ca.SX.sym("F", 2 * len(legs))

    M, Jdot_v, weight = ca.SX.zeros(n, n), ca.SX.zeros(n), ca.SX.zeros(n)
    for mass, inertia, position, angle in _bodies(legs, q, leg_length, hardware):
        J, J_angle = ca.jacobian(position, q), ca.jacobian(angle, q)
        M += hardware.mass_scale * (mass * J.T @ J + inertia * J_angle.T @ J_angle)  # angles are linear in q
        Jdot_v += hardware.mass_scale * mass * J.T @ ca.jtimes(J @ v, q, v)
        weight += hardware.mass_scale * mass * conventions.GRAVITY * J[1, :].T
    M += _rotors(legs, gear_ratio, hardware, rotor_coupling)
    centrifugal = _centrifugal(ca.Function("C", [q, v, p], [Jdot_v]), q, v, p)
    motors = motor_coordinates(legs).tolist()
    # What a robot does not lose is zero, and CasADi leaves it out.
    passive = _passive_forces(legs, q, v, stiffness, hardware)
    resistance = _resistance(v[motors], tau, hardware.losses)

    phi = ca.vertcat(*(_contact(legs, leg, q, leg_length, foot_radius) for leg in range(len(legs))))
    J = ca.jacobian(phi, q)
    B = ca.SX(np.eye(n)[:, motors])
    v_after, impulse = ca.SX.sym("v_after", n), ca.SX.sym("impulse", 2 * len(legs))
    return SagittalModel(
        legs=legs,
        mass=ca.Function("M", [q, p], [M]),
        centrifugal=ca.Function("centrifugal", [q, v, p], [centrifugal]),
        coriolis=ca.Function("coriolis", [q, v, p], [Jdot_v - centrifugal]),
        gravity=ca.Function("G", [q, p], [weight]),
        passive=ca.Function("passive", [q, v, p], [passive]),
        resistance=ca.Function("resistance", [v, tau, p], [resistance]),
        contact=ca.Function("phi", [q, p], [phi]),
        contact_jacobian=ca.Function("J", [q, p], [J]),
        contact_acceleration=ca.Function("phi_dd", [q, v, a, p], [J @ a + ca.jtimes(J @ v, q, v)]),
        residual=ca.Function(
            "residual",
            [q, v, a, tau, force, p],
            [M @ a + Jdot_v + weight - B @ (tau - resistance) - passive - J.T @ force],
        ),
        impact=ca.Function("impact", [q, v, v_after, impulse, p], [M @ (v_after - v) - J.T @ impulse]),
    )


def _bodies(
    legs: Sequence[str], q: ca.SX, leg_length: ca.SX, hardware: HardwareSpec
) -> list[tuple[float, float, ca.SX, ca.SX]]:
    """Mass (kg), inertia (kg m2), centre of mass (x, z) and angle of every body."""
    quarters = len(legs)
    bodies = [
        (quarters * hardware.bp2.trunk_quarter_mass, quarters / 4.0 * hardware.bp2.trunk_pitch_inertia, q[0:2], q[2])
    ]
    for leg in range(len(legs)):
        links, compression = _leg(legs, leg, q, leg_length)
        for mass, inertia, centre, angle in leg_bodies(ca, links, leg_length - compression, hardware):
            bodies.append((mass, inertia, ca.vertcat(*centre), angle))
    return bodies


def _rotors(legs: tuple[str, ...], gear_ratio: ca.SX, hardware: HardwareSpec, coupled: bool) -> ca.SX:
    """What the motors' rotors add to M; `coupled` to the links that hold them, too."""
    n = TRUNK + PER_LEG * len(legs)
    added, own = ca.SX.zeros(n, n), hardware.rotor_inertia * gear_ratio**2
    for motor in motor_coordinates(legs).tolist():
        added[motor, motor] = own
    hips = range(TRUNK, n, PER_LEG) if coupled else ()
    for hip in hips:  # whose motor the trunk holds; the thigh, which pitch and hip turn, holds the knee's
        for motor, angle in ((hip, PITCH), (hip + 1, PITCH), (hip + 1, hip)):
            added[motor, angle] = added[angle, motor] = hardware.rotor_inertia * gear_ratio
    return added


def _centrifugal(C: ca.Function, q: ca.SX, v: ca.SX, p: ca.SX) -> ca.SX:
    """C is quadratic in v, so what remains with one v_i alone is its centrifugal part."""
    n = v.shape[0]
    centrifugal = ca.SX.zeros(n)
    for i in range(TRUNK - 1, n):  # the trunk's translation is not in C
        alone = ca.SX.zeros(n)
        alone[i] = v[i]
        centrifugal += C(q, alone, p)
    return centrifugal


def _passive_forces(legs: tuple[str, ...], q: ca.SX, v: ca.SX, stiffness: ca.SX, hardware: HardwareSpec) -> ca.SX:
    """tau_p: the air's drag, and the springs with their damping, friction and stops."""
    losses = hardware.losses
    passive = ca.SX.zeros(TRUNK + PER_LEG * len(legs))
    air = v[0] + losses.headwind
    passive[0] = (
        -0.5 * conventions.AIR_DENSITY * losses.drag_area * len(legs) / len(conventions.LEGS) * ca.fabs(air) * air
    )
    for spring in spring_coordinates(legs).tolist():
        s, rate = q[spring], v[spring]
        stops = _ramp(-s) - _ramp(s - hardware.spring_travel)
        passive[spring] = -stiffness * s - hardware.spring_damping * rate + hardware.spring_stop_stiffness * stops
        # The stop at no compression may be another part.
        passive[spring] += (hardware.rebound_stiffness - hardware.spring_stop_stiffness) * _ramp(-s)
        passive[spring] -= hardware.rebound_damping * _ramp_slope(-s) * rate
        passive[spring] -= losses.spring_friction * ca.tanh(rate / SLIDE_ROUNDING)
    return passive


def _resistance(joint_velocity: ca.SX, tau: ca.SX, losses: Losses) -> ca.SX:
    """tau_r: what gears and joints take of the motors' torques."""
    turning, load = ca.tanh(joint_velocity / JOINT_ROUNDING), tau * ca.tanh(tau / GEAR_ROUNDING)
    return (losses.joint_friction + (1.0 - losses.gear_efficiency) * load) * turning + (
        losses.joint_viscosity * joint_velocity
    )


def _contact(legs: Sequence[str], leg: int, q: ca.SX, leg_length: ca.SX, radius: float) -> ca.SX:
    """phi of one foot, m."""
    links, compression = _leg(legs, leg, q, leg_length)
    centre = down_link(ca, links.knee, links.lower, leg_length - compression - radius)
    return ca.vertcat(*centre) - ca.vertcat(radius * links.lower, radius)


def _leg(legs: Sequence[str], leg: int, q: ca.SX, leg_length: ca.SX) -> tuple[LegLinks, ca.SX]:
    """The links, and the spring's compression."""
    hip, knee, compression = (q[TRUNK + PER_LEG * leg + i] for i in range(PER_LEG))
    return leg_links(ca, (q[0], q[1], q[2]), hip_fore_aft(legs[leg]), (hip, knee), leg_length), compression


def _ramp(u: ca.SX) -> ca.SX:
    """max(u, 0) with its corner rounded."""
    return (u + ca.sqrt(u**2 + STOP_ROUNDING**2)) / 2.0


def _ramp_slope(u: ca.SX) -> ca.SX:
    """The derivative of `_ramp`: from 0 to 1 around u = 0."""
    return (1.0 + u / ca.sqrt(u**2 + STOP_ROUNDING**2)) / 2.0
