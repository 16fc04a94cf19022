"""The presets, each as differences from the defaults of `settings.env` and
`settings.ppo`; `rewards` and `robots` have rewards and scaling to other robots.

A preset is a config, never a code path. docs/notes/training.md has the ablation.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import get_args

from bp2_rl.base.errors import require_kind, require_one_of
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.named import find_robot
from bp2_rl.settings.env import EnvConfig, RandomizationConfig
from bp2_rl.settings.ppo import PPOConfig
from bp2_rl.settings.presets.rewards import OURS, OURS_SMALL, PAPER
from bp2_rl.settings.presets.robots import (
    GROUND,
    MILD_GROUND,
    drawn_for,
    sized,
    with_slow_commands,
)
from bp2_rl.settings.task import (
    Task,
    TaskSources,
    read_task,
    task_config,
    user_code,
)
from bp2_rl.settings.training import Preset, RunConfig, Stage, TrainConfig, Weights

Differences = Mapping[str, Mapping[str, object]]
"""Settings that differ from the defaults, by their group: `run`, `ppo`, or a group of
the environment's."""

SLOW_TROT: Differences = {
    "library": {"path": "bp2_trot_slow"},
    "control": {"clock_at_rest": False},
    "ppo": {
        "symmetric": True,
        "averaging": 0.9,
        "desired_kl": 0.02,
        "entropy_cost": 2e-3,
    },
}
"""Settings that all presets but `smoke` share: slow trots in the library, symmetric
networks, averaged weights."""

ALL_COMMANDS: Differences = {
    "commands": {
        "max_turn": 4.0,
        "limit_fraction": 0.3,
        "slow_fraction": 0.2,
        "stand_fraction": 0.15,
    },
    "reset": {"standing_fraction": 0.5},
}
"""The whole range of commands: fast, slow, standing and turning."""

EASY: Differences = {
    "commands": {"max_lateral": 0.2, "straight_fraction": 0.8},
    "randomization": {
        "mass": (0.95, 1.05),
        "com_offset": 0.01,
        "latency": (0.0, 0.006),
        "joint_velocity_noise": 0.15,
        "push_velocity": 0.2,
    },
}
"""Easier commands and less randomisation; the ground is `MILD_GROUND`."""

HISTORY = (5, 10, 15, 20)
"""Control steps, 25 to 100 ms, over which a policy observes changes of its observation:
in a third of a stride the motion of legs and trunk shows the robot's speed."""
GPU: Differences = {
    "control": {"history": HISTORY, "launching": 6.0, "launching_speed": 18.0},
    "ppo": {"dtype": "bfloat16"},
    "run": {"judged": 60},
}
"""The recipe of the shipped policies."""
GENTLE: Differences = {
    "control": {"braking": 4.0, "stopping_time": 0.9},
    "commands": {"stand_time": (1.0, 6.0)},
    "reset": {"standing_time": (0.0, 1.0), "command_error": 5.0},
    "ppo": {"learning_rate": 1e-4, "entropy_decay": 200.0},
}
"""Launches far behind the command, gentle stops and long stands."""

CPU: Differences = {
    "ppo": {
        "num_envs": 1024,
        "num_minibatches": 8,
        "policy_layers": (128, 128),
        "value_layers": (128, 128),
        "max_learning_rate": 2e-3,
    },
    "run": {"steps": 6_000_000, "logs": 100, "checkpoints": 6, "judged": 24},
}
"""A training of six minutes on two cores, with 1024 robots."""
FIRST: Differences = {
    "commands": {"max_forward": 2.5, "acceleration": (1.0, 2.0)},
    "reset": {"standing_fraction": 0.6},
    "ppo": {"num_envs": 512, "policy_layers": (64, 64), "value_layers": (64, 64)},
    "run": {"steps": 2_400_000, "logs": 40, "checkpoints": 4, "judged": 4},
}
"""From `CPU`: a short first training, in which a robot learns to trot at 2 m/s."""
HALF_OF_FIRST: Differences = {
    "commands": {"max_forward": 2.0},
    "ppo": {"num_envs": 256, "critic_steps": 4, "averaging": 0.8},
    "run": {"steps": 1_200_000, "checkpoints": 2, "judged": 12},
}
"""From `FIRST`: half the robots and half the control steps make as many train steps;
more policies are judged, so that `--until` ends a run sooner."""
FINE_TUNING: Differences = {"ppo": {"learning_rate": 1e-4, "entropy_cost": 1e-3}}
"""A relaxed stage of `CPU` or `FIRST`, which continues with trained networks."""

SMOKE: Differences = {
    "commands": {"max_forward": 3.0, "acceleration": (1.0, 4.0)},
    "curriculum": {"start_speed": 2.0},
    "reset": {"standing_fraction": 0.2},
    "randomization": {"latency": (0.0, 0.006)},
    "ppo": {
        "num_envs": 64,
        "unroll_length": 16,
        "num_minibatches": 4,
        "num_epochs": 2,
        "policy_layers": (64, 64),
        "value_layers": (64, 64),
        "episode_length": 400,
    },
    "run": {"steps": 40_960, "logs": 20, "checkpoints": 2},
}
"""Slow running on the kinematic gait with little randomised, in a minute on two
cores."""

