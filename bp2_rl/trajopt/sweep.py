"""Many trajectories at once: speeds x cold starts, over the cores, each kept and never solved twice."""

import concurrent.futures
import dataclasses
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from bp2_rl import config
from bp2_rl.errors import UserError
from bp2_rl.trajopt.problem import Problem
from bp2_rl.trajopt.solution import Solution, load_solution, save_solution
from bp2_rl.trajopt.verify import verify
from bp2_rl.workers import spawned


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


def sweep(problem: Problem, speeds: Sequence[float], starts: int, folder: Path, workers: int = 2) -> Iterator[Attempt]:
    """Solve from every start at every speed; yields each attempt as it ends, those already in `folder` first.

    Every solution is kept in `folder`; `best_of` reads the cheapest of each speed.

    Raises:
        UserError: the folder holds a sweep of another problem.
    """
    _claim(folder, problem)
    todo = []
    for speed in speeds:
        for start in range(starts):
            record = _record(folder, speed, start)
            if record.is_file():
                yield config.load_config(Attempt, record)
            else:
                todo.append((speed, start))
    with spawned(workers) as pool:
        attempts = [pool.submit(_attempt, problem.at(speed), start, folder) for speed, start in todo]
        for attempt in concurrent.futures.as_completed(attempts):
            yield attempt.result()


def best_of(folder: Path) -> list[Solution]:
    """The cheapest solution of each speed that a sweep has left, verified, slowest first.

    Raises:
        UserError: there is none, or one cannot be read.
    """
    attempts = [config.load_config(Attempt, record) for record in sorted(folder.glob("speed-*-start-*.attempt.json"))]
    solved = [attempt for attempt in attempts if attempt.solved]
    if not solved:
        raise UserError(f"{folder} holds no solved sweep: run `bp2 trajopt sweep --out {folder}`")
    best: dict[float, Attempt] = {}
    for attempt in solved:
        if attempt.speed not in best or attempt.cost < best[attempt.speed].cost:
            best[attempt.speed] = attempt
    return [load_solution(_path(folder, speed, best[speed].start)) for speed in sorted(best)]


def _attempt(problem: Problem, start: int, folder: Path) -> Attempt:
    """Solve once, keep what came of it, and say how it ended."""
    from bp2_rl.trajopt.collocation import NotSolved, cold_guess, solve

    began = time.perf_counter()
    try:
        solution = solve(problem, cold_guess(problem, seed=start or None))
    except NotSolved as failure:
        attempt = Attempt(problem.speed, start, False, time.perf_counter() - began, why=str(failure))
    else:
        save_solution(_path(folder, problem.speed, start), dataclasses.replace(solution, checks=verify(solution)))
        attempt = Attempt(problem.speed, start, True, solution.seconds, solution.cost, solution.violation)
    config.save_config(_record(folder, problem.speed, start), attempt)
    return attempt


def _claim(folder: Path, problem: Problem) -> None:
    """Make the folder this problem's."""
    card = folder / "sweep.json"
    if card.is_file() and config.load_config(Problem, card) != problem:
        raise UserError(f"{folder} holds a sweep of another problem (see {card}): choose another --out or remove it")
    folder.mkdir(parents=True, exist_ok=True)
    config.save_config(card, problem)


def _path(folder: Path, speed: float, start: int) -> Path:
    return folder / f"speed-{speed:05.2f}-start-{start}"


def _record(folder: Path, speed: float, start: int) -> Path:
    return folder / f"speed-{speed:05.2f}-start-{start}.attempt.json"
