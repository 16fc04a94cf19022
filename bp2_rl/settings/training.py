"""What `imitation` and `relaxed`, `smoke`, `cpu` and `gpu` mean: configs, never code paths."""

import dataclasses
import math
from pathlib import Path
from typing import Annotated, Literal

import tyro

from bp2_rl.base.bounds import Range, Within, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import require_name
from bp2_rl.base.serialization import load_config
from bp2_rl.robot.specs import ROBOTS, RobotName
from bp2_rl.settings.env import (
    CommandConfig,
    ControlConfig,
    CurriculumConfig,
    EnvConfig,
    Impl,
    Kernel,
    ResetConfig,
    RewardConfig,
)
from bp2_rl.settings.ppo import PPOConfig
from bp2_rl.settings.reference import CollocationConfig

Stage = Literal["imitation", "relaxed"]
Preset = Literal["smoke", "cpu", "gpu"]

Weights = Literal["ours", "paper"]
Steps = Annotated[int, Within(1, 10**15)]
CONFIG = "config.json"
"""In a run's folder: its settings."""
LARGEST_SEED = 2**32 - 1
"""JAX takes the 32 lower bits of a seed."""

PAPER: dict[Stage, RewardConfig] = {
    "imitation": RewardConfig(),
    "relaxed": RewardConfig(
        height=0.0, attitude=0.0, imitation=0.1, tracking=0.4, torque=0.2, power=0.1, smoothness=0.2, symmetry=0.1
    ),
}
"""The two columns of Table S4."""

FOLLOWING = Kernel(floor=0.1, width=9.0, tail=0.5, yaw_width=0.1, yaw_reach=0.3, memory=0.2)
"""A slope at every error: sharp where motion is slow, wide where it is fast, a straight line beyond both, and blind to
how the trunk sways and turns within a stride."""
SMALL_FLEET = Kernel(width=9.0, tail=0.3, yaw_width=0.4)
"""The kernel of the `cpu` preset, with tracking worth 1.25: closer tracking is learned more slowly."""
OURS: dict[Stage, RewardConfig] = {
    "imitation": dataclasses.replace(PAPER["imitation"], tracking=2.0, kernel=FOLLOWING),
    "relaxed": dataclasses.replace(PAPER["relaxed"], tracking=2.0, torque=0.1, kernel=FOLLOWING),
}
"""Table S4 with tracking worth more, by a kernel of our own: with the paper's, a robot that is 2 m/s too slow has
nothing to gain by running faster. docs/notes/training.md has the ablation."""

COMMANDS = CommandConfig(max_turn=4.0, limit_fraction=0.3, slow_fraction=0.2, stand_fraction=0.15)
"""The whole range of commands: fast, slow, standing, turning."""
LAUNCHES = CommandConfig(max_forward=13.0, max_lateral=0.2, straight_fraction=0.8, acceleration=(1.0, 5.0))
"""Easier commands for a first training: gather speed, mostly straight ahead."""
HISTORY = (5, 10, 15, 20)
"""Control steps, 25 to 100 ms: a third of a stride, in which legs and trunk tell how fast the robot moves."""

FRICTION: dict[RobotName, Range] = {"ideal": (0.55, 1.22), "built": (0.62, 1.38)}
"""Factors for ground of 0.5 to 1.1."""
MILD_FRICTION: dict[RobotName, Range] = {"ideal": (0.67, 1.22), "built": (0.75, 1.38)}
"""Factors for ground of 0.6 to 1.1."""
LOSSES: dict[RobotName, Range] = {"ideal": (1.0, 1.0), "built": (0.8, 1.2)}


def on_robot(env: EnvConfig, robot: RobotName) -> EnvConfig:
    """Return the environment with this robot, randomised as widely as its assumed values are uncertain."""
    drawn = dataclasses.replace(env.randomization, friction=FRICTION[robot], losses=LOSSES[robot])
    return dataclasses.replace(env, hardware=ROBOTS[robot], randomization=drawn)


def milder(env: EnvConfig, robot: RobotName) -> EnvConfig:
    """Return the environment with weaker randomisation, in which a small fleet learns sooner."""
    drawn = dataclasses.replace(
        env.randomization, friction=MILD_FRICTION[robot], mass=(0.95, 1.05), com_offset=0.01, latency=(0.0, 0.006),
        joint_velocity_noise=0.15, push_velocity=0.2,
    )  # fmt: skip
    return dataclasses.replace(env, randomization=drawn)


def careful(env: EnvConfig) -> EnvConfig:
    """Return the environment with launches far behind the command, gentle stops and long stands."""
    return dataclasses.replace(
        env,
        control=dataclasses.replace(env.control, braking=4.0, stopping_time=0.9),
        commands=dataclasses.replace(env.commands, stand_time=(1.0, 6.0)),
        reset=dataclasses.replace(env.reset, standing_time=(0.0, 1.0), command_error=5.0),
    )


