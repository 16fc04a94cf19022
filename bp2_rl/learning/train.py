"""The training run: the one place where the pure train step meets files, clocks and the console."""

import contextlib
import dataclasses
import datetime
import shlex
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bp2_rl.config import ConfigError, config_hash, from_json, load_config, package_versions, save_config, to_json
from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.env.config import upgrade
from bp2_rl.env.metrics import SPEED_BINS
from bp2_rl.env.observations import LAYOUT
from bp2_rl.errors import RunStopped, UserError
from bp2_rl.learning import cluster, guards
from bp2_rl.learning.checkpoint import (
    CHECKPOINTS,
    FAILED,
    CheckpointError,
    Saver,
    latest_step,
    place,
    read_metadata,
    restore_checkpoint,
    save_checkpoint,
)
from bp2_rl.learning.monitor import Monitor, Mute
from bp2_rl.learning.policy import PolicyCard, export_policy, save_policy
from bp2_rl.learning.ppo import PPO, STUCK, TrainState
from bp2_rl.learning.signals import StopSignals
from bp2_rl.learning.stages import Parent, TrainConfig
from bp2_rl.robot import specs

CONFIG = "config.json"
POLICY, POLICIES = "policy", "policies"
"""The newest policy of a run; and the folder of those of all its saves, each by its number of control steps."""
NETWORK = ("policy_layers", "value_layers", "activation")
"""Fields of `PPOConfig` that a run shares with its parent."""


def start(config: TrainConfig, run_dir: Path, *, parent: Path | None = None) -> Path:
    """Train a new run in `run_dir`, from random weights or from the newest checkpoint of the run `parent`.

    From a parent come policy, critic, observation normaliser and the robots' curriculum levels; optimiser, clock and
    random numbers start anew.

    Raises:
        UserError: the folder is not empty or not writable, or the parent's networks or actions differ.
        RunStopped: by a signal, a full disk or a train step that is not finite; its line says how to go on.
    """
    run_dir = Path(run_dir)
    inherited = None
    with cluster.together():
        learner = make_learner(config)
        if parent is not None:
            inherited, origin = _inherit(Path(parent), config, learner.shape())
            config = dataclasses.replace(config, parent=origin)
    cluster.require_same(config_hash(config), "settings")
    with cluster.together():
        if cluster.is_first():
            _claim(run_dir)
            save_config(run_dir / CONFIG, config)
    state = learner.init(config.run.seed)
    if inherited is not None:
        state = _adopt(state, inherited)
    save_checkpoint(run_dir, 0, state, config=to_json(config))
    return _run(learner, state, config, run_dir)


def resume(run_dir: Path) -> Path:
    """Go on with a stopped run exactly where its newest checkpoint stands.

    Raises:
        UserError: there is no run or no checkpoint, or it does not fit this program.
        RunStopped: as `start`.
    """
    run_dir = Path(run_dir)
    with cluster.together():
        config = load_run_config(run_dir)
        step = latest_step(run_dir)
        if step is None:
            raise UserError(f"run {run_dir} was stopped before its first checkpoint: remove that folder and start anew")
        metadata = _read_own(run_dir, step, config)
        learner = make_learner(config)
        _, state = restore_checkpoint(run_dir, learner.shape(), step)
    cluster.require_same(f"{config_hash(config)} {step}", "checkpoints")
    return _run(learner, state, config, run_dir, unlogged=metadata["log"])


def replay(run_dir: Path) -> str:
    """Repeat the train step at which a run stopped because it was not finite; what was not finite first, in words.

    Raises:
        UserError: there is no run, or it did not stop so.
    """
    config = load_run_config(run_dir)
    step = latest_step(run_dir, FAILED)
    if step is None:
        raise UserError(f"run {run_dir} has no train step to replay: all that it made were finite")
    _read_own(run_dir, step, config, FAILED)
    learner = make_learner(config)
    _, state = restore_checkpoint(run_dir, learner.shape(), step, folder=FAILED)
    return f"train step {step + 1}: {guards.explain(learner, state)}"


