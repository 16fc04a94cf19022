"""A quadruped in the sagittal plane as a MuJoCo model: the mechanics of `sagittal`,
with no line of code in common.

    M(q) a + h(q, v) = B u(tau, v) + tau_p(q, v) + J(q)^T F,        h = C + G

MuJoCo gives M, h, the feet's Jacobian J and the derivative of it; the passive forces
tau_p of springs, stops and air, and what reaches the joints of the motors' torque, u,
are closed forms. Coordinates, contact coordinates phi and the orders of all of them are
those of `sagittal`. Links have their places and inertias in space; the joints alone
make the model planar.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from bp2_rl.optimiser import verifier_laws
from bp2_rl.optimiser.problem import (
    STOP_ROUNDING,
    Problem,
    motor_coordinates,
    per_leg,
    spring_coordinates,
)
from bp2_rl.robot import conventions
from bp2_rl.robot.anatomy import Leg, Link, Vector
from bp2_rl.robot.hardware import HardwareSpec

Y_AXIS, UP = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


class Terms(NamedTuple):
    """Terms of the equations of motion in one state; n coordinates, c contact
    coordinates."""

    mass: Float[np.ndarray, "n n"]  # M
    bias: Float[np.ndarray, " n"]  # h = C + G
    # tau_p: springs, their damping, friction and stops, and drag
    passive: Float[np.ndarray, " n"]
    contact: Float[np.ndarray, " c"]  # phi, m: (x, z) of each foot
    jacobian: Float[np.ndarray, "c n"]  # J
    convective: Float[np.ndarray, " c"]  # dJ/dt v, m/s2


class PlanarModel:
    """MuJoCo model of some legs and their share of the trunk, in the plane; left legs
    stand for the right ones.

    Args:
        legs: names; those that begin with F are at the front, the others behind.
        hardware: the parameters of the body.
        foot_radius: m, in place of the robot's own; 0 for a point.
        rotor_coupling: whether rotors turn with the links that hold them, too.
    """

    def __init__(
        self,
        legs: tuple[str, ...],
        hardware: HardwareSpec,
        foot_radius: float | None = None,
        rotor_coupling: bool = False,
    ):
        self.hardware = hardware
        self.share = len(legs) / len(conventions.LEGS)  # of the robot that the model is
        self.motors = motor_coordinates(legs, per_leg(hardware))
        self.springs = (
            spring_coordinates(legs) if hardware.anatomy.sprung else np.zeros(0, int)
        )
        self._rounding = STOP_ROUNDING * hardware.size.length
        self._model = _build_spec(legs, hardware, rotor_coupling).compile()
        self._data = mujoco.MjData(self._model)
        # body, centre in its frame, radius
        self._feet: list[tuple[int, tuple[float, float, float], float]] = []
        for name in legs:
            leg = _leg(hardware, name)
            radius = leg.foot_radius if foot_radius is None else foot_radius
            part, top = ("shank", 0.0) if leg.toe is None else ("toe", leg.seat[2])
            centre = (0.0, leg.foot[1], leg.foot[2] - leg.foot_radius + radius - top)
            self._feet.append((self._model.body(f"{name}_{part}").id, centre, radius))
        self.weight = float(np.sum(self._model.body_mass)) * conventions.GRAVITY  # N

    @classmethod
    def of(cls, problem: Problem) -> "PlanarModel":
        """Build the model of a problem's robot."""
        return cls(
            problem.stride.legs,
            problem.hardware,
            problem.foot_radius,
            problem.rotor_coupling,
        )

    def terms(self, q: Float[np.ndarray, " n"], v: Float[np.ndarray, " n"]) -> Terms:
        """Compute the terms of the equations of motion at coordinates `q` and
        velocities `v`."""
        model, data = self._model, self._data
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        phi, J, Jdot = (
            np.concatenate(parts)
            for parts in zip(*(self._foot(*foot) for foot in self._feet), strict=True)
        )
        return Terms(mass, data.qfrc_bias.copy(), self.passive(q, v), phi, J, Jdot @ v)

    def passive(
        self, q: Float[np.ndarray, " n"], v: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Return the passive forces tau_p: linear springs and dampers, slides, rounded
        one-sided stops at both ends of travel, and drag."""
        hardware, s, rate = self.hardware, q[self.springs], v[self.springs]
        force = np.zeros_like(q)
        force[:1] = verifier_laws.drag(hardware, self.share, v[:1])
        force[self.springs] = (
            hardware.rebound_stiffness * _ramp(-s, self._rounding)
            - hardware.spring_stop_stiffness
            * _ramp(s - hardware.spring_travel, self._rounding)
            - hardware.spring_stiffness * s
            - self.damping(s) * rate
            + verifier_laws.slide_friction(hardware, rate)
        )
        return force

    def damping(
        self, s: Float[np.ndarray, "... springs"]
    ) -> Float[np.ndarray, "... springs"]:
        """Return the damping of springs at compressions s, N s/m: the spring's, plus
        the rebound stop's near s = 0."""
        hold = _ramp(-s, self._rounding) / np.hypot(s, self._rounding)
        return self.hardware.spring_damping + self.hardware.rebound_damping * hold

    def dissipation(
        self,
        q: Float[np.ndarray, "k n"],
        v: Float[np.ndarray, "k n"],
        tau: Float[np.ndarray, "k motors"],
    ) -> Float[np.ndarray, " k"]:
        """Return the power, W, that springs, slides, gears, joints and the air take in
        k states; headwind may give some."""
        rate, qd = v[:, self.springs], v[:, self.motors]
        springs = (
            self.damping(q[:, self.springs]) * rate**2
            - verifier_laws.slide_friction(self.hardware, rate) * rate
        )
        joints = (tau - verifier_laws.joint_torque(self.hardware, qd, tau)) * qd
        air = -verifier_laws.drag(self.hardware, self.share, v[:, 0]) * v[:, 0]
        return np.sum(springs, axis=1) + np.sum(joints, axis=1) + air

    def accelerate(
        self,
        q: Float[np.ndarray, " n"],
        v: Float[np.ndarray, " n"],
        tau: Float[np.ndarray, " motors"],
        rows: list[int],
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " held"]]:
        """Acceleration, and forces (N) that keep the contact coordinates `rows`
        unaccelerated.

        [M  -J^T] [a]   [B u + tau_p - h]
        [J   0  ] [F] = [    -dJ/dt v     ]
        """
        terms = self.terms(q, v)
        push = terms.passive - terms.bias
        push[self.motors] += verifier_laws.joint_torque(
            self.hardware, v[self.motors], tau
        )
        return _solve_with_contact(
            terms.mass, terms.jacobian[rows], push, -terms.convective[rows]
        )

    def land(
        self, q: Float[np.ndarray, " n"], v: Float[np.ndarray, " n"], rows: list[int]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " held"]]:
        """Velocity after an inelastic impact, and the impulses (N s) that stop the
        contact coordinates `rows`.

        [M  -J^T] [ v+   ]   [M v-]
        [J   0  ] [Lambda] = [ 0  ]
        """
        terms = self.terms(q, v)
        return _solve_with_contact(
            terms.mass, terms.jacobian[rows], terms.mass @ v, np.zeros(len(rows))
        )

    def _foot(
        self, body: int, place: tuple[float, float, float], r: float
    ) -> tuple[
        Float[np.ndarray, "2"], Float[np.ndarray, "2 n"], Float[np.ndarray, "2 n"]
    ]:
        """Return a foot's place on the ground, the place's Jacobian and its derivative.

        The place is phi = (x_c - r alpha, z_c - r).
        """
        model, data = self._model, self._data
        centre = data.xpos[body] + data.xmat[body].reshape(3, 3) @ place
        point, rotation, point_rate = (np.zeros((3, model.nv)) for _ in range(3))
        mujoco.mj_jac(model, data, point, rotation, centre, body)
        mujoco.mj_jacDot(model, data, point_rate, None, centre, body)
        roll = r * rotation[1]  # all axes are y: alpha is a sum of coordinates
        phi = np.array([centre[0] - roll @ data.qpos, centre[2] - r])
        return phi, np.stack([point[0] - roll, point[2]]), point_rate[[0, 2]]


