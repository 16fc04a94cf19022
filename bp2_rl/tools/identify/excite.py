"""Targets that move a hanging robot's joints so that a log tells its motors' numbers."""

import csv
import io

import numpy as np
from jaxtyping import Float

from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.robot_file import GainNumbers

STEP = 0.002  # s, between two targets
DURATION = 20.0  # s
CHIRPED = 0.6
"""Share of the time that the chirps take; square waves take the rest."""
SLOWEST, QUICKEST = 0.3, 10.0  # Hz, of the chirps
SQUARE = 1.0  # Hz, of abad of FR; each further joint's wave is a little quicker
SPEED = 0.6
"""Share of the no-load speed that a chirp reaches at most."""
MARGIN = 0.1  # rad, from the joints' stops
INSIDE = 0.6
"""Share of the way to the stops that the targets go; the joints overshoot."""


def excitation(
    hardware: HardwareSpec, gains: GainNumbers, duration: float = DURATION
) -> tuple[Float[np.ndarray, " T"], Float[np.ndarray, "T 12"]]:
    """Return the times (s) and joint targets (rad) of a chirp, then of square waves.

    A chirp alone leaves the no-load speed open: the square waves ask for more torque
    than the motors have, on all joints at phases of their own.
    """
    time = np.arange(0.0, duration, STEP)
    anatomy = hardware.anatomy
    low, high = np.array([leg.ranges for leg in anatomy.legs]).reshape(12, 2).T
    middle = np.clip(anatomy.stand, low + 0.5, high - 0.5)
    room = np.minimum(middle - low, high - middle) - MARGIN
    chirped = CHIRPED * duration
    rate = np.minimum(SLOWEST + (QUICKEST - SLOWEST) * time / chirped, QUICKEST)
    phase = 2.0 * np.pi * np.cumsum(rate) * STEP
    apart = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    no_load = np.broadcast_to(hardware.joint_no_load_speed, 12)
    least = SPEED * no_load / (2.0 * np.pi * rate[:, None])
    chirp = np.minimum(INSIDE * room, least) * np.sin(phase[:, None] + apart)
    peak = np.broadcast_to(hardware.joint_peak_torque, 12)
    stiffness = np.tile(np.broadcast_to(gains.stiffness, 3), 4)
    swing = np.minimum(INSIDE * room, 0.75 * peak / stiffness)
    quick = SQUARE * (1.0 + 0.13 * np.arange(12))
    square = swing * np.sign(np.sin(2.0 * np.pi * quick * time[:, None]))
    return time, middle + np.where(time[:, None] < chirped, chirp, square)


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
    writer.writerows(
        [f"{x:.6g}" for x in row] for row in np.stack([time, *own], axis=1)
    )
    return file.getvalue()
