"""Compare a stride of the optimiser, of the motion library, and of the policy that
imitates the library.

pip install -c constraints.txt -e ".[trajopt]"
python examples/optimiser_to_policy.py
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from bp2_rl.base.assets import asset_path
from bp2_rl.learning.policy import load_policy
from bp2_rl.optimiser.collocation import solve
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.verify import verify
from bp2_rl.reference.library.trot import CollocationGait
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import Ramp


class Stride(NamedTuple):
    """Period and duty factor of a stride."""

    period: float  # s
    duty: float  # share of the cycle in which a foot stands


def solved(speed: float, intervals: int) -> tuple[Stride, float]:
    """Return the optimiser's trot on a coarse mesh, and the relative error of its
    energy according to the verifier."""
    solution = solve(Problem(speed=speed, intervals=intervals))
    return Stride(solution.period, solution.duty), verify(solution)["energy_residual"]


def played(speed: float) -> Stride:
    """Return the stride of the shipped library, which interpolates solutions at thirty
    speeds."""
    gait, command = CollocationGait(), jnp.array([speed, 0.0, 0.0])
    cycle = jax.jit(gait)(jnp.tile(command, (1000, 1)), jnp.arange(1000) / 1000.0)
    return Stride(1.0 / float(gait.phase_rate(command)), float(cycle.contact.mean()))


def run(speed: float, hold: float) -> Stride:
    """Return the stride of the policy trained with this library, in C MuJoCo."""
    policy = load_policy(asset_path("policies/built"))
    [found] = simulate(policy, [RunRequest(Ramp((speed, 0.0, 0.0), hold=hold))])
    leg = found.metrics.legs[0]
    return Stride(1.0 / (leg.stride_frequency or math.inf), leg.duty_factor)


def main() -> None:
    """Print all three strides at 8 m/s."""
    found, missing = solved(8.0, 16)
    print(f"the optimiser's stride misses {missing:.1e} of its motors' work")
    for name, stride in (
        ("optimiser", found),
        ("library", played(8.0)),
        ("policy", run(8.0, 4.0)),
    ):
        print(f"{name:10} period {stride.period:.3f} s, duty {stride.duty:.2f}")


if __name__ == "__main__":
    main()
