"""The environment's settings: frozen dataclasses, saved with every run and every
exported policy."""

import dataclasses
import math
from typing import Annotated, Literal

import tyro

from bp2_rl.base.bounds import Range, Share, Within, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.operator import CommandLaw
from bp2_rl.settings.reference import CollocationConfig, KinematicConfig
from bp2_rl.settings.task import Coefficient, TaskConfig
from bp2_rl.settings.terrain import TerrainConfig

Amount = Annotated[float, Within(0.0, 1000.0)]
Extent = Annotated[float, Within(0.001, 1000.0)]
"""`Amount` may be zero, `Extent` may not. A thousand metres, seconds or radians are
more than any setting needs."""
BelowOne = Annotated[float, Within(0.0, 1.0, open_above=True)]
ReferenceName = Literal["collocation", "kinematic", "none"]
Schedule = Literal["text", "literal", "off"]
"""Readings of Table S4's speed-dependent weights: `env.rewards.speed_schedule`."""
Impl = Literal["jax", "kernel", "warp"]
"""Physics engines: `env.physics.interface` describes them."""


@dataclasses.dataclass(frozen=True)
class ControlConfig(CommandLaw):
    """Control settings: the meaning of actions, the joint PD loop, and limits on the
    command.

    The gains of the loop are ASSUMED.
    """

    # joint targets are the reference motion, or the standing pose, plus the action
    mode: Literal["residual", "absolute"] = "residual"
    action_scale: Extent = 0.5  # rad per unit of action
    action_limit: Extent = 3.0  # actions are clipped to +- this
    stiffness: Annotated[float, Within(0.1, 1e5)] = bp2.LOOP_STIFFNESS  # Nm/rad
    damping: Annotated[float, Within(0.0, 1e4)] = bp2.LOOP_DAMPING  # Nm s/rad
    feedforward: Annotated[float, Within(-10.0, 10.0)] = 0.0
    """share of the reference's torque that is added, in `residual` mode"""
    # Nm/s
    torque_rate: Annotated[float, Within(0.001, 1e9, infinite=True)] = float("inf")
    clock_at_rest: bool = True
    """whether the policy observes the full phase vector also in a stand; if not, the
    vector's length is the size of the reference's steps, 0 in a stand"""
    history: tuple[Annotated[int, Within(1, 200)], ...] = ()
    """numbers of control steps: for each number, the policy also observes the change of
    its observation over so many steps (0 at first)"""


@dataclasses.dataclass(frozen=True)
class CommandConfig:
    """Random velocity commands: the command approaches a target at a limited rate, and
    every few seconds a new target is drawn."""

    max_forward: Extent = 15.5  # m/s, v_x^max of Table S4, which has no number for it
    max_lateral: Amount = 0.5  # m/s, v_y^max
    max_yaw_rate: Amount = 1.0  # rad/s, omega_z^max
    max_backward: Amount = 0.0  # m/s
    # m/s2, largest forward speed x yaw rate, below the limit of friction
    max_turn: Amount = 3.0
    # share of targets in the fastest tenth of the curriculum's range
    limit_fraction: Share = 0.4
    # share of targets with no lateral and no yaw command
    straight_fraction: Share = 0.5
    slow_fraction: Share = 0.0  # share of targets of at most `slow` forward
    slow: Extent = 3.0  # m/s
    stand_fraction: Share = 0.05  # share of targets that are zero
    acceleration: Annotated[Range, Within(0.001, 1000.0)] = (1.0, 8.0)
    """m/s2, rate at which the forward command approaches its target"""
    # m/s2 and rad/s2, rate of the lateral and yaw commands
    turn_acceleration: Amount = 2.0
    # s, from reaching a target's forward speed to the next draw
    hold_time: Annotated[Range, Within(0.0, 1000.0)] = (1.0, 3.0)
    stand_time: Annotated[Range | None, Within(0.0, 1000.0)] = None
    """s, from the end of a stop to the next draw, if the target is to stand; None:
    hold_time"""


