"""Draw which way each joint turns as its angle grows: `python docs/joint_signs.py
PICTURE.png`."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.plotting import FRONT, QUIET, WIDTH, save_figure, styled
from bp2_rl.robot import bp2, kinematics
from bp2_rl.robot.hardware import IDEAL

TURN = 0.4  # rad, by which a joint is turned
# the horizontal axis of a view from behind, and of one from the right
SIDEWAYS, LENGTHWAYS = (1, -1.0), (0, 1.0)
VIEWS = (
    ("abad +: feet to the left", 0, (0, 1), SIDEWAYS, "seen from behind"),
    (
        "hip +: foot back",
        1,
        (0,),
        LENGTHWAYS,
        "seen from the right, front \N{RIGHTWARDS ARROW}",
    ),
    (
        "knee +: leg straightens",
        2,
        (0,),
        LENGTHWAYS,
        "seen from the right, front \N{RIGHTWARDS ARROW}",
    ),
)
"""Title, joint, legs that are shown, view, and the view in words."""


@styled
def draw() -> Figure:
    """Draw each joint in the standing pose, and turned by `TURN`."""
    figure, axes = plt.subplots(
        1, len(VIEWS), figsize=(WIDTH, 3.2), layout="constrained"
    )
    stand = np.reshape(bp2.STAND_JOINTS, (4, 3))
    for ax, (title, joint, legs, view, words) in zip(axes, VIEWS, strict=True):
        turned = stand.copy()
        turned[:, joint] += TURN
        for leg in legs:
            before = _draw_leg(ax, stand, leg, view, QUIET)
            after = _draw_leg(ax, turned, leg, view, FRONT)
            arrow = {
                "arrowstyle": "-|>",
                "color": FRONT,
                "lw": 1.6,
                "connectionstyle": "arc3,rad=0.15",
            }
            ax.annotate(
                "", after - (0.0, 0.035), before - (0.0, 0.035), arrowprops=arrow
            )
        ax.set_title(title, loc="center")
        ax.set(aspect="equal", xticks=[], yticks=[])
        ax.set_xlabel(words)
        ax.grid(False)
        ax.spines[:].set_visible(False)
        ax.margins(0.15)
    return figure


def _draw_leg(
    ax: Axes, joints: np.ndarray, leg: int, view: tuple[int, float], color: str
) -> np.ndarray:
    """Draw a leg, abduction axis to foot, and return where its foot is in the
    picture."""
    length = IDEAL.anatomy.leg_length
    knee_and_foot = [
        kinematics.foot_position(joints, compression)[leg]
        for compression in (length, 0.0)
    ]
    # A leg with neither thigh nor lower leg ends at its hip.
    flat = joints * (1.0, 0.0, 0.0)
    hip = kinematics.foot_position(flat, 2.0 * length)[leg]
    points = np.array([kinematics.leg_origins()[leg], hip, *knee_and_foot])
    axis, direction = view
    places = np.stack([direction * points[:, axis], points[:, 2]], axis=-1)
    ax.plot(*places.T, color=color, lw=3.0, marker="o", ms=5.0)
    return places[-1]


if __name__ == "__main__":
    save_figure(draw(), Path(sys.argv[1]))
