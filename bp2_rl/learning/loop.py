"""The training loop: the one place where the pure train step meets files, clocks and
the console."""

import contextlib
import dataclasses
import errno
import shlex
import sys
import time
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import jax
import jax.numpy as jnp
import numpy as np

from bp2_rl.base.errors import RunStopped, UserError
from bp2_rl.base.serialization import config_hash, package_versions, to_json, utc_now
from bp2_rl.env.observations import layout_of
from bp2_rl.learning import cluster
from bp2_rl.learning.checkpoint import (
    FAILED,
    CheckpointError,
    Saver,
    latest_step,
    restore_checkpoint,
    saved_steps,
)
from bp2_rl.learning.exports import ExportedPolicies, Judge
from bp2_rl.learning.judged import (
    exported_steps,
    own_policy,
    policy_folder,
    read_judged,
)
from bp2_rl.learning.monitor import Log, Monitor, Unlogged
from bp2_rl.learning.networks import dense_layers
from bp2_rl.learning.policy import PolicyCard, PolicyError, make_policy
from bp2_rl.learning.ppo import PPO, TrainState
from bp2_rl.learning.writers import Writer
from bp2_rl.robot import conventions
from bp2_rl.settings.training import CONFIG, TrainConfig, load_run_config


@dataclasses.dataclass(frozen=True)
class TrainingRun:
    """A run that this process trains: settings, folder, learner, judge and writers."""

    config: TrainConfig
    run_dir: Path  # already holds the config
    learner: PPO
    # of the exported policies; of a cluster's processes only the first has one
    judge: Judge | None = None
    # of the metrics, beside the run's own files; only in the first process
    writers: Sequence[Writer] = ()
    # devices that trained the checkpoint of a resumed run
    before: str | None = None


def train(
    run: TrainingRun,
    state: TrainState,
    unlogged: Unlogged | None = None,
    unexported: Sequence[int] = (),
) -> Path:
    """Train to the run's last step, or until a policy reaches the speed that ends the
    run; return the run's folder.

    Args:
        run: what is trained.
        state: where to begin.
        unlogged: metrics added but not yet written when the checkpoint of `state` was
            saved (`Log.unwritten`).
        unexported: the checkpoints that `find_unexported` found; their policies are
            exported first.

    Raises:
        RunStopped: by a signal, a full disk or a train step that is not finite; its
            line says how to go on.
    """
    config = run.config
    run_dir = run.run_dir
    devices = cluster.devices()
    total = train_steps(config)
    per_step = config.ppo.steps_per_train_step
    started = time.monotonic()
    first = int(state.step)
    title = f"{config.stage} on {devices}"
    shown = run_dir if cluster.is_first() else None
    monitor = Monitor(
        shown,
        total * per_step,
        start_step=first * per_step,
        title=title,
        writers=run.writers,
    )
    with monitor, _stopping_in_one_line(monitor, run_dir, total):
        versions = ", ".join(
            f"{name} {version}" for name, version in package_versions().items()
        )
        monitor.record(
            f"{'resumed' if first else 'started'} at step {first} of {total} on {devices}; {versions}"
        )
        monitor.record(f"command: {shlex.join(sys.argv)}")
        if run.before not in (None, devices):
            monitor.note(
                f"trained on {run.before} before: what follows is not bit for bit what it had been there"
            )
        policies = ExportedPolicies(
            run_dir, monitor, run.judge, config.run.until, first * per_step
        )
        loop = _Loop(run, monitor, policies)
        loop.export_late(unexported, state)
        with (
            Saver(run_dir, to_json(config)) as saver,
            cluster.StopSignals(monitor.note, monitor.release_terminal) as signals,
        ):
            state, done = loop.repeat(
                state, Log(monitor, config.ppo, unlogged or Unlogged()), saver, signals
            )
            saver.wait()
            policies.wait(lambda: signals.caught is not None)
        if int(state.step) < done:
            _stop_at_failed(state, config, run_dir)
        if done < total and signals.caught:
            name = signals.caught.name
            status = 128 + signals.caught
            raise RunStopped(
                f"stopped by {name}, kept step {done} of {total}: {_resume(run_dir)}",
                status,
            )
        minutes = (time.monotonic() - started) / 60
        steps = (done - first) * per_step
        monitor.note(
            f"done: {steps:,} control steps in {minutes:.1f} min, policy in {own_policy(run_dir)}"
        )
    return run_dir