@dataclasses.dataclass(frozen=True)
class CurriculumConfig:
    """Per-robot curriculum of speed and ground: commands tracked near a robot's limit
    raise its level, falls lower it."""

    start_speed: Extent | None = None
    """m/s, fastest forward command at level 0 (level 1: commands.max_forward); None:
    all commands from the start on"""
    near: BelowOne = 0.9
    """with a start speed, only commands above this share of the limit count"""
    evidence: Amount = 0.5  # s, least time at counted commands between two draws
    # largest mean speed error at counted commands, as a share of (1 m/s + limit)
    tolerance: Extent = 0.1
    raise_by: BelowOne = 0.15
    lower_by: BelowOne = 0.05


@dataclasses.dataclass(frozen=True)
class ResetConfig:
    """Initial states of episodes: at rest or on the running reference, with noise."""

    # share of episodes that start at rest with a rising command; the others start on
    # the running reference
    standing_fraction: Share = 0.3
    standing_time: Annotated[Range, Within(0.0, 1000.0)] = (0.0, 0.0)
    """s, time for which a robot that starts at rest is commanded to stand; without this
    time the robot leans forward in expectation of the launch"""
    joint_noise: Amount = 0.05  # rad, uniform +-
    # m/s, largest difference between command and speed at a running start
    command_error: Amount = 0.0
    velocity_noise: Amount = 0.1  # share of the reference's velocities, uniform +-


@dataclasses.dataclass(frozen=True)
class RandomizationConfig:
    """Domain randomisation: each reset draws new parameters, uniformly within these
    ranges."""

    enabled: bool = True
    # factor: 0.5 to 1.1 on ground of 0.9
    friction: Annotated[Range, Within(0.001, 100.0)] = (0.55, 1.22)
    # factor, for each body separately
    mass: Annotated[Range, Within(0.01, 100.0)] = (0.9, 1.1)
    com_offset: Amount = 0.02  # m, of the trunk, +- on each axis
    # factor on the peak torque
    strength: Annotated[Range, Within(0.0, 100.0)] = (0.9, 1.0)
    weak_braking: Annotated[Range, Within(0.0, 1.0)] = (0.0, 0.0)
    """weakness of braking at speed: 0 the hardware's braking, 1 the braking torque
    falls with speed as the driving torque does"""
    no_load_speed: Annotated[Range | None, Within(0.1, 10.0)] = None
    """factor on the motors' no-load and corner speeds, one for all motors of a robot;
    None: the hardware's"""
    armature: Annotated[Range | None, Within(0.1, 10.0)] = None
    """factor on the rotors' inertia, one for all motors of a robot; None: the
    hardware's"""
    spring_stiffness: Annotated[Range | None, Within(0.1, 10.0)] = None
    """factor on the springs' stiffness, one for all springs of a robot; None: the
    hardware's"""
    spring_damping: Annotated[Range | None, Within(0.0, 100.0)] = None
    """factor on the springs' damping, one for all springs of a robot; None: the
    hardware's"""
    # factor on PD stiffness and damping
    gains: Annotated[Range, Within(0.0, 100.0)] = (0.9, 1.1)
    # s, from observation to new joint target
    latency: Annotated[Range, Within(0.0, 0.010)] = (0.0, 0.010)
    losses: Annotated[Range, Within(0.0, 100.0)] = (1.0, 1.0)
    """factor on each of the hardware's losses separately: air, gear, joints, slides,
    current lag, bus power, sag"""
    joint_position_noise: Amount = 0.01  # rad, standard deviation
    joint_velocity_noise: Amount = 0.3  # rad/s
    orientation_noise: Amount = 0.01
    angular_velocity_noise: Amount = 0.1  # rad/s
    push_interval: Extent = 4.0  # s, mean time between pushes
    # m/s, largest sudden change of the trunk's horizontal velocity
    push_velocity: Amount = 0.5


@dataclasses.dataclass(frozen=True)
class TerminationConfig:
    """Limits of a robot's state; beyond any of these limits the robot has fallen."""

    # Height and tilt end an episode before the trunk touches the ground, a contact that
    # training does not simulate.
    min_height: Amount = 0.3  # m, trunk centre
    min_up: BelowOne = 0.8  # vertical part of the body's z axis: 37 deg of tilt
    # rad/s or m/s in any coordinate: the physics has exploded
    max_speed: Annotated[float, Within(0.1, 1e6)] = 200.0
    max_overlap: Annotated[float, Within(0.0, 1.0)] = 0.005
    """m, largest overlap of a leg with another leg or the trunk, if legs are solid: the
    depth that C MuJoCo's soft contacts allow. Training has no contacts between legs,
    and ends the episode instead"""


