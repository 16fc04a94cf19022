"""Draw a recorded gait of a real robot beside that of a policy in C MuJoCo.

    python docs/real_gait.py LOG.npz POLICY PICTURE.png

LOG.npz is made by docs/real_recording.py, POLICY was trained for the identified robot.
Each line is the mean over the strides of the right legs, each stride from one lift-off
of the right fore leg to the next one; shaded: one standard deviation.
"""

import itertools
import sys
from pathlib import Path

import jax
import numpy as np
from matplotlib.figure import Figure

from bp2_rl.base.plotting import INK, LEG_COLORS, WIDTH, save_figure, styled
from bp2_rl.env.observations import sense
from bp2_rl.learning.policy import load_policy
from bp2_rl.robot.named import find_robot_file
from bp2_rl.simulation.gait import contacts
from bp2_rl.simulation.rollout import rollout
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import steady_window
from bp2_rl.tools.identify.log import read_log

SPEED, HOLD = 5.0, 8.0  # m/s, s
POINTS = 100
PHASE = np.arange(POINTS) / POINTS
SHOWN = {"hip": ((1, 7), "rad"), "knee": ((2, 8), "rad"), "trunk": ((0, 1), "degrees")}
"""Columns of each panel: the right legs' joints; pitch and roll."""


def strides(signal: np.ndarray, free: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return a signal (rows, n) by stride and phase, (strides, POINTS, n)."""
    begins = time[1:][np.diff(free.astype(int)) > 0]
    longest = 1.5 * np.median(np.diff(begins))
    pairs = [pair for pair in itertools.pairwise(begins) if np.ptp(pair) < longest]
    at = np.array([start + PHASE * (end - start) for start, end in pairs])
    return np.stack([np.interp(at, time, column) for column in signal.T], axis=-1)


def attitude(up: np.ndarray) -> np.ndarray:
    """Return pitch and roll, degrees, (rows, 2), from the world's z in the trunk's axes."""
    return np.degrees(
        np.stack([-np.arcsin(up[:, 0]), np.arctan2(up[:, 1], up[:, 2])], axis=-1)
    )


@styled
def gait_figure(gaits: dict[str, dict[str, np.ndarray]]) -> Figure:
    """Draw gaits, each with joint angles, rates and attitude by stride and phase."""
    figure = Figure(figsize=(1.5 * WIDTH, 5.4), layout="constrained")
    panels = figure.subplots(2, 3, sharex=True)
    for column, (title, (chosen, unit)) in enumerate(SHOWN.items()):
        kinds = ("attitude", "turning") if title == "trunk" else ("angle", "rate")
        for axes, kind in zip(panels[:, column], kinds, strict=True):
            names = ("pitch", "roll") if title == "trunk" else ("fore", "hind")
            for (who, gait), line in zip(gaits.items(), ("-", "--"), strict=True):
                for name, i, color in zip(
                    names, chosen, (LEG_COLORS["FR"], LEG_COLORS["RR"]), strict=True
                ):
                    each = gait[kind][..., i]
                    mean, spread = each.mean(axis=0), each.std(axis=0)
                    axes.plot(PHASE, mean, line, color=color, label=f"{name}, {who}")
                    axes.fill_between(
                        PHASE,
                        mean - spread,
                        mean + spread,
                        color=color,
                        alpha=0.1,
                        lw=0,
                    )
            per = "/s" if kind in ("rate", "turning") else ""
            axes.set_ylabel(f"{kind} [{unit}{per}]")
            axes.grid(color=INK, alpha=0.1)
        panels[0, column].set_title(title)
        panels[0, column].legend(
            loc="lower center", bbox_to_anchor=(0.5, 1.1), ncols=2, fontsize="small"
        )
        panels[1, column].set_xlabel("Share of the stride")
    return figure


def main(log_file: str, policy: str, picture: str) -> None:
    """Read a log, run a policy, and draw both."""
    log = read_log(Path(log_file), find_robot_file("black_panther").anatomy)
    run = rollout(load_policy(policy), Ramp(SPEED, hold=HOLD))
    held = steady_window(run)
    measured = jax.vmap(sense)(held.qpos, held.qvel)
    free = ~contacts(held)[:, 0]
    sources = {
        "recorded": (
            log.time,
            log.airborne[:, 0],
            log.q,
            np.gradient(log.q, log.time, axis=0),
            log.up,
            log.omega,
        ),
        "simulated": (
            held.time,
            free,
            held.joint_position,
            held.joint_velocity,
            np.asarray(measured.up),
            np.asarray(measured.angular_velocity),
        ),
    }
    gaits = {}
    for who, (time, lifted, q, qd, upward, omega) in sources.items():
        signals = {
            "angle": q,
            "rate": qd,
            "attitude": attitude(upward),
            "turning": np.degrees(omega[:, [1, 0]]),
        }
        gaits[who] = {
            kind: strides(signal, lifted, time) for kind, signal in signals.items()
        }
        lengths = np.diff(time[1:][np.diff(lifted.astype(int)) > 0])
        spread = gaits[who]["attitude"].std(axis=(0, 1))
        print(
            f"{who}: {1 / np.median(lengths):.2f} strides a second, free {lifted.mean():.2f} of the time,"
        )
        most = np.abs(gaits[who]["rate"].mean(axis=0)).max(axis=0)[[1, 2, 7, 8]]
        print(
            "  most {:.1f}, {:.1f} rad/s of fore hip, knee; {:.1f}, {:.1f} of hind".format(
                *most
            )
        )
        print(
            f"  attitude varies by {spread[0]:.1f} degrees in pitch, {spread[1]:.1f} in roll"
        )
    save_figure(gait_figure(gaits), Path(picture))


if __name__ == "__main__":
    main(*sys.argv[1:])
