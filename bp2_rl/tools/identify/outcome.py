"""Outcome of an identification: numbers with their intervals, errors on held-out rows, a
robot file and a picture."""

import dataclasses
import math
import os
import re
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import metric
from bp2_rl.base.plotting import FALL, FRONT, INK, QUIET, WIDTH, legend_above, styled
from bp2_rl.robot.conventions import JOINTS
from bp2_rl.robot.robot_file import RobotFile, row
from bp2_rl.tools.identify.fit import (
    Found,
    Rig,
    cut_windows,
    fit_motors,
    predicted_error,
    rig_of,
)
from bp2_rl.tools.identify.log import Log, LogQuality, describe_log
from bp2_rl.tools.identify.swing import Motors, Windows

TRAINED = 2.0 / 3.0
"""Share of the rows that the fit sees; the rest is held out."""
RUNNING = ("torque_scale", "no_load_speed", "friction", "viscosity", "delay")
HANGING = (*RUNNING, "armature", "corner_speed")
"""Numbers that a log can tell; running alone leaves the rotors' inertia open."""
WINDOW = {False: 0.05, True: 0.2}
"""s, length of a window of a running and of a hanging robot."""
Z90 = 1.6449
"""Standard deviations of a normal distribution that hold 90 % between them."""
WIDE = 0.2
"""Half an interval over its value, above which a number is not identified."""
UNITS = Motors("", "rad/s", "Nm", "Nm s/rad", "kg m2", "rad/s", "s")
Verdict = Literal["identified", "not identified: wide", "not identified: at its bound"]


@dataclasses.dataclass(frozen=True)
class IdentifiedNumber:
    """A number of one kind of joint, with its 90 % interval."""

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
    windows: int
    numbers: tuple[IdentifiedNumber, ...]
    errors: tuple[HeldOutError, ...]
    over_time: dict[str, tuple[tuple[float, ...], ...]]


