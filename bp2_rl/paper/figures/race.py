"""Fig. 6 B-D of the paper: speed over distance beside athletes; and the times beside
Table S2."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.plotting import FALL, FRONT, INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.evaluation import races
from bp2_rl.evaluation.benchmarks.outcome import NOT_MEASURED, Table, show
from bp2_rl.evaluation.races import TRACK
from bp2_rl.paper import published_races
from bp2_rl.paper.figures.drawn import Drawn
from bp2_rl.paper.figures.race_numbers import (
    LAUNCH_DISTANCE,
    Profile,
    RaceNumbers,
    Racer,
    Start,
    compare,
    measure,
    paper_profile,
    read,
    read_reports,
)
from bp2_rl.paper.figures.settings import RaceSettings
from bp2_rl.paper.published_races import read_standards

DOTS, DASHES = (0, (1.2, 1.2)), (0, (4, 2))
# of a label on a line
ON_WHITE = {"boxstyle": "square,pad=0.15", "facecolor": "white", "edgecolor": "none"}
PAPER = FALL  # colour of BP2 as the paper has it
RUNS = FRONT, LEG_COLORS["RR"], LEG_COLORS["RL"], LEG_COLORS["FL"]  # of policies
ATHLETES = INK, QUIET, LEG_COLORS["FL"], LEG_COLORS["RL"]
Profiles = dict[str, Profile]


def race(settings: RaceSettings) -> Drawn:
    """The figure, its tables, and what comes of what the paper says of it."""
    athletes, profiles = read(settings)
    runs = read_reports(settings.runs)
    numbers = measure(athletes, profiles, runs)
    figure = race_figure(
        numbers, profiles, {athlete.name: profile for athlete, profile in runs}
    )
    return Drawn(
        numbers,
        (time_table(numbers), start_table(numbers)),
        compare(numbers),
        {"race": figure},
    )


def time_table(numbers: RaceNumbers) -> Table:
    """Times on both clocks, and what they are worth."""
    ranked = sorted(
        (*numbers.racers, *numbers.runs), key=lambda racer: racer.time or np.inf
    )
    head = (
        "100 m",
        "from the gun, s",
        "reaction, s",
        "moving, s",
        "mean, m/s",
        "best 10 m, m/s",
        "60 to 100 m, m/s",
        "men's level",
        "women's level",
    )
    lines = [
        (
            racer.name,
            show(racer.time, ".2f"),
            show(racer.reaction, ".3f"),
            show(racer.moving_time, ".2f"),
            show(TRACK / racer.time if racer.time else None, ".2f"),
            show(max(racer.means, default=None), ".2f"),
            show(racer.fade, "+.2f"),
            show(racer.male_level, "d"),
            show(racer.female_level, "d"),
        )
        for racer in ranked
    ]
    title = f"Times; a robot's clock starts with the command; {NOT_MEASURED}: not published, or no level"
    return Table(title, head, lines)


def start_table(numbers: RaceNumbers) -> Table:
    """The first 5 m by every reading."""
    head = (
        "First 5 m",
        "said, m/s²",
        "time, s",
        "speed, m/s",
        "v/t, m/s²",
        "v²/2d",
        "2d/t²",
        "best 0.5 s",
    )
    lines = []
    for racer in (*numbers.racers, *numbers.runs):
        start = racer.start
        if start is None and racer.said_acceleration is not None:
            constant = numbers.paper.constant_times[racer.name]
            name = f"{racer.name}, were it constant"
            speed = f"{2 * LAUNCH_DISTANCE / constant:.2f}"
            lines.append(
                (
                    name,
                    f"{racer.said_acceleration:g}",
                    f"{constant:.2f}",
                    speed,
                    *("=",) * 4,
                )
            )
        elif start is not None:
            lines.append(
                (racer.name, show(racer.said_acceleration, "g"), *_start_cells(start))
            )
    lines.append(
        (
            "BP2, exponential to 10.74 m/s in 12.2 s",
            NOT_MEASURED,
            *_start_cells(numbers.paper.start),
        )
    )
    return Table(
        "Starts; an athlete's time is without the reaction, from a spline through the splits",
        head,
        lines,
    )


def _start_cells(start: Start) -> tuple[str, ...]:
    measures = (
        start.time,
        start.speed,
        start.over_time,
        start.over_distance,
        start.constant,
        start.best,
    )
    return tuple(f"{measure:.2f}" for measure in measures)


@styled
def race_figure(numbers: RaceNumbers, profiles: Profiles, runs: Profiles) -> Figure:
    """Beside the fastest, the trained and the untrained; the first metres; and the
    times."""
    figure = Figure(figsize=(1.3 * WIDTH, 12.2), layout="constrained")
    panels = figure.subplot_mosaic(
        [["B", "C"], ["D", "E"], ["F", "F"]], height_ratios=(1.0, 1.0, 0.85)
    )
    fastest, trained, untrained, starts = (panels[letter] for letter in "BCDE")
    top = 1.06 * max(
        profile.speed.max()
        for profile in (*profiles.values(), *runs.values(), paper_profile())
    )
    for axes in (fastest, trained, untrained, starts):
        _draw_bp2(axes, runs)
        axes.set(
            xlabel="Distance [m]",
            ylabel="Speed [m/s]",
            xlim=(0.0, TRACK),
            ylim=(0.0, top),
        )
    for axes in (fastest, starts):
        _draw_athletes(axes, numbers, profiles, steps=axes is fastest)
    _draw_mean(trained, numbers, races.TRAINED)
    _draw_mean(untrained, numbers, races.UNTRAINED)
    _draw_said(starts, numbers)
    fastest.set_title("B   Beside the fastest")
    trained.set_title("C   Beside a trained sprinter")
    untrained.set_title("D   Beside untrained adults")
    starts.set(
        title=f"E   The first {LAUNCH_DISTANCE:g} m; solid and dashed as in B",
        xlim=(0.0, LAUNCH_DISTANCE),
        ylim=(0.0, 9.0),
    )
    for axes in (fastest, trained, untrained):
        axes.legend(loc="lower right", fontsize=8)
    starts.legend(
        handles=starts.get_lines()[-len(published_races.PUBLISHED_ACCELERATIONS) :],
        loc="lower right",
        fontsize=8,
    )
    _draw_times(panels["F"], numbers)
    return figure


def _draw_bp2(axes: Axes, runs: Profiles) -> None:
    """BP2 as policies run, and as the paper's numbers have it."""
    for number, (name, profile) in enumerate(runs.items()):
        axes.plot(
            profile.distance,
            profile.speed,
            color=RUNS[number % len(RUNS)],
            linewidth=1.8,
            label=name,
        )
    paper, label = paper_profile(), "BP2: exponential, 10.74 m/s, 12.2 s"
    axes.plot(
        paper.distance,
        paper.speed,
        color=PAPER,
        linewidth=1.6,
        linestyle=DASHES,
        label=label,
    )


