"""The place where a training's processes meet."""

import dataclasses
import re
from typing import Annotated

from bp2_rl.base.bounds import Within, check_bounds
from bp2_rl.base.errors import UserError


@dataclasses.dataclass(frozen=True)
class ClusterConfig:
    """Where the processes of one training meet; by default one process has all GPUs of
    the machine."""

    coordinator: str | None = None
    """HOST:PORT of process 0, told to all processes; auto: ask Slurm or Open MPI"""
    processes: Annotated[int, Within(1, 2**16)] | None = None
    """how many there are; not with auto"""
    process: Annotated[int, Within(0)] | None = None
    """which of them this is, counted from 0; not with auto"""
    patience: Annotated[float, Within(0.0, 1e6, open_below=True)] = 300.0
    """seconds to wait for the others at the start"""

    def __post_init__(self) -> None:
        """Refuse what cannot meet."""
        check_bounds(self, "--cluster.")
        numbers = (self.processes, self.process)
        if self.coordinator in (None, "auto"):
            if numbers != (None, None):
                raise UserError(
                    "--cluster.processes and --cluster.process go with --cluster.coordinator HOST:PORT"
                )
        elif not re.fullmatch(r".+:\d+", self.coordinator):
            raise UserError(
                f"--cluster.coordinator must be HOST:PORT or auto, got {self.coordinator}"
            )
        elif self.processes is None or self.process is None:
            raise UserError(
                "--cluster.coordinator HOST:PORT needs --cluster.processes and --cluster.process"
            )
        elif self.process >= self.processes:
            raise UserError(
                f"--cluster.process must be 0 to {self.processes - 1}, got {self.process}"
            )
