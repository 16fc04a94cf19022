"""Fig. 5 E of the paper: torque over speed of hips and knees, three cycles, in all four
quadrants."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bp2_rl.base.errors import UserError
from bp2_rl.base.plotting import FAINT, FALL, INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.evaluation.benchmarks.outcome import Table
from bp2_rl.paper.benchmarks.efficiency.measured import ENDS, motors_of
from bp2_rl.paper.figures.drawn import Comparison, Drawn
from bp2_rl.paper.figures.runs import CYCLES, cycles, read_runs
from bp2_rl.paper.figures.settings import OperatingSettings
from bp2_rl.paper.motor_heat import Network, Temperatures, heated
from bp2_rl.paper.thermal_specs import AMBIENT, MotorHeat
from bp2_rl.robot import bp2
from bp2_rl.robot.actuator import Actuator, torque_limits
from bp2_rl.robot.conventions import LEGS
from bp2_rl.simulation.measuring import envelope_use
from bp2_rl.simulation.samples import steady_window
from bp2_rl.simulation.trajectory import Trajectory

BENCHMARK = "topspeed"
KINDS = tuple(f"{end} {joint}" for end in ENDS for joint in ("hip", "knee"))
FULL = "hind hip", "fore knee"  # which the paper says use their envelopes fully
USED = 0.01  # share of time on the envelope from which it is used
DASHED = (0, (4, 2))


@dataclasses.dataclass(frozen=True)
class KindNumbers:
    """Both motors of a kind in the steady part of a run."""

    name: str  # "hind hip"
    driving: float  # W, greatest power of one ...
    braking: float  # W, ... and greatest that it takes back, as a positive number
    torque: float  # Nm, root mean square
    speed: float  # rad/s, of the joint
    on_envelope: float  # share of time within 1 % of a limit
    beyond_no_load: float  # share of time that it turns faster than it can by itself
    brakes: float  # share of time that its torque is against its motion


@dataclasses.dataclass(frozen=True)
class RunNumbers:
    """One run."""

    speed: float  # m/s, mean of the steady part
    commanded: float  # m/s
    kinds: tuple[KindNumbers, ...]

    @property
    def fullest(self) -> tuple[str, ...]:
        """The two kinds that are most of the time on their envelopes."""
        return tuple(
            kind.name
            for kind in sorted(self.kinds, key=lambda kind: -kind.on_envelope)[:2]
        )


@dataclasses.dataclass(frozen=True)
class OperatingNumbers:
    """All that the figure says."""

    runs: tuple[RunNumbers, ...]
    peak: float  # W, that the envelope allows: peak torque at the corner speed
    winding: float  # C, of the hot envelope; magnets as warm as the air


def operating(settings: OperatingSettings) -> Drawn:
    """The figure and its numbers.

    Raises:
        UserError: no report, or a run without three cycles.
    """
    if not settings.runs:
        raise UserError(
            f"--runs takes reports that python eval.py --benchmark {BENCHMARK} leaves, one a speed"
        )
    runs = [run.trajectory for run in read_runs(settings.runs, BENCHMARK)]
    hardware = runs[0].hardware
    if any(run.hardware != hardware for run in runs):
        raise UserError(
            "--runs: these are of different robots, and one envelope is drawn: name runs of one robot"
        )
    numbers = OperatingNumbers(
        runs=tuple(measure(run) for run in runs),
        peak=hardware.joint_peak_torque * hardware.joint_corner_speed,
        winding=MotorHeat().limit,
    )
    picture = operating_figure([cycles(run) for run in runs], numbers)
    tables = tuple(_table(run) for run in numbers.runs)
    return Drawn(numbers, tables, compare(numbers), {"operating": picture})


def measure(run: Trajectory) -> RunNumbers:
    """The motors' work in the steady part of a run."""
    steady = steady_window(run)
    near = envelope_use(steady).near
    return RunNumbers(
        speed=float(np.mean(steady.ground_velocity[:, 0])),
        commanded=float(steady.command[-1, 0]),
        kinds=tuple(_kind(steady, near, name) for name in KINDS),
    )


def _kind(run: Trajectory, near: Bool[np.ndarray, "N 12"], name: str) -> KindNumbers:
    chosen = motors_of(name)
    torque, qd = run.torque[:, chosen], run.joint_velocity[:, chosen]
    power = torque * qd
    return KindNumbers(
        name=name,
        driving=max(float(np.max(power)), 0.0),
        braking=max(-float(np.min(power)), 0.0),
        torque=float(np.sqrt(np.mean(torque**2))),
        speed=float(np.sqrt(np.mean(qd**2))),
        on_envelope=float(np.mean(near[:, chosen])),
        beyond_no_load=float(np.mean(np.abs(qd) > run.hardware.joint_no_load_speed)),
        brakes=float(np.mean(power < 0.0)),
    )


def compare(numbers: OperatingNumbers) -> tuple[Comparison, ...]:
    """What the paper says of its motors, and ours at the first speed."""
    first = numbers.runs[0]
    on = ", ".join(f"{kind.name} {kind.on_envelope:.1%}" for kind in first.kinds)
    used = {kind.name: kind.on_envelope for kind in first.kinds}
    same = set(first.fullest) == set(FULL) and min(used[name] for name in FULL) >= USED
    hind = ", ".join(
        f"{kind.name} {kind.driving:.0f} W"
        for kind in first.kinds
        if kind.name.startswith("hind")
    )
    paper = " and ".join(f"{power:g}" for power in bp2.HIND_PEAK_POWERS)
    beyond = ", ".join(f"{kind.name} {kind.brakes:.0%}" for kind in first.kinds)
    at = f"at {first.speed:.2f} m/s"
    return (
        Comparison(
            "hind hips and front knees use their torque-speed envelopes fully",
            f"{at}, share of time on it: {on}",
            "same" if same else "differs",
            "" if same else f"most of the time on it are {' and '.join(first.fullest)}",
        ),
        Comparison(
            f"peaks of {paper} W in the hind legs' motors",
            f"{at}: {hind}",
            "not comparable",
            f"our envelope's corner was derived from 1765 W: it allows {numbers.peak:.0f} W",
        ),
        Comparison(
            "all motors work within their rated high-efficiency regions",
            f"{at} they brake {beyond} of the time",
            "not comparable",
            "no region and no efficiency is published; for ours see bp2 paper eval --benchmark efficiency",
        ),
    )


