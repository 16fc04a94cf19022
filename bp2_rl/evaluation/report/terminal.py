"""Evaluations on the terminal."""

from rich.console import Console
from rich.table import Table
from rich.text import Text

from bp2_rl.evaluation.benchmarks.outcome import Evaluation


def print_table(evaluation: Evaluation, console: Console) -> None:
    """Print the figures of merit of an evaluation, then its verdict."""
    table = Table(
        title=Text(
            f"{evaluation.benchmark}: {evaluation.subject} ({evaluation.backend})"
        ),
        title_justify="left",
        title_style="bold",
        box=None,
        show_header=False,
    )
    table.add_column(no_wrap=True)
    table.add_column(justify="right", style="bold", no_wrap=True)
    table.add_column(style="dim")
    for row in evaluation.rows:
        table.add_row(*map(Text, row))
    console.print(table)
    console.print(verdict_of(evaluation))


def verdict_of(evaluation: Evaluation) -> Text:
    """Return an evaluation's verdict in green, or in red where it is not good."""
    return Text(
        evaluation.verdict, style="bold green" if evaluation.good else "bold red"
    )
