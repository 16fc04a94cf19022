"""Problems that are solved one after another, each from the last one's solution, and
kept."""

import contextlib
import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
)

from bp2_rl.base.files import write_text
from bp2_rl.base.processes import spawned
from bp2_rl.base.serialization import config_hash
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.solution import (
    NotSolved,
    Solution,
    load_solution,
    resample,
    save_solution,
)
from bp2_rl.paper.trajectories.codesign.settings import DesignBounds, Parameter

TIME_LIMIT = 20.0  # s an interval: several times what a solution takes


@dataclasses.dataclass(frozen=True)
class Chain:
    """Problems solved one after another, each from the last solution; the first from a
    cold guess.

    Free parameters are found within `bounds`, starting from the last solution's, or
    else from the problem's own.
    """

    problems: tuple[Problem, ...]
    free: tuple[Parameter, ...]
    bounds: DesignBounds
    seed: int = 0  # of the cold guess; 0 is the one that is not varied

    def then(self, problem: Problem) -> "Chain":
        """The chain with one more problem."""
        return dataclasses.replace(self, problems=(*self.problems, problem))

    @property
    def parts(self) -> list["Chain"]:
        """The chains that end with the first problem, with the second, and so on."""
        return [
            dataclasses.replace(self, problems=self.problems[: i + 1])
            for i in range(len(self.problems))
        ]


def solve_chain(chain: Chain, folder: Path) -> Solution | None:
    """Solve the problems of a chain, keep their solutions in `folder`, and return the
    last one's; None if IPOPT failed.

    What is in the folder is not solved again. A problem that cannot be solved is passed
    over: the next one starts from the last solution before it.
    """
    last = solution = None
    for part in chain.parts:
        solution = (
            read_solution(part, folder)
            if is_solved(part, folder)
            else _solve_end(part, last, folder)
        )
        last = solution or last
    return solution


def is_solved(chain: Chain, folder: Path) -> bool:
    """Whether it is known already how a chain ends."""
    path = _path(chain, folder)
    return path.with_suffix(".json").exists() or path.with_suffix(".failed").exists()


def read_solution(chain: Chain, folder: Path) -> Solution | None:
    """Read what `solve_chain` left of a chain's last problem; None where IPOPT
    failed."""
    path = _path(chain, folder)
    return None if path.with_suffix(".failed").exists() else load_solution(path)


def solve_chains(
    chains: Sequence[Chain], folder: Path, workers: int, title: str
) -> None:
    """Solve what is not in `folder` yet in `workers` processes, or in this one if it is
    one."""
    missing = [
        chain
        for chain in chains
        if not all(is_solved(part, folder) for part in chain.parts)
    ]
    if not missing:
        return
    parts = {part for chain in chains for part in chain.parts}
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns) as progress, contextlib.ExitStack() as stack:
        task = progress.add_task(
            title,
            total=len(parts),
            completed=sum(is_solved(part, folder) for part in parts),
        )
        run = map if workers == 1 else stack.enter_context(spawned(workers)).map
        for _ in run(solve_chain, missing, itertools.repeat(folder)):
            progress.update(
                task, completed=sum(is_solved(part, folder) for part in parts)
            )


def _solve_end(chain: Chain, start: Solution | None, folder: Path) -> Solution | None:
    """Solve a chain's last problem from a solution, or else from a cold guess, and keep
    what came of it."""
    # CasADi only where something is solved
    from bp2_rl.optimiser.collocation import solve
    from bp2_rl.optimiser.guess import cold_guess
    from bp2_rl.optimiser.transcription import SolveOptions

    problem, path = chain.problems[-1], _path(chain, folder)
    if start is None:
        guess = cold_guess(problem, seed=chain.seed or None)
    else:
        problem = problem.on(
            **{name: start.problem.hardware.parameter(name) for name in chain.free}
        )
        guess = resample(start.problem, start.motion, problem)
    try:
        options = SolveOptions(
            free=chain.bounds.of(chain.free), time_limit=TIME_LIMIT * problem.intervals
        )
        solution = solve(problem, guess, options)
    except NotSolved as failure:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path.with_suffix(".failed"), f"{failure}\n")
        return None
    save_solution(path, solution)
    return solution


def _path(chain: Chain, folder: Path) -> Path:
    return folder / "solutions" / config_hash(chain)
