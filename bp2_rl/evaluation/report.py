"""What an evaluation leaves: a table on the terminal, and a folder that explains itself.

metrics.json     benchmark, conditions and every figure of merit
index.html       the same as one page, pictures inside
*.png            the pictures        run.mp4   the best seconds        trajectory.npz   every millisecond
"""

import base64
import dataclasses
import html
import io
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table

from bp2_rl.config import load_config, save_config, write_text
from bp2_rl.errors import UserError
from bp2_rl.evaluation.benchmarks import Evaluation
from bp2_rl.evaluation.figures import FIGURES
from bp2_rl.evaluation.metrics import RunMetrics
from bp2_rl.evaluation.video import NoVideo, make_video

METRICS, PAGE, TRAJECTORY, VIDEO = "metrics.json", "index.html", "trajectory.npz", "run.mp4"
NOT_MEASURED = "-"


class Row(NamedTuple):
    """One line of the table."""

    label: str
    value: str
    meaning: str


# --- The table -----------------------------------------------------------------------------------------------


def verdict(metrics: RunMetrics) -> str:
    """The run in one sentence."""
    if metrics.fell_at is not None:
        return f"Fell after {metrics.fell_at:.2f} s, {metrics.hold_time:.1f} s into the hold."
    return f"Held {metrics.mean_speed:.2f} m/s for {metrics.hold_time:.1f} s without a fall."


def summary(metrics: RunMetrics) -> tuple[Row, ...]:
    """The figures of merit for a reader, each with what it means."""
    m = metrics
    frequency, duty = _mean_gait(m)
    strongest = max(m.motors, key=lambda motor: motor.peak_torque)
    fastest = max(m.motors, key=lambda motor: motor.peak_speed)
    hardest = max(m.motors, key=lambda motor: motor.peak_power)
    return (
        Row("Top speed", _show(m.best_speed, ".2f", "m/s"), "best 1-s mean of forward speed"),
        Row("Commanded speed", _show(m.commanded_speed, ".2f", "m/s"), "at the end"),
        Row(
            "Mean speed",
            _show(m.mean_speed, ".2f", "m/s"),
            f"steady window, {m.steady_from:.1f} to {m.steady_to:.1f} s",
        ),
        Row("Slowest second", _show(m.slowest_held_speed, ".2f", "m/s"), "lowest 1-s mean while held"),
        Row("Tracking error", _show(m.tracking_error, ".2f", "m/s"), "mean |speed - command| while held"),
        Row("Fall", "none" if m.fell_at is None else f"at {m.fell_at:.2f} s", f"in {m.duration:.1f} s"),
        Row("Time held", f"{m.hold_time:.1f} s", "at the final command"),
        Row("Distance", f"{m.distance:.1f} m", "straight from start to end"),
        Row("Lateral drift", f"{m.lateral_drift:.2f} m", "greatest, from the first heading's line"),
        Row("Heading drift", f"{m.heading_drift:.2f} rad", "greatest, from the first heading"),
        Row("Peak torque", f"{strongest.peak_torque:.0f} Nm", strongest.name),
        Row("Peak joint speed", f"{fastest.peak_speed:.1f} rad/s", fastest.name),
        Row("Peak motor power", f"{hardest.peak_power:.0f} W", f"{hardest.name}, driving"),
        Row("On the envelope", f"{m.on_envelope:.1%}", "motor samples within 1 % of a limit"),
        Row("Outside the envelope", f"{m.outside_envelope}", "motor samples; must be 0"),
        Row("Peak foot force", f"{m.peak_force:.0f} N", "impacts included"),
        Row("Peak spring travel", f"{1e3 * m.peak_compression:.0f} mm", f"on a stop {m.on_stop:.1%} of the time"),
        Row("Stride frequency", _show(frequency, ".2f", "Hz"), "mean of legs, steady window"),
        Row("Duty factor", f"{duty:.2f}", "mean of legs, steady window"),
        Row("Trunk height", f"{m.mean_height:.3f} m", "mean, steady window"),
        Row("Mechanical cost", _show(m.mechanical_cost_of_transport, ".2f"), "positive motor work / (m g distance)"),
        Row("Electrical cost", _show(m.electrical_cost_of_transport, ".2f"), "likewise, with copper losses"),
        Row("Mechanical power", f"{m.mechanical_power:.0f} W", "positive, mean, steady window"),
        Row("Electrical power", f"{m.electrical_power:.0f} W", "likewise, with copper losses"),
        Row("Froude number", _show(m.froude_number, ".1f"), "v\u00b2 / (g h) at top speed, h = 0.55 m"),
        Row("Motor demand", _show(m.motor_demand, ".2f"), "m g v / (peak torque x no-load speed)"),
    )


