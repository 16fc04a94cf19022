"""Tables of metrics on the terminal."""

from rich.console import Console
from rich.table import Table
from rich.text import Text

from bp2_rl.base import metric

COLUMNS = 130  # of a table, at least


def print_table(table: metric.Table, *, folded: bool = False) -> None:
    """Print a table on `COLUMNS` columns at least: a number that is cut off is worse
    than a line that is folded.

    Args:
        table: all columns but the first (and the last, if `words`) hold numbers.
        folded: all columns hold sentences.
    """
    shown = Table(title=table.title, title_justify="left", title_style="bold")
    last = len(table.head) - 1
    for place, column in enumerate(table.head):
        left = folded or place == 0 or (table.words and place == last)
        keep = place == 0 and not folded
        shown.add_column(column, no_wrap=keep, justify="left" if left else "right")
    for line in table.lines:
        shown.add_row(*map(Text, line))
    Console(width=max(Console().width, COLUMNS)).print(shown)
