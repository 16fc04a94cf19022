"""A training run as a folder: started, resumed, inherited from, replayed."""

import contextlib
import dataclasses
import operator
import shutil
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bp2_rl.base.errors import UserError
from bp2_rl.base.folders import LOCK, lock_folder, make_folder
from bp2_rl.base.serialization import (
    ConfigError,
    config_hash,
    flatten,
    from_json,
    save_config,
    to_json,
)
from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.learning import cluster, guards, loop
from bp2_rl.learning.checkpoint import (
    CHECKPOINTS,
    FAILED,
    CheckpointError,
    Metadata,
    Saver,
    latest_step,
    place,
    read_metadata,
    require_same,
    restore_checkpoint,
)
from bp2_rl.learning.exports import Judge
from bp2_rl.learning.monitor import Unlogged
from bp2_rl.learning.ppo import PPO, TrainState
from bp2_rl.learning.programs import use_kept
from bp2_rl.learning.writers import Writer, open_tracker
from bp2_rl.robot.operator import COMMAND_LIMITS
from bp2_rl.settings.env import ControlConfig
from bp2_rl.settings.task import FOLDER, TaskSources, read_task
from bp2_rl.settings.tracker import Tracker
from bp2_rl.settings.training import CONFIG, Parent, TrainConfig, load_run_config

NETWORK = ("policy_layers", "value_layers", "activation", "symmetric")
"""Fields of `PPOConfig` in which a run must agree with its parent."""


def start(
    config: TrainConfig,
    run_dir: Path,
    *,
    parent: Path | None = None,
    judge: Judge | None = None,
    tracker: Tracker | None = None,
    programs: Path | None = None,
) -> Path:
    """Train a new run in `run_dir`, from random weights or from the newest checkpoint
    of the run `parent`.

    `judge` measures the exported policies, if given; `tracker` receives the metrics,
    too; `programs` is a folder of traced programs, for a faster start
    (`programs.use_kept`).

    From a parent come policy, critic, observation normaliser and the robots' curriculum
    levels; optimiser, clock and random numbers are new.

    Raises:
        UserError: the folder is not empty, not writable or another process's, or the
            parent's networks or actions differ; or the tracker does not work.
        RunStopped: by a signal, a full disk or a train step that is not finite; its
            line says how to go on.
    """
    run_dir = Path(run_dir)
    inherited = None
    task = config.env.task
    if task.source and not isinstance(task.code, TaskSources):
        raise UserError(
            'a training takes a task from a file, to keep it: preset(..., task="my_task.py")'
        )
    with cluster.together():
        learner = make_learner(config, programs)
        if parent is not None:
            inherited, origin = _inherit(Path(parent), config, learner.shape)
            config = dataclasses.replace(config, parent=origin)
    cluster.require_same(config_hash(config), "settings")
    writers: list[Writer] = []
    # of a half-made run, however the process ends; until it can be resumed
    removal: Finalize | None = None
    with contextlib.ExitStack() as held:
        with cluster.together():
            if cluster.is_first():
                make_folder(run_dir)
                _require_empty(run_dir)
                held.enter_context(_lock(run_dir))
                _require_empty(run_dir)  # another process may have been faster
                removal = Finalize(None, shutil.rmtree, (run_dir, True), exitpriority=0)
                held.callback(removal)
                writers = open_tracker(tracker, run_dir, config)
                if isinstance(task.code, TaskSources):
                    task.code.write(run_dir / FOLDER)
                save_config(run_dir / CONFIG, config)
        with learner.compiling():
            state = learner.init(config.run.seed)
            if inherited is not None:
                state = _with_inherited(state, inherited)
        with Saver(run_dir, to_json(config)) as saver:
            saver.save(0, state)
        if removal is not None:
            removal.cancel()
        return loop.train(
            loop.TrainingRun(config, run_dir, learner, judge, writers), state
        )


def resume(
    run_dir: Path,
    *,
    judge: Judge | None = None,
    tracker: Tracker | None = None,
    programs: Path | None = None,
) -> Path:
    """Continue a stopped run from its newest checkpoint; the other arguments are those
    of `start`.

    Raises:
        UserError: there is no run or no checkpoint, it does not fit this program,
            another process trains it, or the tracker does not work.
        RunStopped: as `start`.
    """
    run_dir = Path(run_dir)
    with contextlib.ExitStack() as held:
        with cluster.together():
            config = load_own(run_dir)
            if cluster.is_first():
                held.enter_context(_lock(run_dir))
            step = latest_step(run_dir)
            if step is None:
                raise UserError(
                    f"run {run_dir} was stopped before its first checkpoint: remove that folder and start again"
                )
            metadata = _read_own(run_dir, step, config)
            unlogged = _read_log(metadata, run_dir)
            learner = make_learner(config, programs)
            _, state = restore_checkpoint(run_dir, learner.shape, step)
            unexported = loop.find_unexported(run_dir, config)
            writers = (
                open_tracker(tracker, run_dir, config) if cluster.is_first() else []
            )
        cluster.require_same(
            f"{config_hash(config)} {step} {unexported}", "checkpoints"
        )
        resumed = loop.TrainingRun(
            config, run_dir, learner, judge, writers, before=metadata.devices
        )
        return loop.train(resumed, state, unlogged, unexported)


