"""The hybrid model of a quadruped in the sagittal plane (paper, Eqs.
continuous_dynamics and hybrid), in CasADi.

    M(q) a + C(q, v) + G(q) = B (tau - tau_r(v, tau)) + tau_p(q, v) + J(q)^T F        in stance and flight
    M(q) (v+ - v-) = J(q)^T Lambda,  q+ = q-                        at touchdown

Coordinates q: x, z and pitch of the trunk, then for every leg hip, knee and, unless the
shank is rigid, compression of the spring. They are those of the MuJoCo model with
abduction, roll and yaw held at zero: z up, angles about +y (nose down is positive, a
positive hip swings the foot back). C is centrifugal (terms in v_i^2) plus Coriolis
(terms in v_i v_j).

Motors enter by their rotor inertia and gear ratio, as r^2 I_m on the joints' own
diagonal. A rotor turns with the link that holds it as well, the trunk or the thigh:
`rotor_coupling` adds what that couples, r I_m between the joint and that link's angle
(paper, Fig. S1, "complete motor inertia model"), for rotors that turn in the joint's
own sense.

A spring's stops push one way each, as in the MuJoCo model, but take hold over
`STOP_ROUNDING`, as polynomials of some milliseconds cannot follow a corner.

Of what a machine loses (`Losses`) the model has the air's drag on the trunk, the
friction of the springs' slides, both in tau_p, and what gears and joints take of a
motor's torque tau, tau_r. Where they change sign, friction and gears' losses are as
smooth as the stops (`JOINT_ROUNDING` and so on). It knows no current lag, no latency,
no legs that collide and no soft ground.

A foot is a sphere: it rolls. Its contact coordinates are phi = (x_c - r alpha, z_c - r)
with the sphere's centre c and the lower leg's angle alpha, so phi fixed is rolling
without slip; `foot_radius = 0` is the paper's point foot.

Forces and contact coordinates stand in the order (x, z) of the first leg, (x, z) of the
second, and so on.
"""

import dataclasses
import functools

import numpy as np
from jaxtyping import Float

from bp2_rl.base.errors import not_installed
from bp2_rl.optimiser.links import leg_bodies, leg_links, leg_of, trunk_body
from bp2_rl.optimiser.problem import (
    GEAR_ROUNDING,
    JOINT_ROUNDING,
    SLIDE_ROUNDING,
    STOP_ROUNDING,
    TRUNK,
    Problem,
    motor_coordinates,
    per_leg,
    spring_coordinates,
)
from bp2_rl.robot import conventions
from bp2_rl.robot.hardware import IDEAL, HardwareSpec

try:
    import casadi as ca
except ImportError as missing:
    raise not_installed("trajectory optimisation", "casadi", "trajopt") from missing


PITCH = TRUNK - 1
DESIGN_PARAMETERS = ("gear_ratio", "leg_length", "spring_stiffness")
"""Parameters of a robot that the model takes as arguments; what hangs below a knee or a
spring follows the length."""


@dataclasses.dataclass(frozen=True)
class SagittalModel:
    """Terms of the equations of motion as CasADi functions; `p` is the vector of
    `design_vector`.

    With n = 3 + 3 legs coordinates, 3 + 2 legs with rigid shanks, u = 2 legs motors and
    c = 2 legs contact coordinates.
    """

    legs: tuple[str, ...]
    mass: ca.Function  # (q, p) -> M, n x n
    centrifugal: ca.Function  # (q, v, p) -> n
    coriolis: ca.Function  # (q, v, p) -> n
    gravity: ca.Function  # (q, p) -> G, n
    # (q, v, p) -> tau_p, n: springs, their damping, friction and stops, and drag
    passive: ca.Function
    # (v, tau, p) -> tau_r, u: what gears and joints take of the motors' torques
    resistance: ca.Function
    contact: ca.Function  # (q, p) -> phi, c
    contact_jacobian: ca.Function  # (q, p) -> J, c x n
    contact_acceleration: ca.Function  # (q, v, a, p) -> d2 phi / dt2, c
    # (q, v, a, tau, F, p) -> M a + C + G - B (tau - tau_r) - tau_p - J^T F, n
    residual: ca.Function
    # (q, v before, v after, Lambda, p) -> M (v+ - v-) - J^T Lambda, n
    impact: ca.Function


def design_vector(hardware: HardwareSpec) -> Float[np.ndarray, "3"]:
    """Return the hardware parameters that the model's functions take as their last
    argument."""
    return np.array(
        [hardware.gear_ratio, hardware.anatomy.leg_length, hardware.spring_stiffness]
    )


