"""The training loop: the one place where the pure train step meets files, clocks and the console."""

import contextlib
import datetime
import errno
import shlex
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp

from bp2_rl.base.errors import RunStopped, UserError
from bp2_rl.base.folders import find_folder
from bp2_rl.base.serialization import config_hash, package_versions, to_json
from bp2_rl.env.observations import layout_of
from bp2_rl.learning import cluster
from bp2_rl.learning.checkpoint import (
    FAILED,
    CheckpointError,
    Saver,
    latest_step,
    restore_checkpoint,
    save_checkpoint,
    saved_steps,
)
from bp2_rl.learning.exports import POLICIES, POLICY, Judge, Policies
from bp2_rl.learning.log import Log, Unlogged
from bp2_rl.learning.monitor import Monitor, Mute
from bp2_rl.learning.networks import dense_layers
from bp2_rl.learning.policy import PolicyCard, PolicyError, make_policy
from bp2_rl.learning.ppo import PPO, TrainState
from bp2_rl.learning.signals import StopSignals
from bp2_rl.learning.writers import LogWriter
from bp2_rl.robot import specs
from bp2_rl.settings.training import CONFIG, TrainConfig, began


def train(
    learner: PPO,
    state: TrainState,
    config: TrainConfig,
    run_dir: Path,
    *,
    unlogged: Unlogged | None = None,
    unexported: Sequence[int] = (),
    judge: Judge | None = None,
    writers: Sequence[LogWriter] = (),
) -> Path:
    """Train from `state` to the run's end, or until a policy is as fast as the run is to become; the run's folder.

    Args:
        learner: of the run.
        state: where to begin.
        config: the run's settings.
        run_dir: the run's folder, which holds its config.
        unlogged: what `Log.open` gave to the checkpoint that `state` is from.
        unexported: the checkpoints that `find_unexported` found; they are exported first.
        judge: of the policies; of a cluster's processes only the first has one.
        writers: of the metrics, beside the run's own files; likewise.

    Raises:
        RunStopped: by a signal, a full disk or a train step that is not finite; its line says how to go on.
    """
    total, per_step = train_steps(config), config.ppo.steps_per_train_step
    began, first = time.monotonic(), int(state.step)
    devices = f"{learner.mesh.size} x {learner.mesh.devices.flat[0].device_kind}"
    title = f"{config.stage} on {devices}"
    monitor = Mute()
    if cluster.is_first():
        monitor = Monitor(run_dir, total * per_step, start_step=first * per_step, title=title, writers=writers)
    with monitor, _stopping_in_one_line(monitor, run_dir, total):
        versions = ", ".join(f"{name} {version}" for name, version in package_versions().items())
        monitor.record(f"{'resumed' if first else 'started'} at step {first} of {total} on {devices}; {versions}")
        monitor.record(f"command: {shlex.join(sys.argv)}")
        policies = Policies(run_dir, monitor, judge, config.run.until, first * per_step)
        _export_late(unexported, learner, state, config, run_dir, monitor, policies)
        with Saver(run_dir, to_json(config)) as saver, StopSignals(monitor.note, monitor.release_terminal) as signals:
            log = Log(monitor, config.ppo, unlogged or Unlogged())
            state, done = _repeat(learner, state, config, run_dir, monitor, saver, signals, log, policies)
            saver.wait()
            policies.wait(lambda: signals.caught is not None)
        if int(state.step) < done:
            _keep_failed(state, config, run_dir)
        if done < total:
            reached = _reached(config, policies)  # no longer, where the judge has failed since
            if signals.caught:
                name, status = signals.caught.name, 128 + signals.caught
                raise RunStopped(f"stopped by {name}, kept step {done} of {total}: {_resume(run_dir)}", status)
            if not reached:
                what = f"the judge failed before his verdict was whole, kept step {done} of {total}"
                raise RunStopped(f"{what}: {_resume(run_dir)}", status=1)
        minutes = (time.monotonic() - began) / 60
        steps = (done - first) * per_step
        monitor.note(f"done: {steps:,} control steps in {minutes:.1f} min, policy in {run_dir / POLICY}")
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
            if not (run_dir / CONFIG).is_file():
                gone = f"the run's folder {run_dir} is gone, deleted or moved: nothing more can be kept in it"
                raise RunStopped(gone, status=1) from error
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
        f"{train_steps(config)}; see what it was: python train.py --replay {run_dir}",
        status=1,
    )