def replay(run_dir: Path) -> str:
    """Repeat the train step at which a run stopped because it was not finite; return
    what was not finite first, in words.

    Raises:
        UserError: there is no run, or it stopped for another reason.
    """
    config = load_own(run_dir)
    step = latest_step(run_dir, FAILED)
    if step is None:
        raise UserError(
            f"run {run_dir} has no train step to replay: all that it made were finite"
        )
    _read_own(run_dir, step, config, FAILED)
    learner = make_learner(config)
    _, state = restore_checkpoint(run_dir, learner.shape, step, folder=FAILED)
    return f"train step {step + 1}: {guards.explain(learner, state)}"


def load_own(run_dir: Path | str) -> TrainConfig:
    """Return the settings of a run that is continued, with the code of its task, which
    the run's folder holds.

    Raises:
        UserError: there is no run, or the task's code is missing or has changed.
    """
    config = load_run_config(run_dir)
    task = config.env.task
    if task.source:
        task = task.with_code(read_task(Path(run_dir) / FOLDER / task.source))
    return dataclasses.replace(config, env=dataclasses.replace(config.env, task=task))


def make_learner(config: TrainConfig, programs: Path | None = None) -> PPO:
    """Return the learner of a run, on all of JAX's devices.

    `programs` is the folder where its traced programs are kept, if they are.
    """
    robots = -(-config.ppo.num_envs // len(jax.devices()))
    env = BP2Env(config.env, impl=config.impl, num_robots=robots)
    learner = PPO(env, config.ppo)
    if programs is not None:
        use_kept(learner, config, env.mj_model, programs)
    return learner


# --- From one run to the next ---------------------------------------------------------


def _require_empty(run_dir: Path) -> None:
    if any(entry.name != LOCK for entry in run_dir.iterdir()):
        what = "a run already" if (run_dir / CONFIG).exists() else "other files"
        raise UserError(
            f"{run_dir} holds {what}: name another --out, or continue a run with --resume"
        )


def _lock(run_dir: Path) -> contextlib.AbstractContextManager[int]:
    """Return a context manager that locks a run's folder against other trainings; raise
    `UserError` for a link in the folder."""
    for entry in run_dir.iterdir():
        if entry.is_symlink() and entry.name != CHECKPOINTS:
            raise UserError(
                f"{entry} is a link to elsewhere: only a run's {CHECKPOINTS} may be; remove it"
            )
    return lock_folder(
        run_dir, f"another process trains in {run_dir}: wait for it, or stop it"
    )


def _inherit(
    parent: Path, config: TrainConfig, shape: TrainState
) -> tuple[dict[str, Any], Parent]:
    """Read networks, normaliser and curriculum levels from the newest checkpoint of the
    run `parent`.

    The second value names the parent.
    """
    old = load_run_config(parent)
    names = ["env.task.observations", *(f"ppo.{name}" for name in NETWORK)]
    names += [
        f"env.control.{field.name}"
        for field in dataclasses.fields(ControlConfig)
        if field.name not in COMMAND_LIMITS
    ]
    for name in names:
        theirs, ours = (
            operator.attrgetter(name)(settings) for settings in (old, config)
        )
        if theirs != ours:
            raise UserError(
                f"run {parent} was trained with {name} = {theirs}, this one has {ours}: they must agree"
            )
    levels = np.empty(old.ppo.num_envs, np.float32)
    wanted = {
        "params": shape.params,
        "normalizer": shape.normalizer,
        "fleet": {"info": {"curriculum": levels}},
    }
    step, part = restore_checkpoint(parent, wanted, part=True)
    before = old.parent.control_steps if old.parent else 0
    steps = before + step * old.ppo.steps_per_train_step
    return part, Parent(
        run=parent.resolve().name, config_hash=config_hash(old), control_steps=steps
    )


def _with_inherited(state: TrainState, part: dict[str, Any]) -> TrainState:
    """Return `state` with the parent's networks and normaliser, and with its curriculum
    levels assigned to the robots in turn."""
    here = state.fleet.info["curriculum"]
    levels = place(np.resize(part["fleet"]["info"]["curriculum"], here.shape), here)
    fleet = dataclasses.replace(
        state.fleet, info={**state.fleet.info, "curriculum": levels}
    )
    average = jax.tree.map(jnp.copy, part["params"].policy)
    return state.replace(
        params=part["params"],
        average=average,
        normalizer=part["normalizer"],
        fleet=fleet,
    )


def _read_log(metadata: Metadata, run_dir: Path) -> Unlogged:
    """Return the metrics that the log had not written when a checkpoint was saved."""
    try:
        return from_json(Unlogged, metadata.log)
    except ConfigError as error:
        raise CheckpointError(
            f"{run_dir}'s checkpoint {metadata.step} is damaged: log: {error}"
        ) from error


def _read_own(
    run_dir: Path, step: int, config: TrainConfig, folder: str = CHECKPOINTS
) -> Metadata:
    """Return the metadata of a checkpoint, which must be of a run with these
    settings."""
    directory = run_dir / folder / str(step)
    metadata = read_metadata(run_dir, step, folder)
    try:
        there = flatten(to_json(from_json(TrainConfig, metadata.config)))
    except ConfigError as error:
        raise CheckpointError(f"{directory} is of another training: {error}") from error
    require_same(there, flatten(to_json(config)), directory, where=f"in {CONFIG}")
    return metadata
