"""One robot in C MuJoCo under a policy and somebody's hands, 5 ms at a time; knows neither clock nor screen."""

import collections
import dataclasses
import math
from typing import Annotated

import mujoco
import numpy as np
from jaxtyping import Float

from bp2_rl.base.bounds import Within
from bp2_rl.env.termination import fall
from bp2_rl.robot import specs
from bp2_rl.robot.easing import launch_rate
from bp2_rl.robot.kinematics import yaw_of
from bp2_rl.robot.model import MOTOR_QVEL, foot_forces, foot_geom_ids
from bp2_rl.robot.specs import HardwareSpec
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.operator import HEADING_HOLD, HeadingHold
from bp2_rl.simulation.policy_runner import ActionFunction, PolicyRunner
from bp2_rl.simulation.schedule import COMMAND_ACCELERATION
from bp2_rl.simulation.simulator import DT, RobotSetup, settled
from bp2_rl.simulation.world import shove

BRAKING = 1.5  # m/s2, at which a slower speed is commanded where the controller does not ease stops itself
RIPPLE = 0.25  # s: over a stride speeds are averaged
DOWN = 1.5  # s, for which a fallen robot lies before it stands again
REMEMBERED = 250  # ms of torques and joint speeds
Friction = Annotated[float, Within(0.05, 2.0)]


@dataclasses.dataclass(frozen=True)
class Wish:
    """The speed and turn that a person asks for; the command approaches them at rates that policies can follow."""

    speed: float = 0.0  # m/s, forward
    turn: float = 0.0  # rad/s, to the left


