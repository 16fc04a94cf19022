"""Bounds declared on fields: one line names the field, what it may be, and what it is."""

import dataclasses
import math
from typing import Annotated

import pytest

from bp2_rl.bounds import Count, NotNegative, Positive, Range, Share, Within, check_bounds
from bp2_rl.errors import UserError


@dataclasses.dataclass(frozen=True)
class Inner:
    rate: Positive = 1.0
    cap: Annotated[float, Within(0.0, open_below=True, infinite=True)] = math.inf


@dataclasses.dataclass(frozen=True)
class Settings:
    inner: Inner = Inner()
    count: Count = 1
    share: Share = 0.5
    delay: Annotated[Range, Within(0.0, 0.01)] = (0.0, 0.01)
    speed: Positive | None = None
    layers: tuple[Count, ...] = (4, 4)
    size: NotNegative = 0.0
    below: Annotated[float, Within(0.0, 1.0, open_above=True)] = 0.0
    anything: float = -3.0
    flag: bool = False
    name: str = ""


def test_settings_within_bounds_pass():
    check_bounds(Settings())
    check_bounds(Settings(inner=Inner(cap=5.0), speed=2.0, count=10**6))


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"inner": Inner(rate=0.0)}, "env.inner.rate must be positive, got 0"),
        ({"inner": Inner(cap=-math.inf)}, "env.inner.cap must be positive, and finite, got -inf"),
        ({"inner": Inner(rate=math.inf)}, "env.inner.rate must be positive, and finite, got inf"),
        ({"count": 0}, "env.count must be at least 1, got 0"),
        ({"count": -(10**400)}, "env.count must be at least 1, and finite, got a huge integer"),
        ({"share": 1.1}, "env.share must be from 0 to 1, got 1.1"),
        ({"share": math.nan}, "env.share must be from 0 to 1, and finite, got nan"),
        ({"delay": (0.0, 0.02)}, "env.delay must be from 0 to 0.01, got 0.02"),
        ({"delay": (0.005, 0.001)}, r"env.delay must be a range \(low, high\)"),
        ({"speed": -1.0}, "env.speed must be positive, got -1"),
        ({"layers": (4, 0)}, "env.layers must be at least 1, got 0"),
        ({"size": -1.0}, "env.size must be at least 0, got -1"),
        ({"below": 1.0}, "env.below must be from 0 to below 1, got 1"),
        ({"anything": math.nan}, "env.anything must be a finite number, and finite, got nan"),
    ],
)
def test_a_number_out_of_bounds_is_named(changes, line):
    with pytest.raises(UserError, match=f"^{line}"):
        check_bounds(dataclasses.replace(Settings(), **changes), "env.")
