"""Outcome of an identification: numbers with their intervals, errors on held-out rows, a
robot file and a picture."""

import dataclasses
import math
import os
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import jax
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import metric
from bp2_rl.base.plotting import FALL, FRONT, INK, QUIET, WIDTH, styled
from bp2_rl.robot.conventions import JOINTS, MOTOR_NAMES
from bp2_rl.robot.robot_file import GainNumbers, RobotFile, row
from bp2_rl.tools.identify.fit import (
    Found,
    Rig,
    cut_windows,
    fit_motors,
    predicted_error,
    predictor,
    rig_of,
)
from bp2_rl.tools.identify.log import LogQuality, RobotLog, describe_log
from bp2_rl.tools.identify.swing import Windows

HELD_OUT = 1.0 / 3.0
"""Share of the rows that the fit does not see: the last ones of a robot that runs, every
third `HELD_OUT_BLOCK` of one that hangs."""
HELD_OUT_BLOCK = 1.0  # s
RUNNING = ("torque_scale", "no_load_speed", "friction", "viscosity", "delay")
HANGING = (*RUNNING, "armature", "corner_share", "inertia")
"""Numbers that a log can tell; running alone leaves the inertias open."""
WINDOW = {False: 0.05, True: 0.2}
"""s, length of a window of a running and of a hanging robot."""
STRIDE = {False: 0.01, True: 0.2}
"""s, from a window's start to the next one's."""
Z90 = 1.6449
"""Standard deviations of a normal distribution that hold 90 % between them."""
WIDE = 0.2
"""Half an interval over its value, above which a number is not identified."""
UNITS = {
    "torque_scale": "of what is asked",
    "no_load_speed": "rad/s",
    "friction": "Nm",
    "viscosity": "Nm s/rad",
    "armature": "kg m2",
    "corner_share": "of no-load speed",
    "delay": "s",
    "inertia": "of the file's",
}
NAMES = {1: ("all",), 3: JOINTS, 12: MOTOR_NAMES}
"""Names of the joints, by how many numbers there are."""
Verdict = Literal["identified", "too wide", "none to be seen", "the log is silent"]


@dataclasses.dataclass(frozen=True)
class IdentifiedNumber:
    """An identified motor number, with its 90 % interval."""

    name: str = metric("Number", form="")
    joint: str = metric("Joint", form="")
    unit: str = metric("Unit", form="")
    configured: float = metric("Configured", form=".4g")
    value: float = metric("Found", form=".4g")
    low: float | None = metric("From", form=".4g")
    high: float | None = metric("To", form=".4g")
    verdict: Verdict = metric("Verdict", form="")


@dataclasses.dataclass(frozen=True)
class HeldOutError:
    """Root mean square error of predicted angles at a window's end, on held-out rows."""

    start: str = metric("Start from", form="")
    joint: str = metric("Joint", form="")
    fitted: float = metric("Fitted", "mrad", ".1f")
    configured: float = metric("Configured", "mrad", ".1f")
    constant: float = metric("Constant velocity", "mrad", ".0f")


@dataclasses.dataclass(frozen=True)
class Identification:
    """All that an identification found; errors over time are (rows, joints), rad."""

    log: LogQuality
    hanging: bool
    window: float  # s
    swings: int
    converged: bool
    numbers: tuple[IdentifiedNumber, ...]
    errors: tuple[HeldOutError, ...]
    over_time: dict[str, tuple[tuple[float, ...], ...]]


