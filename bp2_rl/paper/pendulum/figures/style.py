"""What the pictures of pendulums share: each pendulum's colour, and a ratio's.

In the style of `plotting`. Pendulum 1 is blue, 2 vermilion, the beam green; a ratio of torques is blue where a free
beam helps and red where it hurts.
"""

from matplotlib.axes import Axes
from matplotlib.colors import Normalize, TwoSlopeNorm

from bp2_rl.base.plotting import INK

ONE, TWO, BEAM = "#0072B2", "#D55E00", "#009E73"
PENDULUMS = (ONE, TWO)
HELPS_AND_HURTS = "RdBu_r"


def ratio_norm(least: float, most: float) -> Normalize:
    """White at 1."""
    return TwoSlopeNorm(1.0, vmin=least, vmax=most)


def remark(axes: Axes, text: str, *, at: tuple[float, float] = (0.98, 0.95), align: str = "right") -> None:
    """A line of text inside the panel, on white."""
    box = {"boxstyle": "square,pad=0.2", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
    axes.text(*at, text, transform=axes.transAxes, ha=align, va="top", color=INK, fontsize=8.5, bbox=box)
