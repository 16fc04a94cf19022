"""The first guess of a solve that starts from no other solution. This module does not
import CasADi."""

import numpy as np
from jaxtyping import Float

from bp2_rl.optimiser.links import hip_and_knee, hip_of, leg_of
from bp2_rl.optimiser.problem import TRUNK, Problem, Stride
from bp2_rl.optimiser.solution import Motion
from bp2_rl.robot import conventions


def cold_guess(problem: Problem, seed: int | None = None) -> Motion:
    """Return a guess with constant trunk speed, feet on arcs and half-sine forces; a
    seed varies all of these."""
    vary = (
        (lambda low, high: 1.0) if seed is None else np.random.default_rng(seed).uniform
    )
    stride, speed, size, anatomy = (
        problem.stride,
        problem.speed,
        problem.hardware.size,
        problem.hardware.anatomy,
    )
    stance = vary(0.8, 1.25) * min(0.6 * size.length / speed, 0.25 * size.time)
    flight = vary(0.8, 1.25) * 0.12 * size.time * speed / (speed + 2.0 * size.speed)
    height, lift = (
        vary(0.95, 1.05) * 1.42 * anatomy.leg_length,
        vary(0.7, 1.5) * 0.12 * size.length,
    )
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