def identify(log: RobotLog, robot: RobotFile, gains: GainNumbers) -> Identification:
    """Find the numbers of a robot's motors that predict its free legs best.

    Args:
        log: the recording.
        robot: whose numbers are tried first.
        gains: of the position loop during the recording.

    Raises:
        UserError: no leg is free for long enough, or too few are.
    """
    rig = rig_of(robot.hardware, gains)
    # a target's rate acts as a target farther on, by the ratio of the gains
    ratio = np.broadcast_to(np.divide(gains.damping, gains.stiffness), 3)
    aimed = log.q_target + np.tile(ratio, 4) * log.qd_target
    log = dataclasses.replace(log, q_target=aimed)
    length = WINDOW[log.hanging]
    held = np.arange(len(log.time)) >= (1.0 - HELD_OUT) * len(log.time)
    if log.hanging:
        held = np.floor(log.time / HELD_OUT_BLOCK) % 3 == 2
    windows = cut_windows(log, length, STRIDE[log.hanging], chosen=~held)
    found = fit_motors(rig, windows, HANGING if log.hanging else RUNNING)
    run = predictor(rig, log.step)
    by_start = {
        start: _errors(
            run, rig, found, cut_windows(log, length, log.step, chosen=held, past=past)
        )
        for start, past in (("a centred filter", False), ("past rows alone", True))
    }
    errors = [
        HeldOutError(start, joint, *(float(error[-1, i]) for error in ways.values()))
        for start, ways in by_start.items()
        for i, joint in enumerate(JOINTS)
    ]
    return Identification(
        log=describe_log(log),
        hanging=log.hanging,
        window=length,
        swings=len(np.unique(windows.swing)),
        converged=found.converged,
        numbers=tuple(_numbers(rig, found, HANGING if log.hanging else RUNNING)),
        errors=tuple(errors),
        over_time={
            way: tuple(map(tuple, x.tolist()))
            for way, x in by_start["a centred filter"].items()
        },
    )


def _errors(
    run: Callable[..., jax.Array], rig: Rig, found: Found, windows: Windows
) -> dict[str, Float[np.ndarray, "rows 3"]]:
    """Return the errors of three ways to predict held-out windows, rad."""
    time = float(windows.step) * np.arange(1, len(windows.q))[:, None, None, None]
    constant = windows.start[..., :3] + windows.start[..., 3:] * time - windows.q[1:]
    ways = {
        "fitted": predicted_error(run, found.motors, windows),
        "configured": predicted_error(run, rig.configured, windows),
        "constant velocity": constant[:, np.asarray(windows.kept)],
    }
    return {way: np.sqrt(np.mean(error**2, axis=1)) for way, error in ways.items()}


def _numbers(rig: Rig, found: Found, free: tuple[str, ...]) -> list[IdentifiedNumber]:
    numbers: list[IdentifiedNumber] = []
    for name in free:
        configured, values, spreads = (
            np.ravel(getattr(motors, name))
            for motors in (rig.configured, found.motors, found.spread)
        )
        for i, (value, spread) in enumerate(zip(values, spreads, strict=True)):
            wide = math.exp(min(Z90 * float(spread), 50.0))
            verdict: Verdict = "identified"
            if value == 0.0:
                verdict = "none to be seen"
            elif wide > 1e3:
                verdict = "the log is silent"
            elif wide - 1.0 / wide > 2.0 * WIDE:
                verdict = "too wide"
            shown = verdict in ("identified", "too wide")
            numbers.append(
                IdentifiedNumber(
                    name=name,
                    joint=NAMES[len(values)][i],
                    unit=UNITS[name],
                    configured=float(configured[i]),
                    value=float(value),
                    low=float(value / wide) if shown else None,
                    high=float(value * wide) if shown else None,
                    verdict=verdict,
                )
            )
    return numbers


