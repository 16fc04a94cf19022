"""What the figures of a family of trajectories show, in numbers."""

import dataclasses

import numpy as np

from bp2_rl.optimiser.solution import Solution
from bp2_rl.optimiser.verify import StrideSummary, summarise
from bp2_rl.paper.trajectories.coupling_account import CouplingAccount
from bp2_rl.paper.trajectories.decomposition import (
    KINDS,
    TERMS,
    Decomposition,
    TermMeans,
    Trends,
    peak_velocity_force,
    turning_speeds,
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class ShownStride(StrideSummary):
    """The trajectory that is drawn, and what its panels and the trends say."""

    speed: float  # m/s
    closure: float  # N or Nm, of the equations of motion
    velocity_force: float  # peak of the vertical C over weight
    horizontal_impulse: float  # N s, of the ground over the cycle: 0
    vertical_impulse: float  # of the ground over the cycle, over that of gravity: 1
    # least ratio of the two's vertical means over all speeds, or the inverse of the
    # greatest
    gravity_to_ground: float
    turns: dict[str, tuple[float, ...]]  # m/s, where a hip's shares turn, by term


@dataclasses.dataclass(frozen=True)
class FigureNumbers:
    """All of them."""

    shown: ShownStride
    means: tuple[TermMeans, ...]  # by speed
    by_speed: tuple[CouplingAccount, ...]


def number_shown(
    solution: Solution, terms: Decomposition, trends: Trends
) -> ShownStride:
    """The numbers of the panels that are of one speed, and of the trends."""
    weights, ground = terms.cycle.weights.ravel(), TERMS.index("ground reaction")
    x, z = (terms.coordinates.index(name) for name in ("x", "z"))
    pushed = weights @ terms.forces[ground] + np.sum(terms.impulses[ground], axis=0)
    weight = weights @ terms.along("gravity", "z")
    gravity, reaction = (
        trends.average[:, TERMS.index(name), KINDS.index("z")]
        for name in ("gravity", "ground reaction")
    )
    ratio = gravity / reaction
    turns = {
        term: tuple(
            turning_speeds(
                trends.speeds, trends.share[:, TERMS.index(term), KINDS.index("hip")]
            )
        )
        for term in ("active", "coupled inertial")
    }
    return ShownStride(
        speed=solution.problem.speed,
        **vars(summarise(solution)),
        closure=terms.closure,
        velocity_force=peak_velocity_force(terms),
        horizontal_impulse=float(pushed[x]),
        vertical_impulse=float(pushed[z] / weight),
        gravity_to_ground=float(np.min(np.minimum(ratio, 1.0 / ratio))),
        turns=turns,
    )
