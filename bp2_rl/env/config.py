"""The MDP's settings: frozen dataclasses, written whole into every run and every exported policy."""

import dataclasses
from typing import Literal

from bp2_rl.errors import UserError
from bp2_rl.gait.kinematic import KinematicGait
from bp2_rl.robot.specs import HardwareSpec

Range = tuple[float, float]


@dataclasses.dataclass(frozen=True)
class ControlConfig:
    """What the policy's action means, and the joint PD loop under it (gains ASSUMED)."""

    mode: Literal["residual", "absolute"] = "residual"  # around the reference motion, or around the standing pose
    action_scale: float = 0.5  # rad a unit of action
    action_limit: float = 3.0  # actions are clipped to +- this
    stiffness: float = 250.0  # Nm/rad
    damping: float = 3.0  # Nm s/rad
    current_lag: float = 0.0  # s, first-order torque lag of the drive; 0 = none
    torque_rate: float = float("inf")  # Nm/s


@dataclasses.dataclass(frozen=True)
class CommandConfig:
    """How velocity commands are drawn: a target, approached at a limited rate, drawn anew every few seconds."""

    max_forward: float = 12.0  # m/s, v_x^max of Table S4
    max_lateral: float = 0.5  # m/s, v_y^max
    max_yaw_rate: float = 1.0  # rad/s, omega_z^max
    max_backward: float = 0.0  # m/s
    straight_fraction: float = 0.5  # share of targets with no lateral and no yaw command
    stand_fraction: float = 0.05  # share of targets that are zero
    acceleration: Range = (1.0, 4.0)  # m/s2, rate at which the forward command approaches its target
    turn_acceleration: float = 2.0  # m/s2 and rad/s2, likewise for lateral and yaw
    hold_time: Range = (2.0, 4.0)  # s, from one draw to the next


@dataclasses.dataclass(frozen=True)
class CurriculumConfig:
    """Per-robot speed curriculum: tracked segments raise a robot's fastest command, falls lower it."""

    start_speed: float = 4.0  # m/s, fastest forward command at level 0; level 1 is commands.max_forward
    tolerance: float = 0.12  # a segment is tracked if its mean speed error is below tolerance x (1 m/s + command)
    raise_by: float = 0.25
    lower_by: float = 0.1


@dataclasses.dataclass(frozen=True)
class ResetConfig:
    """Where episodes start."""

    standing_fraction: float = 0.2  # start at rest with the command ramping up; the others on the running reference
    joint_noise: float = 0.05  # rad, uniform +-
    velocity_noise: float = 0.1  # share of the reference's velocities, uniform +-


@dataclasses.dataclass(frozen=True)
class RandomizationConfig:
    """Domain randomisation, drawn anew at each reset. Ranges are uniform, factors multiply."""

    enabled: bool = True
    friction: Range = (0.6, 1.1)
    mass: Range = (0.9, 1.1)  # factor, every body by itself
    com_offset: float = 0.02  # m, of the trunk, +- on each axis
    strength: Range = (0.9, 1.0)  # factor on the peak torque
    gains: Range = (0.9, 1.1)  # factor on PD stiffness and damping
    latency: Range = (0.0, 0.006)  # s, from observation to new joint target
    joint_position_noise: float = 0.01  # rad, standard deviation
    joint_velocity_noise: float = 0.3  # rad/s
    orientation_noise: float = 0.01
    angular_velocity_noise: float = 0.1  # rad/s
    push_interval: float = 4.0  # s, mean time between pushes
    push_velocity: float = 0.5  # m/s, largest sudden change of the trunk's horizontal velocity


@dataclasses.dataclass(frozen=True)
class TerminationConfig:
    """When a robot has fallen."""

    min_height: float = 0.25  # m, trunk centre
    min_up: float = 0.5  # vertical part of the body's z axis: 60 deg of tilt
    max_speed: float = 200.0  # rad/s or m/s in any coordinate: the physics has exploded


@dataclasses.dataclass(frozen=True)
class RewardConfig:
    """Coefficients of Table S4; the defaults are its imitation column. See `env.rewards` for the terms."""

    height: float = 0.05  # c_h
    attitude: float = 0.05  # c_R
    imitation: float = 0.6  # c_J bar
    tracking: float = 0.1  # c_V bar
    torque: float = 0.1  # c_tau
    power: float = 0.0  # c_P
    smoothness: float = 0.1  # c_s
    symmetry: float = 0.0  # of r_str
    terminal: float = 1.0
    schedule: Literal["text", "literal"] = "text"  # see rewards.speed_schedule
    tracking_width: float = float("inf")  # m/s, command at which the tracking kernel has widened by sqrt 2; inf = paper


@dataclasses.dataclass(frozen=True)
class EnvConfig:
    """Everything that BP2Env depends on."""

    hardware: HardwareSpec = HardwareSpec()
    gait: KinematicGait = KinematicGait()
    control: ControlConfig = ControlConfig()
    commands: CommandConfig = CommandConfig()
    curriculum: CurriculumConfig = CurriculumConfig()
    reset: ResetConfig = ResetConfig()
    randomization: RandomizationConfig = RandomizationConfig()
    termination: TerminationConfig = TerminationConfig()
    reward: RewardConfig = RewardConfig()

    def __post_init__(self) -> None:
        """Refuse impossible values with a line that names the field; the gait is that of this hardware's legs."""
        object.__setattr__(self, "gait", dataclasses.replace(self.gait, hardware=self.hardware))
        _require(self.commands.max_forward > 0, "commands.max_forward must be a positive speed in m/s")
        for name in ("max_lateral", "max_yaw_rate", "max_backward", "turn_acceleration"):
            _require(getattr(self.commands, name) >= 0, f"commands.{name} must not be negative")
        _require(
            0 < self.curriculum.start_speed <= self.commands.max_forward,
            "curriculum.start_speed must lie between 0 and commands.max_forward",
        )
        _require(self.control.action_scale > 0, "control.action_scale must be positive")
        _require(self.control.stiffness > 0, "control.stiffness must be positive")
        _require(self.control.damping >= 0, "control.damping must not be negative")
        _require(self.reward.tracking_width > 0, "reward.tracking_width must be positive")
        _require(self.randomization.latency[1] <= 0.010, "randomization.latency may be at most 0.010 s")
        for group in (self.commands, self.randomization):
            for field in dataclasses.fields(group):
                value = getattr(group, field.name)
                if isinstance(value, tuple):
                    low, high = value
                    _require(0 <= low <= high, f"{field.name} must be a range (low, high) with 0 <= low <= high")
        for group in (self.commands, self.reset):
            for field in dataclasses.fields(group):
                if field.name.endswith("fraction"):
                    _require(0 <= getattr(group, field.name) <= 1, f"{field.name} must lie between 0 and 1")


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise UserError(message)
