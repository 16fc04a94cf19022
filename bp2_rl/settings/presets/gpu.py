"""The preset `gpu`: the recipe of the shipped policies, in the fused physics kernel."""

import dataclasses

from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.settings.env import (
    CommandConfig,
    ControlConfig,
    EnvConfig,
    RandomizationConfig,
    ResetConfig,
)
from bp2_rl.settings.ppo import PPOConfig
from bp2_rl.settings.presets.rewards import OURS, PAPER
from bp2_rl.settings.presets.robots import ranges_of
from bp2_rl.settings.reference import CollocationConfig
from bp2_rl.settings.training import RunConfig, TrainConfig, Weights

HISTORY = (5, 10, 15, 20)
"""Control steps, 25 to 100 ms: a third of a stride, in which legs and trunk tell how
fast the robot moves."""


def imitation(weights: Weights, robot: HardwareSpec) -> TrainConfig:
    """Return the settings of the imitation stage: the whole range of commands, fast,
    slow, standing and turning."""
    env = EnvConfig(
        hardware=robot,
        library=CollocationConfig(path="bp2_trot_slow"),
        control=ControlConfig(
            clock_at_rest=False, history=HISTORY, launching=6.0, launching_speed=18.0
        ),
        commands=CommandConfig(
            max_turn=4.0, limit_fraction=0.3, slow_fraction=0.2, stand_fraction=0.15
        ),
        reset=ResetConfig(standing_fraction=0.5),
        randomization=RandomizationConfig(
            friction=ranges_of(robot).friction, losses=ranges_of(robot).losses
        ),
        reward=(PAPER if weights == "paper" else OURS)["imitation"],
    )
    ppo = PPOConfig(
        symmetric=True,
        dtype="bfloat16",
        averaging=0.9,
        critic_steps=6,
        desired_kl=0.02,
        entropy_cost=2e-3,
    )
    return TrainConfig(
        "imitation", env, ppo, RunConfig(steps=40_000_000, judged=60), impl="kernel"
    )


def relaxed(weights: Weights, robot: HardwareSpec) -> TrainConfig:
    """Return the settings of the relaxed stage: launches far behind the command, gentle
    stops and long stands."""
    env = EnvConfig(
        hardware=robot,
        library=CollocationConfig(path="bp2_trot_slow"),
        control=ControlConfig(
            clock_at_rest=False,
            history=HISTORY,
            launching=6.0,
            launching_speed=18.0,
            braking=4.0,
            stopping_time=0.9,
        ),
        commands=CommandConfig(
            max_turn=4.0,
            limit_fraction=0.3,
            slow_fraction=0.2,
            stand_fraction=0.15,
            stand_time=(1.0, 6.0),
        ),
        reset=ResetConfig(
            standing_fraction=0.5, standing_time=(0.0, 1.0), command_error=5.0
        ),
        randomization=RandomizationConfig(
            friction=ranges_of(robot).friction, losses=ranges_of(robot).losses
        ),
        reward=PAPER["relaxed"]
        if weights == "paper"
        else dataclasses.replace(OURS["relaxed"], stand=1.0),
    )
    ppo = PPOConfig(
        symmetric=True,
        dtype="bfloat16",
        averaging=0.9,
        learning_rate=1e-4,
        desired_kl=0.02,
        entropy_cost=2e-3,
        entropy_decay=200.0,
    )
    return TrainConfig(
        "relaxed", env, ppo, RunConfig(steps=100_000_000, judged=60), impl="kernel"
    )
