"""The report as a page of HTML that explains itself, pictures inside."""

import html
from collections.abc import Collection, Iterable, Sequence

from bp2_rl.evaluation.benchmarks.outcome import MEASURES, Evaluation, Table
from bp2_rl.evaluation.report.pictures import figure
from bp2_rl.evaluation.report.player import element

PAGE, VIDEO, STILL, TRAJECTORY = "index.html", "run.mp4", "run.jpg", "trajectory.npz"


def page(evaluation: Evaluation, *, has_video: bool, command: str | None = None) -> str:
    """The report as one HTML page; only the film and the trajectory stay files beside it.

    Args:
        evaluation: what to show.
        has_video: whether the film is there, with its still.
        command: what makes the report again.
    """
    run = evaluation.trajectory
    moving = element.player(run) if run is not None else ""
    film = f'<video src="{VIDEO}" poster="{STILL}" preload="none" controls loop muted playsinline></video>'
    figures = "".join(map(figure, evaluation.pictures))
    measures = Table("Measures", MEASURES, evaluation.rows, words=True)
    conditions = "".join(
        f"<tr><th>{_escape(k)}</th><td>{_escape(v)}</td></tr>" for k, v in evaluation.conditions.items()
    )
    return document(
        title=f"{evaluation.benchmark}: {evaluation.subject}",
        header=f"{_verdict(evaluation)}<p class=quiet>{_escape(evaluation.backend)}</p>",
        body=f"{_tiles(evaluation)}{moving}{film if has_video else ''}{figures}"
        f"{''.join(map(_section, (measures, *evaluation.tables)))}"
        f"<h2>Conditions</h2><table class=conditions><tbody>{conditions}</tbody></table>"
        f"{_again(command, run is not None)}",
        style=element.style() if run is not None else "",
    )


def _again(command: str | None, has_trajectory: bool) -> str:
    """How the report is made again, and what it is made from."""
    made = f"<pre class=wide><code>{_escape(command)}</code></pre>" if command else ""
    data = (
        f'<p><a href="{TRAJECTORY}">{TRAJECTORY}</a> holds the run millisecond by millisecond; in Python: '
        "<code>bp2_rl.simulation.trajectory.Trajectory.load</code>.</p>"
    )
    return (f"<h2>Make it again</h2>{made}{data if has_trajectory else ''}") if command or has_trajectory else ""


def overview(evaluations: Sequence[Evaluation]) -> str:
    """One page that leads to the page of every benchmark."""
    sections = "".join(
        f'<h2><a href="{_escape(each.benchmark)}/{PAGE}">{_escape(each.benchmark)}</a></h2>'
        f"<p class=quiet>{_escape(each.subject)}, {_escape(each.backend)}</p>{_verdict(each)}{_tiles(each)}"
        for each in evaluations
    )
    policy = f"<p class=quiet>{_escape(evaluations[0].conditions['policy'])}</p>"
    return document("All benchmarks", policy, sections)


def document(title: str, header: str, body: str, style: str = "") -> str:
    """A whole page in the house's look; header, body and further style sheet are HTML and CSS already."""
    return _PAGE.format(title=_escape(title), header=header, body=body, style=style)


def _verdict(evaluation: Evaluation) -> str:
    return f'<p class="verdict {"good" if evaluation.good else "bad"}">{_escape(evaluation.verdict)}</p>'


def _tiles(evaluation: Evaluation) -> str:
    shown = {row.label: row.value for row in evaluation.rows}
    tiles = "".join(
        f"<div><b>{_escape(shown[label])}</b><span>{_escape(label)}</span></div>" for label in evaluation.tiles
    )
    return f"<section class=tiles>{tiles}</section>"


def _section(table: Table) -> str:
    numbers = range(1, len(table.head) - table.words)
    content = _table(table.head, table.lines, numbers=numbers)
    return f"<h2>{_escape(table.title)}</h2><div class=wide>{content}</div>"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: Collection[int]) -> str:
    def line(tag: str, cells: Sequence[str]) -> str:
        cells = [f"<{tag}{' class=n' if i in numbers else ''}>{_escape(cell)}</{tag}>" for i, cell in enumerate(cells)]
        return f"<tr>{''.join(cells)}</tr>"

    return f"<table><thead>{line('th', head)}</thead><tbody>{''.join(line('td', row) for row in rows)}</tbody></table>"


def _escape(text: str) -> str:
    return html.escape(text)


_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
:root {{ --ink: #1f2328; --quiet: #656d76; --line: #e4e7eb; --good: #00704f; --bad: #b33c00; }}
* {{ box-sizing: border-box; }}
body {{ margin: 0 auto; max-width: 60rem; padding: 3rem 1.5rem 5rem; color: var(--ink); background: #fff;
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", sans-serif; }}
h1 {{ margin: 0; font-size: 1.7rem; line-height: 1.25; letter-spacing: -.01em; }}
h2 {{ margin: 3rem 0 .75rem; font-size: 1.15rem; }}
.verdict {{ margin: .4rem 0 0; font-size: 1.1rem; font-weight: 600; }}
a {{ color: inherit; text-decoration-color: var(--quiet); text-underline-offset: .2em; }}
.good {{ color: var(--good); }} .bad {{ color: var(--bad); }}
.quiet {{ margin: 0; color: var(--quiet); }}
.tiles {{ display: flex; flex-wrap: wrap; gap: 1px; margin: 2rem 0;
  background: var(--line); border: 1px solid var(--line); border-radius: 8px; overflow: hidden; }}
.tiles div {{ flex: 1 1 9rem; padding: .9rem .8rem; background: #fff; }}
.tiles b {{ display: block; font-size: 1.2rem; font-variant-numeric: tabular-nums; }}
.tiles span {{ color: var(--quiet); font-size: .85rem; }}
video, img {{ display: block; width: 100%; height: auto; border-radius: 8px; }}
figure {{ margin: 2.25rem 0 0; }}
figcaption {{ margin-top: .4rem; color: var(--quiet); font-size: .9rem; }}
.wide {{ overflow-x: auto; }}
.pan img {{ min-width: 40rem; }}
pre {{ margin: 0 0 1rem; padding: .7rem .9rem; background: #f6f8fa; border-radius: 8px; font-size: .85rem; }}
p code {{ font-size: .85em; overflow-wrap: anywhere; }}
table {{ width: 100%; border-collapse: collapse; font-size: .92rem; font-variant-numeric: tabular-nums; }}
th, td {{ padding: .38rem .75rem .38rem 0; border-bottom: 1px solid var(--line);
  text-align: left; vertical-align: top; }}
th {{ font-weight: 600; }} thead th {{ color: var(--quiet); }}
.n {{ text-align: right; white-space: nowrap; padding-right: 1.5rem; }} thead .n {{ white-space: normal; }}
thead th {{ vertical-align: bottom; }}
.wide th:first-child, .wide td:first-child {{ position: sticky; left: 0; background: #fff; }}
th:last-child, td:last-child {{ padding-right: 0; }}
.conditions th {{ width: 8rem; font-weight: 600; }}
.conditions td {{ overflow-wrap: anywhere; }}
@media (max-width: 36rem) {{
  body {{ padding: 1.5rem 1rem 3rem; }}
  .wide table {{ font-size: .8rem; }} .wide th, .wide td {{ padding-right: .5rem; }}
}}
{style}
</style>
</head>
<body>
<header>
<h1>{title}</h1>
{header}
</header>
{body}
</body>
</html>
"""
