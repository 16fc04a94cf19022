"""Follow a trajectory from the optimiser to the policy: what was asked for, what is played, what is run.

pip install -c constraints.txt -e ".[trajopt]"
python examples/optimiser_to_policy.py
"""

from typing import NamedTuple

import numpy as np

from bp2_rl.assets import asset_path
from bp2_rl.evaluation.runs.metrics import measure
from bp2_rl.evaluation.runs.rollout import rollout_mujoco
from bp2_rl.evaluation.runs.schedule import Ramp
from bp2_rl.gait.collocation.gait import CollocationGait
from bp2_rl.learning.policy import load_policy
from bp2_rl.trajopt.collocation import solve
from bp2_rl.trajopt.problem import Problem, spring_coordinates
from bp2_rl.trajopt.verify import verify


class Stride(NamedTuple):
    """What the three have in common."""

    period: float  # s
    duty: float  # share of the cycle that a foot stands
    travel: float  # m, most that a spring is pressed in


def solved(speed: float, intervals: int) -> tuple[Stride, float]:
    """The optimiser's trot on a coarse mesh, and the energy that a judge of its own misses in it."""
    solution = solve(Problem(speed=speed, intervals=intervals))
    springs = solution.motion.q[..., spring_coordinates(solution.problem.stride.legs)]
    return Stride(solution.period, solution.duty, float(springs.max())), verify(solution)["energy_residual"]


def played(speed: float) -> Stride:
    """The library that ships: such solutions at thirty speeds, each near its neighbour, as training plays it."""
    gait = CollocationGait()
    command = np.tile(np.array([speed, 0.0, 0.0]), (1000, 1))
    cycle = gait(command, np.linspace(0.0, 1.0, 1000, endpoint=False))
    period = 1.0 / float(gait.phase_rate(command[0]))
    return Stride(period, float(np.mean(cycle.contact)), float(np.max(cycle.spring_compression)))


def run(speed: float, hold: float) -> Stride:
    """The policy that learnt from that library, in C MuJoCo, in three dimensions."""
    policy = load_policy(asset_path("policies/default"))
    metrics = measure(rollout_mujoco(policy, Ramp((speed, 0.0, 0.0), hold=hold), policy.card.env))
    period = np.mean([1.0 / leg.stride_frequency for leg in metrics.legs if leg.stride_frequency])
    duty = np.mean([leg.duty_factor for leg in metrics.legs])
    return Stride(float(period), float(duty), metrics.peak_compression)


def main() -> None:
    """All three at 8 m/s."""
    found, missing = solved(8.0, 16)
    print(f"the optimiser's stride misses {missing:.1e} of its motors' work")
    for name, stride in (("optimiser", found), ("library", played(8.0)), ("policy", run(8.0, 4.0))):
        print(f"{name:10} period {stride.period:.3f} s, duty {stride.duty:.2f}, spring {1000 * stride.travel:.0f} mm")


if __name__ == "__main__":
    main()
