"""`bp2 paper posterior`: simulate robots that BP2 may be, and weigh them by the paper's
numbers."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.cli.app import Command


@dataclasses.dataclass(frozen=True)
class PosteriorSettings(Bounded, path="--"):
    """Simulate robots that BP2 may be under two policies, and draw those that explain the
    paper's numbers.

    Takes half an hour on two cores. runs.csv is what `bp2 paper figures
    identifiability` reads, robots.csv what `eval.py --benchmark posterior` runs.

    For example: bp2 paper posterior --out posterior
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("reports/posterior")
    """folder of both files; what it has of runs.csv, under the same assumptions, is not
    simulated again"""
    robots: Annotated[int, Within(32, 2**14)] = 256
    """simulated robots, which fill the assumptions' ranges evenly; a power of two"""
    draws: Annotated[int, Within(1, 10_000)] = 250
    """robots drawn from the posterior, and simulated again"""


def _simulate(settings: PosteriorSettings) -> None:
    from bp2_rl.cli import runtime  # noqa: F401  # isort: skip  # before all that imports MuJoCo

    import numpy as np

    from bp2_rl.base.errors import UserError
    from bp2_rl.base.serialization import claim_folder
    from bp2_rl.cli.trajopt import progress_bar
    from bp2_rl.evaluation.plausible import read_assumptions
    from bp2_rl.learning.policy import load_policy
    from bp2_rl.paper.posterior import runs, study
    from bp2_rl.paper.posterior.inference import effective
    from bp2_rl.simulation.parallel import compute_here, keep_workers

    assumptions = read_assumptions()
    card = runs.RunCard(assumptions)
    claim_folder(settings.out, "assumptions.json", card, "runs")
    compute_here()
    policies = {name: load_policy(name) for name in study.POLICIES}
    space = runs.fill_ranges(settings.robots, len(assumptions))
    everyone = [
        (robot, name)
        for robot in runs.robots_at(assumptions, space)
        for name in policies
    ]
    kept = settings.out / "runs.csv"
    found = runs.read_runs(kept) if kept.is_file() else []
    if len(found) > len(everyone):
        raise UserError(
            f"{kept} has {len(found) // len(policies)} robots: give --robots as many, or another --out"
        )
    with keep_workers(), progress_bar() as bar:
        step = bar.add_task("robots", total=len(everyone), completed=len(found))
        for batch in runs.run_robots(everyone[len(found) :], policies):
            found += batch
            bar.advance(step, len(batch))
            runs.write_rows(kept, [dataclasses.asdict(run) for run in found])
        fitted = study.fit(found, space)
        chosen = study.choose(fitted, settings.draws)
        robots = runs.robots_at(assumptions, chosen.shares)
        again = [
            run
            for batch in bar.track(
                runs.run_robots(
                    list(zip(robots, chosen.policies, strict=True)), policies
                ),
                -(-settings.draws // runs.BATCH),
                description="draws",
            )
            for run in batch
        ]
    rows = study.weigh_again(chosen, robots, again)
    runs.write_rows(settings.out / "robots.csv", rows)
    size = effective(np.array([row["weight"] for row in rows], float))
    print(f"{len(rows)} robots that know as much as {size:.0f} equally likely ones")
    print(f"runs.csv, robots.csv: {settings.out}")


main = Command("bp2 paper posterior", PosteriorSettings, _simulate)
