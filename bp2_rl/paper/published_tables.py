"""Tables of published numbers in CSV files, ours or a user's, checked as they are read.

A row is a frozen dataclass. Its fields are the columns, under the headings that
`ColumnHeading` gives them, unit included: a column in km/h is not taken for one in m/s.
A file may hold further columns, and the columns in any order.
"""

import csv
import types
import typing
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar, get_args

from bp2_rl.base.bounds import check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import BadFileError, read_bytes

TableRow = TypeVar("TableRow")

LARGEST = 1 << 20  # bytes of a table that is read


class ColumnHeading(NamedTuple):
    """The heading of a field's column, where it is not the field's name.

    Such as `mass: Annotated[float, ColumnHeading("mass [kg]")]`.
    """

    text: str


def read_table(path: Path, row: type[TableRow]) -> tuple[TableRow, ...]:
    """Return the rows of a CSV file, one at least.

    Args:
        path: of UTF-8 text whose first line holds the headings.
        row: a frozen dataclass of str, int, float, bool (yes or no), or optional ones
            (an empty cell is None), with their bounds.

    Raises:
        BadFileError: the file cannot be read, lacks a column, or holds what is no such
            row; the line says where.
    """
    try:
        reader = csv.reader(
            read_bytes(path, LARGEST).decode("utf-8-sig").splitlines(keepends=True),
            strict=True,
        )
        lines = [
            (reader.line_num, [cell.strip() for cell in cells])
            for cells in reader
            if any(cell.strip() for cell in cells)
        ]
    except (csv.Error, UnicodeDecodeError) as error:
        raise BadFileError(f"{path} is no CSV file in UTF-8: {error}") from error
    if len(lines) < 2:
        raise BadFileError(
            f"{path} holds no table: expected a line of headings, and rows below"
        )
    (_, head), *body = lines
    columns = _columns(row)
    for heading in columns.values():
        if head.count(heading) != 1:
            raise BadFileError(
                f"{path} needs one column {heading!r}; its columns should be: {','.join(columns.values())}"
            )
    return tuple(
        _row(f"{path}, line {number}", head, cells, columns, row)
        for number, cells in body
    )


def _columns(row: type[object]) -> dict[str, str]:
    """Return the headings of a row's columns by the names of its fields."""
    hints = typing.get_type_hints(row, include_extras=True)
    return {
        name: next(
            (one.text for one in get_args(hint) if isinstance(one, ColumnHeading)), name
        )
        for name, hint in hints.items()
    }


def _row(
    place: str,
    head: Sequence[str],
    cells: Sequence[str],
    columns: dict[str, str],
    row: type[TableRow],
) -> TableRow:
    if len(cells) != len(head):
        raise BadFileError(
            f"{place} has {len(cells)} cells, the line of headings {len(head)}"
        )
    found = dict(zip(head, cells, strict=True))
    hints = typing.get_type_hints(row)
    try:
        made = row(
            **{
                name: _value(heading, hints[name], found[heading])
                for name, heading in columns.items()
            }
        )
        check_bounds(made)
    except UserError as error:
        raise BadFileError(f"{place}: {error}") from error
    return made


def _value(heading: str, hint: object, cell: str) -> str | float | bool | None:
    """Return what a cell holds, of the type that its field has."""
    kinds = get_args(hint) or (hint,)
    if cell == "" and types.NoneType in kinds:
        return None
    read, wanted = READERS[kinds[0]]
    try:
        return read(cell)
    except (ValueError, KeyError):
        shown = cell if len(cell) <= 40 else f"{cell[:37]}..."
        raise UserError(f"{heading} takes {wanted}, got {shown!a}") from None


def _text(cell: str) -> str:
    if not cell:
        raise ValueError
    return cell


READERS: dict[object, tuple[Callable[[str], str | float | bool], str]] = {
    bool: ({"yes": True, "no": False}.__getitem__, "yes or no"),
    int: (int, "a whole number"),
    float: (float, "a number"),
    str: (_text, "some text"),
}
"""Reader of a cell, and words for what the cell should be, by the field's type."""
