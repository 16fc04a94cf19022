"""Figures of merit, each declared once: a field of a dataclass says its label, unit, format
and meaning, and whether a policy's card keeps its value.

Reports, cards and tables are made from the declaration::

    @dataclasses.dataclass(frozen=True)
    class SpringMetrics:
        travel: float = metric("Peak spring travel", "mm", ".0f", "of all springs")
        hits: int = metric("Stop hits", form="d", card=True)

    rows_of(SpringMetrics(0.031, 2))  # (Row("Peak spring travel", "31 mm", ...), ...)
    card_of(SpringMetrics(0.031, 2))  # {"hits": 2}
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

NOT_MEASURED = "-"
# A value is held in SI units and shown in these.
SCALES = {"mm": 1e3, "mrad": 1e3, "ms": 1e3, "kW": 1e-3, "deg": 180.0 / math.pi}


class Row(NamedTuple):
    """One figure of merit as a report shows it."""

    label: str
    value: str
    meaning: str


class Table(NamedTuple):
    """A table of text; all columns but the first (and the last, if `words`) are numbers."""

    title: str
    head: Sequence[str]
    lines: Sequence[Sequence[str]]
    words: bool = False


@dataclasses.dataclass(frozen=True)
class Metric:
    """Label, unit, format and meaning of a figure of merit, and where the figure is
    shown.

    Attributes:
        label: its name for a reader.
        unit: the unit that is shown; values are in SI units (see `SCALES`).
        form: a format such as ".2f", or a function from the value to its text.
        meaning: its definition in a few words, where `{m.name}` stands for another
            field of the same dataclass; or a function from that dataclass to the words.
        card: whether a policy's card keeps the value, under the field's name; or the
            name under which the card keeps it.
        shown: whether reports and tables show it; or a function that says so of the
            dataclass that holds it.
    """

    label: str
    unit: str = ""
    form: str | Callable[[Any], str] = ".2f"
    meaning: str | Callable[[Any], str] = ""
    card: bool | str = False
    shown: bool | Callable[[Any], bool] = True

    @property
    def head(self) -> str:
        """Heading of this metric's column in a table: its label and unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    def show(self, value: object, *, unit: bool = True) -> str:
        """Return a value of this metric as text, with its unit unless a table's heading
        has it."""
        if callable(self.form):
            return self.form(value)
        if isinstance(value, bool):
            return "yes" if value else "no"
        if isinstance(value, int | float) and self.unit in SCALES:
            value = value * SCALES[self.unit]
        return show(value, self.form, self.unit if unit else "")

    def is_shown(self, holder: object) -> bool:
        """Return whether reports and tables show this metric of the dataclass
        `holder`."""
        return self.shown(holder) if callable(self.shown) else self.shown

    def explain(self, holder: object) -> str:
        """Return this metric's definition in words, filled in with values of the
        dataclass `holder`."""
        if callable(self.meaning):
            return self.meaning(holder)
        return self.meaning.format(m=holder)


def metric(*declared: Any, default: Any = dataclasses.MISSING, **more: Any) -> Any:
    """Declare a dataclass field as a `Metric`; arguments as of `Metric`, and `default`."""
    return dataclasses.field(
        default=default, metadata={"metric": Metric(*declared, **more)}
    )


def metrics_of(holder: Any) -> dict[str, Metric]:
    """Return the metrics that a dataclass, or an instance, declares, by field name."""
    fields = dataclasses.fields(holder)
    return {f.name: f.metadata["metric"] for f in fields if "metric" in f.metadata}


def rows_of(holder: object, *names: str) -> tuple[Row, ...]:
    """Return a row for each metric of a dataclass, and of dataclasses in its fields.

    `names` are the fields to show, in this order; by default all.
    """
    return tuple(
        Row(figure.label, figure.show(value), figure.explain(held))
        for held, _, figure, value in _walk(holder, names)
        if figure.is_shown(held)
    )


def card_of(holder: object, *names: str) -> dict[str, Any]:
    """Return a dataclass's values for a policy's card, by name, rounded to four digits.

    `names` are the fields to look at; by default all.
    """
    kept = (
        (name if figure.card is True else figure.card, value)
        for _, name, figure, value in _walk(holder, names)
        if figure.card
    )
    return rounded({str(name): value for name, value in kept})


def table_of(
    title: str, subjects: Sequence[object], *names: str, words: bool = False
) -> Table:
    """Return a table with a line for each subject and a column for each of its metrics.

    Args:
        title: what stands above the table.
        subjects: dataclasses of one kind, at least one.
        names: the fields to show, in this order; by default all metrics.
        words: whether the last column holds text.
    """
    declared = metrics_of(subjects[0])
    chosen = {
        name: declared[name]
        for name in names or declared
        if declared[name].is_shown(subjects[0])
    }
    lines = [
        [one.show(getattr(s, name), unit=False) for name, one in chosen.items()]
        for s in subjects
    ]
    return Table(title, [figure.head for figure in chosen.values()], lines, words)


def table_of_rows(title: str, rows: Sequence[Row]) -> Table:
    """Return a table of measure, value and definition, with a line for each report
    row."""
    return Table(title, ("Measure", "Value", "Definition"), rows, words=True)


def show(value: object, form: str, unit: str = "") -> str:
    """Format a value with its unit; a dash stands for None."""
    return NOT_MEASURED if value is None else f"{value:{form}} {unit}".strip()


def show_fall(fell_at: float | None) -> str:
    """Return the time of a robot's fall, s, as text, or "none" if no robot fell."""
    return "none" if fell_at is None else f"at {fell_at:.2f} s"


def rounded(value: Any) -> Any:
    """Round numbers to four digits, in lists and dicts too; infinite ones become None."""
    if isinstance(value, float):
        return float(f"{value:.4g}") if math.isfinite(value) else None
    if isinstance(value, dict):
        return {name: rounded(entry) for name, entry in value.items()}
    return (
        [rounded(entry) for entry in value]
        if isinstance(value, list | tuple)
        else value
    )


def _walk(
    holder: Any, names: Sequence[str] = ()
) -> Iterator[tuple[object, str, Metric, object]]:
    declared = metrics_of(holder)
    for name in names or (field.name for field in dataclasses.fields(holder)):
        value = getattr(holder, name)
        if name in declared:
            yield holder, name, declared[name], value
        elif dataclasses.is_dataclass(value):
            yield from _walk(value)
