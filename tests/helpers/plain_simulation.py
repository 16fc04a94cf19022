"""One robot in C MuJoCo by a plain loop in NumPy: the independent result that the
simulator is compared with."""

import collections
import functools

import jax
import mujoco
import numpy as np

from bp2_rl.env.controller import Controller, motors_of
from bp2_rl.env.termination import fall
from bp2_rl.robot import losses
from bp2_rl.robot.actuator import (
    bus_voltage,
    joint_torque,
    share_bus,
    stall_torque,
    torque_limits,
)
from bp2_rl.robot.bp2 import STAND_JOINTS
from bp2_rl.robot.kinematics import yaw_of
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import MOTOR_QPOS, MOTOR_QVEL, foot_forces
from bp2_rl.simulation import simulator
from bp2_rl.simulation.policy_runner import control_step, control_steps_behind
from bp2_rl.simulation.simulator import CONVERGED, OUTSIDE, TRIALS, RobotSetup
from bp2_rl.simulation.world import sensed_pose

STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class PlainRobot:
    """One simulated robot, from its keyframe `stand`, with the attributes of the
    simulator that a `Watch` uses."""

    def __init__(self, robot):
        self.model = robot.model()
        self.data = [mujoco.MjData(self.model)]
        self.motors = [motors_of(robot.config)]
        self.resistance = Resistance.from_hardware(robot.config.hardware)
        self.throughout = robot.config.hardware.envelope == "throughout"
        mujoco.mj_resetDataKeyframe(
            self.model, self.data[0], self.model.key("stand").id
        )

    def set_motors(self, _, motors):
        self.motors = [motors]

    def settle(self):
        data = self.data[0]
        stand = data.qpos[MOTOR_QPOS].copy()
        for _ in range(round(simulator.SETTLING_TIME * 1e3)):
            self.millisecond(stand, np.zeros(12))
            data.qvel *= 0.99
        data.qpos[:2], data.qvel[:], data.time = 0.0, 0.0, 0.0

    def millisecond(self, position, velocity, numerics=CONVERGED):
        """Simulate a millisecond, and return the torque applied at its beginning,
        Nm."""
        updates = numerics.steps if numerics.motors_each_step else 1
        torques = [
            self._update(position, velocity, 1e-3 / updates, numerics.steps // updates)
            for _ in range(updates)
        ]
        return torques[0]

    def _update(self, position, velocity, seconds, steps):
        (data,), (motors,) = self.data, self.motors
        q, qd, before = (
            data.qpos[MOTOR_QPOS],
            data.qvel[MOTOR_QVEL].copy(),
            data.ctrl.copy(),
        )
        torque = joint_torque(motors, before, q, qd, position, velocity, seconds)
        start = np.empty(mujoco.mj_stateSize(self.model, STATE))
        mujoco.mj_getState(self.model, data, start, STATE)
        voltage = bus_voltage(motors, before, qd)
        slope = (
            stall_torque(motors.peak_torque, motors.corner_speed, motors.no_load_speed)
            / motors.no_load_speed
        )
        for trial in range(TRIALS + 1):
            mujoco.mj_setState(self.model, data, start, STATE)
            data.ctrl[:] = torque
            if self.resistance is not None:
                data.qfrc_applied[:] = losses.generalized(
                    losses.loss(self.resistance, data.qpos, data.qvel, torque),
                    data.qvel,
                )
            mujoco.mj_step(self.model, data, nstep=steps)
            lower, upper = torque_limits(motors, data.qvel[MOTOR_QVEL], voltage)
            outside = torque - np.clip(torque, lower, upper)
            if (
                not self.throughout
                or np.max(np.abs(outside)) <= OUTSIDE
                or trial == TRIALS
            ):
                break
            unit = np.zeros((12, 22))
            unit[np.arange(12), MOTOR_QVEL] = 1.0
            answer = np.empty_like(unit)
            mujoco.mj_solveM(self.model, data, answer, unit)
            less = torque - outside / (
                1.0 + slope * seconds * answer[np.arange(12), MOTOR_QVEL]
            )
            torque = share_bus(motors, less, torque_limits(motors, qd, voltage), qd)
        return torque


def plain_run(policy, config, request):
    """Return the samples of a run, by name as in a `Trajectory`, and whether the robot
    fell."""
    robot = request.robot(config)
    body = PlainRobot(RobotSetup(robot.config, robot.world))
    body.settle()
    robot.numerics.apply(body.model)
    (data,) = body.data
    schedule = request.schedule
    behind = control_steps_behind(robot.config.hardware.losses.latency)
    issued = collections.deque(
        [(np.array(STAND_JOINTS), np.zeros(12))] * (max(behind) + 1),
        maxlen=max(behind) + 1,
    )
    control, state = (
        jax.jit(functools.partial(control_step(config), policy)),
        Controller(config).init(),
    )
    told, samples, fell = schedule.command(0.0), collections.defaultdict(list), False
    for k in range(int(np.ceil(schedule.duration / 5e-3 - 1e-9))):
        seen = sensed_pose(data.qpos, robot.world, request.gyro_bias, k * 5e-3)
        asked = request.operator.steer(
            schedule.command((k + 1) * 5e-3), seen[1], yaw_of(seen[3:7])
        )
        given = (np.asarray(x, np.float32) for x in (told, seen, data.qvel, asked))
        state, targets, _, next_told = control(state, *given)
        issued.append(
            (np.asarray(targets.position, float), np.asarray(targets.velocity, float))
        )
        for ms, late in enumerate(behind):
            position, velocity = issued[-1 - late]
            robot.world.push(data, 5 * k + ms)
            there = data.qpos[0] >= request.finish
            now = {
                "qpos": data.qpos.copy(),
                "qvel": data.qvel.copy(),
                "target": position,
                "command": told,
            }
            now["torque"] = body.millisecond(position, velocity, robot.numerics)
            now["foot_force"] = foot_forces(data).copy()
            for name, value in now.items():
                samples[name].append(value)
            fell = bool(fall(data.qpos, data.qvel, config.termination).happened)
            enough = request.watch is not None and request.watch(body, 0, now["torque"])
            if fell or there or enough:
                return {
                    name: np.array(values) for name, values in samples.items()
                }, fell
        told = np.asarray(next_told)
    return {name: np.array(values) for name, values in samples.items()}, fell
