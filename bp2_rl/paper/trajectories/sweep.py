"""Many trajectories at once: speeds x cold starts, over the cores, each kept and never
solved twice."""

import concurrent.futures
import dataclasses
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from bp2_rl.base import serialization as config
from bp2_rl.base.errors import UserError
from bp2_rl.base.processes import spawned
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.solution import (
    NotSolved,
    Solution,
    load_solution,
    save_solution,
    speed_name,
)


@dataclasses.dataclass(frozen=True)
class Attempt:
    """One cold start: how it ended."""

    speed: float  # m/s
    start: int  # 0 is the cold guess itself, others are varied
    solved: bool
    seconds: float  # wall time of the solve, building the program included
    cost: float = float("nan")
    violation: float = float("nan")
    why: str = ""  # if not solved


def sweep(
    problem: Problem,
    speeds: Sequence[float],
    starts: int,
    folder: Path,
    workers: int = 2,
) -> Iterator[Attempt]:
    """Solve from every start at every speed; yields each attempt as it ends, those
    already in `folder` first.

    Every solution is kept in `folder`; `best_of` reads the cheapest of each speed.

    Raises:
        UserError: the folder holds a sweep of another problem.
    """
    config.claim_folder(folder, "sweep.json", problem, "a sweep")
    todo = []
    for speed in speeds:
        for start in range(starts):
            if (record := _record(folder, speed, start)).is_file():
                yield _read(record, speed, start)
            else:
                todo.append((speed, start))
    with spawned(workers) as pool:
        attempts = [
            pool.submit(_attempt, problem.at(speed), start, folder)
            for speed, start in todo
        ]
        for attempt in concurrent.futures.as_completed(attempts):
            yield attempt.result()


def best_of(folder: Path) -> list[Solution]:
    """The cheapest solution of each speed that a sweep has left, verified, slowest
    first.

    Raises:
        UserError: there is none, or one cannot be read.
    """
    attempts = [
        config.load_config(Attempt, record)
        for record in sorted(folder.glob("speed-*-start-*.attempt.json"))
    ]
    solved = [attempt for attempt in attempts if attempt.solved]
    if not solved:
        raise UserError(
            f"{folder} holds no solved sweep: run `bp2 paper trajectories sweep --out {folder}`"
        )
    problem = config.load_config(Problem, folder / "sweep.json")
    best: dict[float, Attempt] = {}
    for attempt in solved:
        if attempt.speed not in best or attempt.cost < best[attempt.speed].cost:
            best[attempt.speed] = attempt
    return [
        load_solution(_path(folder, speed, best[speed].start), problem.at(speed))
        for speed in sorted(best)
    ]


def _attempt(problem: Problem, start: int, folder: Path) -> Attempt:
    """Solve once, keep what came of it, and say how it ended."""
    from bp2_rl.optimiser.collocation import solve
    from bp2_rl.optimiser.guess import cold_guess
    from bp2_rl.optimiser.verify import verify

    began = time.perf_counter()
    try:
        solution = solve(problem, cold_guess(problem, seed=start or None))
    except NotSolved as failure:
        attempt = Attempt(
            problem.speed, start, False, time.perf_counter() - began, why=str(failure)
        )
    else:
        save_solution(
            _path(folder, problem.speed, start),
            dataclasses.replace(solution, checks=verify(solution)),
        )
        attempt = Attempt(
            problem.speed,
            start,
            True,
            solution.seconds,
            solution.cost,
            solution.violation,
        )
    config.save_config(_record(folder, problem.speed, start), attempt)
    return attempt


def _read(record: Path, speed: float, start: int) -> Attempt:
    attempt = config.load_config(Attempt, record)
    if (attempt.speed, attempt.start) != (speed, start):
        raise UserError(
            f"{record} is about start {attempt.start} at {attempt.speed:.9g} m/s: choose another folder, or remove it"
        )
    return attempt


def _path(folder: Path, speed: float, start: int) -> Path:
    return folder / f"{speed_name(speed)}-start-{start}"


def _record(folder: Path, speed: float, start: int) -> Path:
    return folder / f"{speed_name(speed)}-start-{start}.attempt.json"
