"""Bounds declared on fields: an error's one line names the field, its bounds and its
value."""

import dataclasses
import math
from typing import Annotated, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bp2_rl.base.bounds import (
    Bounded,
    Count,
    Positive,
    Range,
    Share,
    Within,
    check_bounds,
)
from bp2_rl.base.errors import UserError


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
    size: Annotated[float, Within(0.0)] = 0.0
    below: Annotated[float, Within(0.0, 1.0, open_above=True)] = 0.0
    anything: float = -3.0
    pair: float | tuple[float, float] = (2.0, 1.0)  # no range: it need not ascend
    several: tuple[Inner, ...] = ()
    flag: bool = False
    name: str = ""


def test_settings_within_bounds_pass():
    check_bounds(Settings())
    check_bounds(Settings(inner=Inner(cap=5.0), speed=2.0, count=10**6))
    numpys: Any = {
        "anything": np.float64(-3.0),
        "share": np.float32(0.5),
        "count": np.int64(2),
    }
    check_bounds(Settings(**numpys))


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"inner": Inner(rate=0.0)}, "env.inner.rate must be positive, got 0"),
        ({"inner": Inner(cap=-math.inf)}, "env.inner.cap must be positive, got -inf"),
        (
            {"inner": Inner(rate=math.inf)},
            "env.inner.rate must be positive and finite, got inf",
        ),
        ({"count": 0}, "env.count must be at least 1, got 0"),
        (
            {"count": -(10**400)},
            "env.count must be at least 1 and finite, got a huge integer",
        ),
        ({"share": 1.1}, "env.share must be from 0 to 1, got 1.1"),
        ({"share": math.nan}, "env.share must be from 0 to 1, got nan"),
        ({"delay": (0.0, 0.02)}, "env.delay must be from 0 to 0.01, got 0.02"),
        ({"delay": (0.005, 0.001)}, r"env.delay must be a range \(low, high\)"),
        ({"speed": -1.0}, "env.speed must be positive, got -1"),
        ({"layers": (4, 0)}, "env.layers must be at least 1, got 0"),
        ({"size": -1.0}, "env.size must be at least 0, got -1"),
        ({"below": 1.0}, "env.below must be at least 0 and below 1, got 1"),
        ({"several": 3}, "env.several takes a tuple of entries, each an Inner, got 3"),
        (
            {"several": (3,)},
            "env.several takes an Inner, got 3",
        ),
        ({"several": (Inner(), Inner(cap=-7.0))}, "env.several.cap must be "),
        ({"inner": 3}, "env.inner takes an Inner, got 3"),
        ({"count": 1.5}, "env.count takes a whole number, got 1.5"),
        ({"flag": 1}, "env.flag takes True or False, got 1"),
        ({"speed": True}, "env.speed takes a number, got True"),
        ({"anything": math.nan}, "env.anything must be a finite number, got nan"),
    ],
)
def test_a_number_out_of_bounds_is_named(changes, line):
    with pytest.raises(UserError, match=f"^{line}"):
        check_bounds(dataclasses.replace(Settings(), **changes), "env.")


@st.composite
def ranges(draw):
    """Draw bounds of every kind, with room between the least and the greatest value."""
    least = draw(st.none() | st.floats(-1e6, 1e6))
    most = draw(st.none() | st.floats(1.1e6, 1e9))
    given = {
        name: value
        for name, value in (("least", least), ("most", most))
        if value is not None
    }
    return Within(
        **given, open_below=draw(st.booleans()), open_above=draw(st.booleans())
    )


def one_number(bounds: Within, value: float):
    """Return a dataclass of one number within `bounds`."""
    made = dataclasses.make_dataclass(
        "Made", [("number", Annotated[float, bounds])], frozen=True
    )
    return made(value)


@given(ranges(), st.data())
def test_any_number_inside_is_accepted(bounds, data):
    least, most = (
        None if math.isinf(end) else end for end in (bounds.least, bounds.most)
    )
    no_least, no_most = (
        bounds.open_below and least is not None,
        bounds.open_above and most is not None,
    )
    numbers = st.floats(
        least,
        most,
        allow_infinity=False,
        allow_nan=False,
        exclude_min=no_least,
        exclude_max=no_most,
    )
    check_bounds(one_number(bounds, data.draw(numbers)))


@given(ranges(), st.data())
def test_any_number_outside_is_refused(bounds, data):
    outside = st.sampled_from([math.nan, math.inf, -math.inf])
    if math.isfinite(bounds.least):
        outside |= st.floats(max_value=bounds.least, exclude_max=not bounds.open_below)
    if math.isfinite(bounds.most):
        outside |= st.floats(min_value=bounds.most, exclude_min=not bounds.open_above)
    with pytest.raises(UserError, match=r"^number must be .*, got \S+$"):
        check_bounds(one_number(bounds, data.draw(outside)))


def test_a_bounded_dataclass_refuses_when_it_is_made_and_names_its_path_to_those_below_it():
    @dataclasses.dataclass(frozen=True)
    class Flags(Bounded, path="--"):
        big_step: Positive = 1.0

    @dataclasses.dataclass(frozen=True)
    class More(Flags):
        count: Count = 1

    @dataclasses.dataclass(frozen=True)
    class Plain(Bounded):
        count: Count = 1

    assert More(2.0, 3) == More(big_step=2.0, count=3)
    with pytest.raises(UserError, match=r"^--big-step must be positive, got 0$"):
        More(big_step=0.0)
    with pytest.raises(UserError, match=r"^count must be at least 1, got 0$"):
        Plain(0)