def model_of(problem: Problem) -> SagittalModel:
    """Return the sagittal model of a problem's robot and legs."""
    return build_model(
        problem.stride.legs,
        problem.hardware,
        problem.foot_radius,
        problem.rotor_coupling,
    )


@functools.lru_cache(maxsize=8)
def build_model(
    legs: tuple[str, ...] = conventions.LEGS,
    hardware: HardwareSpec = IDEAL,
    foot_radius: float | None = None,
    rotor_coupling: bool = False,
) -> SagittalModel:
    """Build the sagittal model of these legs and of their share of the trunk.

    Args:
        legs: names; those that begin with F are at the front, the others behind.
        hardware: everything but the design parameters, which are arguments of the
            functions.
        foot_radius: m, in place of the robot's own; 0 for a point.
        rotor_coupling: whether rotors couple their joints to the links that hold them.
    """
    each = per_leg(hardware)
    n = TRUNK + each * len(legs)
    q, v, a = (ca.SX.sym(name, n) for name in "qva")
    p = ca.SX.sym("p", len(DESIGN_PARAMETERS))
    gear_ratio, leg_length, stiffness = (p[i] for i in range(len(DESIGN_PARAMETERS)))
    tau, force = ca.SX.sym("tau", 2 * len(legs)), ca.SX.sym("F", 2 * len(legs))

    stretch = leg_length - hardware.anatomy.leg_length
    M, Jdot_v, weight = ca.SX.zeros(n, n), ca.SX.zeros(n), ca.SX.zeros(n)
    for mass, inertia, position, angle in _bodies(legs, q, stretch, hardware):
        J, J_angle = ca.jacobian(position, q), ca.jacobian(angle, q)
        # angles are linear in q
        M += hardware.mass_scale * (mass * J.T @ J + inertia * J_angle.T @ J_angle)
        Jdot_v += hardware.mass_scale * mass * J.T @ ca.jtimes(J @ v, q, v)
        weight += hardware.mass_scale * mass * conventions.GRAVITY * J[1, :].T
    M += _rotors(legs, gear_ratio, hardware, rotor_coupling)
    centrifugal = _centrifugal(ca.Function("C", [q, v, p], [Jdot_v]), q, v, p)
    motors = motor_coordinates(legs, each).tolist()
    # What a robot does not lose is zero, and CasADi leaves it out.
    passive = _passive_forces(legs, q, v, stiffness, hardware)
    resistance = _resistance(v[motors], tau, hardware)

    phi = ca.vertcat(
        *(
            _contact(legs, leg, q, stretch, hardware, foot_radius)
            for leg in range(len(legs))
        )
    )
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
        contact_acceleration=ca.Function(
            "phi_dd", [q, v, a, p], [J @ a + ca.jtimes(J @ v, q, v)]
        ),
        residual=ca.Function(
            "residual",
            [q, v, a, tau, force, p],
            [M @ a + Jdot_v + weight - B @ (tau - resistance) - passive - J.T @ force],
        ),
        impact=ca.Function(
            "impact", [q, v, v_after, impulse, p], [M @ (v_after - v) - J.T @ impulse]
        ),
    )


def _bodies(
    legs: tuple[str, ...], q: ca.SX, stretch: ca.SX, hardware: HardwareSpec
) -> list[tuple[float, float, ca.SX, ca.SX]]:
    """Mass (kg), inertia (kg m2), centre of mass (x, z) and angle of every body."""
    bodies = [trunk_body(ca, hardware.anatomy, legs, (q[0], q[1], q[2]))]
    for i, name in enumerate(legs):
        leg = leg_of(hardware.anatomy, name)
        joints, compression = _leg_coordinates(hardware, i, q)
        links = leg_links(ca, (q[0], q[1], q[2]), leg, joints, 0.0, stretch)
        bodies += leg_bodies(ca, leg, links, compression, stretch)
    return [
        (mass, inertia, ca.vertcat(*centre), angle)
        for mass, inertia, centre, angle in bodies
    ]


def _rotors(
    legs: tuple[str, ...], gear_ratio: ca.SX, hardware: HardwareSpec, coupled: bool
) -> ca.SX:
    """Return the rotors' share of the mass matrix M; `coupled` to the links that hold
    them, too."""
    each = per_leg(hardware)
    n = TRUNK + each * len(legs)
    added = ca.SX.zeros(n, n)
    rotors = np.broadcast_to(hardware.rotor_inertia, 3)[1:].tolist()
    for hip in range(TRUNK, n, each):
        for motor, rotor in zip((hip, hip + 1), rotors, strict=True):
            added[motor, motor] = rotor * gear_ratio**2
        # the trunk holds the hip's motor; the thigh, which pitch and hip turn, holds
        # the knee's
        if coupled:
            for motor, angle, rotor in (
                (hip, PITCH, 0),
                (hip + 1, PITCH, 1),
                (hip + 1, hip, 1),
            ):
                added[motor, angle] = added[angle, motor] = rotors[rotor] * gear_ratio
    return added


