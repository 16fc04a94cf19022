"""The tables of an evaluation on the terminal."""

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table as TerminalTable
from rich.text import Text

from bp2_rl.evaluation.benchmarks.outcome import Evaluation


def print_table(evaluation: Evaluation, console: Console) -> None:
    """Print the figures of merit of an evaluation."""
    table = _terminal_table(
        f"{evaluation.benchmark}: {evaluation.subject} ({evaluation.backend})"
    )
    table.add_column(no_wrap=True)
    table.add_column(justify="right", style="bold", no_wrap=True)
    table.add_column(style="dim")
    for row in evaluation.rows:
        table.add_row(*map(Text, row))
    console.print(table)
    console.print(Text(evaluation.verdict, style=_mood_color(evaluation)))


def print_overview(evaluations: Sequence[Evaluation], console: Console) -> None:
    """Print the verdicts of several benchmarks."""
    table = _terminal_table("all benchmarks")
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for evaluation in evaluations:
        table.add_row(
            evaluation.benchmark,
            Text(evaluation.verdict, style=_mood_color(evaluation)),
        )
    console.print(table)


def _terminal_table(title: str) -> TerminalTable:
    return TerminalTable(
        title=Text(title),
        title_justify="left",
        title_style="bold",
        box=None,
        show_header=False,
    )


def _mood_color(evaluation: Evaluation) -> str:
    return "bold green" if evaluation.good else "bold red"
