"""Is it the trot that limits BP2? Trot, bound, pronk, half-bound and gallop in the plane.

A bound is the model of half a robot on a fore and a hind leg half a cycle apart ("two-leg"), a pronk that on both at
once; with left and right alike the other half does the same. In the plane right and left legs of one end cannot be
told apart, so a pace is a trot with other pairs, a rotary gallop a transverse one. In a half-bound the fore legs land
one after the other, in a gallop the hind legs, too. What a plane cannot know is roll, and how a pace or a gallop holds
it: greatest speeds are upper bounds.
"""

import dataclasses

from bp2_rl.optimiser.problem import Gait, Problem
from bp2_rl.paper.trajectories.comparison import ComparedVariant

GAITS: dict[str, Gait] = {
    "trot (and pace)": "trot",
    "bound": "two-leg",
    "pronk": "pronk",
    "half-bound": "half-bound",
    "gallop": "gallop",
}


def gait_variants(problem: Problem) -> list[ComparedVariant]:
    """The problem in each gait."""
    return [ComparedVariant(name, gait, dataclasses.replace(problem, gait=gait)) for name, gait in GAITS.items()]