def _centrifugal(C: ca.Function, q: ca.SX, v: ca.SX, p: ca.SX) -> ca.SX:
    """Return the centrifugal part of C, which is quadratic in v: the terms that remain
    with one v_i alone."""
    n = v.shape[0]
    centrifugal = ca.SX.zeros(n)
    for i in range(TRUNK - 1, n):  # the trunk's translation is not in C
        alone = ca.SX.zeros(n)
        alone[i] = v[i]
        centrifugal += C(q, alone, p)
    return centrifugal


def _passive_forces(
    legs: tuple[str, ...], q: ca.SX, v: ca.SX, stiffness: ca.SX, hardware: HardwareSpec
) -> ca.SX:
    """tau_p: the air's drag, and the springs with their damping, friction and stops."""
    losses, size = hardware.losses, hardware.size
    passive = ca.SX.zeros(q.shape[0])
    air = v[0] + losses.headwind
    passive[0] = (
        -0.5
        * conventions.AIR_DENSITY
        * losses.drag_area
        * len(legs)
        / len(conventions.LEGS)
        * ca.fabs(air)
        * air
    )
    if not hardware.anatomy.sprung:
        return passive
    for spring in spring_coordinates(legs).tolist():
        s, rate = q[spring], v[spring]
        stops = _ramp(-s, size.length) - _ramp(s - hardware.spring_travel, size.length)
        passive[spring] = (
            -stiffness * s
            - hardware.spring_damping * rate
            + hardware.spring_stop_stiffness * stops
        )
        # The stop at no compression may be another part.
        passive[spring] += (
            hardware.rebound_stiffness - hardware.spring_stop_stiffness
        ) * _ramp(-s, size.length)
        passive[spring] -= (
            hardware.rebound_damping * _ramp_slope(-s, size.length) * rate
        )
        passive[spring] -= losses.spring_friction * ca.tanh(
            rate / (SLIDE_ROUNDING * size.speed)
        )
    return passive


def _resistance(joint_velocity: ca.SX, tau: ca.SX, hardware: HardwareSpec) -> ca.SX:
    """Return tau_r: the torques that gears and joints take from the motors' torques."""
    losses, size = hardware.losses, hardware.size
    turning = ca.tanh(joint_velocity / (JOINT_ROUNDING * size.rate))
    load = tau * ca.tanh(tau / (GEAR_ROUNDING * size.torque))
    friction, viscosity = (
        ca.DM(np.tile(np.broadcast_to(value, 3)[1:], tau.shape[0] // 2))
        for value in (losses.joint_friction, losses.joint_viscosity)
    )
    return (
        friction + (1.0 - losses.gear_efficiency) * load
    ) * turning + viscosity * joint_velocity


def _contact(
    legs: tuple[str, ...],
    index: int,
    q: ca.SX,
    stretch: ca.SX,
    hardware: HardwareSpec,
    radius: float | None,
) -> ca.SX:
    """Return the contact coordinates phi of a foot, m."""
    leg = leg_of(hardware.anatomy, legs[index])
    joints, compression = _leg_coordinates(hardware, index, q)
    radius = leg.foot_radius if radius is None else radius
    below = leg.lower_length + stretch - compression - radius
    links = leg_links(ca, (q[0], q[1], q[2]), leg, joints, below, stretch)
    return ca.vertcat(*links.foot) - ca.vertcat(radius * links.lower, radius)


def _leg_coordinates(
    hardware: HardwareSpec, index: int, q: ca.SX
) -> tuple[tuple[ca.SX, ca.SX], ca.SX]:
    """Hip and knee of a leg, and its spring's compression; zero where the shank is
    rigid."""
    first = TRUNK + per_leg(hardware) * index
    return (q[first], q[first + 1]), q[first + 2] if hardware.anatomy.sprung else ca.SX(
        0
    )


def _ramp(u: ca.SX, length: float) -> ca.SX:
    """max(u, 0) with its corner rounded, for a robot of this size."""
    return (u + ca.sqrt(u**2 + (STOP_ROUNDING * length) ** 2)) / 2.0


def _ramp_slope(u: ca.SX, length: float) -> ca.SX:
    """The derivative of `_ramp`: from 0 to 1 around u = 0."""
    return (1.0 + u / ca.sqrt(u**2 + (STOP_ROUNDING * length) ** 2)) / 2.0
