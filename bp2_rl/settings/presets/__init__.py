"""The presets: a module for each size of machine, with a function for each stage;
rewards and robots' ranges beside.

A preset is a config, never a code path: what it does not set is the default of
`settings.env` and `settings.ppo`. docs/notes/training.md says what was tried.
"""

import dataclasses
from pathlib import Path
from typing import get_args

from bp2_rl.base.errors import require_kind, require_one_of
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.named import find_robot
from bp2_rl.settings.presets import cpu, first, gpu, smoke
from bp2_rl.settings.presets.robots import settled, sized
from bp2_rl.settings.training import Preset, Stage, TrainConfig, Weights

PRESETS = {
    "smoke": {"imitation": smoke.imitation, "relaxed": smoke.relaxed},
    "first": {"imitation": first.imitation, "relaxed": first.relaxed},
    "cpu": {"imitation": cpu.imitation, "relaxed": cpu.relaxed},
    "gpu": {"imitation": gpu.imitation, "relaxed": gpu.relaxed},
}


def preset(
    stage: Stage,
    preset: Preset,
    weights: Weights | None = None,
    robot: str | Path | HardwareSpec = "built",
) -> TrainConfig:
    """Return a stage's settings for a size of machine.

    Args:
        stage: `imitation`, from random weights, or `relaxed`, on from a run of
            imitation.
        preset: `gpu`, `cpu`, `first` (to trot, in minutes) or `smoke` (for tests).
        weights: the rewards; by default `paper` with `smoke`, else `ours`.
        robot: a robot's name, its robot file's path, or its hardware.

    Raises:
        UserError: there is no such stage, preset, set of weights or robot.
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
    chosen = weights or ("paper" if preset == "smoke" else "ours")
    config = PRESETS[preset][stage](
        chosen, robot if isinstance(robot, HardwareSpec) else find_robot(str(robot))
    )
    config = dataclasses.replace(config, env=sized(config.env))
    return settled(config) if stage == "relaxed" and chosen == "ours" else config