def _mean_gait(metrics: RunMetrics) -> tuple[float | None, float]:
    """Stride frequency (Hz; None where no leg made a stride) and duty factor, means of the legs."""
    frequencies = [leg.stride_frequency for leg in metrics.legs if leg.stride_frequency is not None]
    frequency = sum(frequencies) / len(frequencies) if frequencies else None
    return frequency, sum(leg.duty_factor for leg in metrics.legs) / len(metrics.legs)


def print_table(evaluation: Evaluation, console: Console) -> None:
    """The summary on the terminal."""
    metrics = evaluation.metrics
    table = Table(
        title=f"{evaluation.benchmark}: {metrics.name} ({metrics.backend})",
        title_justify="left",
        title_style="bold",
        box=None,
        show_header=False,
    )
    table.add_column(no_wrap=True)
    table.add_column(justify="right", style="bold", no_wrap=True)
    table.add_column(style="dim")
    for row in summary(metrics):
        table.add_row(*row)
    console.print(table)
    console.print(verdict(metrics), style="bold green" if metrics.fell_at is None else "bold red")


def _show(value: float | None, form: str, unit: str = "") -> str:
    return NOT_MEASURED if value is None else f"{value:{form}} {unit}".strip()


# --- The folder ----------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Report:
    """What metrics.json holds."""

    benchmark: str
    conditions: dict[str, str]
    metrics: RunMetrics


def open_folder(folder: Path) -> None:
    """Make the report's folder; raises UserError where that cannot be, or where it holds anything but a report."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()) and not (folder / METRICS).is_file():
            raise UserError(f"--out {folder} holds other files: name a new or empty folder, or that of an old report")
        probe = folder / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UserError(f"--out {folder} cannot be written: {error.strerror}") from error


def write_report(
    evaluation: Evaluation, folder: Path, *, video: bool = True, gl_library: str | None = None
) -> str | None:
    """Write the whole report to an open folder.

    Returns the reason, in one line, if a film was asked for and could not be made.
    """
    run = evaluation.trajectory
    for old in (PAGE, VIDEO):
        (folder / old).unlink(missing_ok=True)
    save_config(folder / METRICS, Report(evaluation.benchmark, evaluation.conditions, evaluation.metrics))
    run.save(folder / TRAJECTORY)
    pictures = {name: _png(draw(run)) for name, draw in FIGURES.items()}
    for name, picture in pictures.items():
        (folder / f"{name}.png").write_bytes(picture)
    no_video = None
    if video:
        try:
            make_video(folder / TRAJECTORY, folder / VIDEO, gl_library)
        except NoVideo as reason:
            no_video = str(reason)
    write_text(folder / PAGE, page(evaluation, pictures, has_video=(folder / VIDEO).is_file()))
    return no_video


def read_report(folder: Path) -> Report:
    """What was measured, of a folder that `write_report` wrote; raises UserError for any other."""
    if not (folder / METRICS).is_file():
        raise UserError(f"no report in {folder}: expected {METRICS} there, as python eval.py --out {folder} leaves it")
    return load_config(Report, folder / METRICS)


def results(report: Report) -> dict[str, Any]:
    """What a policy's card says of a report: SI units, four digits, shares of 1; None where it was not measured."""
    m = report.metrics
    frequency, duty = _mean_gait(m)
    measured = {
        "commanded_speed": m.commanded_speed,
        "top_speed": m.best_speed,
        "mean_speed": m.mean_speed,
        "slowest_held_speed": m.slowest_held_speed,
        "hold_time": m.hold_time,
        "fell_at": m.fell_at,
        "tracking_error": m.tracking_error,
        "lateral_drift": m.lateral_drift,
        "heading_drift": m.heading_drift,
        "trunk_height": m.mean_height,
        "stride_frequency": frequency,
        "duty_factor": duty,
        "peak_torque": max(motor.peak_torque for motor in m.motors),
        "peak_joint_speed": max(motor.peak_speed for motor in m.motors),
        "peak_motor_power": max(motor.peak_power for motor in m.motors),
        "on_envelope": m.on_envelope,
        "outside_envelope": m.outside_envelope,
        "peak_foot_force": m.peak_force,
        "peak_spring_travel": m.peak_compression,
        "on_stop": m.on_stop,
        "mechanical_cost_of_transport": m.mechanical_cost_of_transport,
        "electrical_cost_of_transport": m.electrical_cost_of_transport,
        "electrical_power": m.electrical_power,
        "froude_number": m.froude_number,
    }
    conditions = {name: report.conditions[name] for name in _CARD_CONDITIONS if name in report.conditions}
    figures = {name: float(f"{x:.4g}") if isinstance(x, float) else x for name, x in measured.items()}
    return {"benchmark": report.benchmark} | conditions | figures


# The others a card says itself.
_CARD_CONDITIONS = ("schedule", "simulator", "operator")


def _png(figure: Any) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


# --- The page ------------------------------------------------------------------------------------------------


