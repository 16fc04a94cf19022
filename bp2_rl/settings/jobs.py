"""Where the trainings of a study run: as processes beside it, or as jobs of a
cluster."""

import dataclasses
import importlib.util
from typing import Annotated, Literal

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.base.errors import not_installed


@dataclasses.dataclass(frozen=True)
class JobsConfig(Bounded, path="--jobs."):
    """Where the trainings of a study run. By default here, one on each GPU at a
    time."""

    executor: Literal["here", "slurm", "local"] = "here"
    """slurm: each training is a job, which submitit hands to Slurm; local: the same
    jobs on this machine, to try it"""
    most: Annotated[int, Within(1, 10_000)] = 16
    """jobs at a time; the scheduler may run fewer"""
    gpus: Annotated[int, Within(0, 64)] = 1
    """GPUs of each job"""
    cpus: Annotated[int, Within(1, 1024)] = 8
    """CPU cores of each job"""
    hours: Annotated[float, Within(0.02, 720.0)] = 4.0
    """time limit of each job; a training that takes longer is saved, queued again and
    goes on"""
    partition: str | None = None
    """Slurm's partition"""
    account: str | None = None
    """Slurm's account"""

    def require(self) -> None:
        """Raise `UserError` if the executor needs the package submitit and it is not
        installed."""
        if self.executor != "here" and importlib.util.find_spec("submitit") is None:
            raise not_installed(
                f"--jobs.executor {self.executor}", "submitit", "cluster"
            )
