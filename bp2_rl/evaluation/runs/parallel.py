"""Many runs of one policy on all processors."""

import functools
from collections.abc import Callable, Sequence
from typing import TypeVar

import jax

from bp2_rl.evaluation.runs.team import Try, rollout_team
from bp2_rl.evaluation.runs.trajectory import Trajectory
from bp2_rl.learning.policy import Policy
from bp2_rl.workers import processors, spawned

Task = TypeVar("Task")
One = TypeVar("One", bound=Try)
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


def run_team(measure: Callable[[One, Trajectory], Result], policy: Policy, tries: Sequence[One]) -> list[Result]:
    """`measure(one, its run)` of every try, run side by side on all processors.

    `measure` and all else must be picklable.
    """
    workers = min(processors(), len(tries))
    longest = sorted(range(len(tries)), key=lambda i: -tries[i].schedule.duration)
    shares = [longest[worker::workers] for worker in range(workers)]
    done: dict[int, Result] = {}
    with spawned(workers, functools.partial(_begin, jax.config.values["jax_compilation_cache_dir"])) as pool:
        hands = [pool.submit(_measure_all, measure, policy, [tries[i] for i in share]) for share in shares]
        for share, hand in zip(shares, hands, strict=True):
            done.update(zip(share, hand.result(), strict=True))
    return [done[i] for i in range(len(tries))]


def _measure_all(measure: Callable[[One, Trajectory], Result], policy: Policy, tries: Sequence[One]) -> list[Result]:
    return [measure(one, run) for one, run in zip(tries, rollout_team(policy, policy.card.env, tries), strict=True)]


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
