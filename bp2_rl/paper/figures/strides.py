"""Fig. 5 A of the paper: three cycles of the gait as keyframes, from a run of a
policy."""

import dataclasses

import mujoco
import numpy as np
from matplotlib.figure import Figure

from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import metric, table_of
from bp2_rl.base.plotting import LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.paper.benchmarks.speeds import LEG
from bp2_rl.paper.figures.drawn import Drawn
from bp2_rl.paper.figures.robot import draw_outlines, name_parts, outlines
from bp2_rl.paper.figures.runs import CYCLES, cycles, read_runs
from bp2_rl.paper.figures.settings import StridesFigureSettings
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.model import load_model
from bp2_rl.simulation.gait import contacts
from bp2_rl.simulation.trajectory import Trajectory

BENCHMARK = "topspeed"
FRAMES = 8  # a cycle; every second one is faded
SPACE = 1.25  # m, from one frame to the next
FADED = 0.35


@dataclasses.dataclass(frozen=True)
class StridesNumbers:
    """Speed, stride frequency and duty factor over the gait cycles that are drawn."""

    name: str = metric("Three cycles", form="s")  # what ran
    speed: float = metric("Speed", "m/s")
    frequency: float = metric("Strides", "Hz")
    duty: float = metric("Duty factor", form=".3f")  # mean of the legs
    aerial: float = metric("No foot on the ground", form=".1%")  # share of the time


def strides(settings: StridesFigureSettings) -> Drawn:
    """Draw three cycles of a run, and tabulate their gait.

    Raises:
        UserError: no report, several, or a run without three cycles.
    """
    if len(settings.runs) != 1:
        raise UserError(
            f"--runs takes one report that python eval.py --benchmark {BENCHMARK} leaves"
        )
    (run,) = read_runs(settings.runs, BENCHMARK)
    part = cycles(run.trajectory)
    numbers = describe_cycles(run.name, part)
    table = table_of("", (numbers,))
    return Drawn(numbers, (table,), {"strides": strides_figure(part, numbers)})


def describe_cycles(name: str, part: Trajectory) -> StridesNumbers:
    """Return speed, stride frequency and duty factor of the gait cycles in `part`."""
    standing = contacts(part)
    return StridesNumbers(
        name=name,
        speed=part.mean_speed,
        frequency=CYCLES / (len(part) * part.dt),
        duty=float(np.mean(standing)),
        aerial=float(np.mean(~np.any(standing, axis=1))),
    )


@styled
def strides_figure(part: Trajectory, numbers: StridesNumbers) -> Figure:
    """Draw keyframes of the robot, with a row for each gait cycle."""
    model = load_model(part.hardware)
    data = mujoco.MjData(model)
    figure = Figure(figsize=(1.3 * WIDTH, 5.0), layout="constrained")
    samples = (
        np.linspace(0, len(part), CYCLES * FRAMES, endpoint=False)
        .astype(int)
        .reshape(CYCLES, FRAMES)
    )
    for axes, row in zip(figure.subplots(CYCLES, 1), samples, strict=True):
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
        for place, sample in enumerate(row):
            data.qpos[:] = part.qpos[sample]
            data.qpos[:2] = 0.0
            mujoco.mj_kinematics(model, data)
            draw_outlines(
                axes,
                outlines(model, data, (0, 2)),
                right=SPACE * place,
                alpha=FADED if place % 2 else 1.0,
            )
            since = 1e3 * (part.time[sample] - part.time[0])
            axes.annotate(
                f"{since:.0f} ms",
                (SPACE * place, -0.08),
                ha="center",
                va="top",
                fontsize=8,
                color=QUIET,
            )
        axes.set(
            aspect="equal", xlim=(-0.75, SPACE * (FRAMES - 1) + 0.75), ylim=(-0.2, 0.8)
        )
        axes.axis("off")
    name_parts(figure, LEG_COLORS)
    title = f"{numbers.name}: {CYCLES} cycles at {numbers.speed:.2f} m/s from touchdown of {LEGS[LEG]}"
    figure.suptitle(title, x=0.01, ha="left", fontsize=9.5)
    return figure
