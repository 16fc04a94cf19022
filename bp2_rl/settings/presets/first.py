"""The preset `first`: a first training, in which a robot learns to trot at 2 m/s before
one's eyes, on two cores."""

from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.settings.env import (
    CommandConfig,
    ControlConfig,
    EnvConfig,
    RandomizationConfig,
    ResetConfig,
)
from bp2_rl.settings.ppo import PPOConfig
from bp2_rl.settings.presets.rewards import OURS_SMALL, PAPER
from bp2_rl.settings.presets.robots import ranges_of
from bp2_rl.settings.reference import CollocationConfig
from bp2_rl.settings.training import RunConfig, Stage, TrainConfig, Weights

RUN = RunConfig(steps=2_400_000, logs=40, checkpoints=4, judged=4)


def imitation(weights: Weights, robot: HardwareSpec) -> TrainConfig:
    """Return the settings of the imitation stage."""
    ppo = PPOConfig(
        num_envs=512,
        num_minibatches=8,
        policy_layers=(64, 64),
        value_layers=(64, 64),
        symmetric=True,
        averaging=0.9,
        critic_steps=12,
        desired_kl=0.02,
        max_learning_rate=2e-3,
        entropy_cost=2e-3,
    )
    return TrainConfig(
        "imitation", _env("imitation", weights, robot), ppo, RUN, impl="kernel"
    )


def relaxed(weights: Weights, robot: HardwareSpec) -> TrainConfig:
    """Return the settings of the relaxed stage."""
    ppo = PPOConfig(
        num_envs=512,
        num_minibatches=8,
        policy_layers=(64, 64),
        value_layers=(64, 64),
        symmetric=True,
        averaging=0.9,
        learning_rate=1e-4,
        desired_kl=0.02,
        max_learning_rate=2e-3,
        entropy_cost=1e-3,
    )
    return TrainConfig(
        "relaxed", _env("relaxed", weights, robot), ppo, RUN, impl="kernel"
    )


def _env(stage: Stage, weights: Weights, robot: HardwareSpec) -> EnvConfig:
    ranges = ranges_of(robot)
    return EnvConfig(
        hardware=robot,
        library=CollocationConfig(path="bp2_trot_slow"),
        control=ControlConfig(clock_at_rest=False),
        commands=CommandConfig(
            max_forward=2.5,
            max_lateral=0.2,
            straight_fraction=0.8,
            acceleration=(1.0, 2.0),
        ),
        reset=ResetConfig(standing_fraction=0.6),
        randomization=RandomizationConfig(
            friction=ranges.mild_friction,
            losses=ranges.losses,
            mass=(0.95, 1.05),
            com_offset=0.01,
            latency=(0.0, 0.006),
            joint_velocity_noise=0.15,
            push_velocity=0.2,
        ),
        reward=(PAPER if weights == "paper" else OURS_SMALL)[stage],
    )
