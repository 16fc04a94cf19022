"""The MDP's settings: frozen dataclasses, written whole into every run and every exported policy."""

import dataclasses
import math
from typing import Annotated, Any, Literal

import tyro

from bp2_rl.config import ConfigError
from bp2_rl.errors import UserError
from bp2_rl.gait.collocation.library import CollocationConfig, CollocationGait
from bp2_rl.gait.kinematic import KinematicConfig, KinematicGait
from bp2_rl.gait.reference import ReferenceMotion
from bp2_rl.gait.standing import Standing
from bp2_rl.robot.specs import HardwareSpec

Range = tuple[float, float]
ReferenceName = Literal["collocation", "kinematic", "none"]


@dataclasses.dataclass(frozen=True)
class ControlConfig:
    """What the policy's action means, and the joint PD loop under it (gains ASSUMED)."""

    mode: Literal["residual", "absolute"] = "residual"  # around the reference motion, or around the standing pose
    action_scale: float = 0.5  # rad a unit of action
    action_limit: float = 3.0  # actions are clipped to +- this
    stiffness: float = 250.0  # Nm/rad
    damping: float = 3.0  # Nm s/rad
    feedforward: float = 0.0  # share of the reference's torque that is added, in `residual` mode
    current_lag: float = 0.0  # s, first-order torque lag of the drive; 0 = none
    torque_rate: float = float("inf")  # Nm/s


@dataclasses.dataclass(frozen=True)
class CommandConfig:
    """How velocity commands are drawn: a target, approached at a limited rate, drawn anew every few seconds."""

    max_forward: float = 15.5  # m/s, v_x^max of Table S4, which gives none
    max_lateral: float = 0.5  # m/s, v_y^max
    max_yaw_rate: float = 1.0  # rad/s, omega_z^max
    max_backward: float = 0.0  # m/s
    max_turn: float = 3.0  # m/s2, largest forward speed x yaw rate: what friction holds with a margin
    limit_fraction: float = 0.4  # share of targets in the fastest tenth of what the curriculum allows
    straight_fraction: float = 0.5  # share of targets with no lateral and no yaw command
    stand_fraction: float = 0.05  # share of targets that are zero
    acceleration: Range = (1.0, 8.0)  # m/s2, rate at which the forward command approaches its target
    turn_acceleration: float = 2.0  # m/s2 and rad/s2, likewise for lateral and yaw
    hold_time: Range = (1.0, 3.0)  # s, from reaching a target to the next draw


@dataclasses.dataclass(frozen=True)
class CurriculumConfig:
    """Per-robot speed curriculum: commands tracked near a robot's limit raise that limit, falls lower it."""

    start_speed: float | None = None
    """m/s, fastest forward command at level 0 (level 1: commands.max_forward); None: all commands from the start on"""
    near: float = 0.9  # what counts is the time at commands above this share of the limit
    evidence: float = 0.5  # s of such time at least, between two draws
    tolerance: float = 0.1  # of (1 m/s + limit), for the mean speed error in that time
    raise_by: float = 0.15
    lower_by: float = 0.05


@dataclasses.dataclass(frozen=True)
class ResetConfig:
    """Where episodes start."""

    standing_fraction: float = 0.3  # start at rest with the command ramping up; the others on the running reference
    joint_noise: float = 0.05  # rad, uniform +-
    velocity_noise: float = 0.1  # share of the reference's velocities, uniform +-


@dataclasses.dataclass(frozen=True)
class RandomizationConfig:
    """Domain randomisation, drawn anew at each reset. Ranges are uniform, factors multiply."""

    enabled: bool = True
    friction: Range = (0.55, 1.22)  # factor: 0.5 to 1.1 on ground of 0.9
    mass: Range = (0.9, 1.1)  # factor, every body by itself
    com_offset: float = 0.02  # m, of the trunk, +- on each axis
    strength: Range = (0.9, 1.0)  # factor on the peak torque
    gains: Range = (0.9, 1.1)  # factor on PD stiffness and damping
    latency: Range = (0.0, 0.010)  # s, from observation to new joint target
    joint_position_noise: float = 0.01  # rad, standard deviation
    joint_velocity_noise: float = 0.3  # rad/s
    orientation_noise: float = 0.01
    angular_velocity_noise: float = 0.1  # rad/s
    push_interval: float = 4.0  # s, mean time between pushes
    push_velocity: float = 0.5  # m/s, largest sudden change of the trunk's horizontal velocity


