"""A run to look at: its samples, its figures of merit and its file."""

import dataclasses
import functools
import json
from pathlib import Path

import numpy as np

from bp2_rl.base.errors import UserError
from bp2_rl.base.files import ArraySpec, parse_json, read_bytes, read_npz, write_npz
from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.simulation.measuring import run_metrics
from bp2_rl.simulation.metrics import RunMetrics
from bp2_rl.simulation.samples import Samples, shapes_of

FORMAT = "bp2_rl.trajectory/1"


class TrajectoryError(UserError):
    """A file that should hold a trajectory does not."""


@dataclasses.dataclass(frozen=True, repr=False)
class Trajectory(Samples):
    """One run, sampled at every physics step, with its figures of merit; see `Samples`
    for the arrays."""

    def __repr__(self) -> str:
        """Say what ran, for how long, and to which end: the arrays are for programs."""
        end = "upright" if self.fell_at is None else f"fell at {self.fell_at:.2f} s"
        return f"Trajectory({self.name}, {self.time[-1]:.2f} s, {end})"

    @functools.cached_property
    def metrics(self) -> RunMetrics:
        """All figures of merit of the run, computed when they are first asked for."""
        return run_metrics(self)

    def save(self, path: Path | str) -> None:
        """Write one .npz (never a pickle), whole or not at all."""
        facts = _Facts(
            **{
                field.name: getattr(self, field.name)
                for field in dataclasses.fields(_Facts)
            }
        )
        arrays = {field: getattr(self, field) for field in shapes_of(self.hardware)}
        write_npz(
            path,
            {
                "format": np.array(FORMAT),
                "facts": np.array(json.dumps(to_json(facts))),
                **arrays,
            },
        )

    @classmethod
    def load(cls, path: Path | str) -> "Trajectory":
        """Read what `save` wrote; raises TrajectoryError for anything else."""
        if not Path(path).exists():
            raise TrajectoryError(f"no trajectory at {path}")
        try:
            content = read_bytes(path)
            text = ArraySpec(np.str_, ())
            told = read_npz(
                path,
                {"format": text, "facts": text},
                content=content,
                largest=len(content),
            )
            if str(told["format"]) != FORMAT:
                raise TrajectoryError(
                    f"{path} is of format {told['format']}, this version reads {FORMAT}"
                )
            facts = from_json(_Facts, parse_json(str(told["facts"]), "facts"))
            wanted = {
                field: ArraySpec(np.floating, ("N", *shape))
                for field, shape in shapes_of(facts.hardware).items()
            }
            arrays = read_npz(path, wanted, content=content, largest=len(content))
            return cls(
                **arrays,
                **{
                    field.name: getattr(facts, field.name)
                    for field in dataclasses.fields(_Facts)
                },
            )
        except TrajectoryError:
            raise
        except (
            ValueError
        ) as error:  # whatever is wrong with files, their arrays and their facts
            raise TrajectoryError(
                f"{path} is no trajectory, or not a whole one ({error})"
            ) from None


@dataclasses.dataclass(frozen=True)
class _Facts:
    """The facts in a trajectory's file beside the arrays."""

    dt: float
    steady_from: float
    fell_at: float | None
    mass: float
    hardware: HardwareSpec
    name: str
    backend: str
