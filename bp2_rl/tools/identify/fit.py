"""Least squares for motor numbers, with the start of each window as unknowns of its own.

Levenberg and Marquardt's method with Huber's loss. The windows' starts, six numbers
each with a prior about their estimate, are eliminated window by window, so that a step
solves for the motors' numbers alone. Intervals allow for errors that windows of one
leg's stride share (a sandwich of the scores by stride).
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.signal import savgol_coeffs, savgol_filter

from bp2_rl.robot.actuator import Actuator
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.kernel.design import Design
from bp2_rl.robot.model import load_model
from bp2_rl.tools.identify.log import Log
from bp2_rl.tools.identify.swing import EARLIER, Motors, Windows, predict

SMOOTHED, PAST = 7, 8
"""Rows of the filters that estimate a start: centred, and from past rows alone."""
ANGLE, RATE = 1e-3, 0.7
"""rad, rad/s: how far a window's start may be from its estimate."""
NOISE = (3e-3, 6e-3, 6e-3)
"""rad, of abad, hip and knee: errors beyond twice of it count linearly."""
HUBER = 2.0
MODEL, MODEL_DELAY = 0.004, 3e-5
"""Share of a number, and s of the delay, by which the model itself may be wrong: it is
added to the spread."""
VANISHED = 0.02
INFORMATIVE = 1e-7
"""Share of the greatest information, below which the windows say nothing of a number."""


class Rig(NamedTuple):
    """A robot as the fit takes it."""

    design: Design
    drive: Actuator  # gains and limits, (3,) over abad, hip and knee
    gear_loss: float
    configured: Motors
    guess: Motors  # positive, where the fit begins


class Found(NamedTuple):
    """Result of a fit: the motors' numbers, and the spread of the logarithms of those that
    were free."""

    motors: Motors
    spread: Motors  # standard deviation of log(value); nan where a number was kept


def rig_of(
    hardware: HardwareSpec, stiffness: Sequence[float], damping: Sequence[float]
) -> Rig:
    """Return a robot's legs and drives for the fit; gains (Nm/rad, Nm s/rad) of abad,
    hip and knee."""

    def three(value: object) -> np.ndarray:
        return np.broadcast_to(np.asarray(value, dtype=float).reshape(-1)[:3], 3).copy()

    losses = hardware.losses
    drive = Actuator(
        stiffness=np.array(stiffness),
        damping=np.array(damping),
        peak_torque=three(hardware.joint_peak_torque),
        corner_speed=three(hardware.joint_corner_speed),
        no_load_speed=three(hardware.joint_no_load_speed),
    )
    configured = Motors(
        torque_scale=np.ones(3),
        no_load_speed=three(hardware.joint_no_load_speed),
        friction=three(losses.joint_friction),
        viscosity=three(losses.joint_viscosity),
        armature=three(hardware.reflected_inertia),
        corner_speed=three(hardware.joint_corner_speed),
        delay=np.array([losses.latency]),
    )
    guess = configured._replace(
        friction=np.maximum(
            configured.friction, 0.01 * three(hardware.joint_peak_torque)
        ),
        viscosity=np.maximum(configured.viscosity, 0.02 * np.array(damping)),
        delay=np.maximum(configured.delay, 1e-3),
    )
    design = Design.of(load_model(hardware, visual=False, feet_only=True))
    return Rig(design, drive, 1.0 - losses.gear_efficiency, configured, guess)


def cut_windows(
    log: Log, rows: int, *, stride: int | None = None, past: bool = False
) -> Windows:
    """Cut windows of free legs out of a log.

    Args:
        log: the recording.
        rows: length of a window.
        stride: rows from a window's start to the next one's; by default `rows`.
        past: estimate a window's start from the rows before it alone, as a controller
            would; else with a centred filter.
    """
    free = log.airborne & log.whole[:, None]
    starts = [_starts(leg, rows, stride or rows) for leg in free.T]
    count = max(1, *(len(leg) for leg in starts))
    place = np.stack(
        [np.resize(leg if len(leg) else [EARLIER], count) for leg in starts]
    )
    weight = np.stack([np.arange(count) < len(leg) for leg in starts]).astype(float)
    begun = np.cumsum(np.diff(free.astype(int), axis=0, prepend=0) > 0, axis=0)
    each = place if log.hanging else np.take_along_axis(begun.T, place, axis=1)
    swing = 4 * each + np.arange(4)[:, None]
    angles, rates = _smooth(log.q, log.step, past=past)
    up, spin, turning = _smooth(log.up, log.step)[0], *_smooth(log.omega, log.step)

    def of_legs(x: np.ndarray, first: int, last: int) -> np.ndarray:
        at = place + np.arange(first, last)[:, None, None]
        return x.reshape(len(x), 4, 3)[at, np.arange(4)[:, None]]

    def of_trunk(x: np.ndarray) -> np.ndarray:
        return x[place + np.arange(rows)[:, None, None]]

    start = np.concatenate([of_legs(angles, 0, 1)[0], of_legs(rates, 0, 1)[0]], axis=-1)
    return Windows(
        q=of_legs(log.q, 0, rows + 1),
        q_target=of_legs(log.q_target, -EARLIER, rows),
        step=of_trunk(np.diff(log.time, append=log.time[-1] + log.step)),
        up=of_trunk(up),
        spin=of_trunk(spin),
        turning=of_trunk(turning),
        start=start,
        weight=weight,
        swing=swing,
    )


