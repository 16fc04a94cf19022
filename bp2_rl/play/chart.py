"""Torque over speed of the twelve motors in the last moments, as a small SVG."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator, of_joint, torque_limits

WIDTH, HEIGHT = 300, 190  # px
LEFT, BOTTOM, TOP, RIGHT = 34, 30, 16, 6  # px, of the margins
EVERY = 5  # ms: of so many one is drawn
COLORS = {"abad": "#009E73", "hip": "#0072B2", "knee": "#E69F00"}
INK, QUIET, FAINT = "#1F2328", "#6E7781", "#E4E7EB"


class TorqueSpeed:
    """The chart of a robot with these motors."""

    def __init__(self, motors: Actuator):
        no_load, peak = (float(np.max(np.asarray(limit))) for limit in (motors.no_load_speed, motors.peak_torque))
        self._speed, self._torque = 1.4 * no_load, 1.15 * peak
        outlines = dict.fromkeys(self._outline(of_joint(motors, joint)) for joint in range(len(conventions.JOINTS)))
        self._head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="100%" '
            f'font-family="system-ui, sans-serif" font-size="10" fill="{QUIET}" data-chart="torque-speed">'
            f"{''.join(outlines)}{''.join(self._frame(no_load, peak))}"
        )

    def _outline(self, motor: Actuator) -> str:
        """Return a motor's envelope as an SVG element."""
        speeds = np.linspace(-self._speed, self._speed, 141)
        low, high = torque_limits(motor, speeds)
        edge = self._place(np.concatenate((speeds, speeds[::-1])), np.concatenate((high, low[::-1])))
        path = " L".join(f"{x} {y}" for x, y in zip(*edge, strict=True))
        return f'<path d="M{path}Z" fill="{FAINT}" stroke="{INK}" stroke-width="1"/>'

    def svg(self, worked: Float[np.ndarray, "N 2 12"]) -> str:
        """Speeds (rad/s) and torques (Nm) of the joints, as `Session.worked` has them."""
        samples = worked[::-EVERY].reshape(-1, 2, 4, len(conventions.JOINTS))
        x, y = self._place(samples[:, 0], samples[:, 1])
        paths = (
            f'<path d="{"".join(f"M{a} {b}h0" for a, b in zip(x[..., j].flat, y[..., j].flat, strict=True))}" '
            f'stroke="{COLORS[joint]}"/>'
            for j, joint in enumerate(conventions.JOINTS)
        )
        return f'{self._head}<g stroke-width="3" stroke-linecap="round" fill="none">{"".join(paths)}</g></svg>'

    def _frame(self, no_load: float, peak: float) -> Iterable[str]:
        """Yield the axes and labels as SVG elements."""
        end, foot, style = WIDTH - RIGHT, HEIGHT - BOTTOM, f'stroke="{QUIET}" stroke-width=".6"'
        x, y = self._place(np.array([-no_load, 0.0, no_load]), np.array([-peak, 0.0, peak]))
        yield f'<path d="M{LEFT} {y[1]}H{end}M{x[1]} {TOP}V{foot}" {style}/>'
        for tick, speed in zip(x, (-no_load, 0.0, no_load), strict=True):
            yield f'<text x="{tick}" y="{foot + 12}" text-anchor="middle">{speed:.3g}</text>'
        for tick, torque in zip(y, (-peak, 0.0, peak), strict=True):
            yield f'<text x="{LEFT - 4}" y="{tick + 3}" text-anchor="end">{torque:.3g}</text>'
        yield f'<text x="{LEFT}" y="{HEIGHT - 5}">joint speed, rad/s</text>'
        yield f'<text x="{LEFT + 3}" y="{TOP - 5}">torque, Nm</text>'
        for i, (joint, color) in enumerate(COLORS.items()):
            place = f'x="{end - 94 + 34 * i}" y="{HEIGHT - 5}"'
            yield f'<text {place} fill="{color}" font-weight="bold">{joint}</text>'

    def _place(
        self, speed: Float[np.ndarray, "..."], torque: Float[np.ndarray, "..."]
    ) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
        """Return the places of points on the chart, px; a point beyond the chart is drawn on its edge."""
        across = 0.5 + 0.5 * np.clip(speed / self._speed, -1.0, 1.0)
        down = 0.5 - 0.5 * np.clip(torque / self._torque, -1.0, 1.0)
        x, y = LEFT + (WIDTH - LEFT - RIGHT) * across, TOP + (HEIGHT - TOP - BOTTOM) * down
        return np.round(x, 1), np.round(y, 1)