@dataclasses.dataclass(frozen=True)
class TrackingShape:
    """How the tracking reward falls with the error e: exp(-2 e^2 / W^2).

    W^2 = floor^2 + (commanded speed / width)^2 for the velocity, and W = yaw_width for
    the yaw rate. A share `tail` of each reward is instead a straight line, which
    reaches zero at an error of `reach` plus half the command. `TrackingShape()` is the
    paper's.
    """

    floor: Extent = 1.0  # m/s
    width: Annotated[float, Within(0.01, 1e6, infinite=True)] = float("inf")
    tail: Share = 0.0
    reach: Extent = 1.0  # m/s
    yaw_width: Extent = 1.0  # rad/s
    yaw_reach: Extent = 1.0  # rad/s
    memory: Annotated[float, Within(0.0, 10.0)] = 0.0
    """s, time constant of an exponential average of the errors: a trunk sways and turns
    within every stride"""


@dataclasses.dataclass(frozen=True)
class RewardConfig:
    """Coefficients of the reward: Table S4's terms and three terms more; `env.rewards`
    has the terms.

    `RewardConfig()` is the table's imitation column; presets set others
    (`settings.presets`).
    """

    height: Coefficient = 0.05  # c_h
    attitude: Coefficient = 0.05  # c_R
    imitation: Coefficient = 0.6  # c_J bar
    tracking: Coefficient = 0.1
    """c_V bar; Table S4 has 0.1 for imitation and 0.4 for relaxed, `--weights ours` 2,
    with the preset cpu 1.25"""
    torque: Coefficient = 0.1  # c_tau
    power: Coefficient = 0.0  # c_P
    smoothness: Coefficient = 0.1  # c_s
    symmetry: Coefficient = 0.0  # of r_str
    terminal: Coefficient = 1.0
    # of soles that land fast; not in Table S4
    landing: Coefficient = 0.0
    # of motors beyond their no-load speed; not in Table S4
    overspeed: Coefficient = 0.0
    # of an action of 1, averaged over 0.2 s, while the command is to stand; not in
    # Table S4
    stand: Coefficient = 0.0
    schedule: Schedule = "text"  # see rewards.speed_schedule
    tracking_shape: TrackingShape = TrackingShape()


@dataclasses.dataclass(frozen=True)
class EnvConfig:
    """All settings of BP2Env: by default the ideal robot, with Table S4's rewards;
    `make("bp2")` has others."""

    reference: Annotated[ReferenceName, tyro.conf.arg(prefix_name=False)] = (
        "collocation"
    )
    """reference motion of actions, rewards and starts; none: standing"""
    hardware: HardwareSpec = HardwareSpec()
    gait: KinematicConfig = KinematicConfig()
    library: CollocationConfig = CollocationConfig()
    control: ControlConfig = ControlConfig()
    commands: CommandConfig = CommandConfig()
    curriculum: CurriculumConfig = CurriculumConfig()
    reset: ResetConfig = ResetConfig()
    randomization: RandomizationConfig = RandomizationConfig()
    termination: TerminationConfig = TerminationConfig()
    terrain: TerrainConfig = TerrainConfig()
    reward: RewardConfig = RewardConfig()
    task: Annotated[TaskConfig, tyro.conf.Fixed, tyro.conf.Suppress] = TaskConfig()
    """a user's reward terms, terminations and observations: `--task`"""

    def __post_init__(self) -> None:
        """Refuse impossible values with a line that names the field."""
        check_bounds(self)
        speed, fastest = self.curriculum.start_speed, self.commands.max_forward
        if speed is not None and speed > fastest:
            raise UserError(
                f"curriculum.start_speed ({speed:g}) must be at most commands.max_forward ({fastest:g})"
            )
        control = self.control
        if control.launching_speed < math.inf and control.launching == math.inf:
            raise UserError(
                "control.launching_speed needs control.launching, m/s2; for no limit set both to inf"
            )
        if fastest >= control.launching_speed:
            raise UserError(
                f"commands.max_forward ({fastest:g}) must be below control.launching_speed "
                f"({control.launching_speed:g}): a launch never reaches that command"
            )
        if self.commands.hold_time[1] == 0.0:
            raise UserError("commands.hold_time must have an upper end above 0")
