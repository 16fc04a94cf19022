"""Training with the judge beside it: the functions behind `train.py` and
`bp2_rl.train`."""

import contextlib
from collections.abc import Generator
from pathlib import Path
from typing import get_args

import jax

from bp2_rl.robot import mjx  # noqa: F401  # isort: skip  # before Brax, which imports MJX and lets it print

from bp2_rl.base.errors import require_kind, require_one_of
from bp2_rl.base.files import require_name
from bp2_rl.base.processes import keep_compiled, use_all_processors
from bp2_rl.evaluation.judge import open_judge
from bp2_rl.learning import cluster, loop, run
from bp2_rl.learning.exports import Judge
from bp2_rl.settings.tracker import Tracker
from bp2_rl.settings.training import TrainConfig


def train(
    config: TrainConfig,
    run_dir: Path | str,
    *,
    parent: Path | str | None = None,
    tracker: Tracker | None = None,
) -> Path:
    """Train a new run in the folder `run_dir`; return the folder.

    A training in the fused kernel takes all processors, where JAX has not computed anything yet. What is compiled is
    kept on disk, and the next training starts faster (`keep_compiled`).

    Args:
        config: the settings, such as `preset` gives them.
        run_dir: a folder that is empty or not there.
        parent: the run from whose newest checkpoint the networks come; without it their weights are random.
        tracker: receives the metrics, too.

    Raises:
        UserError: `config` is no `TrainConfig`; or see `learning.run.start`.
        RunStopped: by a signal, a full disk or a train step that is not finite; its line says how to go on.

    Examples:
        >>> first = train(preset("imitation", "cpu"), "runs/first")
        >>> train(preset("relaxed", "cpu"), "runs/second", parent=first)
    """
    require_kind(
        "train",
        config,
        TrainConfig,
        'settings, such as preset("imitation", "cpu") gives',
    )
    require_name(run_dir)
    require_one_of("tracker", tracker or "wandb", get_args(Tracker))
    programs = keep_compiled()
    with _judge(config) as judge:
        origin = None if parent is None else Path(parent)
        return run.start(
            config,
            Path(run_dir),
            parent=origin,
            judge=judge,
            tracker=tracker,
            programs=programs,
        )


def resume(run_dir: Path | str, *, tracker: Tracker | None = None) -> Path:
    """Continue a stopped training run from its newest checkpoint, with its own
    settings; return its folder.

    Raises:
        UserError: the folder is no run, or its newest checkpoint does not fit its
            settings.
        RunStopped: as `train` does.
    """
    require_one_of("tracker", tracker or "wandb", get_args(Tracker))
    programs = keep_compiled()
    with _judge(run.load_own(run_dir)) as judge:
        return run.resume(
            Path(run_dir), judge=judge, tracker=tracker, programs=programs
        )


@contextlib.contextmanager
def _judge(config: TrainConfig) -> Generator[Judge | None]:
    """Start the judge of a training, to warm up while the training compiles; yield None
    if no judge is wanted here.

    Before that a training in the fused kernel takes all processors.
    """
    if config.impl == "kernel":
        use_all_processors()
    with cluster.together():
        card = loop.make_card(config, 0, {})
    if not (config.run.judged and cluster.is_first()):
        yield None
        return
    cache = jax.config.values["jax_compilation_cache_dir"]
    with open_judge(card, cache, config.run.until) as judge:
        yield judge
