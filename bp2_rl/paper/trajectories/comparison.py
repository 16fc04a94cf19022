"""A gait in the plane, the optimiser's or a policy's, in a row of metrics.

The objective counts every segment alike, and gaits have different numbers of them. So
gaits are compared by the mean over time of the objective's running cost.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from bp2_rl.base.metric import metric
from bp2_rl.optimiser.cycle import cost_of_transport, whole_cycle
from bp2_rl.optimiser.problem import CostWeights
from bp2_rl.optimiser.solution import (
    Solution,
)
from bp2_rl.optimiser.verifier_laws import at_motors
from bp2_rl.optimiser.verify import StrideSummary, summarise
from bp2_rl.robot.hardware import HardwareSpec


@dataclasses.dataclass(frozen=True, kw_only=True)
class GaitSummary(StrideSummary):
    """Metrics of a gait at one speed, the optimiser's or a policy's; hips and knees,
    forces along the track and up."""

    speed: float = metric("Speed", "m/s")
    rms_torque: float = metric("RMS torque", "Nm", ".1f")
    # cost of transport: the motors' positive work
    positive: float = metric("Work / m g d", form=".3f")
    # mean over time of the optimiser's R without its smoothness
    running_cost: float = metric("R")


def summarise_gait(solution: Solution) -> GaitSummary:
    """Summarise a solution as a whole robot's gait: the running cost of half a robot
    counts twice."""
    cycle = whole_cycle(solution)
    motion = cycle.motion
    weights = cycle.weights / cycle.period

    def mean(values: Float[np.ndarray, "segments points"]) -> float:
        return float(np.sum(weights * values))

    qd = motion.v[..., cycle.problem.stride.motors]
    R = running_cost(
        motion.tau,
        qd,
        motion.force,
        solution.problem.hardware,
        solution.problem.weights,
    )
    return GaitSummary(
        speed=solution.problem.speed,
        **vars(summarise(solution)),
        rms_torque=float(np.sqrt(mean(np.mean(motion.tau**2, axis=-1)))),
        positive=cost_of_transport(solution),
        running_cost=mean(R) / solution.problem.share,
    )


def running_cost(
    torque: Float[np.ndarray, "... motors"],
    qd: Float[np.ndarray, "... motors"],
    force: Float[np.ndarray, "... contacts"],
    hardware: HardwareSpec,
    weights: CostWeights,
) -> Float[np.ndarray, "..."]:
    """Return the running cost R (paper, Eq. R) at each instant without its smoothness:
    powers, torques and forces as shares of the greatest."""
    count = torque.shape[-1]
    tau = torque / at_motors(hardware.joint_peak_torque, count)
    load = force / weights.force
    power = tau * qd / at_motors(hardware.joint_no_load_speed, count)
    return weights.power * _squares(power) + weights.load * (
        _squares(tau) + _squares(load)
    )


def _squares(values: Float[np.ndarray, "... k"]) -> Float[np.ndarray, "..."]:
    return np.sum(values**2, axis=-1)