def page(evaluation: Evaluation, pictures: dict[str, bytes], *, has_video: bool) -> str:
    """The report as one HTML page; only the film stays a file beside it."""
    metrics = evaluation.metrics
    rows = summary(metrics)
    tiles = "".join(
        f"<div><b>{_escape(r.value)}</b><span>{_escape(r.label)}</span></div>" for r in rows if r.label in _TILES
    )
    film = f'<video src="{VIDEO}" controls loop muted playsinline></video>' if has_video else ""
    figures = "".join(
        f'<figure><img alt="{_escape(_CAPTIONS[name])}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'
        f"<figcaption>{_escape(_CAPTIONS[name])}</figcaption></figure>"
        for name, png in pictures.items()
    )
    conditions = "".join(
        f"<tr><th>{_escape(k)}</th><td>{_escape(v)}</td></tr>" for k, v in evaluation.conditions.items()
    )
    return _PAGE.format(
        title=_escape(f"{evaluation.benchmark}: {metrics.name}"),
        verdict=_escape(verdict(metrics)),
        mood="good" if metrics.fell_at is None else "bad",
        backend=_escape(metrics.backend),
        tiles=tiles,
        film=film,
        figures=figures,
        summary=_table(("Measure", "Value", "Definition"), rows, numbers=(1,)),
        motors=_table(*_motor_table(metrics), numbers=range(1, 5)),
        legs=_table(*_leg_table(metrics), numbers=range(1, 6)),
        conditions=conditions,
    )


_TILES = ("Top speed", "Time held", "Tracking error", "Fall", "Electrical cost", "On the envelope")

_CAPTIONS = {
    "speed": "Forward speed with its command, and the drift from the line and heading at the start.",
    "torque_speed": "Torque over speed of the twelve motors, by the millisecond; shaded: what a motor can give.",
    "gait": "The last strides: vertical foot forces, and the stance of each foot with its share of the stride.",
    "joints": "The last strides: joint angles with the policy's targets, and the travel of the springs.",
}


def _motor_table(metrics: RunMetrics) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    head = "Motor", "Peak torque [Nm]", "Peak speed [rad/s]", "Peak power [W]", "On the envelope"
    return head, [
        (m.name, f"{m.peak_torque:.1f}", f"{m.peak_speed:.1f}", f"{m.peak_power:.0f}", f"{m.on_envelope:.1%}")
        for m in metrics.motors
    ]


def _leg_table(metrics: RunMetrics) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    head = "Leg", "Duty factor", "Stride frequency [Hz]", "Peak force [N]", "Peak spring travel [mm]", "On the stop"
    return head, [
        (
            leg.name,
            f"{leg.duty_factor:.2f}",
            _show(leg.stride_frequency, ".2f"),
            f"{leg.peak_force:.0f}",
            f"{1e3 * leg.peak_compression:.0f}",
            f"{leg.on_stop:.1%}",
        )
        for leg in metrics.legs
    ]


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
.good {{ color: var(--good); }} .bad {{ color: var(--bad); }}
.quiet {{ margin: 0; color: var(--quiet); }}
.tiles {{ display: grid; grid-template-columns: repeat(auto-fit, minmax(9rem, 1fr)); gap: 1px; margin: 2rem 0;
  background: var(--line); border: 1px solid var(--line); border-radius: 8px; overflow: hidden; }}
.tiles div {{ padding: .9rem 1rem; background: #fff; }}
.tiles b {{ display: block; font-size: 1.35rem; font-variant-numeric: tabular-nums; }}
.tiles span {{ color: var(--quiet); font-size: .85rem; }}
video, img {{ display: block; width: 100%; height: auto; border-radius: 8px; }}
figure {{ margin: 2.25rem 0 0; }}
figcaption {{ margin-top: .4rem; color: var(--quiet); font-size: .9rem; }}
.wide {{ overflow-x: auto; }}
table {{ width: 100%; border-collapse: collapse; font-size: .92rem; font-variant-numeric: tabular-nums; }}
th, td {{ padding: .38rem .75rem .38rem 0; border-bottom: 1px solid var(--line);
  text-align: left; vertical-align: top; }}
th {{ font-weight: 600; }} thead th {{ color: var(--quiet); }}
.n {{ text-align: right; white-space: nowrap; padding-right: 1.5rem; }}
th:last-child, td:last-child {{ padding-right: 0; }}
.conditions th {{ width: 8rem; font-weight: 600; }}
.conditions td {{ overflow-wrap: anywhere; }}
</style>
</head>
<body>
<header>
<h1>{title}</h1>
<p class="verdict {mood}">{verdict}</p>
<p class="quiet">BP2 in {backend}</p>
</header>
<section class="tiles">{tiles}</section>
{film}
{figures}
<h2>Measures</h2>
<div class="wide">{summary}</div>
<h2>Motors</h2>
<div class="wide">{motors}</div>
<h2>Legs</h2>
<div class="wide">{legs}</div>
<h2>Conditions</h2>
<table class="conditions"><tbody>{conditions}</tbody></table>
</body>
</html>
"""