def _draw_athletes(
    axes: Axes, numbers: RaceNumbers, profiles: Profiles, *, steps: bool
) -> None:
    """Draw the athletes with splits: the curve through the splits, and the mean speeds
    between splits as steps."""
    for number, (name, profile) in enumerate(profiles.items()):
        color, racer = ATHLETES[number % len(ATHLETES)], numbers.find(name)
        if steps:
            axes.stairs(
                racer.means,
                (0.0, *racer.distances),
                color=color,
                linewidth=0.8,
                alpha=0.5,
                baseline=None,
            )
        axes.plot(
            profile.distance, profile.speed, color=color, linewidth=1.8, label=name
        )


def _draw_mean(axes: Axes, numbers: RaceNumbers, name: str) -> None:
    """The mean speed of one without splits."""
    racer = numbers.find(name)
    assert racer.time is not None  # it is published
    mean = TRACK / racer.time
    axes.axhline(
        mean,
        color=INK,
        linewidth=1.2,
        linestyle=DOTS,
        label=f"{name}: mean of 100 m, {mean:.2f} m/s",
    )


def _draw_said(axes: Axes, numbers: RaceNumbers) -> None:
    """The accelerations that the paper says, as if they were constant."""
    distance = np.linspace(0.0, LAUNCH_DISTANCE, 200)
    for name, color in zip(
        published_races.PUBLISHED_ACCELERATIONS, (INK, QUIET, PAPER), strict=True
    ):
        acceleration = published_races.PUBLISHED_ACCELERATIONS[name]
        label = f"{name}, constant {acceleration:g} m/s²: {numbers.paper.constant_times[name]:.2f} s"
        axes.plot(
            distance,
            np.sqrt(2.0 * acceleration * distance),
            color=color,
            linewidth=1.6,
            linestyle=DOTS,
            label=label,
        )


def _draw_times(axes: Axes, numbers: RaceNumbers) -> None:
    """A row each: from the gun, and without the reaction where that is known; above,
    Table S2, with lines down."""
    arrived = (
        (racer.time, racer)
        for racer in (*numbers.racers, *numbers.runs)
        if racer.time is not None
    )
    ranked = sorted(arrived, key=lambda timed: -timed[0])
    for place, (time, racer) in enumerate(ranked):
        color = _time_color(numbers, racer)
        axes.plot(time, place, "o", ms=6.5, color=color, zorder=3)
        if racer.reaction:
            axes.plot(
                time - racer.reaction,
                place,
                "o",
                ms=6.5,
                markerfacecolor="white",
                color=color,
                zorder=3,
            )
        axes.annotate(
            f"{time:.2f}",
            (time, place),
            (8, 0),
            textcoords="offset points",
            va="center",
            bbox=ON_WHITE,
        )
    names = [racer.name for _, racer in ranked]
    for category, whose, leg in (("female", "women", "RL"), ("male", "men", "FR")):
        row, color = len(names), LEG_COLORS[leg]
        for standard in (
            each for each in read_standards() if each.category == category
        ):
            axes.vlines(
                standard.time, -0.6, row, color=color, linewidth=0.9, linestyle=DASHES
            )
            label = f"{standard.level}"
            axes.annotate(
                label,
                (standard.time, row),
                ha="center",
                va="center",
                color=color,
                bbox=ON_WHITE,
            )
        names.append(f"Table S2, {whose}, level")
    axes.set(yticks=range(len(names)), yticklabels=names, ylim=(-0.6, len(names) - 0.4))
    axes.set(
        title="F   Times over 100 m, and what Table S2 asks of men and women for levels 1 to 3"
    )
    axes.set(
        xlabel="Time from the gun, or since the command [s]; open: without the reaction"
    )
    axes.set(xlim=(np.floor(ranked[-1][0]) - 0.2, np.ceil(ranked[0][0])))
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)


def _time_color(numbers: RaceNumbers, racer: Racer) -> str:
    if racer in numbers.runs:
        return RUNS[numbers.runs.index(racer) % len(RUNS)]
    return PAPER if racer.name == races.PAPER_BP2 else INK