@contextlib.contextmanager
def _stopping_in_one_line(
    monitor: Monitor, run_dir: Path, total: int
) -> Generator[None]:
    """Log why a run stops early; a file that cannot be written, on a full disk say, is
    such a reason too."""
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
            what = (
                f"cannot write to {run_dir}: {cause.strerror}"
                if cause is error
                else str(error)
            )
            kept = f"kept step {latest_step(run_dir)} of {total}"
            raise RunStopped(
                f"{what}; {kept}, fix that and continue: {_resume(run_dir)}", status=1
            ) from error
    except RunStopped as stop:
        with contextlib.suppress(OSError):
            monitor.record(str(stop))
        raise


def _resume(run_dir: Path) -> str:
    return f"python train.py --resume {run_dir}"


def _stop_at_failed(state: TrainState, config: TrainConfig, run_dir: Path) -> NoReturn:
    """Save the state whose next train step is not finite, and stop."""
    step = int(state.step)
    with Saver(run_dir, to_json(config), FAILED) as saver:
        saver.save(step, state)
    raise RunStopped(
        f"train step {step + 1} is not finite and nothing was learned from it; kept step {latest_step(run_dir)} of "
        f"{train_steps(config)}; see what it was: python train.py --replay {run_dir}",
        status=1,
    )


