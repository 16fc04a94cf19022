"""What `bp2 tune` may change: flags of train.py, each with the values among which it
looks."""

import dataclasses
import re
from typing import Literal

from bp2_rl.base.errors import UserError

Kind = Literal["float", "log", "int", "choice"]
FORM = "FLAG=LOW:HIGH, FLAG=LOW:HIGH:log or FLAG=A,B,C, with a flag of train.py"


@dataclasses.dataclass(frozen=True)
class Dimension:
    """A flag of train.py and its values."""

    flag: str  # without its dashes
    kind: Kind
    low: float = 0.0
    high: float = 0.0
    choices: tuple[str, ...] = ()

    @property
    def extremes(self) -> tuple[str, ...]:
        """The values that train.py must understand if it is to understand all."""
        return self.choices or (self.word(self.low), self.word(self.high))

    def word(self, value: float | str) -> str:
        """A value as train.py reads it."""
        return (
            value
            if isinstance(value, str)
            else str(round(value))
            if self.kind == "int"
            else repr(float(value))
        )


def parse_dimension(text: str) -> Dimension:
    """A dimension from `FORM`; whole numbers on both sides mean whole numbers.

    Raises:
        UserError: it is no such thing.
    """
    flag, _, values = text.removeprefix("--").partition("=")
    if not re.fullmatch(r"[a-z][\w.-]*", flag) or not values:
        raise UserError(f"--search takes {FORM}; got {text}")
    if ":" not in values:
        choices = tuple(values.split(","))
        if len(set(choices)) < max(2, len(choices)) or not all(choices):
            raise UserError(
                f"--search {flag}: name two values or more, each once; got {values}"
            )
        return Dimension(flag, "choice", choices=choices)
    low, high, *scale = values.split(":")
    try:
        ends = float(low), float(high)
    except ValueError:
        raise UserError(f"--search {flag}: {low} to {high} are not numbers") from None
    if scale not in ([], ["log"]) or not ends[0] < ends[1] or (scale and ends[0] <= 0):
        raise UserError(
            f"--search {flag} takes LOW:HIGH or LOW:HIGH:log with LOW < HIGH, for log above 0; got {values}"
        )
    whole = all(re.fullmatch(r"-?\d+", end) for end in (low, high))
    return Dimension(flag, "log" if scale else "int" if whole else "float", *ends)
