"""A robot in C MuJoCo under a person's commands, one control step of 5 ms at a time,
without clock or display."""

import collections
import dataclasses
import math
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from bp2_rl.env.commands import sideways_limits
from bp2_rl.env.termination import fall
from bp2_rl.evaluation.races import PAPER_BP2, TIMES, TRACK
from bp2_rl.learning.policy import Policy
from bp2_rl.play.pace import Pace
from bp2_rl.robot import conventions
from bp2_rl.robot.coordinates import with_legs
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.height import height_over_ground
from bp2_rl.robot.kinematics import yaw_of
from bp2_rl.robot.model import foot_forces, foot_geom_ids
from bp2_rl.robot.operator import (
    HEADING_HOLD,
    HeadingHold,
    approach,
    wish_rates,
)
from bp2_rl.settings.env import CommandConfig
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.policy_runner import PolicyRunner
from bp2_rl.simulation.simulator import DT, RobotSetup, settled
from bp2_rl.simulation.world import LEVEL, World, sensed_pose, shove

DOWN = 1.5  # s, for which a fallen robot lies before it stands again


class Wish(NamedTuple):
    """The velocity wanted by the person who steers; the command approaches it at
    limited rates."""

    speed: float = 0.0  # m/s, forward
    left: float = 0.0  # m/s, to the left
    turn: float = 0.0  # rad/s, to the left


STEP = Wish(0.5, 0.1, 0.1)
"""Change of each part of a wish by one press of a key."""


def wish_limits(commands: CommandConfig) -> tuple[Wish, Wish]:
    """Return the smallest and the largest wish within a policy's training commands, to
    two digits."""
    ends = commands.max_forward, commands.max_lateral, commands.max_yaw_rate
    most = Wish(*(round(end, 2) for end in ends))
    return Wish(0.0 - round(commands.max_backward, 2), -most.left, -most.turn), most


