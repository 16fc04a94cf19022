"""The largest push that is survived, by bisection, for many kinds of push at once."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float


def largest(
    survives: Callable[[Float[np.ndarray, " N"]], Bool[np.ndarray, " N"]],
    kinds: int,
    most: float,
    rounds: int,
) -> tuple[Float[np.ndarray, " kinds"], Float[np.ndarray, " kinds"]]:
    """Between which two sizes of each kind of push survival ends: (survived, not
    survived).

    A push of 0 counts as survived, one of `most` as not; the two are most / 2^rounds
    apart. Where survival is not monotonous in the size, one of its ends is found.
    """
    low, high = np.zeros(kinds), np.full(kinds, most)
    for _ in range(rounds):
        middle = 0.5 * (low + high)
        up = survives(middle)
        low, high = np.where(up, middle, low), np.where(up, high, middle)
    return low, high
