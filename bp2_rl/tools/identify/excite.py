"""Targets that move a hanging robot's joints so that a log tells its motors' numbers."""

import csv
import io

import numpy as np
from jaxtyping import Float

from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.robot_file import GainNumbers

STEP = 0.002  # s, between two targets
DURATION = 24.0  # s
EASED = 2.0  # s, in which the targets leave the stand, and come back to it
CHIRPED = 0.6
"""Share of the time that the chirps take; square waves take the rest."""
SLOWEST, QUICKEST = 0.3, 10.0  # Hz, of the chirps
SQUARES = (0.9, 1.17, 1.37)  # Hz, of abad, hip and knee
PHASES = (0.0, 2.1, 4.2)  # rad, of their chirps
SPEED = 0.6
"""Share of the no-load speed that a chirp reaches at most."""
INSIDE = 0.55
"""Share of the way to the stops that the targets go; the joints overshoot."""


def excitation(
    hardware: HardwareSpec, gains: GainNumbers, duration: float = DURATION
) -> tuple[Float[np.ndarray, " T"], Float[np.ndarray, "T 12"]]:
    """Return the times (s) and joint targets (rad) of a chirp, then of square waves.

    A chirp alone leaves the no-load speed open: the square waves jump by as much as
    asks for the motors' peak torque, where the joints' ranges allow it. All legs move
    alike, so that they do not meet.
    """
    time = np.arange(0.0, duration, STEP)
    anatomy = hardware.anatomy
    low, high = np.array([leg.ranges for leg in anatomy.legs]).reshape(12, 2).T
    stand = np.array(anatomy.stand)
    quarter = 0.25 * (high - low)
    middle = np.clip(stand, low + quarter, high - quarter)
    room = INSIDE * np.minimum(middle - low, high - middle)
    room = np.tile(np.min(room.reshape(4, 3), axis=0), 4)
    chirped = CHIRPED * duration
    rate = np.minimum(SLOWEST + (QUICKEST - SLOWEST) * time / chirped, QUICKEST)[
        :, None
    ]
    phase = 2.0 * np.pi * np.cumsum(rate, axis=0) * STEP + np.tile(PHASES, 4)
    no_load = np.broadcast_to(hardware.joint_no_load_speed, 12)
    chirp = np.minimum(room, SPEED * no_load / (2.0 * np.pi * rate)) * np.sin(phase)
    peak = np.broadcast_to(hardware.joint_peak_torque, 12)
    stiffness = np.tile(np.broadcast_to(gains.stiffness, 3), 4)
    swing = np.minimum(room, 0.75 * peak / stiffness)
    square = swing * np.sign(np.sin(2.0 * np.pi * np.tile(SQUARES, 4) * time[:, None]))
    moved = middle + np.where(time[:, None] < chirped, chirp, square)
    share = np.clip(np.minimum(time, time[-1] - time) / EASED, 0.0, 1.0)[:, None]
    return time, stand + share * (moved - stand)


def excitation_text(hardware: HardwareSpec, gains: GainNumbers) -> str:
    """Return the excitation as text of a .csv file, in the robot's own joint names, signs
    and zeros."""
    time, targets = excitation(hardware, gains)
    joints = hardware.anatomy.joints
    own = [
        (column - joint.offset) * joint.sign
        for column, joint in zip(targets.T, joints, strict=True)
    ]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["time", *(f"q_target.{joint.name}" for joint in joints)])
    rows = np.stack([time, *own], axis=1)
    writer.writerows([f"{x:.6g}" for x in row] for row in rows)
    return file.getvalue()
