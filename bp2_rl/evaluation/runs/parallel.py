"""Many runs of one policy on all processors."""

import functools
from collections.abc import Callable, Sequence
from typing import TypeVar

import jax

from bp2_rl.learning.policy import Policy
from bp2_rl.workers import processors, spawned

Task = TypeVar("Task")
Result = TypeVar("Result")


def in_parallel(run: Callable[[Policy, Task], Result], policy: Policy, tasks: Sequence[Task]) -> list[Result]:
    """`run(policy, task)` for every task, dealt out in turn: each worker compiles its controller once.

    `run` and all else must be picklable.
    """
    workers = min(processors(), len(tasks))
    with spawned(workers, functools.partial(_begin, jax.config.values["jax_compilation_cache_dir"])) as pool:
        hands = [pool.submit(_run_all, run, policy, tasks[worker::workers]) for worker in range(workers)]
        done = [hand.result() for hand in hands]
    return [done[i % workers][i // workers] for i in range(len(tasks))]


def _run_all(run: Callable[[Policy, Task], Result], policy: Policy, tasks: Sequence[Task]) -> list[Result]:
    return [run(policy, task) for task in tasks]


def compute_here() -> None:
    """Have JAX compute on the processor, in the thread that asks; call it before JAX computes anything.

    C MuJoCo's robots ask for a few numbers every millisecond. To hand such a call to another thread takes longer than
    to answer it, and many times longer where other programs keep the processors busy.
    """
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_cpu_enable_async_dispatch", False)


def _begin(cache: str | None) -> None:
    """Make of a worker what the command has made of itself."""
    compute_here()
    jax.config.update("jax_compilation_cache_dir", cache)