def identified_file(
    found: Identification, robot: RobotFile, source: Path, folder: Path
) -> str:
    """Return the robot file's text with identified numbers in place of its own.

    A comment at its head lists what was not identified and stays as it was.

    Raises:
        UserError: the file is written in a way that this cannot change.
    """
    hardware = robot.hardware
    losses = hardware.losses
    delay = losses.latency + losses.current_lag
    changes = {
        ("motors", "peak_torque"): _known(
            found, "torque_scale", 1.0, hardware.peak_torque
        ),
        ("motors", "no_load_speed"): _known(
            found, "no_load_speed", hardware.no_load_speed
        ),
        ("losses", "joint_friction"): _known(found, "friction", losses.joint_friction),
        ("losses", "joint_viscosity"): _known(
            found, "viscosity", losses.joint_viscosity
        ),
        ("losses", "latency"): _known(found, "delay", delay)[0],
        ("losses", "current_lag"): 0.0,
    }
    share = np.divide(hardware.corner_speed, hardware.no_load_speed)
    no_load = changes["motors", "no_load_speed"]
    changes["motors", "corner_speed"] = _known(found, "corner_share", share, no_load)
    if found.hanging:
        first = np.broadcast_to(hardware.reflected_inertia, 12)[:3]
        changes["motors", "armature"] = _known(found, "armature", first)
    text = source.read_text(encoding="utf-8")
    expected = tomllib.loads(text)
    for (table, key), value in changes.items():
        written = row(value) if isinstance(value, list) else f"{value:.7g}"
        text = _with_value(text, table, key, written)
        expected.setdefault(table, {})[key] = tomllib.loads(f"x = {written}")["x"]
    if "mjcf" in expected:
        moved = os.path.relpath(source.parent / expected["mjcf"], folder)
        expected["mjcf"] = moved
        text = re.sub(
            r"(?m)^mjcf *= *[^\n]*", lambda _: f'mjcf = "{moved}"', text, count=1
        )
    try:
        same = tomllib.loads(text) == expected
    except tomllib.TOMLDecodeError:
        same = False
    if not same:
        raise UserError(
            f"{source}: give each number of [motors] and [losses] a line of its own, as bp2 robot new does"
        )
    head = [
        "# Identified by `bp2 identify`, but for what the log does not tell:",
        *(
            f"#   {number.name} of {number.joint}: {number.verdict}"
            for number in found.numbers
            if number.verdict != "identified"
        ),
    ]
    return "\n".join([*head, text])


def _known(
    found: Identification, name: str, before: object, factor: object = 1.0
) -> list[float]:
    """Return abad's, hip's and knee's number where it was identified, else the number
    before; times a factor."""
    values = np.broadcast_to(np.asarray(before, dtype=float), 3).copy()
    for number in found.numbers:
        if number.name == name and number.verdict == "identified":
            values[:] = np.where(
                [number.joint in (joint, "all") for joint in JOINTS],
                number.value,
                values,
            )
    return (values * np.asarray(factor, dtype=float)).tolist()


def _with_value(text: str, table: str, key: str, value: str) -> str:
    """Return TOML with a key of a table set; the table and the key are added if missing."""
    line = f"{key} = {value}"
    head = re.search(rf"(?m)^\[{table}\][^\n]*\n", text)
    if head is None:
        return f"{text.rstrip()}\n\n[{table}]\n{line}\n"
    rest = text[head.end() :]
    after = re.search(r"(?m)^\[", rest)
    end = after.start() if after else len(rest)
    body, known = re.subn(rf"(?m)^{key} *=.*$", line, rest[:end], count=1)
    if not known:
        body = f"{line}\n{body}"
    return text[: head.end()] + body + rest[end:]


@styled
def identification_figure(found: Identification) -> Figure:
    """Draw the error of predicted angles over the time since a window's start, on rows
    that the fit has not seen."""
    figure = Figure(figsize=(1.2 * WIDTH, 3.4), layout="constrained")
    colors = {"fitted": FRONT, "configured": FALL, "constant velocity": QUIET}
    panels = figure.subplots(1, 3, sharey=True)
    for i, (axes, joint) in enumerate(zip(panels, JOINTS, strict=True)):
        for way, errors in found.over_time.items():
            error = 1e3 * np.array(errors)[:, i]
            time = 1e3 * found.window * np.arange(1, len(error) + 1) / len(error)
            axes.plot(time, error, color=colors[way], label=way)
        axes.set(title=joint, xlabel="Time since the start [ms]", yscale="log")
        axes.grid(color=INK, alpha=0.1)
    panels[0].set_ylabel("RMS error, held-out rows [mrad]")
    panels[0].legend(loc="lower right")
    return figure