def _build_spec(
    legs: tuple[str, ...], hardware: HardwareSpec, rotor_coupling: bool
) -> mujoco.MjSpec:
    """Return the planar model's spec: a trunk on two slides and a hinge, with abduction
    links fixed to it, thighs, shanks and toes."""
    spec, anatomy = mujoco.MjSpec(), hardware.anatomy
    spec.option.gravity = np.array([0.0, 0.0, -conventions.GRAVITY])
    # A rotor is an armature of its joint, or, if it turns with the link that holds it,
    # of a tendon along its own angle.
    rotors = np.array(np.broadcast_to(hardware.rotor_inertia, 3), float)
    _, hip, knee = np.zeros(3) if rotor_coupling else rotors * hardware.gear_ratio**2
    share = len(legs) / len(conventions.LEGS)
    trunk = _add_body(
        spec.worldbody,
        "trunk",
        (0.0, 0.0, 0.0),
        anatomy.trunk,
        share * hardware.mass_scale,
    )
    _add_slide(trunk, "x", (1.0, 0.0, 0.0))
    _add_slide(trunk, "z", (0.0, 0.0, 1.0))
    _add_hinge(trunk, "pitch", 0.0)
    for name in legs:
        leg = _leg(hardware, name)
        abad = _add_body(
            trunk, f"{name}_abad", leg.anchor, leg.abad, hardware.mass_scale
        )
        thigh = _add_body(
            abad, f"{name}_thigh", leg.hip, leg.thigh, hardware.mass_scale
        )
        shank = _add_body(
            thigh, f"{name}_shank", leg.knee, leg.shank, hardware.mass_scale
        )
        _add_hinge(thigh, f"{name}_hip", hip)
        _add_hinge(shank, f"{name}_knee", knee)
        if leg.toe is not None:
            _add_slide(
                _add_body(shank, f"{name}_toe", leg.seat, leg.toe, hardware.mass_scale),
                f"{name}_spring",
                UP,
            )
        if rotor_coupling:
            _add_rotor(spec, hardware, f"{name}_hip", ("pitch",))
            _add_rotor(spec, hardware, f"{name}_knee", ("pitch", f"{name}_hip"))
    if rotor_coupling:  # a link's inertia in Table S3 is that of its rotor, too
        for body in spec.bodies[1:]:
            held = (
                len(legs) if body.name == "trunk" else int(body.name.endswith("thigh"))
            )
            body.fullinertia = np.asarray(body.fullinertia) - held * rotors[
                0
            ] * np.array([1, 1, 1, 0, 0, 0])
    return spec


