"""While tests run, every function's and dataclass's annotations are checked at its
first calls in each test."""

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from bp2_rl.paper.orbits.returns import radius
from bp2_rl.simulation.simulator import Numerics


@pytest.mark.parametrize("test", ["one test", "the next"])
def test_shapes_and_types_are_checked_anew_in(test):
    with pytest.raises(TypeCheckError):
        radius(np.ones((2, 3)))
    with pytest.raises(TypeCheckError):
        Numerics(steps=1.5)  # pyright: ignore[reportArgumentType]
    for _ in range(100):
        assert radius(np.eye(2)) == pytest.approx(1.0)
        assert Numerics(steps=2).steps == 2
