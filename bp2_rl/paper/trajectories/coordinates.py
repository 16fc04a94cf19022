"""Decompose a motion in other coordinates: absolute angles of the links instead of
angles of the joints.

What of an inertial torque is main and what is coupled is no fact about the robot, but
about its coordinates. A constant change q = T q' gives

    M' = T^T M T,    a' = T^-1 a,    Q' = T^T Q

for mass matrix, accelerations and every force. The motion, the powers Q^T v and the
trunk's rows of x and z stay what they are; M'_ii a'_i does not. Only `decompose_links`
needs CasADi.
"""

import numpy as np
from jaxtyping import Float

from bp2_rl.optimiser.problem import PER_LEG, TRUNK
from bp2_rl.optimiser.solution import Solution
from bp2_rl.paper.trajectories.decomposition import (
    TERMS,
    Decomposition,
    decompose,
    evaluate,
    split_inertia,
)

LINKS = {"hip": "thigh", "knee": "lower-leg"}
"""Whose absolute angle stands for a joint's."""


def joints_of_links(legs: tuple[str, ...]) -> Float[np.ndarray, "n n"]:
    """T of q = T q': a hip is its thigh's angle less the trunk's pitch, a knee the
    lower leg's less the thigh's."""
    T = np.eye(TRUNK + PER_LEG * len(legs))
    for hip in range(TRUNK, len(T), PER_LEG):
        T[hip, TRUNK - 1] = T[hip + 1, hip] = -1.0
    return T


def decompose_links(solution: Solution) -> Decomposition:
    """`decompose` in absolute angles of the links; a thigh's torque is its hip's less
    its knee's.

    Raises:
        UserError: CasADi is not installed.
    """
    from bp2_rl.optimiser import sagittal  # here alone, as in `decompose`

    joints = decompose(solution)
    problem, motion = joints.cycle.problem, joints.cycle.motion
    p, model = sagittal.design_vector(problem.hardware), sagittal.model_of(problem)
    T = joints_of_links(joints.legs)

    q, v, a = (x.reshape(-1, x.shape[-1]) for x in (motion.q, motion.v, motion.a))
    forces = joints.forces @ T
    forces[:2] = split_inertia(
        T.T @ evaluate(model.mass, q, p) @ T, a @ np.linalg.inv(T).T
    )

    # C is quadratic in v, so what remains with one rate alone is its centrifugal part.
    centrifugal, coriolis = TERMS.index("centrifugal"), TERMS.index("Coriolis")
    both, rates = forces[centrifugal] + forces[coriolis], v @ np.linalg.inv(T).T
    forces[centrifugal] = 0.0
    for i, column in enumerate(T.T):
        alone = rates[:, i : i + 1] * column
        C = evaluate(model.centrifugal, q, alone, p) + evaluate(
            model.coriolis, q, alone, p
        )
        forces[centrifugal] += C[..., 0] @ T
    forces[coriolis] = both - forces[centrifugal]

    at = motion.q[:, 0]
    jump = motion.v[:, 0] - np.roll(motion.v[:, -1], 1, axis=0)
    impulses = joints.impulses @ T
    impulses[:2] = split_inertia(
        T.T @ evaluate(model.mass, at, p) @ T, jump @ np.linalg.inv(T).T
    )
    names = tuple(
        " ".join(LINKS.get(word, word) for word in name.split())
        for name in joints.coordinates
    )
    return Decomposition(joints.cycle, names, forces, impulses)