PRESETS: dict[Preset, dict[Stage, tuple[Differences, ...]]] = {
    "smoke": {
        "imitation": (SMOKE,),
        "relaxed": (SMOKE, {"ppo": {"learning_rate": 1e-4, "entropy_cost": 2e-3}}),
    },
    "first": {
        "imitation": (SLOW_TROT, EASY, CPU, FIRST, HALF_OF_FIRST),
        "relaxed": (SLOW_TROT, EASY, CPU, FIRST, FINE_TUNING),
    },
    "cpu": {
        "imitation": (
            *(SLOW_TROT, EASY, CPU, {"ppo": {"critic_steps": 6, "averaging": 0.8}}),
            {"commands": {"max_forward": 13.0, "acceleration": (1.0, 5.0)}},
        ),
        "relaxed": (SLOW_TROT, ALL_COMMANDS, CPU, FINE_TUNING),
    },
    "gpu": {
        "imitation": (
            *(SLOW_TROT, ALL_COMMANDS, GPU),
            {"ppo": {"critic_steps": 6}, "run": {"steps": 40_000_000}},
        ),
        "relaxed": (SLOW_TROT, ALL_COMMANDS, GPU, GENTLE),
    },
}
"""Settings of each preset's stages, as differences from the defaults; later ones
override earlier ones."""


def preset(
    stage: Stage,
    preset: Preset,
    weights: Weights | None = None,
    robot: str | Path | HardwareSpec = "built",
    task: str | Path | Task | TaskSources | None = None,
) -> TrainConfig:
    """Return the training settings of a stage in a preset.

    Args:
        stage: `imitation`, from random weights, or `relaxed`, on from a run of
            imitation.
        preset: `gpu`, `cpu`, `first` (to trot, in minutes) or `smoke` (for tests).
        weights: the rewards; by default `paper` with `smoke`, else `ours`.
        robot: a robot's name, its robot file's path, or its hardware.
        task: your own rewards, terminations, observations and settings: FILE.py,
            FILE.py:NAME or package.module:NAME (docs/howto/write_a_reward_term.md).

    Raises:
        UserError: there is no such stage, preset, set of weights, robot or task, or the
            task's code fails.
    """
    require_one_of("stage", stage, get_args(Stage))
    require_one_of("preset", preset, PRESETS)
    require_one_of("weights", weights or "ours", get_args(Weights))
    require_kind(
        "robot",
        robot,
        (str, Path, HardwareSpec),
        "a robot's name, a robot file's path or a HardwareSpec",
    )
    hardware = robot if isinstance(robot, HardwareSpec) else find_robot(str(robot))
    chosen = weights or ("paper" if preset == "smoke" else "ours")
    differences = PRESETS[preset][stage]
    mild = preset == "smoke" or EASY in differences
    env = EnvConfig(
        reference="kinematic" if preset == "smoke" else "collocation",
        hardware=hardware,
        randomization=drawn_for(
            hardware, RandomizationConfig(), MILD_GROUND if mild else GROUND
        ),
        reward=PAPER[stage],
    )
    if chosen == "ours":
        ours = OURS_SMALL if CPU in differences else OURS
        firm = 1.0 if GENTLE in differences else 0.0
        reward = dataclasses.replace(ours[stage], stand=firm)
        env = dataclasses.replace(env, reward=reward)
    config = TrainConfig(
        stage, env, PPOConfig(), RunConfig(), "jax" if preset == "smoke" else "kernel"
    )
    config = _changed(config, differences)
    config = dataclasses.replace(config, env=sized(config.env))
    config = (
        with_slow_commands(config)
        if stage == "relaxed" and chosen == "ours"
        else config
    )
    return config if task is None else with_task(config, task)


def with_task(
    config: TrainConfig, task: str | Path | Task | TaskSources
) -> TrainConfig:
    """Return a stage's settings with a task, and as the task changes them.

    Raises:
        UserError: there is no such task, or its code fails.
    """
    code = read_task(task) if isinstance(task, str | Path) else task
    own = task_config(code, config.stage)
    if (change := own.task.settings) is not None:
        with user_code("settings"):
            config = change(config)
            require_kind("settings", config, TrainConfig, "the TrainConfig, changed")
    return dataclasses.replace(config, env=dataclasses.replace(config.env, task=own))


def _changed(config: TrainConfig, differences: tuple[Differences, ...]) -> TrainConfig:
    """Return the settings with the differences applied, in their order."""
    groups = {group for difference in differences for group in difference}
    merged = {
        group: {
            name: x
            for difference in differences
            for name, x in difference.get(group, {}).items()
        }
        for group in groups
    }
    whole = {
        group: dataclasses.replace(getattr(config, group), **merged.pop(group))
        for group in groups & {"ppo", "run"}
    }
    env = {
        group: dataclasses.replace(getattr(config.env, group), **values)
        for group, values in merged.items()
    }
    return dataclasses.replace(
        config, env=dataclasses.replace(config.env, **env), **whole
    )
