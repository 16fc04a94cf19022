"""Presets: the values that they share, and the values in which they differ."""

from typing import get_args

import pytest

from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.robot.hardware import ROBOTS
from bp2_rl.settings import presets
from bp2_rl.settings.presets.rewards import PAPER
from bp2_rl.settings.presets.robots import drawn_for, on_robot
from bp2_rl.settings.training import Preset, Stage, TrainConfig, Weights

every_stage = pytest.mark.parametrize("stage", get_args(Stage))
every_preset = pytest.mark.parametrize("preset", get_args(Preset))


@every_stage
@every_preset
def test_the_settings_of_every_preset_survive_json(stage, preset):
    config = presets.preset(stage, preset)
    assert from_json(TrainConfig, to_json(config)) == config


@every_stage
@every_preset
@pytest.mark.parametrize("weights", get_args(Weights))
@pytest.mark.parametrize("robot", ROBOTS)
def test_a_preset_has_the_stage_the_robot_and_the_rewards_that_are_asked_for(
    stage, preset, weights, robot
):
    config = presets.preset(stage, preset, weights, robot)
    drawn = config.env.randomization
    assert config.stage == stage
    assert config.env.hardware == ROBOTS[robot]
    assert drawn.losses == drawn_for(ROBOTS[robot], drawn).losses
    assert (config.env.reward == PAPER[stage]) == (weights == "paper")
    others = presets.preset(
        stage, preset, "paper" if weights == "ours" else "ours", robot
    )
    assert config.env.reward != others.env.reward
    assert (config.ppo, config.run, config.env.commands) == (
        others.ppo,
        others.run,
        others.env.commands,
    )


@every_preset
def test_smoke_alone_has_the_papers_rewards_by_default(preset):
    default = "paper" if preset == "smoke" else "ours"
    assert presets.preset("relaxed", preset) == presets.preset(
        "relaxed", preset, default
    )


@pytest.mark.parametrize(
    ("preset", "tracking"), [("gpu", 2.0), ("cpu", 1.25), ("first", 1.25)]
)
@every_stage
def test_our_tracking_is_worth_what_the_help_says(stage, preset, tracking):
    assert presets.preset(stage, preset).env.reward.tracking == tracking


def test_the_gpu_preset_launches_alike_in_both_stages():
    for stage in get_args(Stage):
        control = presets.preset(stage, "gpu").env.control
        assert (control.launching, control.launching_speed) == (6.0, 18.0)


def test_a_relaxed_training_draws_what_its_robot_is_drawn_from_elsewhere():
    for robot in ROBOTS:
        env = presets.preset("relaxed", "gpu", robot=robot).env
        assert on_robot(presets.preset("relaxed", "gpu").env, ROBOTS[robot]) == env
