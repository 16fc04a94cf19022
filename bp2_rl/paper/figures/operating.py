"""Fig. 5 E of the paper: torque over speed of hips and knees, three cycles, in all four
quadrants."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import metric, table_of
from bp2_rl.base.plotting import FAINT, FALL, INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.paper.benchmarks.efficiency.measured import ENDS, motors_of
from bp2_rl.paper.figures.drawn import DASHES, Drawn, note, swatch
from bp2_rl.paper.figures.runs import CYCLES, cycles, read_runs
from bp2_rl.paper.figures.settings import OperatingFigureSettings
from bp2_rl.paper.motor_heat import Temperatures, heated
from bp2_rl.paper.thermal_specs import AMBIENT, MotorHeat
from bp2_rl.robot import bp2
from bp2_rl.robot.actuator import Actuator, torque_limits
from bp2_rl.robot.conventions import LEGS
from bp2_rl.simulation.measuring import envelope_use
from bp2_rl.simulation.trajectory import Trajectory, steady_window

BENCHMARK = "topspeed"
KINDS = tuple(f"{end} {joint}" for end in ENDS for joint in ("hip", "knee"))


@dataclasses.dataclass(frozen=True)
class KindNumbers:
    """Power, torque and speed of a kind of motor, left and right, in a run's steady
    part."""

    name: str = metric("Motors", form="s")  # "hind hip"
    driving: float = metric("Peak", "W", ".0f")  # of one motor
    braking: float = metric("Braking", "W", ".0f")  # of one motor, positive
    torque: float = metric("RMS torque", "Nm", ".1f")
    speed: float = metric("RMS speed", "rad/s", ".1f")
    # share of time within 1 % of a limit
    on_envelope: float = metric("On the envelope", form=".1%")
    # share of time that it turns faster than it can by itself
    beyond_no_load: float = metric("Beyond no-load", form=".1%")
    # share of time that its torque is against its motion
    brakes: float = metric("Brakes", form=".0%")


@dataclasses.dataclass(frozen=True)
class RunNumbers:
    """Power, torque and speed of hip and knee motors in one run."""

    speed: float  # m/s, mean of the steady part
    commanded: float  # m/s
    kinds: tuple[KindNumbers, ...]


@dataclasses.dataclass(frozen=True)
class OperatingNumbers:
    """Power, torque and speed of hip and knee motors in all runs, and the limits that
    are drawn."""

    runs: tuple[RunNumbers, ...]
    peak: float  # W, that the envelope allows: peak torque at the corner speed
    winding: float  # C, of the hot envelope; magnets as warm as the air


def operating(settings: OperatingFigureSettings) -> Drawn:
    """Draw and tabulate torque over speed of hips and knees.

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
        runs=tuple(measure_points(run) for run in runs),
        peak=hardware.joint_peak_torque * hardware.joint_corner_speed,
        winding=MotorHeat().limit,
    )
    picture = operating_figure([cycles(run) for run in runs], numbers)
    tables = tuple(
        table_of(f"{run.speed:.2f} m/s ({run.commanded:g} commanded)", run.kinds)
        for run in numbers.runs
    )
    return Drawn(numbers, tables, {"operating": picture})


def measure_points(run: Trajectory) -> RunNumbers:
    """Measure power, torque and speed of hip and knee motors in the steady part of a
    run."""
    steady = steady_window(run)
    near = envelope_use(steady).near
    return RunNumbers(
        speed=steady.mean_speed,
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


@styled
def operating_figure(parts: list[Trajectory], numbers: OperatingNumbers) -> Figure:
    """Draw torque over joint speed, with a row for each run and a column for each kind
    of motor."""
    figure = Figure(figsize=(1.3 * WIDTH, 0.9 + 2.9 * len(parts)), layout="constrained")
    panels = figure.subplots(
        len(parts), len(KINDS), sharex=True, sharey=True, squeeze=False
    )
    hardware = parts[0].hardware
    cold = Actuator.from_hardware(hardware)
    warm = Temperatures(np.array([numbers.winding]), np.array([AMBIENT]))
    hot = heated(cold, MotorHeat(), warm)
    fastest = max(float(np.max(np.abs(part.joint_velocity))) for part in parts)
    reach = 1.08 * max(hardware.joint_no_load_speed, fastest)
    highest = 1.2 * hardware.joint_peak_torque
    star = {"marker": "*", "mec": INK, "mew": 0.8, "ms": 12, "linestyle": ""}
    for row, part, run in zip(panels, parts, numbers.runs, strict=True):
        for axes, kind in zip(row, run.kinds, strict=True):
            _draw_limits(axes, np.linspace(-reach, reach, 801), cold, hot)
            for motor in motors_of(kind.name):
                color = LEG_COLORS[LEGS[motor // 3]]
                points = part.joint_velocity[:, motor], part.torque[:, motor]
                axes.plot(*points, color=color, linewidth=0.9)
            axes.plot(kind.speed, kind.torque, color="#F0E442", zorder=5, **star)
            said = f"{kind.on_envelope:.1%} on the envelope; -{kind.braking:.0f} to {kind.driving:.0f} W"
            axes.set_title(f"{kind.name.capitalize()}, {run.speed:.1f} m/s\n")
            note(axes, said, (0.0, 1.0), (0, 5), xycoords="axes fraction", fontsize=8)
            axes.set(xlim=(-reach, reach), ylim=(-highest, highest))
        row[0].set_ylabel("Joint torque [Nm]")
    for axes in panels[-1]:
        axes.set_xlabel("Joint speed [rad/s]")
    paper = " and ".join(f"{power:g}" for power in bp2.HIND_PEAK_POWERS)
    handles = [
        *(swatch(color, leg, linewidth=3) for leg, color in LEG_COLORS.items()),
        swatch(INK, "envelope"),
        swatch(FALL, f"winding at {numbers.winding:g} °C", linestyle=DASHES),
        swatch(QUIET, f"{paper} W (paper)", linestyle=DASHES),
        swatch("#F0E442", "RMS", **star),
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
    """Draw cold and hot torque-speed envelopes, and lines of equal power where a motor
    drives."""
    low, high = torque_limits(cold, speeds)
    axes.fill_between(speeds, low, high, color=FAINT, alpha=0.6, linewidth=0)
    curves = [(speeds, limit, INK, "-") for limit in (low, high)]
    curves += [(speeds, limit, FALL, DASHES) for limit in torque_limits(hot, speeds)]
    for side in (-1.0, 1.0):
        driven = speeds[side * speeds > 0.0]
        curves += [(driven, w / driven, QUIET, DASHES) for w in bp2.HIND_PEAK_POWERS]
    for at, limit, color, dashes in curves:
        axes.plot(at, limit, color=color, linewidth=0.9, linestyle=dashes)
    axes.axhline(0.0, color=QUIET, linewidth=0.7)
    axes.axvline(0.0, color=QUIET, linewidth=0.7)
