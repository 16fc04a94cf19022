"""W&B and MLflow follow a run: one more `LogWriter` each, whose run goes on when the
training is resumed."""

import contextlib
import logging
import math
import os
from collections.abc import Generator, Mapping, Set
from pathlib import Path
from typing import Any

from bp2_rl.base.errors import UserError, one_line
from bp2_rl.base.serialization import flatten, save_config, to_json
from bp2_rl.learning.writers import LogWriter, TrackerError, read_metrics
from bp2_rl.settings.tracking import TRACKED, Tracked, Tracker, tracked
from bp2_rl.settings.training import TrainConfig

PROJECT = "bp2_rl"
"""W&B's project and MLflow's experiment, unless their own environment variables say
otherwise."""
STEP = "step"
"""W&B's x-axis. Its own step may not go back, as ours does where a policy is judged
late."""
MOST_PARAMS = 100
"""The most parameters that MLflow takes at once."""


def open_tracker(
    tracker: Tracker | None, run_dir: Path, config: TrainConfig
) -> list[LogWriter]:
    """Return a run's tracker as a writer, new or resumed; an empty list without a
    tracker.

    W&B's own files are kept in the run's folder, MLflow's beside it in `mlruns`, unless
    WANDB_DIR and MLFLOW_TRACKING_URI say otherwise.

    Raises:
        UserError: the tracker does not answer, or does not know the user.
    """
    if tracker is None:
        return []
    had = tracked(run_dir)
    try:
        writer = (_Wandb if tracker == "wandb" else _Mlflow)(run_dir, config, had)
    except Exception as error:
        raise UserError(f"--track {tracker} does not work: {_line(error)}") from error
    if had is None:
        save_config(run_dir / TRACKED, writer.tracked)
        return [writer]
    return [
        _OnlyNewMetrics(
            writer,
            {(line["step"], name) for line in read_metrics(run_dir) for name in line},
        )
    ]


class _OnlyNewMetrics:
    """Writes only metrics that the tracker does not have yet; a resumed run repeats
    some."""

    def __init__(self, writer: LogWriter, told: Set[tuple[int, str]]):
        self._writer, self._told, self.close = writer, told, writer.close

    def write(self, step: int, wall_time: float, metrics: Mapping[str, float]) -> None:
        """See `LogWriter`."""
        news = {
            name: value
            for name, value in metrics.items()
            if (step, name) not in self._told
        }
        if news:
            self._writer.write(step, wall_time, news)


class _Wandb:
    """Weights & Biases; WANDB_MODE=offline keeps all on disk for `wandb sync`."""

    def __init__(self, run_dir: Path, config: TrainConfig, had: Tracked | None):
        import wandb

        project = had.place if had else os.environ.get("WANDB_PROJECT", PROJECT)
        self._run = wandb.init(
            project=project,
            dir=os.environ.get("WANDB_DIR", str(run_dir)),
            name=run_dir.resolve().name,
            id=had.run_id if had else None,
            resume="allow" if had else None,
            config=to_json(config),
            settings=wandb.Settings(console="off", silent=True),
        )
        self._run.define_metric("*", step_metric=STEP)
        self.tracked = Tracked("wandb", self._run.id, project)

    def write(self, step: int, wall_time: float, metrics: Mapping[str, float]) -> None:
        """See `LogWriter`."""
        with _tracker_errors("wandb"):
            self._run.log({STEP: step, "wall_time": wall_time, **metrics})

    def close(self) -> None:
        """See `LogWriter`."""
        with contextlib.suppress(Exception):
            self._run.finish()


class _Mlflow:
    """MLflow, by its client alone: nothing of it is global."""

    def __init__(self, run_dir: Path, config: TrainConfig, had: Tracked | None):
        from mlflow import MlflowClient
        from mlflow.entities import Param

        logging.getLogger("mlflow").setLevel(logging.ERROR)
        here = (run_dir.resolve().parent / "mlruns").as_uri()
        uri = had.place if had else os.environ.get("MLFLOW_TRACKING_URI", here)
        if uri.startswith("file:"):
            # else it wants a database, and SQLAlchemy
            os.environ.setdefault("MLFLOW_ALLOW_FILE_STORE", "true")
        self._client: Any = MlflowClient(uri)
        if had is None:
            name = os.environ.get("MLFLOW_EXPERIMENT_NAME", PROJECT)
            known = self._client.get_experiment_by_name(name)
            experiment = (
                known.experiment_id if known else self._client.create_experiment(name)
            )
            run_id = self._client.create_run(
                experiment, run_name=run_dir.resolve().name
            ).info.run_id
            params = [
                Param(name, str(value))
                for name, value in flatten(to_json(config)).items()
            ]
            for first in range(0, len(params), MOST_PARAMS):
                self._client.log_batch(
                    run_id, params=params[first : first + MOST_PARAMS]
                )
        else:
            run_id = had.run_id
            self._client.update_run(run_id, status="RUNNING")
        self.tracked = Tracked("mlflow", run_id, uri)

    def write(self, step: int, wall_time: float, metrics: Mapping[str, float]) -> None:
        """See `LogWriter`; finite numbers alone, as MLflow's databases take no
        others."""
        from mlflow.entities import Metric

        when = round(1000 * wall_time)
        # Its folders cannot hold `reward` and `reward/tracking`: one is a file, the
        # other within it.
        values = [
            Metric(name.replace("/", "."), value, when, step)
            for name, value in metrics.items()
            if math.isfinite(value)
        ]
        with _tracker_errors("mlflow"):
            self._client.log_batch(self.tracked.run_id, metrics=values)

    def close(self) -> None:
        """See `LogWriter`."""
        with contextlib.suppress(Exception):
            self._client.set_terminated(self.tracked.run_id)


@contextlib.contextmanager
def _tracker_errors(tracker: Tracker) -> Generator[None]:
    """Turn any failure in the block into a `TrackerError`: a server that is gone must
    not stop a training."""
    try:
        yield
    except Exception as error:
        raise TrackerError(
            f"{tracker} has failed, and is told no more of this run: {_line(error)}"
        ) from error


def _line(error: Exception) -> str:
    return one_line(f"{type(error).__name__}: {error}")[:300]
