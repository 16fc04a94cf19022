"""The training run: the one place where the pure train step meets files, clocks and the console."""

import dataclasses
import datetime
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bp2_rl.config import config_hash, load_config, package_versions, save_config
from bp2_rl.env.bp2_env import SPEED_BINS, BP2Env
from bp2_rl.env.observations import LAYOUT
from bp2_rl.errors import UserError
from bp2_rl.learning.checkpoint import latest_step, restore_checkpoint, save_checkpoint
from bp2_rl.learning.monitor import Monitor
from bp2_rl.learning.policy import PolicyCard, export_policy
from bp2_rl.learning.ppo import PPO, TrainState
from bp2_rl.learning.stages import Parent, TrainConfig
from bp2_rl.robot import specs

CONFIG = "config.json"
NETWORK = ("policy_layers", "value_layers", "activation")
"""Fields of `PPOConfig` that a run shares with its parent."""


def start(config: TrainConfig, run_dir: Path, *, parent: Path | None = None) -> Path:
    """Train a new run in `run_dir`, from random weights or from the newest checkpoint of the run `parent`.

    From a parent come policy, critic, observation normaliser and the robots' curriculum levels; optimiser, clock and
    random numbers start anew.

    Raises:
        UserError: the folder is not empty or not writable, or the parent's networks or actions differ.
    """
    run_dir = Path(run_dir)
    learner = make_learner(config)
    inherited = None
    if parent is not None:
        inherited, origin = _inherit(Path(parent), config)
        config = dataclasses.replace(config, parent=origin)
    _claim(run_dir)
    save_config(run_dir / CONFIG, config)
    state = learner.init(config.run.seed)
    if inherited is not None:
        state = _adopt(state, inherited)
    save_checkpoint(run_dir, 0, state)
    return _run(learner, state, config, run_dir)


def resume(run_dir: Path) -> Path:
    """Go on with a stopped run exactly where its newest checkpoint stands.

    Raises:
        UserError: there is no run or no checkpoint, or it does not fit this program.
    """
    run_dir = Path(run_dir)
    config = load_run_config(run_dir)
    if latest_step(run_dir) is None:
        raise UserError(f"run {run_dir} has no checkpoint to resume from: start it anew in another folder")
    learner = make_learner(config)
    _, state = restore_checkpoint(run_dir, learner.shape())
    return _run(learner, state, config, run_dir)


def load_run_config(run_dir: Path) -> TrainConfig:
    """The config of a run; raises `UserError` where there is none."""
    if not (Path(run_dir) / CONFIG).is_file():
        raise UserError(f"{run_dir} is not a training run: it has no {CONFIG}")
    return load_config(TrainConfig, Path(run_dir) / CONFIG)


def is_finished(run_dir: Path) -> bool:
    """Whether a run has trained all its steps."""
    step = latest_step(run_dir)
    return step is not None and step >= _train_steps(load_run_config(run_dir))


