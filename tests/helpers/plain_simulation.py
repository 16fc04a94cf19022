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
from bp2_rl.robot.bp2 import STAND_JOINTS
from bp2_rl.robot.kinematics import yaw_of
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import MOTOR_QPOS, MOTOR_QVEL, foot_forces
from bp2_rl.simulation import simulator
from bp2_rl.simulation.policy_runner import control_step, control_steps_behind
from bp2_rl.simulation.simulator import CONVERGED, OUTSIDE, TRIALS, RobotSetup
from bp2_rl.simulation.world import sensed_pose, shove

STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class PlainMotors:
    """The law of twelve motors and their bus, written out anew: no line of
    `robot.actuator` is shared, so that an error there shows."""

    def __init__(self, motors):
        self.loop = motors.stiffness, motors.damping, motors.current_lag
        self.bus = motors.bus
        self.corner, self.no_load, self.braking = (
            np.broadcast_to(speed, 12)
            for speed in (
                motors.corner_speed,
                motors.no_load_speed,
                motors.braking_speed,
            )
        )
        designed = np.broadcast_to(motors.peak_torque, 12)
        self.peak = motors.strength * designed
        # Nm s/rad, the envelope's fall from the corner to the no-load speed
        self.slope = designed / (self.no_load - self.corner)
        self.heat = 1.0 / self.slope  # W/Nm2: weak motors lose as much

    def power(self, torque, qd):
        """Power that the motors draw, W."""
        return np.sum(torque * qd + self.heat * torque**2)

    def voltage(self, torque, qd):
        """Voltage of the bus under these torques, as a share of the nominal one."""
        if self.bus is None:
            return 1.0
        return np.clip(1.0 - self.bus.sag * self.power(torque, qd), 0.3, 1.0)

    def limits(self, qd, voltage):
        """Least and greatest torques, read off the drawing of the envelope: one line
        along the motion, one against it."""
        ends = []
        for j, w in enumerate(qd):
            peak, speed = self.peak[j], abs(w)
            fall = peak / (self.no_load[j] - self.corner[j])
            along = np.clip(fall * (voltage * self.no_load[j] - speed), -peak, peak)
            against = np.clip(fall * (voltage * self.no_load[j] + speed), -peak, peak)
            if np.isfinite(self.braking[j]):
                line = peak / (self.braking[j] - self.corner[j])
                most = np.clip(line * (self.braking[j] - speed), 0.0, peak)
                against = min(against, most)
            # beyond the no-load speed the back EMF brakes, whatever the drive can
            against = max(against, -along)
            ends.append((-against, along) if w >= 0.0 else (-along, against))
        return np.array(ends).T

    def shared(self, torque, limits, qd):
        """Torques scaled by one factor to what the bus gives or takes."""
        if self.bus is None:
            return torque
        least = np.clip(np.zeros(12), *limits)
        way = torque - least
        square = np.sum(self.heat * way**2)
        linear = np.sum(way * qd + 2.0 * self.heat * least * way)
        power, factor = self.power(torque, qd), 1.0
        for over, limit, which in (
            (power > self.bus.power_out, self.bus.power_out, -1),
            (power < -self.bus.power_in, -self.bus.power_in, 0),
        ):
            if over:
                crossings = np.roots([square, linear, self.power(least, qd) - limit])
                factor = np.clip(np.sort(crossings.real)[which], 0.0, 1.0)
        return least + factor * way

    def torque(self, before, q, qd, position, velocity, seconds):
        """Torque of the next `seconds`: PD law, lag by implicit Euler, limits, bus."""
        stiffness, damping, lag = self.loop
        asked = stiffness * (position - q) + damping * (velocity - qd)
        torque = (lag * before + seconds * asked) / (lag + seconds)
        limits = self.limits(qd, self.voltage(before, qd))
        return self.shared(np.clip(torque, *limits), limits, qd)


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
        (data,), motors = self.data, PlainMotors(self.motors[0])
        q, qd, before = (
            data.qpos[MOTOR_QPOS],
            data.qvel[MOTOR_QVEL].copy(),
            data.ctrl.copy(),
        )
        torque = motors.torque(before, q, qd, position, velocity, seconds)
        start = np.empty(mujoco.mj_stateSize(self.model, STATE))
        mujoco.mj_getState(self.model, data, start, STATE)
        voltage = motors.voltage(before, qd)
        for trial in range(TRIALS + 1):
            mujoco.mj_setState(self.model, data, start, STATE)
            data.ctrl[:] = torque
            if self.resistance is not None:
                data.qfrc_applied[:] = losses.generalized(
                    losses.loss(self.resistance, data.qpos, data.qvel, torque),
                    data.qvel,
                )
            mujoco.mj_step(self.model, data, nstep=steps)
            limits = motors.limits(data.qvel[MOTOR_QVEL], voltage)
            outside = torque - np.clip(torque, *limits)
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
            mobility = answer[np.arange(12), MOTOR_QVEL]
            less = torque - outside / (1.0 + motors.slope * seconds * mobility)
            torque = motors.shared(less, motors.limits(qd, voltage), qd)
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
            for push in robot.world.pushes:
                if round(1e3 * push.time) == 5 * k + ms:
                    shove(data.qpos, data.qvel, push.forward, push.left, push.turn)
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
