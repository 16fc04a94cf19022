"""Runs of a policy at several speeds: their whole strides, tables and panels."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.metric import Row, Table, card_of, rounded, rows_of, show_fall
from bp2_rl.base.plotting import INK
from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    describe_rise,
    describe_subject,
    robot_of,
)
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture
from bp2_rl.evaluation.benchmarks.run import ramp_to_topspeed
from bp2_rl.learning.policy import Policy
from bp2_rl.paper.benchmarks.options import DeepBenchmarkOptions
from bp2_rl.robot.conventions import LEGS
from bp2_rl.simulation.gait import contacts, touchdowns
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import Trajectory

LEG = LEGS.index("RR")  # whose touchdowns begin the strides
EASING = 1.5  # s of the hold that are not looked at


@dataclasses.dataclass(frozen=True)
class AtSpeed:
    """A run under one command: its speed, and whether the robot fell."""

    commanded_speed: float  # m/s
    speed: float  # m/s, over the strides, or the mean of a run that has none
    fell_at: float | None  # s


Found = Sequence[tuple[AtSpeed, object]]
"""Runs that could be measured, each with a dataclass of its metrics."""


class MetricsOverSpeed(Protocol):
    """Metrics of a policy's runs at several speeds."""

    @property
    def found(self) -> Found:
        """Runs that could be measured, each with its metrics."""
        ...


Metrics = TypeVar("Metrics", bound=MetricsOverSpeed)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SpeedBenchmark(Generic[Metrics]):
    """A benchmark that measures a policy's strides at several speeds.

    All functions are module-level ones, as they go to other processes.
    """

    name: str
    speeds: tuple[float, ...]  # m/s, commands; the top one comes on top
    short: tuple[float, ...]  # of them in the quick version
    holds: tuple[float, float]  # s, of the top speed, and in the quick version
    most: int | None = None  # strides that are measured
    part: str  # in words, which strides are measured
    # of the strides, and how many they are
    measure: Callable[[Trajectory, int], object]
    # of commanded speed, speed, time of a fall, and what was measured
    at_speed: Callable[..., AtSpeed]
    gather: Callable[..., Metrics]  # of all speeds
    say: Callable[[Metrics], str]  # in one sentence
    tiles: tuple[str, ...]
    tabulate: Callable[[Metrics], Sequence[Table]]
    picture: tuple[str, str]  # its name and caption
    draw: Callable[[Metrics], Figure]  # where a speed was run through
    # what the policy's card keeps beside the lists over the speeds
    card: Callable[[Metrics], Mapping[str, object]] | None = None

    def ramp(self, policy: Policy, setup: DeepBenchmarkOptions) -> Ramp:
        """Return the command's ramp to the top speed, held as `holds` says by default."""
        return ramp_to_topspeed(policy, setup, hold=self.holds[setup.quick])

    def evaluate(
        self, policy: Policy, ramp: Ramp, setup: DeepBenchmarkOptions
    ) -> Evaluation:
        """Run a policy at each speed, measure the strides, and evaluate the metrics."""
        robot = robot_of(policy, setup)
        top = ramp.target[0]
        below = self.short if setup.quick else self.speeds
        commands = (*(speed for speed in below if speed < top), top)
        ramps = [dataclasses.replace(ramp, to=speed) for speed in commands]
        requests = [RunRequest(each, robot, setup.operator) for each in ramps]
        ran = simulate_all(self.measure_run, policy, requests)
        metrics = self.gather(tuple(ran))
        found = metrics.found
        more = self.card(metrics) if self.card else {}
        return Evaluation(
            benchmark=self.name,
            subject=describe_subject(policy, setup),
            conditions=conditions(
                policy, setup, describe_speeds(ramp, commands, self.part)
            ),
            verdict=self.say(metrics),
            good=len(found) == len(ran),
            rows=rows_over_speed(ran, found),
            tiles=self.tiles,
            pictures=(Picture(*self.picture, self.draw(metrics)),) if found else (),
            metrics=metrics,
            results={**card_over_speed(ran, found), **more},
            tables=tuple(self.tabulate(metrics)),
        )

    def measure_run(self, request: RunRequest, run: Trajectory) -> AtSpeed:
        """Return the speed of a run's whole strides at the held command, and their
        metrics."""
        ramp = request.schedule
        assert isinstance(ramp, Ramp)
        part, strides = steady_strides(run, ramp, self.most) or (run, 0)
        measured = self.measure(part, strides) if strides else None
        return self.at_speed(ramp.target[0], part.mean_speed, run.fell_at, measured)


def steady_strides(
    run: Trajectory, ramp: Ramp, most: int | None = None
) -> tuple[Trajectory, int] | None:
    """Return a run's whole strides at the held command, and their number; None after a
    fall or without a stride."""
    steady = ramp.steady_from + min(EASING, 0.5 * ramp.hold)
    end = len(run) * run.dt
    if run.fell_at is not None or end - steady <= 2 * run.dt:
        return None
    return whole_strides(run.between(steady, end), most)