@dataclasses.dataclass(frozen=True)
class _Loop:
    """Repeats the train step, and saves, logs and exports on the way."""

    run: TrainingRun
    monitor: Monitor
    policies: ExportedPolicies

    def repeat(
        self, state: TrainState, log: Log, saver: Saver, signals: cluster.StopSignals
    ) -> tuple[TrainState, int]:
        """Train from `state` on; return the last state and the number of train steps
        done with it.

        The number is smaller than the run's total where a signal came or a policy was
        fast enough, and larger than `state.step` where a train step was not finite.
        """
        lengths = self.run.config.run
        policies = self.policies
        total = train_steps(self.run.config)
        save_every = max(1, -(-total // lengths.checkpoints))
        judge_every = max(1, -(-total // max(lengths.checkpoints, lengths.judged)))
        log_every = max(1, total // lengths.logs)
        done = int(state.step)
        stop = self._reached()
        while done < total and not stop and not log.not_finite:
            state, metrics = self.run.learner.train_step(state)
            done += 1
            policies.collect()
            stop = signals.received() or self._reached()
            log.add(metrics)
            if done % log_every == 0 or done == total:
                log.close(done)
            save = done % save_every == 0 or done == total or stop
            if save or (done % judge_every == 0 and cluster.largest(policies.idle)):
                # A resume drops what was logged past its checkpoint, so the log must
                # not be behind.
                log.flush()
                if int(state.step) < done:
                    break
                if save:
                    self._save(state, log, saver)
                self._export(state)
        return state, done

    def _save(self, state: TrainState, log: Log, saver: Saver) -> None:
        """Begin to write a checkpoint; raise where the last one could not be written,
        or the run's folder is gone."""
        # otherwise the others would continue if process 0 cannot write
        with cluster.together():
            saver.wait()
            if not (self.run.run_dir / CONFIG).is_file():
                raise FileNotFoundError(
                    errno.ENOENT, "the run's folder is gone", str(self.run.run_dir)
                )
        step = int(state.step)
        saver.save(step, state, to_json(log.unwritten()))
        self.monitor.record(f"saving step {step}")

    def _reached(self) -> bool:
        """Return whether a policy has reached the speed that ends the run, on all
        processes."""
        return self.run.config.run.until is not None and bool(
            cluster.largest(self.policies.reached)
        )

    def export_late(self, steps: Sequence[int], newest: TrainState) -> None:
        """Export the policies of checkpoints that a killed run has left without one;
        `newest` is the state of the last checkpoint."""
        for step in steps:
            if step == int(newest.step):
                self._export(newest)
                continue
            try:
                _, state = restore_checkpoint(
                    self.run.run_dir, self.run.learner.shape, step
                )
            except CheckpointError as error:
                self.monitor.note(f"warning: no policy of step {step}: {error}")
                continue
            self._export(state)

    def _export(self, state: TrainState) -> None:
        """Export the policy of a state; skip it, with a warning, where its weights
        overflow: further training may correct that."""
        params, normalizer = jax.device_get((state.average, state.normalizer))
        # by NumPy nothing compiles; of a cluster a process has a part alone
        levels = state.fleet.info["curriculum"]
        level = float(
            np.mean(levels) if levels.is_fully_addressable else jnp.mean(levels)
        )
        if not cluster.is_first():
            return
        step = int(state.step)
        steps = step * self.run.config.ppo.steps_per_train_step
        card = make_card(
            self.run.config,
            steps,
            {
                "curriculum_level": level,
                "trained_on": cluster.devices(),
                "command": shlex.join(sys.argv),
            },
        )
        try:
            policy = make_policy(
                dense_layers(params, self.run.learner.mirrors), normalizer, card
            )
            self.policies.export(policy, steps)
        except PolicyError as error:
            if isinstance(error.__cause__, OSError):
                raise
            self.monitor.note(f"warning: no policy of step {step}: {error}")


def make_card(config: TrainConfig, steps: int, results: dict[str, Any]) -> PolicyCard:
    """Return the card of a run's policy after `steps` control steps of the run
    itself."""
    before = config.parent.control_steps if config.parent else 0
    return PolicyCard(
        stage=config.stage,
        observation_layout=layout_of(config.env),
        action_size=conventions.NUM_MOTORS,
        activation=config.ppo.activation,
        hidden_layer_sizes=config.ppo.policy_layers,
        env=config.env,
        reference=config.env.reference,
        library_sha256=config.env.library.sha256
        if config.env.reference == "collocation"
        else "",
        physics_steps=(before + steps) * conventions.SUBSTEPS,
        seed=config.run.seed,
        versions=package_versions(),
        config_hash=config_hash(config),
        results=results,
        created=utc_now(),
    )


# --- How far a run is -----------------------------------------------------------------


def train_steps(config: TrainConfig) -> int:
    """Return the number of train steps of a run."""
    return -(-config.run.steps // config.ppo.steps_per_train_step)


def is_finished(run_dir: Path) -> bool:
    """Return whether a run is finished: it has the policy of its last train step, or a
    policy that reaches the run's speed."""
    if not (run_dir / CONFIG).is_file():
        return False
    config = load_run_config(run_dir)
    steps = train_steps(config) * config.ppo.steps_per_train_step
    if policy_folder(run_dir, steps).is_dir():
        return True
    kept = (latest_step(run_dir) or 0) * config.ppo.steps_per_train_step
    return any(
        policy.result.reaches(config.run.until)
        for policy in read_judged(run_dir).policies
        if policy.control_steps <= kept
    )


def find_unexported(run_dir: Path, config: TrainConfig) -> list[int]:
    """Return the steps of the checkpoints without a policy: a kill between save and
    export has left them."""
    exported = exported_steps(run_dir)
    per_step = config.ppo.steps_per_train_step
    return [
        step
        for step in sorted(saved_steps(run_dir))
        if step > 0 and step * per_step not in exported
    ]
