"""The preset `smoke`: slow running on the kinematic gait with little randomised, in a
minute on two cores."""

from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.settings.env import (
    CommandConfig,
    CurriculumConfig,
    EnvConfig,
    RandomizationConfig,
    ResetConfig,
)
from bp2_rl.settings.ppo import PPOConfig
from bp2_rl.settings.presets.rewards import OURS, PAPER
from bp2_rl.settings.presets.robots import ranges_of
from bp2_rl.settings.training import RunConfig, Stage, TrainConfig, Weights

RUN = RunConfig(steps=40_960, logs=20, checkpoints=2)


def imitation(weights: Weights, robot: HardwareSpec) -> TrainConfig:
    """Return the settings of the imitation stage."""
    ppo = PPOConfig(
        num_envs=64,
        unroll_length=16,
        num_minibatches=4,
        num_epochs=2,
        policy_layers=(64, 64),
        value_layers=(64, 64),
        episode_length=400,
    )
    return TrainConfig(
        "imitation", _env("imitation", weights, robot), ppo, RUN, impl="jax"
    )


def relaxed(weights: Weights, robot: HardwareSpec) -> TrainConfig:
    """Return the settings of the relaxed stage."""
    ppo = PPOConfig(
        num_envs=64,
        unroll_length=16,
        num_minibatches=4,
        num_epochs=2,
        policy_layers=(64, 64),
        value_layers=(64, 64),
        episode_length=400,
        learning_rate=1e-4,
        entropy_cost=2e-3,
    )
    return TrainConfig("relaxed", _env("relaxed", weights, robot), ppo, RUN, impl="jax")


def _env(stage: Stage, weights: Weights, robot: HardwareSpec) -> EnvConfig:
    ranges = ranges_of(robot)
    return EnvConfig(
        reference="kinematic",
        hardware=robot,
        commands=CommandConfig(max_forward=3.0, acceleration=(1.0, 4.0)),
        curriculum=CurriculumConfig(start_speed=2.0),
        reset=ResetConfig(standing_fraction=0.2),
        randomization=RandomizationConfig(
            friction=ranges.mild_friction, losses=ranges.losses, latency=(0.0, 0.006)
        ),
        reward=(PAPER if weights == "paper" else OURS)[stage],
    )
