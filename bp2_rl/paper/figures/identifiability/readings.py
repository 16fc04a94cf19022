"""Numbers that are read off a trajectory or a law: a hip's turn and heat, a motor's warming, a sprint's time."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from bp2_rl.optimiser.cycle import whole_cycle
from bp2_rl.optimiser.solution import Solution
from bp2_rl.paper.motor_heat import Network, Temperatures, advance
from bp2_rl.paper.thermal_specs import AMBIENT
from bp2_rl.robot import specs
from bp2_rl.robot.actuator import copper_loss, stall_torque

STEP = 1.0  # s, of the motor's heat
TRACK = 100.0  # m


def sprint(speed: float, acceleration: float) -> float:
    """Time for the 100 m at a constant acceleration and then a constant speed, s."""
    return TRACK / speed + 0.5 * speed / acceleration


def of_hind(solution: Solution, joint: int, what: Callable[..., Float[np.ndarray, " N"]]) -> Float[np.ndarray, " N"]:
    """Something of torque and speed of a hind leg's hip (0) or knee (1) along the cycle."""
    cycle = whole_cycle(solution)
    leg = cycle.problem.stride.legs.index(cycle.hind_leg)
    torque = cycle.motion.tau[..., 2 * leg + joint].ravel()
    return what(torque, cycle.motion.v[..., 3 + 3 * leg + joint].ravel())


def reversal(solution: Solution) -> float:
    """When the hind leg that stands first stops swinging back and begins to swing forward, in periods since it landed:
    where its hip's speed falls through zero, the steepest time."""
    cycle = whole_cycle(solution)
    speed, time = of_hind(solution, 0, lambda torque, speed: speed), cycle.time.ravel()
    falls = [i for i in range(len(speed) - 1) if speed[i] > 0.0 >= speed[i + 1] and time[i + 1] > time[i]]
    steepest = min(falls, key=lambda i: (speed[i + 1] - speed[i]) / (time[i + 1] - time[i]))
    part = speed[steepest] / (speed[steepest] - speed[steepest + 1])
    return float((time[steepest] + part * (time[steepest + 1] - time[steepest])) / cycle.period)


def hip_heat(solution: Solution) -> float:
    """Mean copper loss of that leg's hip, cold, W."""
    cycle, hardware = whole_cycle(solution), solution.problem.hardware
    squares = of_hind(solution, 0, lambda torque, speed: torque**2)
    stall = stall_torque(hardware.joint_peak_torque, hardware.joint_corner_speed, hardware.joint_no_load_speed)
    mean = float(cycle.weights.ravel() @ squares) / cycle.period
    return float(copper_loss(1.0, hardware.joint_no_load_speed, stall)) * mean


def heating_rate(network: Network, cold_heat: float) -> float:
    """Mean rise of a winding over the paper's 86 s under a constant torque, K/s."""
    temperatures = Temperatures.uniform(AMBIENT, (1,))
    for _ in range(round(specs.ENDURANCE_TIME / STEP)):
        temperatures = advance(network, temperatures, np.array([cold_heat]), STEP)
    return float(temperatures.winding[0] - AMBIENT) / specs.ENDURANCE_TIME