class Session:
    """The simulated robot of `bp2 play`, steered by a policy under a person's wishes;
    on straight commands it keeps its line.

    Args:
        policy: steers the robot, and knows the environment that it was trained in.
        hardware: the robot, if it is not the one of that environment.
        world: the ground; beyond its end the robot has fallen.
    """

    def __init__(
        self,
        policy: Policy,
        hardware: HardwareSpec | None = None,
        world: World = LEVEL,
    ):
        self.config = policy.card.env
        self.world = world
        robot = dataclasses.replace(RobotSetup.of(self.config, hardware), world=world)
        self.hardware = robot.config.hardware
        self._policy = policy
        self._simulator = settled([robot])
        self.data = self._simulator.data[0]
        self._model = self._simulator.models[0]
        self._start = self._simulator.state(0)
        self._feet = foot_geom_ids(self._model)
        self.falls = 0
        self.best = math.inf
        """Shortest time of a finished sprint, s."""
        self.reset()
        self.tick()  # compiles the controller, which takes seconds
        self.reset()

    def reset(self) -> None:
        """Put the robot at rest at the origin, and clear wish, time and distance."""
        self._simulator.set_state(0, self._start)
        mujoco.mj_forward(self._model, self.data)
        self._runner = PolicyRunner(
            self._policy,
            self.config,
            operators=[HeadingHold(limit=0.0)],  # `_steered` steers
            latencies=[self.hardware.losses.latency],
            commands=np.zeros((1, 3)),
        )
        self.wish = Wish()
        self._asked = np.zeros(3)
        self._line = np.zeros(3)
        self.time = 0.0
        self.distance = 0.0
        self._began: float | None = None
        self.sprint = 0.0
        """Time since the first command, s, until now or until the robot was `TRACK`
        ahead of the origin."""
        self.finished = False
        self.down_since: float | None = None
        """Time at which the robot fell, s; None while it is upright."""
        self._velocities: collections.deque[Float[np.ndarray, "3"]] = collections.deque(
            maxlen=round(RIPPLE / conventions.CONTROL_STEP)
        )

    # --- Inputs -----------------------------------------------------------------------

    @property
    def wish(self) -> Wish:
        """The wanted velocity, to two digits, clipped to the policy's training
        commands."""
        return self._wish

    @wish.setter
    def wish(self, wish: Wish) -> None:
        least, most = wish_limits(self.config.commands)
        self._wish = Wish(*np.clip(np.round(wish, 2), least, most).tolist())

    def step(self, *, speed: int = 0, left: int = 0, turn: int = 0) -> None:
        """Change the wish by numbers of key presses, each as large as in `STEP`."""
        counts = np.array((speed, left, turn))
        self.wish = Wish(*(np.array(self.wish) + counts * STEP))

    def lean(self, part: str, share: float) -> None:
        """Set a part of the wish to a share of its limit, from -1 to 1, as a stick
        does."""
        least, most = (getattr(end, part) for end in wish_limits(self.config.commands))
        asked = float(np.interp(share, (-1.0, 0.0, 1.0), (least, 0.0, most)))
        self.wish = self.wish._replace(**{part: asked})

    def stand(self) -> None:
        """Set the wish to zero velocity."""
        self.wish = Wish()

    def push(self, forward: float, left: float) -> None:
        """Push the robot: its velocity jumps, by m/s along its heading and to its left."""
        shove(self.data.qpos, self.data.qvel, forward, left)

    @property
    def friction(self) -> float:
        """Friction coefficient of the feet on the ground."""
        return float(self._model.geom_friction[self._feet[0], 0])

    @friction.setter
    def friction(self, value: float) -> None:
        self._model.geom_friction[self._feet, 0] = value

    def tick(self) -> None:
        """Advance by one control step; a fallen robot is reset to the origin after a
        while."""
        data = self.data
        simulator = self._simulator
        if (
            self.down_since is not None
            and self.time > self.down_since + DOWN - 0.5 * conventions.CONTROL_STEP
        ):
            self.reset()
        self._lead()
        if self._began is None and self._asked.any():
            self._began = self.time
        simulator.read(0)  # the user may have changed it
        targets = self._runner.tick(
            sensed_pose(self.qpos, self.world, 0.0, self.time)[None],
            simulator.qvel,
            self._steered()[None],
        )
        for position, velocity in targets:
            simulator.millisecond(position, velocity)
        self.time += len(targets) * DT
        velocity = self._velocity_now()
        pose = self.qpos.copy()
        pose[2] -= self.ground
        if (
            not np.isfinite(velocity).all()
            or (down := fall(pose, data.qvel, self.config.termination)).exploded
        ):
            self.falls += self.down_since is None
            self.reset()
            return
        if down.happened and self.down_since is None:
            self.falls += 1
            self.down_since = self.time
            self.wish = Wish()
        self.distance += float(np.hypot(*data.qvel[:2])) * conventions.CONTROL_STEP
        self._velocities.append(velocity)
        if self._began is not None and not self.finished and self.down_since is None:
            self.sprint = self.time - self._began
            self.finished = bool(self.qpos[0] >= TRACK)
            if self.finished:
                self.best = min(self.best, self.sprint)

    # --- Outputs ----------------------------------------------------------------------

    @property
    def command(self) -> Float[np.ndarray, "3"]:
        """The command that the policy observes: m/s forward, m/s to the left, rad/s
        yaw.

        The operator's steering is included.
        """
        return self._runner.command[0]

    @property
    def velocity(self) -> Float[np.ndarray, "3"]:
        """Mean velocity over the last stride: m/s forward, m/s to the left, rad/s
        yaw."""
        return np.mean(self._velocities, axis=0) if self._velocities else np.zeros(3)

    @property
    def qpos(self) -> Float[np.ndarray, " nq"]:
        """The robot's positions in MuJoCo's coordinates."""
        return self.data.qpos

    @property
    def ground(self) -> float:
        """Height of the ground below the trunk, m."""
        return float(self.qpos[2]) - height_over_ground(self._model, self.data)

    def foot_forces(self) -> Float[np.ndarray, "4 3"]:
        """The ground's force on each foot, N, world frame."""
        return foot_forces(self.data).copy()

    def reference(self) -> Float[np.ndarray, " nq"]:
        """Return the pose of the reference motion at the robot's place, as `qpos`, for
        the ghost."""
        qpos = self.qpos.copy()
        if (reference := self._runner.reference) is None:
            return qpos
        yaw = float(yaw_of(qpos[3:7]))
        up = np.asarray(reference.up, np.float64)[0]
        # lean: the least from z to `up`
        turn = np.zeros(4)
        lean = np.array([1.0 + up[2], -up[1], up[0], 0.0])
        mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), yaw)
        mujoco.mju_mulQuat(qpos[3:7], turn, lean / np.linalg.norm(lean))
        qpos[2] = self.ground + float(reference.height[0])
        return with_legs(
            qpos,
            np.asarray(reference.joint_position)[0],
            np.asarray(reference.spring_compression)[0],
        )

    # --- Within -----------------------------------------------------------------------

    def _lead(self) -> None:
        """Move the asked velocity toward the wish, at the rates and within the limits
        of the training."""
        commands = self.config.commands
        control = self.config.control
        now = self._asked
        dt = conventions.CONTROL_STEP
        rise, fall = wish_rates(control, commands.turn_acceleration)
        asked = approach(now, np.array(self.wish), rise * dt, fall * dt)
        asked = control.tell(now, asked)
        # as in training: less sideways at speed, and turns that friction holds
        most = np.array(sideways_limits(asked[0], commands))
        self._asked = np.append(asked[0], np.clip(asked[1:], -most, most))

    def _steered(self) -> Float[np.ndarray, "3"]:
        """Return the asked velocity; on straight runs with a yaw rate that leads back
        to the line."""
        x, y = self.qpos[:2]
        yaw = float(yaw_of(self.qpos[3:7]))
        if self._asked[1:].any():
            self._line[:] = x, y, yaw
        x0, y0, along = self._line
        across = np.cos(along) * (y - y0) - np.sin(along) * (x - x0)
        off = math.remainder(yaw - along, 2.0 * math.pi)
        return HEADING_HOLD.steer(self._asked, across, off)

    def _velocity_now(self) -> Float[np.ndarray, "3"]:
        """Return the velocity (m/s) forward and to the left of the heading, and the yaw
        rate (rad/s)."""
        vx, vy = self.data.qvel[:2]
        rate = np.zeros(3)
        yaw = yaw_of(self.qpos[3:7])
        mujoco.mju_rotVecQuat(rate, self.data.qvel[3:6], self.qpos[3:7])
        cos, sin = np.cos(yaw), np.sin(yaw)
        return np.array([cos * vx + sin * vy, cos * vy - sin * vx, rate[2]])


def readings(session: Session, pace: Pace) -> dict[str, str]:
    """Return the texts of the display by name: velocities, commands, sprint, run and
    real-time factor."""
    forward, left, turn = session.velocity
    command = session.command
    best = f"{session.best:.2f} s" if math.isfinite(session.best) else "none yet"
    paper = f"; the paper's robot: {TIMES[PAPER_BP2]:g} s"
    fallen = "" if session.down_since is None else "fell; "
    sprint = f"{session.sprint:.2f} s, {max(TRACK - session.qpos[0], 0.0):.0f} m left"
    if session.finished:
        sprint = f"{session.sprint:.2f} s; reset for another"
    return {
        "speed": f"{forward:z.2f} m/s, told {command[0]:z.2f}",
        "sideways": f"{left:z.2f} m/s, told {command[1]:z.2f}",
        "turn": f"{turn:z.2f} rad/s, told {command[2]:z.2f}",
        f"{TRACK:g} m": sprint if session.sprint else "ready",
        "best": best + (paper if session.hardware.is_bp2 else ""),
        "run": f"{fallen}{session.distance:.0f} m in {session.time:.1f} s; falls: {session.falls}",
        "pace": str(pace),
    }
