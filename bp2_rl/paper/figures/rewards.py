"""Table S4 of the paper: reward coefficients of both training stages beside ours, and
the schedule of weights over speed."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from bp2_rl.base.metric import Table
from bp2_rl.base.plotting import FALL, FRONT, QUIET, WIDTH, styled
from bp2_rl.env.rewards import speed_schedule
from bp2_rl.paper.figures.drawn import Drawn
from bp2_rl.paper.figures.settings import RewardsFigureSettings
from bp2_rl.settings.env import Schedule
from bp2_rl.settings.presets.rewards import OURS, PAPER
from bp2_rl.settings.training import Stage

STAGES: tuple[Stage, ...] = ("imitation", "relaxed")
ROWS = {
    "Body height": "height",
    "Body attitude": "attitude",
    "Imitation, c_J": "imitation",
    "Velocity tracking, c_V": "tracking",
    "Torque": "torque",
    "Power": "power",
    "Action smoothness": "smoothness",
    "Straight-running symmetry": "symmetry",
    "Terminal": "terminal",
}
"""Rows of Table S4, and the fields of `RewardConfig` that hold their coefficients."""

LINES: dict[Schedule, dict[str, object]] = {
    "text": {"color": FRONT, "linewidth": 2.2, "label": "by the text: tracking gains"},
    "literal": {
        "color": FALL,
        "linestyle": (0, (3, 1.5)),
        "label": "to the letter of Table S4",
    },
}
"""Line styles of the schedule's readings. The weight of imitation is c_J + c_V less the
weight of tracking."""


@dataclasses.dataclass(frozen=True)
class Reading:
    """Weight of velocity tracking at three speeds, by one reading of the paper's
    schedule."""

    at_rest: float
    at_half: float
    at_top: float


@dataclasses.dataclass(frozen=True)
class RewardsNumbers:
    """Reward coefficients of Table S4 and ours, and two readings of the table's
    schedule."""

    paper: dict[str, dict[str, float]]  # coefficients, by stage and row
    ours: dict[str, dict[str, float]]
    literal: Reading  # Table S4 to the letter
    text: Reading  # what the text says


def rewards(settings: RewardsFigureSettings) -> Drawn:
    """Draw the weight of velocity tracking over speed, and tabulate the reward
    coefficients."""
    paper, ours = (
        {
            stage: {
                row: float(getattr(column[stage], field)) for row, field in ROWS.items()
            }
            for stage in STAGES
        }
        for column in (PAPER, OURS)
    )
    numbers = RewardsNumbers(paper, ours, _reading("literal"), _reading("text"))
    head = (
        "Term",
        *(f"{whose}, {stage}" for whose in ("paper", "ours") for stage in STAGES),
    )
    lines = [
        (
            row,
            *(
                f"{column[stage][row]:g}"
                for column in (paper, ours)
                for stage in STAGES
            ),
        )
        for row in ROWS
    ]
    return Drawn(
        numbers,
        (Table("Table S4, base coefficients", head, lines),),
        {"rewards": rewards_figure(settings)},
    )


def weights(
    stage: Stage, schedule: Schedule, share: Float[np.ndarray, " N"]
) -> Float[np.ndarray, "2 N"]:
    """Return the weights of imitation, c_m, and tracking, c_v, by the paper's
    coefficients; `share` is the commanded speed over the greatest."""
    config = PAPER[stage]
    pairs = [
        speed_schedule(
            jnp.asarray(at), 1.0, config.imitation, config.tracking, schedule
        )
        for at in share.tolist()
    ]
    return np.array(pairs, dtype=float).T


def _reading(schedule: Schedule) -> Reading:
    return Reading(
        *(
            float(value)
            for value in weights("imitation", schedule, np.array([0.0, 0.5, 1.0]))[1]
        )
    )


@styled
def rewards_figure(settings: RewardsFigureSettings) -> Figure:
    """Draw the weight of tracking over speed, a panel for each stage."""
    figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
    share = np.linspace(0.0, 1.0, 121)
    for axes, stage in zip(figure.subplots(1, 2, sharey=True), STAGES, strict=True):
        for schedule, line in LINES.items():
            axes.plot(
                settings.speed * share, weights(stage, schedule, share)[1], **line
            )
        axes.set(
            title=f"{stage.capitalize()} stage, paper's coefficients",
            xlabel="Commanded speed [m/s]",
            ylim=(0.0, 0.7),
        )
        axes.set_xlim(0.0, settings.speed)
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
    figure.axes[0].set_ylabel("Weight of tracking, c_v")
    handles = figure.axes[0].get_lines()[: len(LINES)]
    figure.legend(
        handles=handles, loc="outside upper center", ncols=2, handlelength=2.2
    )
    return figure
