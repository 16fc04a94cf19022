"""Choose the service, W&B, that logs a run in addition to its metrics and
TensorBoard."""

import dataclasses
import importlib.util
from pathlib import Path
from typing import Literal

from bp2_rl.base.errors import not_installed
from bp2_rl.base.serialization import load_config

Tracker = Literal["wandb"]
TRACKED = "tracker.json"
"""The file in a run's folder that names the run's tracker, and the run by the tracker's
own name."""


@dataclasses.dataclass(frozen=True)
class Tracked:
    """A run's identity in its tracker, which a resumed run keeps."""

    tracker: Tracker
    run_id: str
    place: str  # W&B's project


def tracked(run_dir: Path) -> Tracked | None:
    """Return the tracker of the run in this folder, if any; raise `UserError` where the
    file is damaged."""
    return (
        load_config(Tracked, Path(run_dir) / TRACKED)
        if (Path(run_dir) / TRACKED).is_file()
        else None
    )


def choose_tracker(
    named: Tracker | None, run_dir: Path | None = None
) -> Tracker | None:
    """Return the named tracker, or a resumed run's own; raise `UserError` if its
    package is not installed.

    Raises:
        UserError: the package is not installed, or the run's tracker.json is damaged.
    """
    had = tracked(run_dir) if run_dir is not None else None
    tracker = had.tracker if had is not None else named
    if tracker is not None and importlib.util.find_spec(tracker) is None:
        raise not_installed(f"--track {tracker}", tracker, "track")
    return tracker