def _repeat(
    learner: PPO,
    state: TrainState,
    config: TrainConfig,
    run_dir: Path,
    monitor: Monitor,
    saver: Saver,
    signals: StopSignals,
    log: Log,
    policies: Policies,
) -> tuple[TrainState, int]:
    """(The state in the end, the train steps done with it): fewer than all where a signal came, and more than
    `state.step` where a train step was not finite."""
    total = train_steps(config)
    save_every = max(1, -(-total // config.run.checkpoints))
    judge_every = max(1, -(-total // max(config.run.checkpoints, config.run.judged)))
    log_every = max(1, total // config.run.logs)
    done, stop = int(state.step), _reached(config, policies)
    while done < total and not stop and not log.stuck:
        state, metrics = learner.train_step(state)
        done += 1
        policies.collect()
        stop = signals.heard() or _reached(config, policies)
        log.add(metrics)
        if done % log_every == 0 or done == total:
            log.close(done)
        save = done % save_every == 0 or done == total or stop
        if save or (done % judge_every == 0 and cluster.largest(policies.idle)):
            # A resume drops what was logged past its checkpoint, so the log must not be behind.
            log.flush()
            if int(state.step) < done:
                break
            if save:
                with cluster.together():  # or the others would train on when process 0 cannot write
                    saver.wait()
                    if not (run_dir / CONFIG).is_file():
                        raise FileNotFoundError(errno.ENOENT, "no such run any more", str(run_dir))
                saver.save(done, state, to_json(log.open()))
                monitor.record(f"saving step {done}")
            _export(learner, state, config, run_dir, monitor, policies)
    return state, done


def _reached(config: TrainConfig, policies: Policies) -> bool:
    """Whether the run has become as fast as it is to be, on all processes."""
    return config.run.until is not None and bool(cluster.largest(policies.reached))


def train_steps(config: TrainConfig) -> int:
    """Train steps that a run makes from its beginning to its end."""
    return -(-config.run.steps // config.ppo.steps_per_train_step)


def control_steps(config: TrainConfig) -> int:
    """Control steps that a run makes from its beginning to its end: whole train steps, all robots together."""
    return train_steps(config) * config.ppo.steps_per_train_step


# --- Policies ------------------------------------------------------------------------------------------------


def find_unexported(run_dir: Path, config: TrainConfig) -> list[int]:
    """The steps of a run's checkpoints whose policies are not there: the run was killed between save and export."""
    policies = run_dir / POLICIES
    per_step = config.ppo.steps_per_train_step
    steps = sorted(step for step in saved_steps(run_dir) if step > 0)
    return [step for step in steps if not find_folder(policies / str(step * per_step)).is_dir()]


def _export_late(
    steps: Sequence[int],
    learner: PPO,
    state: TrainState,
    config: TrainConfig,
    run_dir: Path,
    monitor: Monitor,
    policies: Policies,
) -> None:
    """Export the policies of checkpoints; `state` is the newest one."""
    for step in steps:
        if step == int(state.step):
            _export(learner, state, config, run_dir, monitor, policies)
            continue
        try:
            _, older = restore_checkpoint(run_dir, learner.shape, step)
        except CheckpointError as error:
            monitor.note(f"warning: no policy of step {step}: {error}")
            continue
        _export(learner, older, config, run_dir, monitor, policies, newest=False)


def _export(
    learner: PPO,
    state: TrainState,
    config: TrainConfig,
    run_dir: Path,
    monitor: Monitor,
    policies: Policies,
    *,
    newest: bool = True,
) -> None:
    """Write the policy of a state.

    One that nobody could run, as its weights overflow say, is warned of and left out: training may mend it.
    """
    params, normalizer = jax.device_get((state.average, state.normalizer))
    steps = int(state.step) * config.ppo.steps_per_train_step
    steps += config.parent.control_steps if config.parent else 0
    card = PolicyCard(
        stage=config.stage,
        observation_layout=tuple((entry.name, entry.size) for entry in layout_of(config.env.control)),
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
            "wall_time": round(time.time() - began(run_dir), 1),  # s
        },
        created=datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
    )
    if cluster.is_first():
        try:
            policy = make_policy(dense_layers(params, learner.mirrors), normalizer, card)
            policies.export(policy, int(state.step) * config.ppo.steps_per_train_step, newest=newest)
        except PolicyError as error:
            if isinstance(error.__cause__, OSError):
                raise
            monitor.note(f"warning: no policy of step {int(state.step)}: {error}")