@dataclasses.dataclass(frozen=True)
class RunConfig:
    """The length of a run, its seed, and what is kept."""

    steps: Steps = 100_000_000  # control steps, all robots together
    seed: Annotated[int, Within(0, LARGEST_SEED)] = 0
    checkpoints: Annotated[int, Within(1, 10**6)] = 10  # saves during the run, evenly spread, the last one at its end
    logs: Annotated[int, Within(1, 10**9)] = 200  # lines of metrics.jsonl during the run
    judged: Annotated[int, Within(0, 10**6)] = 0
    """policies judged in C MuJoCo beside the run, evenly spread: those of all saves, and as many between as spare
    processors can; 0: none"""
    until: Annotated[float | None, Within(0.1, 100.0), tyro.conf.arg(prefix_name=False, metavar="M/S")] = None
    """end the run when a policy reaches this speed, m/s, from a stand in C MuJoCo and holds it"""

    films: bool = False
    """film each judged policy's launch, into films.html in the run's folder"""

    def __post_init__(self) -> None:
        """Refuse impossible values."""
        check_bounds(self, "run.")
        if self.films and not self.judged:
            raise UserError("--run.films shows what the judge sees: let --run.judged be 1 or more")
        if self.until is not None and not self.judged:
            raise UserError("--until needs a judge: let --run.judged be 1 or more")


@dataclasses.dataclass(frozen=True)
class Parent:
    """The run whose networks a training started from."""

    run: str  # name of its folder
    config_hash: str
    control_steps: int  # behind those networks, its own parents' included


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """All settings of a training run, as the run's config.json holds them."""

    stage: Stage = "imitation"
    env: EnvConfig = EnvConfig()
    ppo: PPOConfig = PPOConfig()
    run: RunConfig = RunConfig()
    impl: Impl = "jax"
    parent: Parent | None = None


def load_run_config(run_dir: Path) -> TrainConfig:
    """The config of a run; raises `UserError` where there is none."""
    require_name(run_dir)
    if not Path(run_dir).exists():
        raise UserError(f"no training run at {run_dir}: there is no such folder")
    if not (Path(run_dir) / CONFIG).is_file():
        raise UserError(f"{run_dir} is not a training run: it has no {CONFIG}")
    return load_config(TrainConfig, Path(run_dir) / CONFIG)


def make_config(
    stage: Stage, preset: Preset, weights: Weights | None = None, robot: RobotName = "built"
) -> TrainConfig:
    """Return a stage's settings for a size of machine; the default rewards are `paper` with `smoke`, else `ours`."""
    weights = weights or ("paper" if preset == "smoke" else "ours")
    relaxed = stage == "relaxed"
    env = on_robot(EnvConfig(reward=(PAPER if weights == "paper" else OURS)[stage]), robot)
    ppo = PPOConfig()
    if relaxed:
        ppo = dataclasses.replace(ppo, learning_rate=1e-4, entropy_cost=2e-3)
    if preset != "smoke":  # what was tried is in docs/notes/training.md
        env = dataclasses.replace(
            env,
            library=CollocationConfig(path="bp2_trot_slow"),
            control=ControlConfig(clock_at_rest=False),
            commands=COMMANDS,
            reset=ResetConfig(standing_fraction=0.5),
        )
        ppo = dataclasses.replace(ppo, symmetric=True, averaging=0.9, desired_kl=0.02, entropy_cost=2e-3)
    if preset == "gpu":
        control = dataclasses.replace(env.control, history=HISTORY, launching=6.0, launching_speed=18.0)
        env = dataclasses.replace(env, control=control)
        if relaxed:
            env = careful(env)
            if weights == "ours":
                env = dataclasses.replace(env, reward=dataclasses.replace(env.reward, stand=1.0))
        ppo = dataclasses.replace(ppo, critic_steps=0 if relaxed else 6, entropy_decay=200.0 if relaxed else math.inf)
        run = RunConfig(steps=100_000_000 if relaxed else 40_000_000, judged=60)
        return TrainConfig(stage, env, ppo, run, impl="kernel")
    if preset == "cpu":  # ten minutes on two cores
        if not relaxed:
            env = milder(env, robot)
            env = dataclasses.replace(env, commands=LAUNCHES, reset=ResetConfig(standing_fraction=0.3))
        if weights == "ours":
            env = dataclasses.replace(env, reward=dataclasses.replace(env.reward, tracking=1.25, kernel=SMALL_FLEET))
        ppo = dataclasses.replace(
            ppo, num_envs=1024, num_minibatches=8, policy_layers=(128, 128), value_layers=(128, 128),
            max_learning_rate=2e-3, critic_steps=0 if relaxed else 12, entropy_cost=1e-3 if relaxed else 2e-3,
        )  # fmt: skip
        run = RunConfig(steps=6_000_000, logs=100, checkpoints=6, judged=24)
        return TrainConfig(stage, env, ppo, run, impl="kernel")
    # Slow running, and less to withstand, is what a minute can show.
    small = dataclasses.replace(
        env,
        reference="kinematic",
        commands=CommandConfig(max_forward=3.0, acceleration=(1.0, 4.0)),
        curriculum=CurriculumConfig(start_speed=2.0),
        reset=ResetConfig(standing_fraction=0.2),
        randomization=dataclasses.replace(env.randomization, friction=MILD_FRICTION[robot], latency=(0.0, 0.006)),
    )
    ppo = dataclasses.replace(
        ppo, num_envs=64, unroll_length=16, num_minibatches=4, num_epochs=2, policy_layers=(64, 64),
        value_layers=(64, 64), episode_length=400,
    )  # fmt: skip
    return TrainConfig(stage, small, ppo, RunConfig(steps=40_960, logs=20, checkpoints=2))
