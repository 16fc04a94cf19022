"""The gait of a run: stances, strides, springs, and the room between legs."""

import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from bp2_rl.robot import conventions
from bp2_rl.robot.clearance import Clearance, clearance
from bp2_rl.simulation.metrics import LegMetrics
from bp2_rl.simulation.trajectory import Trajectory

TOUCH_FORCE = 0.05  # of body weight: a foot that presses harder is on the ground ...
LIFT_FORCE = 0.02  # ... until it presses less than this
BOUNCE = 0.03  # s: a shorter loss of contact is a bounce, not a swing
SCUFF = 0.01  # s: a shorter contact is a scuff, not a stance
# samples whose clearances are computed at a time: so many stay in a processor's cache
CHUNK = 512


def contacts(run: Trajectory) -> Bool[np.ndarray, "N 4"]:
    """Return for each sample which feet are in stance, from their normal forces.

    There is hysteresis, and bounces and scuffs do not count.
    """
    weight = run.mass * conventions.GRAVITY
    force = run.foot_force[:, :, 2]
    decided = (force > TOUCH_FORCE * weight) | (force < LIFT_FORCE * weight)
    decided[0] = True
    last_decision = np.maximum.accumulate(
        np.where(decided, np.arange(len(run))[:, None], 0), axis=0
    )
    pressing = np.take_along_axis(force > TOUCH_FORCE * weight, last_decision, axis=0)
    for leg in range(4):
        pressing[:, leg] = _without_short_spells(
            pressing[:, leg], False, round(BOUNCE / run.dt)
        )
        pressing[:, leg] = _without_short_spells(
            pressing[:, leg], True, round(SCUFF / run.dt)
        )
    return pressing


def _without_short_spells(
    states: Bool[np.ndarray, " N"], value: bool, samples: int
) -> Bool[np.ndarray, " N"]:
    """Return the states with every inner spell of `value` that is shorter than
    `samples` flipped."""
    bounds = np.flatnonzero(np.diff(states)) + 1
    states = states.copy()
    for start, stop in itertools.pairwise(bounds):
        if states[start] == value and stop - start < samples:
            states[start:stop] = not value
    return states


def touchdowns(standing: Bool[np.ndarray, " N"]) -> np.ndarray:
    """Return the first sample of every spell of True, such as a stance, that begins
    within the run."""
    return np.flatnonzero(standing[1:] & ~standing[:-1]) + 1


def on_stop(run: Trajectory) -> Bool[np.ndarray, "N 4"]:
    """Return for each sample which springs press on their stops at full travel."""
    return run.spring_compression > run.hardware.spring_travel


def leg_room(run: Trajectory, samples: slice = slice(None)) -> Clearance:
    """Return the clearances between legs and between legs and trunk at each sample, m,
    also for legs that pass through each other."""
    joints = run.joint_position[samples].reshape(-1, 4, 3)
    compression = run.spring_compression[samples]
    chunks = (slice(start, start + CHUNK) for start in range(0, len(joints), CHUNK))
    parts = [
        clearance(joints[chunk], compression[chunk], run.hardware) for chunk in chunks
    ]
    return Clearance(*(np.concatenate(gaps) for gaps in zip(*parts, strict=True)))


def leg_metrics(run: Trajectory, steady: Trajectory) -> tuple[LegMetrics, ...]:
    """Compute each leg's gait over whole strides of the steady window, and its extremes
    over the run."""
    standing = contacts(steady)
    force = np.max(np.linalg.norm(run.foot_force, axis=-1), axis=0)
    compression = np.max(run.spring_compression, axis=0)
    stop = on_stop(run)
    legs = []
    for i, name in enumerate(conventions.LEGS):
        starts = touchdowns(standing[:, i])
        strides = (
            standing[starts[0] : starts[-1], i] if len(starts) > 1 else standing[:, i]
        )
        frequency = (
            (len(starts) - 1) / (len(strides) * run.dt) if len(starts) > 1 else None
        )
        legs.append(
            LegMetrics(
                name=name,
                duty_factor=float(np.mean(strides)),
                stride_frequency=frequency,
                peak_foot_force=float(force[i]),
                peak_spring_travel=float(compression[i]),
                on_stop=float(np.mean(stop[:, i])),
                stop_hits=int(stop[0, i]) + len(touchdowns(stop[:, i])),
            )
        )
    return tuple(legs)


def mean_stride_frequency(legs: Sequence[LegMetrics]) -> float | None:
    """Return the mean of the legs' stride frequencies, Hz; None without a stride."""
    frequencies = [
        leg.stride_frequency for leg in legs if leg.stride_frequency is not None
    ]
    return sum(frequencies) / len(frequencies) if frequencies else None


def evenness(
    steady: Trajectory, legs: Sequence[LegMetrics]
) -> tuple[float | None, float | None]:
    """Compute the left-right asymmetry of a gait in phase and in vertical impulse.

    Returns how far front and rear legs are from half a cycle between left and right
    (cycles, the greater of both), and which share of the vertical impulse one side has
    more than the other.

    A leg's phase is that of its vertical force's centroid on the circle of a stride.
    """
    frequency = mean_stride_frequency(legs)
    if frequency is None:
        return None, None
    force = steady.foot_force[:, :, 2]
    phase = np.angle(np.exp(-2j * np.pi * frequency * steady.time) @ force) / (
        2.0 * np.pi
    )
    right, left = slice(0, None, 2), slice(1, None, 2)
    apart = np.abs((phase[right] - phase[left]) % 1.0 - 0.5)
    sides = np.sum(force[:, right]), np.sum(force[:, left])
    return float(np.max(apart)), float(abs(sides[0] - sides[1]) / (sides[0] + sides[1]))