def _table(run: RunNumbers) -> Table:
    head = (
        "Motors",
        "Peak [W]",
        "Braking [W]",
        "RMS [Nm]",
        "RMS [rad/s]",
        "On the envelope",
        "Beyond no-load",
        "Brake",
    )
    lines = [
        (
            kind.name,
            f"{kind.driving:.0f}",
            f"{kind.braking:.0f}",
            f"{kind.torque:.1f}",
            f"{kind.speed:.1f}",
            f"{kind.on_envelope:.1%}",
            f"{kind.beyond_no_load:.1%}",
            f"{kind.brakes:.0%}",
        )
        for kind in run.kinds
    ]
    return Table(
        f"{run.speed:.2f} m/s ({run.commanded:g} commanded), steady part", head, lines
    )


@styled
def operating_figure(parts: list[Trajectory], numbers: OperatingNumbers) -> Figure:
    """A row a speed, a column a kind of motor."""
    figure = Figure(figsize=(1.3 * WIDTH, 0.9 + 2.9 * len(parts)), layout="constrained")
    panels = np.reshape(
        figure.subplots(len(parts), len(KINDS), sharex=True, sharey=True),
        (len(parts), len(KINDS)),
    )
    hardware = parts[0].hardware
    cold = Actuator.from_hardware(hardware)
    warm = Temperatures(np.array(numbers.winding), np.array(AMBIENT))
    # the way from winding to case does not count here
    hot = heated(cold, Network.from_spec(MotorHeat(), 1.0), warm)
    reach = 1.08 * max(
        hardware.joint_no_load_speed,
        *(float(np.max(np.abs(part.joint_velocity))) for part in parts),
    )
    speeds = np.linspace(-reach, reach, 801)
    for row, part, run in zip(panels, parts, numbers.runs, strict=True):
        for axes, kind in zip(row, run.kinds, strict=True):
            _draw_limits(axes, speeds, cold, hot)
            for motor in motors_of(kind.name):
                color = LEG_COLORS[LEGS[motor // 3]]
                axes.plot(
                    part.joint_velocity[:, motor],
                    part.torque[:, motor],
                    color=color,
                    linewidth=0.9,
                )
            axes.plot(
                kind.speed,
                kind.torque,
                "*",
                ms=12,
                color="#F0E442",
                mec=INK,
                mew=0.8,
                zorder=5,
            )
            axes.set_title(
                f"{kind.name.capitalize()}, {run.speed:.1f} m/s\n", fontsize=9.5
            )
            said = f"{kind.on_envelope:.1%} on the envelope; -{kind.braking:.0f} to {kind.driving:.0f} W"
            axes.annotate(
                said, (0.0, 1.0), (0, 5), "axes fraction", "offset points", fontsize=8
            )
            axes.set(
                xlim=(-reach, reach),
                ylim=(
                    -1.2 * hardware.joint_peak_torque,
                    1.2 * hardware.joint_peak_torque,
                ),
            )
        row[0].set_ylabel("Joint torque [Nm]")
    for axes in panels[-1]:
        axes.set_xlabel("Joint speed [rad/s]")
    handles = [
        Line2D([], [], color=color, linewidth=3, label=leg)
        for leg, color in LEG_COLORS.items()
    ]
    paper = " and ".join(f"{power:g}" for power in bp2.HIND_PEAK_POWERS)
    handles += [
        Line2D([], [], color=INK, label="envelope"),
        Line2D(
            [],
            [],
            color=FALL,
            linestyle=DASHED,
            label=f"winding at {numbers.winding:g} °C",
        ),
        Line2D([], [], color=QUIET, linestyle=DASHED, label=f"{paper} W (paper)"),
        Line2D(
            [],
            [],
            color="#F0E442",
            marker="*",
            ms=10,
            mec=INK,
            mew=0.8,
            linestyle="",
            label="RMS",
        ),
    ]
    figure.legend(
        handles=handles,
        loc="outside upper right",
        ncols=8,
        handlelength=1.5,
        columnspacing=1.1,
    )
    figure.suptitle(f"{CYCLES} cycles; range of power", x=0.01, ha="left", fontsize=9.5)
    return figure


def _draw_limits(
    axes: Axes, speeds: Float[np.ndarray, " N"], cold: Actuator, hot: Actuator
) -> None:
    """Envelopes cold and hot, and lines of one power where a motor drives."""
    low, high = torque_limits(cold, speeds)
    axes.fill_between(speeds, low, high, color=FAINT, alpha=0.6, linewidth=0)
    for limit in (low, high):
        axes.plot(speeds, limit, color=INK, linewidth=1.0)
    for limit in torque_limits(hot, speeds):
        axes.plot(speeds, limit, color=FALL, linewidth=0.9, linestyle=DASHED)
    for power in bp2.HIND_PEAK_POWERS:
        for side in (-1.0, 1.0):
            same = speeds[side * speeds > 0.0]
            axes.plot(same, power / same, color=QUIET, linewidth=0.9, linestyle=DASHED)
    axes.axhline(0.0, color=QUIET, linewidth=0.7)
    axes.axvline(0.0, color=QUIET, linewidth=0.7)
