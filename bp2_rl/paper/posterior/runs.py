"""The simulated robots from which the posterior is computed: how they are drawn, run and
kept."""

import csv
import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

from bp2_rl.base.errors import UserError
from bp2_rl.base.files import read_bytes, write_text
from bp2_rl.evaluation.plausible import Assumption, Values, run_plausible
from bp2_rl.learning.policy import Policy
from bp2_rl.robot import bp2

BATCH = 64  # runs, after which what was found is handed on
Shares = Float[np.ndarray, "N D"]
"""Places of robots in the assumptions' ranges, 0 to 1."""


@dataclasses.dataclass(frozen=True)
class RunCard:
    """Assumptions of the runs in a folder; runs under others are not added to them."""

    assumption_set: dict[str, Assumption]


@dataclasses.dataclass(frozen=True)
class RobotRun:
    """The results of a robot under a policy: speeds, race time and motor powers."""

    policy: str
    belt: float  # m/s, best second on the treadmill
    road: float  # m/s, best second outdoors
    time_100m: float  # s; NaN: it fell
    hip: float  # W, peak of the hind hips' motors outdoors, at the paper's pace
    knee: float  # W, of the hind knees'


def fill_ranges(count: int, assumptions: int) -> Shares:
    """Return places that fill the ranges evenly: a scrambled Sobol sequence."""
    power = 2 ** math.ceil(math.log2(count))
    return qmc.Sobol(assumptions, rng=np.random.default_rng(0)).random(power)[:count]


def robots_at(assumptions: Mapping[str, Assumption], shares: Shares) -> list[Values]:
    """Return the robots at places in the ranges."""
    columns = [one.at(x) for one, x in zip(assumptions.values(), shares.T, strict=True)]
    return [
        dict(zip(assumptions, map(float, row), strict=True))
        for row in zip(*columns, strict=True)
    ]


def run_robots(
    everyone: Sequence[tuple[Values, str]], policies: Mapping[str, Policy]
) -> Iterator[list[RobotRun]]:
    """Run robots as the paper's BP2 ran, each under the policy that is named with it;
    yield what they did, in order, some robots at a time."""
    for first in range(0, len(everyone), BATCH):
        batch = everyone[first : first + BATCH]
        found: dict[int, RobotRun] = {}
        for name, policy in policies.items():
            its = [i for i, (_, whose) in enumerate(batch) if whose == name]
            ran = run_plausible(
                policy, [batch[i][0] for i in its], bp2.LAUNCH_ACCELERATION
            )
            for i, one in zip(its, ran, strict=True):
                found[i] = RobotRun(
                    name,
                    one.belt.speed,
                    one.road.speed,
                    one.time_100m or math.nan,
                    *one.road.powers,
                )
        yield [found[i] for i in range(len(batch))]


def write_rows(path: Path, rows: Sequence[Mapping[str, float | str]]) -> None:
    """Write a table as CSV, its numbers to six digits."""
    lines = [
        [x if isinstance(x, str) else f"{x:.6g}" for x in row.values()] for row in rows
    ]
    write_text(path, "".join(f"{','.join(cells)}\n" for cells in [[*rows[0]], *lines]))


def read_runs(path: Path) -> list[RobotRun]:
    """Return the runs of a file that `write_rows` wrote.

    Raises:
        UserError: the file cannot be read, or is another one.
    """
    rows = csv.DictReader(read_bytes(path).decode(errors="replace").splitlines())
    try:
        return [
            RobotRun(row.pop("policy"), **{key: float(x) for key, x in row.items()})
            for row in rows
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(
            f"{path} is no runs.csv, such as bp2 paper posterior writes"
        ) from error