def _leg(hardware: HardwareSpec, name: str) -> Leg:
    """Return the left leg at the end of the trunk that a leg's name tells."""
    return hardware.anatomy.legs[1] if name[0] == "F" else hardware.anatomy.legs[3]


def _add_body(
    parent: mujoco.MjsBody, name: str, at: Vector, link: Link, scale: float
) -> mujoco.MjsBody:
    """Add a link at a place in its parent's frame, m, with a share or multiple of its
    mass."""
    return parent.add_body(
        name=name,
        pos=at,
        mass=scale * link.mass,
        fullinertia=[scale * inertia for inertia in link.inertia],
        ipos=link.com,
        explicitinertial=True,
    )


def _add_slide(
    body: mujoco.MjsBody, name: str, axis: tuple[float, float, float]
) -> None:
    body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)


def _add_hinge(body: mujoco.MjsBody, name: str, armature: float) -> None:
    body.add_joint(
        name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=Y_AXIS, armature=armature
    )


def _add_rotor(
    spec: mujoco.MjSpec, hardware: HardwareSpec, joint: str, held: tuple[str, ...]
) -> None:
    """Add a rotor whose angle is its link's angle, the sum of the joints `held`, plus
    gear times joint."""
    tendon = spec.add_tendon(
        name=f"{joint}_rotor", armature=hardware.parameter("rotor_inertia")
    )
    tendon.wrap_joint(joint, hardware.gear_ratio)
    for angle in held:
        tendon.wrap_joint(angle, 1.0)


def _solve_with_contact(
    mass: Float[np.ndarray, "n n"],
    jacobian: Float[np.ndarray, "held n"],
    push: Float[np.ndarray, " n"],
    contact: Float[np.ndarray, " held"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " held"]]:
    """Solve M x = push + J^T f and J x = contact, and return x and the multiplier f."""
    nothing = np.zeros((len(jacobian), len(jacobian)))
    system = np.block([[mass, -jacobian.T], [jacobian, nothing]])
    found = np.linalg.solve(system, np.concatenate([push, contact]))
    return found[: len(mass)], found[len(mass) :]


def _ramp(
    u: Float[np.ndarray, "... springs"], rounding: float
) -> Float[np.ndarray, "... springs"]:
    """max(u, 0) with its corner rounded."""
    return (u + np.sqrt(u**2 + rounding**2)) / 2.0
