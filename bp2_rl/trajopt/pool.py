"""Processes for solves: fresh ones, and an interruption ends what has not begun."""

import concurrent.futures
import contextlib
import multiprocessing
from collections.abc import Iterator

from bp2_rl.errors import UserError


@contextlib.contextmanager
def solvers(workers: int) -> Iterator[concurrent.futures.ProcessPoolExecutor]:
    """A pool of `workers` processes, spawned: one forked beside JAX's threads can hang.

    Raises:
        UserError: fewer than one.
    """
    if workers < 1:
        raise UserError(f"workers must be at least 1, got {workers}")
    pool = concurrent.futures.ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()
