"""Tables of published numbers as CSV: ours that ship, and a stranger's, looked at
before use.

A row is a frozen dataclass. Its fields are the columns, under the headings that
`ColumnHeading` gives them, unit
included: a column in km/h is not taken for one in m/s. A file may hold further columns,
and the columns in any order.
"""

import csv
import dataclasses
import types
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar, get_args, get_origin

from bp2_rl.base.bounds import check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import BadFileError, read_bytes

TableRow = TypeVar("TableRow")

LARGEST = 1 << 20  # bytes of a table that is read
YES, NO = "yes", "no"


class ColumnHeading(NamedTuple):
    """The heading of a field's column, where it is not the field's name.

    Such as `mass: Annotated[float, ColumnHeading("mass [kg]")]`.
    """

    text: str


def read_table(path: Path, row: type[TableRow]) -> tuple[TableRow, ...]:
    """The rows of a CSV file, one at least.

    Args:
        path: of UTF-8 text whose first line holds the headings.
        row: a frozen dataclass of str, int, float, bool (yes or no), or optional ones
            (an empty cell is None), with their bounds.

    Raises:
        BadFileError: the file cannot be read, lacks a column, or holds what is no such
            row; the line says where.
    """
    lines = _lines(path)
    if len(lines) < 2:
        raise BadFileError(
            f"{path} holds no table: expected a line of headings, and rows below"
        )
    (_, head), *body = lines
    columns = _columns(path, [cell.strip() for cell in head], row)
    return tuple(
        _row(f"{path}, line {number}", cells, len(head), columns, row)
        for number, cells in body
    )


def headings(row: type[Any]) -> tuple[str, ...]:
    """The headings that a table of such rows needs."""
    return tuple(column.heading for column in _fields(row))


class _Field(NamedTuple):
    name: str
    heading: str
    type: Any
    optional: bool


def _fields(row: type[Any]) -> tuple[_Field, ...]:
    hints = typing.get_type_hints(row, include_extras=True)
    found = []
    for field in dataclasses.fields(row):
        remarks = (
            get_args(hints[field.name])[1:]
            if get_origin(hints[field.name]) is Annotated
            else ()
        )
        heading = next(
            (remark.text for remark in remarks if isinstance(remark, ColumnHeading)),
            field.name,
        )
        bare = get_args(hints[field.name])[0] if remarks else hints[field.name]
        members = get_args(bare) if isinstance(bare, types.UnionType) else (bare,)
        found.append(_Field(field.name, heading, members[0], types.NoneType in members))
    return tuple(found)


def _lines(path: Path) -> list[tuple[int, list[str]]]:
    """Return the cells of all lines that are not empty, with the lines' numbers."""
    try:
        reader = csv.reader(
            read_bytes(path, LARGEST).decode("utf-8-sig").splitlines(keepends=True),
            strict=True,
        )
        return [
            (reader.line_num, cells)
            for cells in reader
            if any(cell.strip() for cell in cells)
        ]
    except (csv.Error, UnicodeDecodeError) as error:
        raise BadFileError(f"{path} is no CSV file in UTF-8: {error}") from error


def _columns(path: Path, head: Sequence[str], row: type[Any]) -> dict[_Field, int]:
    """Where each field's column is."""
    fields = _fields(row)
    if missing := [field.heading for field in fields if head.count(field.heading) != 1]:
        raise BadFileError(
            f"{path} needs one column {missing[0]!r}; its columns should be: {','.join(headings(row))}"
        )
    return {field: head.index(field.heading) for field in fields}


def _row(
    place: str,
    cells: Sequence[str],
    width: int,
    columns: dict[_Field, int],
    row: type[TableRow],
) -> TableRow:
    if len(cells) != width:
        raise BadFileError(
            f"{place} has {len(cells)} cells, the line of headings {width}"
        )
    values = {
        field.name: _value(place, field, cells[at].strip())
        for field, at in columns.items()
    }
    try:
        made = row(**values)
        check_bounds(made)
    except UserError as error:
        raise BadFileError(f"{place}: {error}") from error
    return made


def _value(place: str, field: _Field, cell: str) -> Any:
    if cell == "" and field.optional:
        return None
    if field.type is str and cell:
        return cell
    if field.type is bool and cell in (YES, NO):
        return cell == YES
    if field.type in (int, float):
        try:
            return field.type(cell)
        except ValueError:
            pass
    wanted = {
        bool: "yes or no",
        int: "a whole number",
        float: "a number",
        str: "some text",
    }[field.type]
    shown = cell if len(cell) <= 40 else f"{cell[:37]}..."
    raise BadFileError(f"{place}: {field.heading} takes {wanted}, got {shown!a}")
