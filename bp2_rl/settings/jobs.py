"""Settings of a study's trainings as processes on this machine or as jobs of a
cluster."""

import dataclasses
import importlib.util
from typing import Annotated, Literal

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.base.errors import not_installed


@dataclasses.dataclass(frozen=True)
class JobsConfig(Bounded, path="--jobs."):
    """Execution of a study's trainings; by default on this machine, one on each GPU at
    a time."""

    executor: Literal["here", "slurm", "local"] = "here"
    """here: on this machine; slurm: each training is a Slurm job, submitted by
    submitit; local: the same jobs on this machine, to test them"""
    most: Annotated[int, Within(1, 10_000)] = 16
    """largest number of jobs at a time"""
    gpus: Annotated[int, Within(0, 64)] = 1
    """GPUs of each job"""
    cpus: Annotated[int, Within(1, 1024)] = 8
    """CPU cores of each job"""
    hours: Annotated[float, Within(0.02, 720.0)] = 4.0
    """time limit of each job; a longer training is saved, requeued and continued"""
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
