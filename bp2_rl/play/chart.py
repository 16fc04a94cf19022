"""Torque over speed of the twelve motors in the last moments, as a small SVG."""

from typing import Any

import numpy as np
from jaxtyping import Float

from bp2_rl.base.assets import render
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator, of_joint, torque_limits

# px, where the axes cross, and how far they reach right and up
CENTER, REACH = (164, 88), (130, -72)
EVERY = 5  # ms: of so many one is drawn
COLORS = {"abad": "#009E73", "hip": "#0072B2", "knee": "#E69F00"}


class TorqueSpeed:
    """The chart of a robot with these motors."""

    def __init__(self, motors: Actuator):
        no_load, peak = (
            float(np.max(np.asarray(limit)))
            for limit in (motors.no_load_speed, motors.peak_torque)
        )
        self._ends = np.array([1.4 * no_load, 1.15 * peak])  # of the axes, rad/s and Nm
        speeds = np.linspace(-self._ends[0], self._ends[0], 141)
        outlines: dict[str, None] = {}
        for joint in range(len(conventions.JOINTS)):
            low, high = torque_limits(of_joint(motors, joint), speeds)
            edge = np.stack([[*speeds, *speeds[::-1]], [*high, *low[::-1]]], axis=-1)
            # one for joints with the same motors
            outlines[" L".join(self._places(edge))] = None
        speed, torque = self._ends.tolist()
        self._fixed: dict[str, Any] = {
            "outlines": list(outlines),
            "no_load": no_load,
            "peak": peak,
            "speed": speed,
            "torque": torque,
            "center": CENTER,
            "reach": REACH,
        }

    def svg(self, worked: Float[np.ndarray, "N 2 12"]) -> str:
        """Speeds (rad/s) and torques (Nm) of the joints, as `Session.worked` has
        them."""
        samples = np.moveaxis(
            worked[::-EVERY].reshape(-1, 2, 4, len(conventions.JOINTS)), (3, 1), (0, 3)
        )
        dots = {
            joint: "".join(
                f"M{place}h0" for place in self._places(points.reshape(-1, 2))
            )
            for joint, points in zip(conventions.JOINTS, samples, strict=True)
        }
        return render("play/chart.svg", worked=dots, colors=COLORS, **self._fixed)

    def _places(self, points: Float[np.ndarray, "N 2"]) -> list[str]:
        """Return the places of points (rad/s, Nm) on the chart, px; a point beyond the
        chart is drawn on its edge."""
        places = np.array(CENTER) + np.array(REACH) * np.clip(
            points / self._ends, -1.0, 1.0
        )
        return [f"{x:.1f} {y:.1f}" for x, y in places.tolist()]