def identify(log: Log, robot: RobotFile) -> Identification:
    """Find the numbers of a robot's motors that predict its free legs best.

    Raises:
        UserError: no leg is free for long enough.
    """
    gains = robot.gains
    assert gains is not None  # as the command has seen
    stiffness, damping = (
        np.broadcast_to(x, 3).tolist() for x in (gains.stiffness, gains.damping)
    )
    rig = rig_of(robot.hardware, stiffness, damping)
    rows = round(WINDOW[log.hanging] / log.step)
    last = int(TRAINED * len(log.time))
    fitted, held = log.between(0, last), log.between(last, len(log.time))
    windows = cut_windows(
        fitted, rows, stride=rows if log.hanging else max(rows // 5, 1)
    )
    if windows.weight.sum() < 12.0 or not cut_windows(held, rows).weight.any():
        raise UserError(
            f"too few windows in which a leg is free for {WINDOW[log.hanging]:g} s: record longer"
        )
    found = fit_motors(rig, windows, HANGING if log.hanging else RUNNING)
    tests = {
        "a centred filter": cut_windows(held, rows, stride=1),
        "past rows alone": cut_windows(held, rows, stride=1, past=True),
    }
    errors: list[HeldOutError] = []
    over_time: dict[str, tuple[tuple[float, ...], ...]] = {}
    for start, test in tests.items():
        by_way = {
            "fitted": predicted_error(rig, found.motors, test),
            "configured": predicted_error(rig, rig.configured, test),
            "constant velocity": _constant_velocity(test),
        }
        over_time = over_time or {
            way: tuple(map(tuple, _rms(error).tolist()))
            for way, error in by_way.items()
        }
        ends = [_rms(error)[-1] for error in by_way.values()]
        errors += [
            HeldOutError(start, joint, *map(float, each))
            for joint, *each in zip(JOINTS, *ends, strict=True)
        ]
    return Identification(
        log=describe_log(log),
        hanging=log.hanging,
        window=rows * log.step,
        windows=int(windows.weight.sum()),
        numbers=tuple(_numbers(rig, found)),
        errors=tuple(errors),
        over_time=over_time,
    )


def _numbers(rig: Rig, found: Found) -> list[IdentifiedNumber]:
    numbers: list[IdentifiedNumber] = []
    for name, unit in UNITS._asdict().items():
        configured, values, spreads = (
            getattr(motors, name)
            for motors in (rig.configured, found.motors, found.spread)
        )
        for i, (before, value, spread) in enumerate(
            zip(configured, values, spreads, strict=True)
        ):
            if math.isnan(spread):
                continue
            wide = math.exp(min(Z90 * spread, 50.0))
            verdict: Verdict = "identified"
            if value == 0.0 or wide > 1e3:
                verdict = "not identified: at its bound"
            elif wide - 1.0 / wide > 2.0 * WIDE:
                verdict = "not identified: wide"
            at_bound = verdict == "not identified: at its bound"
            joint = JOINTS[i] if len(values) > 1 else "all"
            low, high = (
                (None, None) if at_bound else (float(value / wide), float(value * wide))
            )
            numbers.append(
                IdentifiedNumber(
                    name, joint, unit, float(before), float(value), low, high, verdict
                )
            )
    return numbers


def _constant_velocity(windows: Windows) -> Float[np.ndarray, "rows n 3"]:
    time = np.cumsum(windows.step, axis=0)[..., None]
    error = windows.start[..., :3] + windows.start[..., 3:] * time - windows.q[1:]
    return error[:, windows.weight > 0.0]


def _rms(error: Float[np.ndarray, "rows n 3"]) -> Float[np.ndarray, "rows 3"]:
    return np.sqrt(np.mean(error**2, axis=1))


def identified_file(
    found: Identification, robot: RobotFile, source: Path, folder: Path
) -> str:
    """Return the robot file's text with the numbers that were found in place of its own.

    What was not identified is listed in a comment at its head.
    """
    values = {(one.name, one.joint): one.value for one in found.numbers}

    def of_joints(name: str, factor: object = 1.0) -> str:
        factors = np.broadcast_to(np.asarray(factor, dtype=float), 3)
        return row(
            x * values[name, joint] for x, joint in zip(factors, JOINTS, strict=True)
        )

    hardware, gains = robot.hardware, robot.gains
    assert gains is not None  # as `identify` has seen
    changes = {
        ("motors", "peak_torque"): of_joints("torque_scale", hardware.peak_torque),
        ("motors", "no_load_speed"): of_joints("no_load_speed"),
        ("gains", "stiffness"): of_joints("torque_scale", gains.stiffness),
        ("gains", "damping"): of_joints("torque_scale", gains.damping),
        ("losses", "joint_friction"): of_joints("friction"),
        ("losses", "joint_viscosity"): of_joints("viscosity"),
        ("losses", "latency"): f"{values['delay', 'all']:.6g}",
    }
    if found.hanging:
        changes["motors", "armature"] = of_joints("armature")
        changes["motors", "corner_speed"] = of_joints("corner_speed")
    text = source.read_text(encoding="utf-8")
    for (table, key), value in changes.items():
        text = _with_value(text, table, key, value)
    if found_path := re.search(r'^mjcf *= *"(.*)"', text, re.MULTILINE):
        moved = os.path.relpath(source.parent / found_path[1], folder)
        text = text.replace(found_path[0], f'mjcf = "{moved}"')
    open_ones = [
        f"#   {one.name} of {one.joint}: {one.verdict}"
        for one in found.numbers
        if one.verdict != "identified"
    ]
    head = [
        f"# Identified from a log of {found.log.rows} rows, {found.windows} windows of free legs."
    ]
    return "\n".join([*head, *open_ones, text])


def _with_value(text: str, table: str, key: str, value: str) -> str:
    """Return TOML with a key of a table set; the table and the key are added if missing."""
    line = f"{key} = {value}"
    head = re.search(rf"^\[{table}\][^\n]*\n", text, re.MULTILINE)
    if head is None:
        return f"{text.rstrip()}\n\n[{table}]\n{line}\n"
    rest = text[head.end() :]
    end = (
        match.start() if (match := re.search(r"^\[", rest, re.MULTILINE)) else len(rest)
    )
    body, known = re.subn(
        rf"^{key} *=.*$", line, rest[:end], count=1, flags=re.MULTILINE
    )
    return text[: head.end()] + (body if known else f"{line}\n{body}") + rest[end:]


@styled
def identification_figure(found: Identification) -> Figure:
    """Draw the error of predicted angles over the time since a window's start, on rows
    that the fit has not seen."""
    figure = Figure(figsize=(1.2 * WIDTH, 3.2), layout="constrained")
    colors = {"fitted": FRONT, "configured": FALL, "constant velocity": QUIET}
    for i, (axes, joint) in enumerate(zip(figure.subplots(1, 3), JOINTS, strict=True)):
        for way, errors in found.over_time.items():
            error = 1e3 * np.array(errors)[:, i]
            time = 1e3 * found.window * np.arange(1, len(error) + 1) / len(error)
            axes.plot(time, error, color=colors[way], label=way)
        axes.set(title=joint, xlabel="Time since the start [ms]", yscale="log")
        axes.grid(color=INK, alpha=0.1)
    figure.axes[0].set_ylabel("RMS error, held-out rows [mrad]")
    legend_above(figure.axes[2])
    return figure