def _starts(free: np.ndarray, rows: int, stride: int) -> list[int]:
    """Return the first rows of all windows in which a leg is free throughout."""
    edges = np.flatnonzero(
        np.diff(np.concatenate([[False], free, [False]]).astype(int))
    )
    begins, ends = edges[::2], edges[1::2]
    margin = PAST + EARLIER
    return [
        start
        for begin, end in zip(begins, ends, strict=True)
        for start in range(
            max(begin, margin), min(end, len(free) - PAST) - rows, stride
        )
    ]


def _smooth(
    x: np.ndarray, step: float, *, past: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return a signal's value and derivative at each row by a local polynomial."""
    if not past:
        return savgol_filter(x, SMOOTHED, 3, axis=0), savgol_filter(
            x, SMOOTHED, 3, deriv=1, delta=step, axis=0
        )
    value, slope = (
        savgol_coeffs(PAST, 2, pos=PAST - 1, deriv=order, delta=step, use="dot")
        for order in (0, 1)
    )
    rows = np.stack([np.roll(x, PAST - 1 - i, axis=0) for i in range(PAST)])
    return np.tensordot(value, rows, 1), np.tensordot(slope, rows, 1)


def predicted_error(
    rig: Rig, motors: Motors, windows: Windows
) -> Float[np.ndarray, "rows n 3"]:
    """Return predicted less recorded angles, rad, after each row of all windows, from the
    estimated starts."""
    run = jax.jit(partial(predict, rig.design, rig.drive, rig.gear_loss))
    error = np.asarray(run(motors, windows.start, windows)) - windows.q[1:]
    return error[:, windows.weight > 0.0]


def fit_motors(
    rig: Rig, windows: Windows, free: Sequence[str], *, iterations: int = 40
) -> Found:
    """Find the motors' numbers named in `free` that predict the windows best.

    The other numbers stay as guessed. A number that falls below `VANISHED` of its guess is 0.
    """
    values = {name: np.asarray(value) for name, value in rig.guess._asdict().items()}
    sizes = [len(values[name]) for name in free]

    def motors(u: jax.Array) -> Motors:
        parts = jnp.split(u, np.cumsum(sizes)[:-1])
        tried = {
            name: values[name] * jnp.exp(part)
            for name, part in zip(free, parts, strict=True)
        }
        return Motors(**(values | tried))

    def residual(u: jax.Array, start: jax.Array) -> jax.Array:
        q = predict(rig.design, rig.drive, rig.gear_loss, motors(u), start, windows)
        error = jnp.moveaxis((q - windows.q[1:]) / jnp.array(NOISE), 0, -2)
        prior = (start - windows.start) / jnp.array([ANGLE] * 3 + [RATE] * 3)
        both = jnp.concatenate([error.reshape(*prior.shape[:2], -1), prior], -1)
        return both * windows.weight[..., None]

    @jax.jit
    def derivatives(
        u: jax.Array, start: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        def by_start(i: jax.Array) -> jax.Array:
            along = jnp.zeros_like(start).at[..., i].set(1.0)
            return jax.jvp(partial(residual, u), (start,), (along,))[1]

        by_u = jax.vmap(
            lambda along: jax.jvp(lambda x: residual(x, start), (u,), (along,))[1]
        )(jnp.eye(len(u)))
        return residual(u, start), by_u, jax.vmap(by_start)(jnp.arange(6))

    cost = jax.jit(lambda u, start: jnp.sum(_huber(residual(u, start))))
    u, start = np.zeros(sum(sizes)), np.array(windows.start)
    damping, least = 1e-3, float(cost(u, start))
    for _ in range(iterations):
        normal = _normal(windows.swing, *map(np.asarray, derivatives(u, start)))
        while damping < 1e6:
            du, dstart = normal.step(damping)
            tried = float(cost(u + du, start + dstart))
            if tried < least:
                break
            damping *= 8.0
        else:
            break
        gain, least = least - tried, tried
        u, start, damping = u + du, start + dstart, max(damping / 8.0, 1e-8)
        if gain < 1e-5 * least:
            break
    normal = _normal(windows.swing, *map(np.asarray, derivatives(u, start)))
    best = motors(jnp.asarray(u))._asdict()
    found = {name: np.asarray(x, dtype=float) for name, x in best.items()}
    parts = np.split(normal.spread(), np.cumsum(sizes)[:-1])
    spread = {name: np.full_like(value, math.nan) for name, value in values.items()}
    for name, part in zip(free, parts, strict=True):
        model = MODEL_DELAY / found[name] if name == "delay" else MODEL
        spread[name] = np.hypot(part, model)
    kept = {
        name: np.where(x < VANISHED * values[name], 0.0, x) for name, x in found.items()
    }
    return Found(Motors(**kept), Motors(**spread))


def _huber(residual: jax.Array) -> jax.Array:
    size = jnp.abs(residual)
    return jnp.where(size < HUBER, 0.5 * size * size, HUBER * (size - 0.5 * HUBER))


class _Normal(NamedTuple):
    """Normal equations with blocks of the motors' numbers (u) and the windows' starts (s);
    windows first."""

    uu: np.ndarray  # (n, 6 or fewer, ...) by window
    us: np.ndarray
    ss: np.ndarray
    u: np.ndarray  # gradients
    s: np.ndarray
    swing: np.ndarray  # to which each window belongs

    def step(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Return Levenberg's steps of the motors' logarithms and of the starts."""
        grown = self.ss * (1.0 + damping * np.eye(6))
        along = np.linalg.solve(
            grown, np.concatenate([self.us.swapaxes(-1, -2), self.s[..., None]], -1)
        )
        left = np.sum(self.uu, axis=(0, 1))
        left = left * (1.0 + damping * np.eye(len(left))) - np.sum(
            self.us @ along[..., :-1], axis=(0, 1)
        )
        right = np.sum(self.u - (self.us @ along[..., -1:])[..., 0], axis=(0, 1))
        du = np.clip(
            -np.linalg.solve(left + 1e-9 * np.eye(len(left)), right), -0.5, 0.5
        )
        return du, -along[..., -1] - along[..., :-1] @ du

    def spread(self) -> np.ndarray:
        """Return the standard deviations of the motors' logarithms, robust to errors that
        windows of one swing share; inf where the windows say nothing."""
        along = np.linalg.solve(
            self.ss, np.concatenate([self.us.swapaxes(-1, -2), self.s[..., None]], -1)
        )
        left = np.sum(self.uu - self.us @ along[..., :-1], axis=(0, 1))
        scores = self.u - (self.us @ along[..., -1:])[..., 0]
        told = np.diag(left) > INFORMATIVE * np.max(np.diag(left))
        inverse = np.linalg.inv(left[np.ix_(told, told)])
        swings = np.zeros((int(np.max(self.swing)) + 1, len(told)))
        np.add.at(swings, self.swing, scores)
        between = (swings.T @ swings)[np.ix_(told, told)]
        spread = np.full(len(told), math.inf)
        spread[told] = np.sqrt(np.diag(inverse @ between @ inverse))
        return spread


def _normal(
    swing: np.ndarray, residual: np.ndarray, by_u: np.ndarray, by_start: np.ndarray
) -> _Normal:
    """Return the normal equations of a Huber loss at residuals (4, W, m)."""
    weight = np.minimum(1.0, HUBER / np.maximum(np.abs(residual), 1e-12))[..., None]
    u = np.moveaxis(by_u, 0, -1).astype(float)
    s = np.moveaxis(by_start, 0, -1).astype(float)
    ut = (weight * u).swapaxes(-1, -2)
    st = (weight * s).swapaxes(-1, -2)
    r = residual[..., None].astype(float)
    ss = st @ s
    empty = (np.trace(ss, axis1=-2, axis2=-1) == 0.0)[..., None, None]
    return _Normal(
        ut @ u,
        ut @ s,
        ss + empty * np.eye(6),
        (ut @ r)[..., 0],
        (st @ r)[..., 0],
        swing,
    )
