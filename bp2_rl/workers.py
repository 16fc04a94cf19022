"""Worker processes: fresh ones, and an interruption ends what has not begun."""

import concurrent.futures
import contextlib
import multiprocessing
from collections.abc import Callable, Iterator

from bp2_rl.errors import UserError


@contextlib.contextmanager
def spawned(
    count: int, initializer: Callable[[], None] | None = None
) -> Iterator[concurrent.futures.ProcessPoolExecutor]:
    """A pool of `count` processes, spawned: one forked beside JAX's threads can hang. Each begins with `initializer`.

    Raises:
        UserError: fewer than one.
    """
    if count < 1:
        raise UserError(f"workers must be at least 1, got {count}")
    spawn = multiprocessing.get_context("spawn")
    pool = concurrent.futures.ProcessPoolExecutor(count, mp_context=spawn, initializer=initializer)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()