def make_learner(config: TrainConfig) -> PPO:
    """The learner of a run, on all of JAX's devices."""
    robots = -(-config.ppo.num_envs // len(jax.devices()))
    return PPO(BP2Env(config.env, impl=config.impl, num_robots=robots), config.ppo)


# --- The loop ------------------------------------------------------------------------------------------------


def _run(learner: PPO, state: TrainState, config: TrainConfig, run_dir: Path) -> Path:
    total = _train_steps(config)
    per_step = config.ppo.steps_per_train_step
    save_every = max(1, -(-total // config.run.checkpoints))
    log_every = max(1, total // config.run.logs)
    done = int(state.step)
    title = f"{config.stage} on {learner.mesh.size} x {learner.mesh.devices.flat[0].device_kind}"
    with Monitor(run_dir, total * per_step, start_step=done * per_step, title=title) as monitor:
        began, first = time.monotonic(), done
        log = _Log(monitor, per_step)
        try:
            while done < total:
                state, metrics = learner.train_step(state)
                done += 1
                log.add(metrics)
                if done % log_every == 0 or done == total:
                    log.close(done)
                if done % save_every == 0 or done == total:
                    log.flush()
                    save_checkpoint(run_dir, done, state)
                    _export(state, config, run_dir)
        except KeyboardInterrupt:
            log.flush()
            # A train step consumes its state: stopped in the middle of one, the run has its last checkpoint.
            if not any(leaf.is_deleted() for leaf in jax.tree.leaves(state)):
                save_checkpoint(run_dir, int(state.step), state)
            monitor.note(f"interrupted, kept step {latest_step(run_dir)} of {total}: train.py --resume {run_dir}")
            raise
        minutes = (time.monotonic() - began) / 60
        steps = (total - first) * per_step
        monitor.note(f"done: {steps:,} control steps in {minutes:.1f} min, policy in {run_dir / 'policy'}")
    return run_dir


class _Log:
    """Averages metrics on the device over a logging interval, and writes them one interval late.

    So the device never waits for the console, and a line stands for all of its interval's steps.
    """

    def __init__(self, monitor: Monitor, per_step: int):
        self._monitor, self._per_step = monitor, per_step
        self._sums: Any = None
        self._count = 0
        self._pending: tuple[int, Any, int, float] | None = None
        self._since = time.monotonic()

    def add(self, metrics: dict[str, jax.Array]) -> None:
        """Take in one train step's metrics, which may still be under computation."""
        self._sums = metrics if self._sums is None else _add(self._sums, metrics)
        self._count += 1

    def close(self, done: int) -> None:
        """The interval ends with train step `done`; write the one before it."""
        self.flush()
        self._pending = done, self._sums, self._count, self._since
        self._sums, self._count, self._since = None, 0, time.monotonic()

    def flush(self) -> None:
        """Write what has been closed."""
        if self._pending is None:
            return
        done, sums, count, since = self._pending
        self._pending = None
        means = {name: float(value) / count for name, value in jax.device_get(sums).items()}
        rate = count * self._per_step / (time.monotonic() - since)
        self._monitor.log(done * self._per_step, summarize(means) | {"steps_per_second": rate})


@jax.jit
def _add(a: dict[str, jax.Array], b: dict[str, jax.Array]) -> dict[str, jax.Array]:
    return jax.tree.map(jnp.add, a, b)


def summarize(metrics: dict[str, float]) -> dict[str, float]:
    """From means over robots and steps to numbers that mean something by themselves.

    Falls become falls a robot a second, falls of all ended episodes become `falls`; errors by bin are divided by
    the bin's share of commands (and left out where nobody was commanded so).
    """
    out = {name: value for name, value in metrics.items() if not name.startswith("error/")}
    ended = metrics["falls"] + metrics["time_outs"]
    out["falls"] = metrics["falls"] / ended if ended > 0 else 0.0
    out["falls_per_second"] = metrics["falls"] / specs.CONTROL_STEP
    for lower in SPEED_BINS:
        share = metrics[f"share/{lower:g}"]
        if share > 0:
            out[f"speed_error/{lower:g}"] = metrics[f"error/{lower:g}"] / share
    return out


def _train_steps(config: TrainConfig) -> int:
    return -(-config.run.steps // config.ppo.steps_per_train_step)


def _export(state: TrainState, config: TrainConfig, run_dir: Path) -> None:
    params, normalizer = jax.device_get((state.params.policy, state.normalizer))
    steps = int(state.step) * config.ppo.steps_per_train_step
    steps += config.parent.control_steps if config.parent else 0
    card = PolicyCard(
        stage=config.stage,
        observation_layout=tuple((entry.name, entry.size) for entry in LAYOUT),
        action_size=specs.NUM_MOTORS,
        activation=config.ppo.activation,
        hidden_layer_sizes=config.ppo.policy_layers,
        env=config.env,
        reference="kinematic",
        physics_steps=steps * specs.SUBSTEPS,
        seed=config.run.seed,
        versions=package_versions(),
        config_hash=config_hash(config),
        results={
            "curriculum_level": float(np.mean(jax.device_get(state.fleet.info["curriculum"]))),
            "trained_on": f"{jax.device_count()} x {jax.devices()[0].device_kind}",
        },
        created=datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
    )
    export_policy(run_dir / "policy", params=params, normalizer=normalizer, card=card)


# --- From one run to the next --------------------------------------------------------------------------------


def _claim(run_dir: Path) -> None:
    """Make the run's folder; it must be new or empty, so that nothing is lost."""
    try:
        if run_dir.is_dir() and any(run_dir.iterdir()):
            what = "a run already" if (run_dir / CONFIG).exists() else "other files"
            raise UserError(f"{run_dir} holds {what}: name another --out, or continue a run with --resume")
        run_dir.mkdir(parents=True, exist_ok=True)
        probe = run_dir / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UserError(f"cannot write to run folder {run_dir}: {error.strerror}") from error


def _inherit(parent: Path, config: TrainConfig) -> tuple[TrainState, Parent]:
    """The newest state of the run `parent`, on the host, and what it is."""
    old = load_run_config(parent)
    for name, theirs, ours in (
        *((f"ppo.{name}", getattr(old.ppo, name), getattr(config.ppo, name)) for name in NETWORK),
        ("env.control", old.env.control, config.env.control),
    ):
        if theirs != ours:
            raise UserError(f"run {parent} was trained with {name} = {theirs}, this one has {ours}: they must agree")
    learner = PPO(BP2Env(old.env), old.ppo, devices=jax.devices()[:1])
    step, state = restore_checkpoint(parent, jax.tree.map(_on_host, learner.shape()))
    before = old.parent.control_steps if old.parent else 0
    steps = before + step * old.ppo.steps_per_train_step
    return state, Parent(run=parent.resolve().name, config_hash=config_hash(old), control_steps=steps)


def _on_host(leaf: jax.ShapeDtypeStruct) -> np.ndarray:
    return np.empty(leaf.shape, leaf.dtype)


def _adopt(state: TrainState, parent: TrainState) -> TrainState:
    """`state` with the parent's networks and normaliser, and its robots' curriculum levels dealt out in turn."""

    def place(old: Any, new: Any) -> Any:
        return jax.tree.map(lambda o, n: jax.device_put(jnp.asarray(o, n.dtype), n.sharding), old, new)

    levels = np.resize(parent.fleet.info["curriculum"], state.fleet.info["curriculum"].shape)
    info = {**state.fleet.info, "curriculum": place(levels, state.fleet.info["curriculum"])}
    return state.replace(
        params=place(parent.params, state.params),
        normalizer=place(parent.normalizer, state.normalizer),
        fleet=dataclasses.replace(state.fleet, info=info),
    )