class Session:
    """The robot, from a stand. Under a straight command it keeps to the line on which it was when it last turned.

    Args:
        policy: observation -> action.
        config: the environment that the policy was trained in.
        hardware: the robot, if it is not that one.
        operator: who steers under a straight command.
    """

    def __init__(
        self,
        policy: ActionFunction,
        config: EnvConfig,
        *,
        hardware: HardwareSpec | None = None,
        operator: HeadingHold = HEADING_HOLD,
    ):
        robot = RobotSetup.of(config, hardware)
        self.config, self.hardware = config, robot.config.hardware
        self.wish = Wish()
        self._policy, self._operator = policy, operator
        self._simulator = settled([robot])
        self.data = self._simulator.data[0]
        self._model, self._start = self._simulator.models[0], self._simulator.state(0)
        self._feet = foot_geom_ids(self._model)
        self.falls = 0
        self.reset()
        self.tick()  # compiles the controller, which takes seconds
        self.reset()

    def reset(self) -> None:
        """Stand at the origin; the wish stays."""
        self._simulator.set_state(0, self._start)
        mujoco.mj_forward(self._model, self.data)
        self._runner = PolicyRunner(
            self._policy,
            self.config,
            operators=[self._operator],
            latencies=[self.hardware.losses.latency],
            commands=np.zeros((1, 3)),
        )
        self._asked = Wish()
        self._line = np.zeros(3)
        self.time = 0.0
        self.distance = 0.0
        self.down_since: float | None = None
        """When it fell, s; None while it is up."""
        self._velocities: collections.deque[tuple[float, float]] = collections.deque(
            maxlen=round(RIPPLE / specs.CONTROL_STEP)
        )
        self._worked = np.zeros((REMEMBERED, 2, specs.NUM_MOTORS))

    # --- What hands can do -----------------------------------------------------------------------------------

    def push(self, forward: float, left: float) -> None:
        """Let the robot's velocity jump by so many m/s, in the frame of its heading."""
        shove(self.data, forward, left)

    @property
    def friction(self) -> float:
        """Friction coefficient of the feet on the ground."""
        return float(self._model.geom_friction[self._feet[0], 0])

    @friction.setter
    def friction(self, value: float) -> None:
        self._model.geom_friction[self._feet, 0] = value

    def tick(self) -> None:
        """A control step. A robot that has fallen lies a while, then it stands at the origin again."""
        data, simulator = self.data, self._simulator
        if self.down_since is not None and self.time > self.down_since + DOWN - 0.5 * specs.CONTROL_STEP:
            self.reset()
        self._lead()
        scheduled = np.array([self._asked.speed, 0.0, self._asked.turn])
        simulator.read(0)  # hands may have changed it
        targets = self._runner.tick(self._seen_from_line()[None], simulator.qvel, scheduled[None])
        for position, velocity in targets:
            self._worked[:-1] = self._worked[1:]
            self._worked[-1, 0] = data.qvel[MOTOR_QVEL]
            self._worked[-1, 1] = simulator.millisecond(position, velocity)[0]
        self.time += len(targets) * DT
        forward = self._forward_velocity()
        if not np.isfinite(forward) or (down := fall(data.qpos, data.qvel, self.config.termination)).exploded:
            self.falls += self.down_since is None
            self.reset()
            return
        if down.happened and self.down_since is None:
            self.falls, self.down_since = self.falls + 1, self.time
        self.distance += float(np.hypot(*data.qvel[:2])) * specs.CONTROL_STEP
        self._velocities.append((forward, float(self._yaw_rate())))

    # --- What eyes can see ------------------------------------------------------------------------------------

    @property
    def command(self) -> Float[np.ndarray, "3"]:
        """What the policy is told: m/s forward, m/s to the left, rad/s; the operator's steering included."""
        return self._runner.command[0]

    @property
    def speed(self) -> float:
        """m/s, forward, over the last stride."""
        return float(np.mean([v for v, _ in self._velocities])) if self._velocities else 0.0

    @property
    def turn(self) -> float:
        """rad/s, to the left, over the last stride."""
        return float(np.mean([w for _, w in self._velocities])) if self._velocities else 0.0

    @property
    def worked(self) -> Float[np.ndarray, "N 2 12"]:
        """Speed (rad/s) and torque (Nm) of every joint in the last milliseconds."""
        return self._worked

    @property
    def qpos(self) -> Float[np.ndarray, "23"]:
        """The robot's state in MuJoCo's coordinates."""
        return self.data.qpos

    def foot_forces(self) -> Float[np.ndarray, "4 3"]:
        """The ground's force on each foot, N, world frame."""
        return foot_forces(self.data).copy()

    def reference(self) -> Float[np.ndarray, "23"]:
        """The reference motion at this moment where the robot is: `qpos` of its ghost."""
        qpos = self.qpos.copy()
        if (reference := self._runner.reference) is None:
            return qpos
        yaw, up = float(yaw_of(qpos[3:7])), np.asarray(reference.up, np.float64)[0]
        turn, lean = np.zeros(4), np.array([1.0 + up[2], -up[1], up[0], 0.0])  # lean: the least from z to `up`
        mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), yaw)
        mujoco.mju_mulQuat(qpos[3:7], turn, lean / np.linalg.norm(lean))
        qpos[2] = float(reference.height[0])
        joints = np.asarray(reference.joint_position)[0].reshape(4, 3)
        qpos[7:] = np.column_stack((joints, np.asarray(reference.spring_compression)[0])).ravel()
        return qpos

    # --- Within -----------------------------------------------------------------------------------------------

    def _lead(self) -> None:
        """Change what is asked by as much as a policy can follow in a control step, within what it was trained for."""
        limits, dt = self.config.commands, specs.CONTROL_STEP
        speed = float(np.clip(self.wish.speed, -limits.max_backward, limits.max_forward))
        now = self._asked
        control = self.config.control
        braking = min(control.braking, COMMAND_ACCELERATION if control.stopping_time else BRAKING)
        launching = COMMAND_ACCELERATION
        if math.isfinite(control.launching):  # as fast as the policy will be told, and no faster: a stop comes at once
            launching = launch_rate(now.speed, control, np)
        speed = now.speed + float(np.clip(speed - now.speed, -braking * dt, launching * dt))
        # As in training: what friction holds.
        most = min(limits.max_yaw_rate, limits.max_turn / max(abs(speed), 1e-6))
        turn = float(np.clip(self.wish.turn, -most, most))
        step = limits.turn_acceleration * dt
        self._asked = Wish(speed, now.turn + float(np.clip(turn - now.turn, -step, step)))

    def _seen_from_line(self) -> Float[np.ndarray, "23"]:
        """The state in the frame of the line that the robot is to keep to: the operator steers along its x axis."""
        qpos = self.qpos
        if self._asked.turn != 0.0:
            self._line[:] = *qpos[:2], yaw_of(qpos[3:7])
        x, y, yaw = self._line
        seen, back = qpos.copy(), np.zeros(4)
        cos, sin = np.cos(yaw), np.sin(yaw)
        seen[0] = cos * (qpos[0] - x) + sin * (qpos[1] - y)
        seen[1] = cos * (qpos[1] - y) - sin * (qpos[0] - x)
        mujoco.mju_axisAngle2Quat(back, np.array([0.0, 0.0, 1.0]), -yaw)
        mujoco.mju_mulQuat(seen[3:7], back, qpos[3:7].copy())
        return seen

    def _forward_velocity(self) -> float:
        yaw, (vx, vy) = yaw_of(self.qpos[3:7]), self.data.qvel[:2]
        return float(np.cos(yaw) * vx + np.sin(yaw) * vy)

    def _yaw_rate(self) -> float:
        """rad/s, about the world's vertical."""
        rate = np.zeros(3)
        mujoco.mju_rotVecQuat(rate, self.data.qvel[3:6], self.qpos[3:7])
        return float(rate[2])