@dataclasses.dataclass(frozen=True)
class TerminationConfig:
    """When a robot has fallen."""

    # Together they end an episode before the trunk can touch the ground, whose contact training leaves out.
    min_height: float = 0.3  # m, trunk centre
    min_up: float = 0.8  # vertical part of the body's z axis: 37 deg of tilt
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

    reference: Annotated[ReferenceName, tyro.conf.arg(prefix_name=False)] = "collocation"
    """the motion that residual actions, imitation rewards and episode starts are about; none: standing still"""
    hardware: HardwareSpec = HardwareSpec()
    gait: KinematicConfig = KinematicConfig()
    library: CollocationConfig = CollocationConfig()
    control: ControlConfig = ControlConfig()
    commands: CommandConfig = CommandConfig()
    curriculum: CurriculumConfig = CurriculumConfig()
    reset: ResetConfig = ResetConfig()
    randomization: RandomizationConfig = RandomizationConfig()
    termination: TerminationConfig = TerminationConfig()
    reward: RewardConfig = RewardConfig()

    def __post_init__(self) -> None:
        """Refuse impossible values with a line that names the field."""
        _check_finite(self, "")
        for name, group in (("commands", self.commands), ("randomization", self.randomization), ("reset", self.reset)):
            for field in dataclasses.fields(group):
                value, path = getattr(group, field.name), f"{name}.{field.name}"
                if isinstance(value, tuple):
                    _require(0 <= value[0] <= value[1], f"{path} must be a range (low, high) with 0 <= low <= high")
                elif field.name.endswith("fraction"):
                    _require(0 <= value <= 1, f"{path} must lie between 0 and 1, got {value}")
                elif not isinstance(value, bool):
                    _require(value >= 0, f"{path} must not be negative, got {value}")
        control, curriculum, randomization = self.control, self.curriculum, self.randomization
        for path, value in (
            ("commands.max_forward", self.commands.max_forward),
            ("commands.acceleration", self.commands.acceleration[0]),
            ("commands.hold_time", self.commands.hold_time[1]),
            ("control.action_scale", control.action_scale),
            ("control.action_limit", control.action_limit),
            ("control.stiffness", control.stiffness),
            ("control.torque_rate", control.torque_rate),
            ("curriculum.tolerance", curriculum.tolerance),
            ("randomization.friction", randomization.friction[0]),
            ("randomization.mass", randomization.mass[0]),
            ("randomization.push_interval", randomization.push_interval),
            ("termination.max_speed", self.termination.max_speed),
            ("reward.tracking_width", self.reward.tracking_width),
        ):
            _require(value > 0, f"{path} must be positive, got {value}")
        for path, value in (
            ("control.damping", control.damping),
            ("control.current_lag", control.current_lag),
            ("curriculum.evidence", curriculum.evidence),
        ):
            _require(value >= 0, f"{path} must not be negative, got {value}")
        for path, value in (
            ("curriculum.near", curriculum.near),
            ("curriculum.raise_by", curriculum.raise_by),
            ("curriculum.lower_by", curriculum.lower_by),
            ("termination.min_up", self.termination.min_up),
        ):
            _require(0 <= value < 1, f"{path} must lie between 0 and 1, got {value}")
        _require(
            curriculum.start_speed is None or 0 < curriculum.start_speed <= self.commands.max_forward,
            "curriculum.start_speed must lie between 0 and commands.max_forward, or be None",
        )
        _require(
            0 <= self.termination.min_height < self.motion.height,
            f"termination.min_height must lie between 0 and the reference's height of {self.motion.height:.3f} m",
        )
        _require(randomization.latency[1] <= 0.010, "randomization.latency may be at most 0.010 s")

    @property
    def motion(self) -> ReferenceMotion:
        """The reference motion that `reference` names, on this robot."""
        match self.reference:
            case "kinematic":
                return KinematicGait(**vars(self.gait), hardware=self.hardware)
            case "collocation":
                return CollocationGait(**vars(self.library), hardware=self.hardware)
            case "none":
                return Standing(self.hardware)


def upgrade(data: Any) -> Any:
    """The JSON of a policy's card or of a run's settings, made by any version, as `from_json` of this one reads it.

    Once both gaits of an `EnvConfig` held a copy of its robot. `EnvConfig` saw to it that the copies were equal, so
    nothing is lost without them; a file in which one differs was never written by us.

    Raises:
        ConfigError: a gait is of another robot than the environment.
    """
    env = data.get("env") if isinstance(data, dict) else None
    if not isinstance(env, dict):
        return data
    changed = dict(env)
    for name in ("gait", "library"):
        gait = env.get(name)
        if isinstance(gait, dict) and "hardware" in gait:
            if gait["hardware"] != env.get("hardware"):
                raise ConfigError(f"env.{name}.hardware: is another robot than env.hardware")
            changed[name] = {key: value for key, value in gait.items() if key != "hardware"}
    return data | {"env": changed}


MAY_BE_INFINITE = ("control.torque_rate", "reward.tracking_width")


def _check_finite(config: Any, path: str) -> None:
    """Refuse NaN anywhere, and infinity where it has no meaning."""
    for field in dataclasses.fields(config):
        value, name = getattr(config, field.name), f"{path}{field.name}"
        if dataclasses.is_dataclass(value):
            _check_finite(value, f"{name}.")
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, float) and not math.isfinite(number):
                _require(number > 0 and name in MAY_BE_INFINITE, f"{name} must be a finite number, got {number}")


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise UserError(message)