def load_run_config(run_dir: Path) -> TrainConfig:
    """The config of a run; raises `UserError` where there is none."""
    if not (Path(run_dir) / CONFIG).is_file():
        raise UserError(f"{run_dir} is not a training run: it has no {CONFIG}")
    return load_config(TrainConfig, Path(run_dir) / CONFIG, upgrade=upgrade)


def is_finished(run_dir: Path) -> bool:
    """Whether a run has trained all its steps."""
    step = latest_step(run_dir)
    return step is not None and step >= _train_steps(load_run_config(run_dir))


def control_steps(config: TrainConfig) -> int:
    """Control steps that a run makes from its beginning to its end: whole train steps, all robots together."""
    return _train_steps(config) * config.ppo.steps_per_train_step


def make_learner(config: TrainConfig) -> PPO:
    """The learner of a run, on all of JAX's devices."""
    robots = -(-config.ppo.num_envs // len(jax.devices()))
    return PPO(BP2Env(config.env, impl=config.impl, num_robots=robots), config.ppo)


# --- The loop ------------------------------------------------------------------------------------------------


def _run(
    learner: PPO, state: TrainState, config: TrainConfig, run_dir: Path, *, unlogged: Mapping[str, Any] | None = None
) -> Path:
    """Train from `state` to the run's end; `unlogged` is `_Log.open` of the checkpoint that it is from."""
    total, per_step = _train_steps(config), config.ppo.steps_per_train_step
    began, first = time.monotonic(), int(state.step)
    devices = f"{learner.mesh.size} x {learner.mesh.devices.flat[0].device_kind}"
    title = f"{config.stage} on {devices}"
    monitor = Mute()
    if cluster.is_first():
        monitor = Monitor(run_dir, total * per_step, start_step=first * per_step, title=title)
    with monitor, _stopping_in_one_line(monitor, run_dir, total):
        versions = ", ".join(f"{name} {version}" for name, version in package_versions().items())
        monitor.record(f"{'resumed' if first else 'started'} at step {first} of {total} on {devices}; {versions}")
        monitor.record(f"command: {shlex.join(sys.argv)}")
        with Saver(run_dir, to_json(config)) as saver, StopSignals(monitor.note, monitor.release_terminal) as signals:
            state, done = _train(learner, state, config, run_dir, monitor, saver, signals, unlogged)
            saver.wait()
        if int(state.step) < done:
            _keep_failed(state, config, run_dir)
        if done < total and signals.caught:
            name, status = signals.caught.name, 128 + signals.caught
            raise RunStopped(f"stopped by {name}, kept step {done} of {total}: {_resume(run_dir)}", status)
        if first == total:  # the run was killed between its last save and its export
            _export(state, config, run_dir)
        minutes = (time.monotonic() - began) / 60
        steps = (total - first) * per_step
        monitor.note(f"done: {steps:,} control steps in {minutes:.1f} min, policy in {run_dir / 'policy'}")
    return run_dir


@contextlib.contextmanager
def _stopping_in_one_line(monitor: Monitor, run_dir: Path, total: int) -> Iterator[None]:
    """Log why a run stops early; a file that cannot be written, on a full disk say, is such a reason too."""
    try:
        try:
            yield
        except (OSError, UserError) as error:
            cause = error if isinstance(error, OSError) else error.__cause__
            if not isinstance(cause, OSError):
                raise
            what = f"cannot write to {run_dir}: {cause.strerror}" if cause is error else str(error)
            kept = f"kept step {latest_step(run_dir)} of {total}"
            raise RunStopped(f"{what}; {kept}, mend that and go on: {_resume(run_dir)}", status=1) from error
    except RunStopped as stop:
        with contextlib.suppress(OSError):
            monitor.record(str(stop))
        raise


def _resume(run_dir: Path) -> str:
    return f"python train.py --resume {run_dir}"


def _keep_failed(state: TrainState, config: TrainConfig, run_dir: Path) -> None:
    """Save the state whose next train step is not finite, and stop."""
    step = int(state.step)
    save_checkpoint(run_dir, step, state, config=to_json(config), folder=FAILED)
    raise RunStopped(
        f"train step {step + 1} is not finite and nothing was learned from it; kept step {latest_step(run_dir)} of "
        f"{_train_steps(config)}; see what it was: python train.py --replay {run_dir}",
        status=1,
    )


def _train(
    learner: PPO,
    state: TrainState,
    config: TrainConfig,
    run_dir: Path,
    monitor: Monitor,
    saver: Saver,
    signals: StopSignals,
    unlogged: Mapping[str, Any] | None,
) -> tuple[TrainState, int]:
    """(The state in the end, the train steps done with it): fewer than all where a signal came, and more than
    `state.step` where a train step was not finite."""
    total = _train_steps(config)
    save_every = max(1, -(-total // config.run.checkpoints))
    log_every = max(1, total // config.run.logs)
    log = _Log(monitor, config, unlogged)
    done, stop = int(state.step), None
    while done < total and not stop and not log.stuck:
        state, metrics = learner.train_step(state)
        done += 1
        stop = signals.heard()
        log.add(metrics)
        if done % log_every == 0 or done == total:
            log.close(done)
        if done % save_every == 0 or done == total or stop:
            # A resume drops what was logged past its checkpoint, so the log must not be behind.
            log.flush()
            if int(state.step) < done:
                break
            with cluster.together():  # or the others would train on when process 0 cannot write
                saver.wait()
            saver.save(done, state, log.open())
            monitor.record(f"saving step {done}")
            _export(state, config, run_dir)
    return state, done


class _Log:
    """Averages metrics on the device over a logging interval, and writes them one interval late.

    So the device never waits for the console, and a line stands for all of its interval's steps.

    Args:
        monitor: where to.
        config: the run's settings.
        unlogged: what `open` gave, where the run goes on within an interval.
    """

    def __init__(self, monitor: Monitor, config: TrainConfig, unlogged: Mapping[str, Any] | None):
        self._monitor, self._ppo = monitor, config.ppo
        self._watch = guards.Watch()
        self._interval = _Interval()
        if unlogged:
            self._interval.sums = {name: np.float32(value) for name, value in unlogged["sums"].items()}
            self._interval.count = unlogged["count"]
        self._pending: tuple[int, _Interval] | None = None
        self._since = time.monotonic()  # what is being timed began then
        self.stuck = False  # a train step was not finite

    def add(self, metrics: dict[str, jax.Array]) -> None:
        """Take in one train step's metrics, which may still be under computation."""
        interval = self._interval
        interval.sums = metrics if interval.sums is None else _add(interval.sums, metrics)
        interval.count += 1
        interval.timed += 1

    def open(self) -> dict[str, Any]:
        """What has been added since the last interval was closed, as JSON."""
        if self._interval.sums is None:
            return {}
        sums = jax.device_get(self._interval.sums)
        return {"count": self._interval.count, "sums": {name: float(value) for name, value in sums.items()}}

    def close(self, done: int) -> None:
        """The interval ends with train step `done`; write the one before it."""
        self.flush()
        self._pending, self._interval = (done, self._interval), _Interval()

    def flush(self) -> None:
        """Write what has been closed, and warn of what it shows; nothing from a train step that is not finite on."""
        if self._pending is None or self.stuck:
            return
        (done, interval), self._pending = self._pending, None
        means = {name: float(value) / interval.count for name, value in jax.device_get(interval.sums).items()}
        self.stuck = means.pop(STUCK) > 0
        if self.stuck:
            return
        per_step = self._ppo.steps_per_train_step
        # To fetch an interval's metrics is to wait for its end, and that of the one before has been waited for.
        now = time.monotonic()
        rate, self._since = interval.timed * per_step / (now - self._since), now
        self._monitor.log(done * per_step, summarize(means) | {"steps_per_second": rate})
        for words in self._watch.news(guards.warnings(means, self._ppo)):
            self._monitor.note(f"warning: {words}")


@dataclasses.dataclass
class _Interval:
    """Train steps that become one line of the log."""

    sums: Any = None  # of their metrics
    count: int = 0
    timed: int = 0  # those of them that this process did


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
    out["reward_rms"] = out.pop("reward_square") ** 0.5
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
        reference=config.env.reference,
        library_sha256=config.env.library.sha256 if config.env.reference == "collocation" else "",
        physics_steps=steps * specs.SUBSTEPS,
        seed=config.run.seed,
        versions=package_versions(),
        config_hash=config_hash(config),
        results={
            "curriculum_level": float(jnp.mean(state.fleet.info["curriculum"])),
            "trained_on": f"{jax.device_count()} x {jax.devices()[0].device_kind}",
            "command": shlex.join(sys.argv),
            "wall_time": round(time.time() - (run_dir / CONFIG).stat().st_mtime, 1),  # s, since the run's very start
        },
        created=datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
    )
    if cluster.is_first():
        policy = export_policy(run_dir / POLICY, params=params, normalizer=normalizer, card=card)
        save_policy(run_dir / POLICIES / str(int(state.step) * config.ppo.steps_per_train_step), policy)


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


def _inherit(parent: Path, config: TrainConfig, shape: TrainState) -> tuple[dict[str, Any], Parent]:
    """What the newest checkpoint of the run `parent` gives to a state of `shape`, and what it is."""
    old = load_run_config(parent)
    for name, theirs, ours in (
        *((f"ppo.{name}", getattr(old.ppo, name), getattr(config.ppo, name)) for name in NETWORK),
        ("env.control", old.env.control, config.env.control),
    ):
        if theirs != ours:
            raise UserError(f"run {parent} was trained with {name} = {theirs}, this one has {ours}: they must agree")
    levels = np.empty(old.ppo.num_envs, np.float32)
    wanted = {"params": shape.params, "normalizer": shape.normalizer, "fleet": {"info": {"curriculum": levels}}}
    step, part = restore_checkpoint(parent, wanted, part=True)
    before = old.parent.control_steps if old.parent else 0
    steps = before + step * old.ppo.steps_per_train_step
    return part, Parent(run=parent.resolve().name, config_hash=config_hash(old), control_steps=steps)


def _adopt(state: TrainState, part: dict[str, Any]) -> TrainState:
    """`state` with the parent's networks and normaliser, and its robots' curriculum levels dealt out in turn."""
    here = state.fleet.info["curriculum"]
    levels = place(np.resize(part["fleet"]["info"]["curriculum"], here.shape), here)
    fleet = dataclasses.replace(state.fleet, info={**state.fleet.info, "curriculum": levels})
    return state.replace(params=part["params"], normalizer=part["normalizer"], fleet=fleet)


def _read_own(run_dir: Path, step: int, config: TrainConfig, folder: str = CHECKPOINTS) -> dict[str, Any]:
    """The metadata of a checkpoint, which must be of a run with these settings."""
    directory = run_dir / folder / str(step)
    metadata = read_metadata(run_dir, step, folder)
    try:
        there = _fields(to_json(from_json(TrainConfig, upgrade(metadata["config"]))))
    except ConfigError as error:
        raise CheckpointError(f"{directory} is of another training: {error}") from error
    here = _fields(to_json(config))
    for name in [*here, *there]:
        if there.get(name) != here.get(name):
            raise CheckpointError(
                f"{directory} is of another training: {name} is {there.get(name, 'absent')} there and "
                f"{here.get(name, 'absent')} in {CONFIG}"
            )
    return metadata


def _fields(data: Any, path: str = "") -> dict[str, Any]:
    """The values of a JSON object by their dotted names."""
    if not isinstance(data, dict):
        return {path: data}
    return {
        name: value for key, inner in data.items() for name, value in _fields(inner, f"{path}.{key}".strip(".")).items()
    }
