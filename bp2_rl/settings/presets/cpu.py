"""The preset `cpu`: six minutes on two cores, with 1024 robots in the fused physics
kernel."""

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
from bp2_rl.settings.training import RunConfig, TrainConfig, Weights

RUN = RunConfig(steps=6_000_000, logs=100, checkpoints=6, judged=24)


def imitation(weights: Weights, robot: HardwareSpec) -> TrainConfig:
    """Return the settings of the imitation stage: easier commands, and less randomised,
    than in the relaxed stage."""
    env = EnvConfig(
        hardware=robot,
        library=CollocationConfig(path="bp2_trot_slow"),
        control=ControlConfig(clock_at_rest=False),
        commands=CommandConfig(
            max_forward=13.0,
            max_lateral=0.2,
            straight_fraction=0.8,
            acceleration=(1.0, 5.0),
        ),
        reset=ResetConfig(standing_fraction=0.3),
        randomization=RandomizationConfig(
            friction=ranges_of(robot).mild_friction,
            losses=ranges_of(robot).losses,
            mass=(0.95, 1.05),
            com_offset=0.01,
            latency=(0.0, 0.006),
            joint_velocity_noise=0.15,
            push_velocity=0.2,
        ),
        reward=(PAPER if weights == "paper" else OURS_SMALL)["imitation"],
    )
    ppo = PPOConfig(
        num_envs=1024,
        num_minibatches=8,
        policy_layers=(128, 128),
        value_layers=(128, 128),
        symmetric=True,
        averaging=0.9,
        critic_steps=12,
        desired_kl=0.02,
        max_learning_rate=2e-3,
        entropy_cost=2e-3,
    )
    return TrainConfig("imitation", env, ppo, RUN, impl="kernel")


def relaxed(weights: Weights, robot: HardwareSpec) -> TrainConfig:
    """Return the settings of the relaxed stage: the whole range of commands, and all of
    the randomisation."""
    env = EnvConfig(
        hardware=robot,
        library=CollocationConfig(path="bp2_trot_slow"),
        control=ControlConfig(clock_at_rest=False),
        commands=CommandConfig(
            max_turn=4.0, limit_fraction=0.3, slow_fraction=0.2, stand_fraction=0.15
        ),
        reset=ResetConfig(standing_fraction=0.5),
        randomization=RandomizationConfig(
            friction=ranges_of(robot).friction, losses=ranges_of(robot).losses
        ),
        reward=(PAPER if weights == "paper" else OURS_SMALL)["relaxed"],
    )
    ppo = PPOConfig(
        num_envs=1024,
        num_minibatches=8,
        policy_layers=(128, 128),
        value_layers=(128, 128),
        symmetric=True,
        averaging=0.9,
        learning_rate=1e-4,
        desired_kl=0.02,
        max_learning_rate=2e-3,
        entropy_cost=1e-3,
    )
    return TrainConfig("relaxed", env, ppo, RUN, impl="kernel")