def whole_strides(
    run: Trajectory, most: int | None = None
) -> tuple[Trajectory, int] | None:
    """Return a run's last whole strides, between touchdowns of `LEG`, and their number.

    None of a run without two touchdowns.
    """
    landed = touchdowns(contacts(run)[:, LEG])
    if most is not None:
        landed = landed[-most - 1 :]
    if len(landed) < 2:
        return None
    first, last = run.time[landed[[0, -1]]].tolist()
    return run.between(first, last), len(landed) - 1


# --- Rows, cards and tables -----------------------------------------------------------


def rows_over_speed(speeds: Sequence[AtSpeed], found: Found) -> tuple[Row, ...]:
    """Return report rows: the number of speeds run through, the first fall, and the
    fastest run's metrics."""
    fell = [at.fell_at for at in speeds if at.fell_at is not None]
    rows = (
        Row("Speeds", f"{len(found)} of {len(speeds)}", "run through"),
        Row("Fall", show_fall(min(fell, default=None)), "at any of the speeds, first"),
    )
    if not found:
        return rows
    at, fastest = found[-1]
    told = Row("Speed", f"{at.speed:.2f} m/s", "the fastest; all below are of it")
    return (*rows, told, *rows_of(fastest))


def card_over_speed(speeds: Sequence[AtSpeed], found: Found) -> dict[str, object]:
    """Return the metrics that a policy's card keeps, as lists over the speeds."""
    cards = [card_of(each) for _, each in found]
    lists = {name: [card[name] for card in cards] for name in (cards or [{}])[0]}
    falls = sum(at.fell_at is not None for at in speeds)
    return {"speeds": rounded([at.speed for at, _ in found]), **lists, "falls": falls}


def table_over_speed(
    title: str, speeds: Sequence[float], columns: Sequence[Mapping[str, str]]
) -> Table:
    """Return a table with a column for each speed, m/s, and a line for each name."""
    head = ("Speed [m/s]", *(f"{speed:.2f}" for speed in speeds))
    names = columns[0] if columns else ()
    lines = [(name, *(column[name] for column in columns)) for name in names]
    return Table(title, head, lines)


def metrics_table(title: str, found: Found) -> Table:
    """Return the table of all metrics, with a column for every measured run's speed."""
    columns = [{row.label: row.value for row in rows_of(each)} for _, each in found]
    return table_over_speed(title, [at.speed for at, _ in found], columns)


def shares_table(
    title: str, found: Found, shares: Sequence[Mapping[str, float]]
) -> Table:
    """Return the table of shares by cause, with a column for every measured run's
    speed."""
    columns = [
        {cause: f"{share:+.3f}" for cause, share in each.items()} for each in shares
    ]
    return table_over_speed(title, [at.speed for at, _ in found], columns)


def describe_speeds(ramp: Ramp, commands: Sequence[float], part: str) -> str:
    """Return a line on the commands' schedule and on the part of a run that is
    measured."""
    told = ", ".join(f"{speed:g}" for speed in commands)
    return f"from a stand to {told} m/s {describe_rise(ramp)}, then hold for {ramp.hold:g} s; {part}"


# --- Panels ---------------------------------------------------------------------------


class Line(NamedTuple):
    """One line of a plot over speed: its label, values and looks."""

    label: str
    values: Sequence[float | None]
    color: str
    style: str = "o-"


def draw_lines(axes: Axes, speeds: Sequence[float], lines: Sequence[Line]) -> None:
    """Draw quantities over speed, with a legend."""
    for line in lines:
        values = np.array(line.values, float)
        axes.plot(speeds, values, line.style, ms=3, color=line.color, label=line.label)
    axes.set_xlabel("Speed [m/s]")
    axes.legend(fontsize=8, ncols=2, handlelength=2.0, columnspacing=0.9)


def draw_stacks(
    axes: Axes,
    speeds: Sequence[float],
    shares: Sequence[Mapping[str, float]],
    colors: Mapping[str, str],
) -> None:
    """Draw a bar for each speed, of shares by cause; negative shares hang below
    zero."""
    places = np.arange(len(speeds))
    tops = np.zeros((2, len(speeds)))
    for cause, color in colors.items():
        values = np.array([each[cause] for each in shares])
        parts = values.clip(min=0.0), values.clip(max=0.0)
        for top, part, label in zip(tops, parts, (cause, None), strict=True):
            axes.bar(places, part, 0.6, bottom=top, color=color, label=label)
            top += part
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set_xticks(places, [f"{speed:.1f}" for speed in speeds])
    axes.set_xlabel("Speed [m/s]")
    axes.grid(axis="x", visible=False)
    room = 0.35 * float(np.max(tops[0]) - np.min(tops[1])) + 1e-6
    axes.set_ylim(float(np.min(tops[1])) - 0.1 * room, float(np.max(tops[0])) + room)
    axes.legend(
        loc="upper left", fontsize=8, ncols=3, handlelength=0.8, columnspacing=0.9
    )
