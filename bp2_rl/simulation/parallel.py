"""Runs of a policy, shared out over all processors."""

import concurrent.futures
import contextlib
import functools
from collections.abc import Callable, Generator, Sequence
from typing import TypeVar

import jax
import numpy as np

from bp2_rl.base.processes import keep_compiled, processors, spawned
from bp2_rl.learning.policy import Policy
from bp2_rl.simulation.backend import Backend
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.trajectory import Trajectory

Task = TypeVar("Task")
One = TypeVar("One", bound=RunRequest)
Result = TypeVar("Result")

_kept: list[concurrent.futures.ProcessPoolExecutor] = []


@contextlib.contextmanager
def keep_workers() -> Generator[None]:
    """Within it the workers stay, with all that they have compiled, for one benchmark
    after the other."""
    with _workers(processors()) as pool:
        _kept.append(pool)
        try:
            yield
        finally:
            _kept.remove(pool)


def in_parallel(
    run: Callable[[Policy, Task], Result], policy: Policy, tasks: Sequence[Task]
) -> list[Result]:
    """Return `run(policy, task)` for each task, dealt out to the workers in turn.

    `run` and all else must be picklable.
    """
    count = min(processors(), len(tasks))
    shares = [list(range(worker, len(tasks), count)) for worker in range(count)]
    return _share_out(functools.partial(_run_all, run), policy, tasks, shares)


def simulate_all(
    measure: Callable[[One, Trajectory], Result],
    policy: Policy,
    requests: Sequence[One],
    backend: Backend = "mujoco",
) -> list[Result]:
    """Return `measure(request, its run)` of every request, run side by side on all
    processors.

    `measure` and all else must be picklable.
    """
    run = functools.partial(_measure_all, measure, backend)
    return _share_out(run, policy, requests, shares_of(requests, processors()))


def shares_of(requests: Sequence[RunRequest], workers: int) -> list[list[int]]:
    """Share requests out among workers, with equal work and few robots for each.

    The longest first, as those side by side last as long as the longest of them.
    """
    kinds: dict[object, int] = {}
    alike = sorted(
        range(len(requests)),
        key=lambda i: kinds.setdefault(requests[i].hardware, len(kinds)),
    )
    # Torques of a few robots take as long as four of their physics steps.
    work = np.array(
        [
            one.schedule.duration * (one.numerics.steps + 4 * one.numerics.updates)
            for one in (requests[i] for i in alike)
        ]
    )
    worker = (workers * (np.cumsum(work) - work / 2) / max(np.sum(work), 1e-9)).astype(
        int
    )
    # where that comes to all of them, by requests that take no time
    worker = np.minimum(worker, workers - 1)
    shares = [
        [i for i, whose in zip(alike, worker, strict=True) if whose == each]
        for each in range(workers)
    ]
    return [
        sorted(share, key=lambda i: -requests[i].schedule.duration)
        for share in shares
        if share
    ]


def _share_out(
    run_all: Callable[[Policy, list[Task]], list[Result]],
    policy: Policy,
    tasks: Sequence[Task],
    shares: Sequence[Sequence[int]],
) -> list[Result]:
    """Return the results of all tasks, in order."""
    done: dict[int, Result] = {}
    if not tasks:
        return []
    with contextlib.nullcontext(_kept[-1]) if _kept else _workers(len(shares)) as pool:
        futures = [
            pool.submit(run_all, policy, [tasks[i] for i in share]) for share in shares
        ]
        for share, future in zip(shares, futures, strict=True):
            done.update(zip(share, future.result(), strict=True))
    return [done[i] for i in range(len(tasks))]


def _workers(
    count: int,
) -> contextlib.AbstractContextManager[concurrent.futures.ProcessPoolExecutor]:
    keep_compiled()
    # When the block ends, nothing that is asked for is left to do; after an
    # interruption nobody wants it.
    return spawned(
        count,
        functools.partial(_begin, jax.config.values["jax_compilation_cache_dir"]),
        abandon=True,
    )


def _measure_all(
    measure: Callable[[One, Trajectory], Result],
    backend: Backend,
    policy: Policy,
    requests: Sequence[One],
) -> list[Result]:
    runs = simulate(policy, requests, backend=backend)
    return [measure(one, run) for one, run in zip(requests, runs, strict=True)]


def _run_all(
    run: Callable[[Policy, Task], Result], policy: Policy, tasks: Sequence[Task]
) -> list[Result]:
    return [run(policy, task) for task in tasks]


def compute_here() -> None:
    """Have JAX compute on the processor, in the thread that asks; call it before JAX
    computes anything.

    C MuJoCo's robots ask for a few numbers every millisecond. To hand such a call to
    another thread takes longer than to answer it, and many times longer where other
    programs keep the processors busy.
    """
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_cpu_enable_async_dispatch", False)


def _begin(cache: str | None) -> None:
    """Set up a worker as the command set up itself."""
    compute_here()
    jax.config.update("jax_compilation_cache_dir", cache)
