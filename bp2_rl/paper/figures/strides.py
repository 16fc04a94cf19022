"""Fig. 5 A of the paper: three cycles of the gait as keyframes, from a run of a
policy."""

import dataclasses

import mujoco
import numpy as np
from matplotlib.figure import Figure

from bp2_rl.base.errors import UserError
from bp2_rl.base.plotting import INK, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.evaluation.benchmarks.outcome import Table
from bp2_rl.paper.figures.drawn import Comparison, Drawn
from bp2_rl.paper.figures.runs import CYCLES, LEG, cycles, read_runs
from bp2_rl.paper.figures.settings import StridesSettings
from bp2_rl.paper.figures.silhouette import draw, outlines
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
    """All that the figure says."""

    name: str  # what ran
    speed: float  # m/s, over the cycles
    frequency: float  # Hz, of the stride
    duty: float  # mean of the legs
    aerial: float  # share of the time with no foot on the ground


def strides(settings: StridesSettings) -> Drawn:
    """The figure and its numbers.

    Raises:
        UserError: no report, several, or a run without three cycles.
    """
    if len(settings.runs) != 1:
        raise UserError(
            f"--runs takes one report that python eval.py --benchmark {BENCHMARK} leaves"
        )
    (run,) = read_runs(settings.runs, BENCHMARK)
    part = cycles(run.trajectory)
    numbers = measure(run.name, part)
    lines = [
        ("speed", f"{numbers.speed:.2f} m/s"),
        ("strides a second", f"{numbers.frequency:.2f}"),
        ("duty factor", f"{numbers.duty:.3f}"),
        ("no foot on the ground", f"{numbers.aerial:.1%}"),
    ]
    said = Comparison(
        "the leg pushes off and an aerial phase follows",
        f"no foot on the ground {numbers.aerial:.0%} of the time",
        "same" if numbers.aerial > 0.0 else "differs",
    )
    table = Table(f"Three cycles, {numbers.name}", ("Gait", "Value"), lines)
    return Drawn(numbers, (table,), (said,), {"strides": strides_figure(part, numbers)})


def measure(name: str, part: Trajectory) -> StridesNumbers:
    """The gait of these cycles."""
    standing = contacts(part)
    return StridesNumbers(
        name=name,
        speed=float(np.mean(part.ground_velocity[:, 0])),
        frequency=CYCLES / (len(part) * part.dt),
        duty=float(np.mean(standing)),
        aerial=float(np.mean(~np.any(standing, axis=1))),
    )


@styled
def strides_figure(part: Trajectory, numbers: StridesNumbers) -> Figure:
    """A row a cycle."""
    model = load_model(part.hardware)
    data = mujoco.MjData(model)
    figure = Figure(figsize=(1.3 * WIDTH, 5.0), layout="constrained")
    colors: dict[str | None, str] = {None: INK, **LEG_COLORS}
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
            draw(
                axes,
                outlines(model, data, (0, 2)),
                colors,
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
    handles = [
        figure.axes[0].fill([], [], color=color, label=leg)[0]
        for leg, color in LEG_COLORS.items()
    ]
    figure.legend(
        handles=handles,
        loc="outside upper right",
        ncols=4,
        handlelength=0.9,
        columnspacing=1.0,
    )
    title = f"{numbers.name}: {CYCLES} cycles at {numbers.speed:.2f} m/s from touchdown of {LEGS[LEG]}"
    figure.suptitle(title, x=0.01, ha="left", fontsize=9.5)
    return figure
