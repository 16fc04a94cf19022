"""Fit the motors' numbers, and the state in which each window starts, by least squares.

Levenberg and Marquardt's method with Huber's smooth loss. The windows' starts, six
numbers each with a prior about their estimate, are eliminated window by window, so that
a step solves for the motors' numbers alone. Intervals allow for errors that the windows
of one swing share: a sandwich of the curvature and of the scores by swing.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.signal import savgol_coeffs, savgol_filter

from bp2_rl.base.errors import UserError
from bp2_rl.robot.actuator import Actuator
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.kernel.design import Design
from bp2_rl.robot.model import load_model
from bp2_rl.robot.robot_file import GainNumbers
from bp2_rl.tools.identify.log import RobotLog
from bp2_rl.tools.identify.swing import (
    LONGEST_DELAY,
    STEP,
    Motors,
    Rig,
    Windows,
    predict,
)

SMOOTHED, PAST = 7, 8
"""Lengths, in rows, of the two filters that estimate a window's start: one is centred,
one reads past rows alone."""
ANGLE, RATE = 1e-3, 0.7
"""rad, rad/s: how far a window's start may be from its estimate."""
FARTHEST = 10.0
"""Largest step of a window's start in an iteration, over its prior."""
NOISE = (3e-3, 6e-3, 6e-3)
"""rad, of abad, hip and knee: errors beyond twice of it count linearly."""
HUBER = 2.0
VANISHED = 0.02
"""A number that falls below this share of its guess is taken as 0."""
HIGHEST = {"corner_share": 0.98}
"""The highest numbers that a fit tries: the envelope must fall over some speeds."""
INFORMATIVE = 1e-7
"""Share of the greatest information, below which the windows say nothing of a number."""
MODEL, MODEL_DELAY = 0.004, 3e-5
"""Share of a number, and s of the delay, by which the model itself may be wrong: it is
added to the spread."""
SETTLED = 5e-4
"""Share of the loss by which two last steps may still lower it."""
INERTIA = 0.03
"""Standard deviation of the logarithm of a link's inertia: 90 % are within 5 %. Torque,
friction and armature are known no better, as motion tells only their ratio to it."""
BLOCK = 0.5  # s, of a hanging leg, whose windows may share errors
ENOUGH = 2
"""Swings that a fit needs for each unknown of the motors."""


class Found(NamedTuple):
    """Result of a fit: the motors' numbers, and the spread of the logarithms of those that
    were free."""

    motors: Motors
    spread: Motors  # standard deviation of log(value); nan where a number was kept
    converged: bool


def rig_of(hardware: HardwareSpec, gains: GainNumbers) -> Rig:
    """Return a robot's legs and drives for the fit, under these gains."""

    def three(value: object) -> np.ndarray:
        first = np.asarray(value, dtype=float).reshape(-1)[:3]
        return np.broadcast_to(first, 3).copy()

    losses = hardware.losses
    no_load = three(hardware.joint_no_load_speed)
    drive = Actuator(
        stiffness=three(gains.stiffness),
        damping=three(gains.damping),
        peak_torque=three(hardware.joint_peak_torque),
        corner_speed=three(hardware.joint_corner_speed),
        no_load_speed=no_load,
    )
    configured = Motors(
        torque_scale=np.ones(3),
        no_load_speed=no_load,
        friction=three(losses.joint_friction),
        viscosity=three(losses.joint_viscosity),
        armature=three(hardware.reflected_inertia),
        corner_share=three(hardware.joint_corner_speed) / no_load,
        delay=np.array([losses.latency + losses.current_lag]),
        inertia=np.ones((4, 3)),
    )
    peak = three(hardware.joint_peak_torque)
    guess = configured._replace(
        friction=np.maximum(configured.friction, 0.01 * peak),
        viscosity=np.maximum(configured.viscosity, 1e-3 * peak / no_load),
        armature=np.maximum(configured.armature, 1e-6 * peak),
        corner_share=np.clip(configured.corner_share, 0.1, 0.9),
        delay=np.maximum(configured.delay, 1e-3),
    )
    design = Design.of(load_model(hardware, visual=False, feet_only=True))
    return Rig(design, drive, 1.0 - losses.gear_efficiency, configured, guess)


def cut_windows(
    log: RobotLog,
    length: float,
    stride: float,
    *,
    chosen: Bool[np.ndarray, " rows"] | None = None,
    past: bool = False,
) -> Windows:
    """Cut windows of free legs out of a log.

    Args:
        log: the recording.
        length: of a window, s.
        stride: from a window's start to the next one's, s.
        chosen: rows in which windows may lie; by default all.
        past: estimate a window's start from the rows before it alone, as a controller
            would; else with a centred filter.

    Raises:
        UserError: no leg is free for long enough.
    """
    rows = round(length / log.step)
    every = max(round(stride / log.step), 1)
    before = max(math.ceil(LONGEST_DELAY / log.step) + 1, PAST)
    kept = log.airborne if chosen is None else log.airborne & chosen[:, None]
    starts = [_starts(leg, log.whole, rows, every, before) for leg in kept.T]
    count = max(map(len, starts))
    if count == 0:
        raise UserError(
            f"no leg is free for {length:g} s, with {before} rows before and none lost"
        )
    filled = [
        np.resize(leg if len(leg) else starts[np.argmax([*map(len, starts)])], count)
        for leg in starts
    ]
    place = np.stack(filled)
    begun = np.cumsum(np.diff(kept.astype(int), axis=0, prepend=0) > 0, axis=0)
    each = np.floor(log.time[place] / BLOCK).astype(int)
    if not log.hanging:
        each = np.take_along_axis(begun.T, place, axis=1)
    angles, rates = _smooth(log.q, log.step, past=past)
    spin, turning = _smooth(log.omega, log.step)

    def of_legs(x: np.ndarray, first: int, last: int) -> np.ndarray:
        at = place + np.arange(first, last)[:, None, None]
        return x.reshape(len(x), 4, 3)[at, np.arange(4)[:, None]]

    def of_trunk(x: np.ndarray) -> np.ndarray:
        return x[place + np.arange(rows)[:, None, None]]

    start = np.concatenate([of_legs(angles, 0, 1)[0], of_legs(rates, 0, 1)[0]], axis=-1)
    return Windows(
        step=np.array(log.step),
        q=of_legs(log.q, 0, rows + 1),
        q_target=of_legs(log.q_target, -before, rows),
        acceleration=of_trunk(_smooth(log.acceleration, log.step)[0]),
        spin=of_trunk(spin),
        turning=of_trunk(turning),
        start=start,
        kept=np.stack([np.arange(count) < len(leg) for leg in starts]),
        swing=4 * each + np.arange(4)[:, None],
    )


def _starts(
    free: np.ndarray, whole: np.ndarray, rows: int, every: int, before: int
) -> list[int]:
    """Return the first rows of windows in which a leg is free, and around which no row
    was lost."""
    starts: list[int] = []
    for row in range(before, len(free) - rows - SMOOTHED):
        apart = not starts or row >= starts[-1] + every
        if (
            apart
            and free[row : row + rows + 1].all()
            and whole[row - before : row + rows + SMOOTHED].all()
        ):
            starts.append(row)
    return starts


def _smooth(
    x: np.ndarray, step: float, *, past: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return a signal's value and derivative at each row by a local polynomial."""
    if not past:
        value = savgol_filter(x, SMOOTHED, 3, axis=0)
        slope = savgol_filter(x, SMOOTHED, 3, deriv=1, delta=step, axis=0)
        return np.asarray(value), np.asarray(slope)
    now, rate = (
        savgol_coeffs(PAST, 2, pos=PAST - 1, deriv=order, delta=step, use="dot")
        for order in (0, 1)
    )
    rows = np.stack([np.roll(x, PAST - 1 - i, axis=0) for i in range(PAST)])
    return np.tensordot(now, rows, 1), np.tensordot(rate, rows, 1)


def predictor(rig: Rig, step: float) -> Callable[..., jax.Array]:
    """Compile `predict` for a robot and a time `step` between rows, s."""
    return jax.jit(partial(predict, rig, substeps=_substeps(step)))


def predicted_error(
    run: Callable[..., jax.Array], motors: Motors, windows: Windows
) -> Float[np.ndarray, "rows n 3"]:
    """Return predicted less recorded angles, rad, after each row of all windows, from the
    estimated starts; `run` is made by `predictor`."""
    error = np.asarray(run(motors, windows.start, windows)) - windows.q[1:]
    return error[:, np.asarray(windows.kept)]


def _substeps(step: float) -> int:
    return math.ceil(step / STEP - 1e-3)


def fit_motors(
    rig: Rig, windows: Windows, free: Sequence[str], *, iterations: int = 40
) -> Found:
    """Find the motors' numbers named in `free` that predict the windows best.

    The other numbers stay as guessed. A number that falls below `VANISHED` of its guess
    is 0.

    Raises:
        UserError: there are too few swings, or the log cannot be predicted at all.
    """
    guess = {name: np.asarray(x) for name, x in rig.guess._asdict().items()}
    sizes = np.cumsum([guess[name].size for name in free])
    # a leg's own inertias are known before, and move that leg alone
    own = np.concatenate(
        [np.full(guess[name].size, name == "inertia") for name in free]
    )
    swings = len(np.unique(np.asarray(windows.swing)[np.asarray(windows.kept)]))
    needed = ENOUGH * np.sum(~own)
    if swings < needed:
        raise UserError(
            f"{swings} swings are too few for {np.sum(~own)} numbers: record {needed} or more"
        )

    def motors(u: jax.Array) -> Motors:
        parts = zip(free, jnp.split(u, sizes[:-1]), strict=True)
        changed = {
            name: guess[name] * jnp.exp(part.reshape(guess[name].shape))
            for name, part in parts
        }
        return Motors(**(guess | changed))

    def residual(u: jax.Array, start: jax.Array, windows: Windows) -> jax.Array:
        q = predict(rig, motors(u), start, windows, substeps)
        error = jnp.moveaxis((q - windows.q[1:]) / jnp.array(NOISE), 0, -2)
        prior = (start - windows.start) / jnp.array([ANGLE] * 3 + [RATE] * 3)
        both = jnp.concatenate([error.reshape(*prior.shape[:2], -1), prior], -1)
        return jnp.where(windows.kept[..., None], both, 0.0)

    substeps = _substeps(float(windows.step))
    loss = jax.jit(lambda *x: jnp.sum(_huber(residual(*x))))

    def cost(u: np.ndarray, start: np.ndarray) -> float:
        return float(loss(u, start, windows)) + 0.5 * float(prior @ u**2)

    derivatives = jax.jit(partial(_derivatives, residual))
    u, start = np.zeros(sizes[-1]), np.array(windows.start)
    highest = np.concatenate(
        [np.log(HIGHEST.get(name, math.inf) / guess[name].ravel()) for name in free]
    )
    prior = np.where(own, INERTIA**-2.0, 0.0)
    legs, joints = np.divmod(np.cumsum(own) - 1, 3)
    of_leg = ~own | (legs == np.arange(4)[:, None])
    ways = np.eye(sizes[-1])[~own]
    if np.any(own):
        ways = np.concatenate([ways, own * (joints == np.arange(3)[:, None])])

    def normal_at(u: np.ndarray, start: np.ndarray) -> _Normal:
        """Return the normal equations there; legs and windows first."""
        found = map(np.asarray, derivatives(u, start, windows, ways))
        rest, by_way, by_start = (np.moveaxis(x, 0, -1).astype(float) for x in found)
        by_u = by_way @ ways * of_leg[:, None, None]
        return _Normal(by_u, by_start, rest, np.asarray(windows.swing), prior, u)

    damping, least, calm = 1e-3, cost(u, start), 0
    if not math.isfinite(least):
        raise UserError(
            "the robot file's numbers predict no motion from this log: look at joints' names, signs and units"
        )
    for _ in range(iterations):
        normal = normal_at(u, start)
        gain = 0.0
        while damping < 1e6:
            du, dstart = normal.step(damping)
            moved = np.minimum(u + du, highest)
            tried = cost(moved, start + dstart)
            if tried < least:
                gain, least = least - tried, tried
                u, start = moved, start + dstart
                break
            damping *= 8.0
        calm = calm + 1 if gain < SETTLED * least else 0
        if calm == 2:
            break
        damping = max(damping / 8.0, 1e-8)
    normal = normal_at(u, start)
    found = {
        name: np.asarray(x, dtype=float)
        for name, x in motors(jnp.asarray(u))._asdict().items()
    }
    spread = {name: np.full_like(value, math.nan) for name, value in guess.items()}
    for name, part in zip(free, np.split(normal.spread(), sizes[:-1]), strict=True):
        model = MODEL_DELAY / found[name] if name == "delay" else MODEL
        spread[name] = np.hypot(part.reshape(guess[name].shape), model)
    kept = {
        name: np.where(x < VANISHED * guess[name], 0.0, x) for name, x in found.items()
    }
    return Found(Motors(**kept), Motors(**spread), calm == 2)


def _derivatives(
    residual: Callable[..., jax.Array],
    u: jax.Array,
    start: jax.Array,
    windows: Windows,
    ways: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return residuals (1, 4, W, m), and their derivatives along the ways of `u` and by
    each window's start."""

    def by_u(along: jax.Array) -> jax.Array:
        return jax.jvp(lambda x: residual(x, start, windows), (u,), (along,))[1]

    def by_start(i: jax.Array) -> jax.Array:
        along = jnp.zeros_like(start).at[..., i].set(1.0)
        return jax.jvp(lambda x: residual(u, x, windows), (start,), (along,))[1]

    both = jax.vmap(by_u)(ways), jax.vmap(by_start)(jnp.arange(6))
    return residual(u, start, windows)[None], *both


def _huber(residual: jax.Array) -> jax.Array:
    """Return Huber's loss, smooth: r^2 / 2 near 0, and linear beyond `HUBER`."""
    return HUBER**2 * (jnp.sqrt(1.0 + (residual / HUBER) ** 2) - 1.0)


class _Normal(NamedTuple):
    """Normal equations with blocks of the motors' numbers (u) and the windows' starts (s);
    legs and windows first."""

    u: np.ndarray  # derivatives of the residuals, (4, W, m, n)
    s: np.ndarray  # and by the starts, (4, W, m, 6)
    residual: np.ndarray  # (4, W, m, 1)
    swing: np.ndarray  # to which each window belongs, (4, W)
    prior: np.ndarray  # precision of the motors' logarithms about 0, (n,)
    at: np.ndarray  # the motors' logarithms, (n,)

    def step(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Return Levenberg's steps of the motors' logarithms and of the starts."""
        along, left, right = self._eliminated(-0.5, damping)
        left = left * (1.0 + damping * np.eye(len(left))) + 1e-9 * np.eye(len(left))
        slope = np.sum(right, axis=(0, 1)) + self.prior * self.at
        du = np.clip(-np.linalg.solve(left, slope), -0.5, 0.5)
        dstart = -along[..., -1] - along[..., :-1] @ du
        most = FARTHEST * np.array([ANGLE] * 3 + [RATE] * 3)
        return du, np.clip(dstart, -most, most)

    def spread(self) -> np.ndarray:
        """Return the standard deviations of the motors' logarithms, robust to errors that
        windows of one swing share; inf where the windows say nothing."""
        _, left, scores = self._eliminated(-1.5, 0.0)
        swings = np.zeros((int(np.max(self.swing)) + 1, scores.shape[-1]))
        np.add.at(swings, self.swing, scores)
        there = np.any(swings != 0.0, axis=1).sum()
        told = np.diag(left) > INFORMATIVE * np.max(np.diag(left))
        inverse = np.linalg.pinv(left[np.ix_(told, told)], rcond=1e-10, hermitian=True)
        between = swings.T @ swings * there / (there - 1.0) + np.diag(self.prior)
        variance = np.diag(inverse @ between[np.ix_(told, told)] @ inverse)
        spread = np.full(len(told), math.inf)
        spread[told] = np.sqrt(np.maximum(variance, 0.0))
        return spread

    def _eliminated(
        self, power: float, damping: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Eliminate the windows' initial states; return their share of each column, the
        motors' matrix, and the motors' gradients by window.

        Residuals r weigh (1 + (r / HUBER)^2)^power: -1/2 makes the steps of iteratively
        reweighted least squares, -3/2 is the loss's own curvature.
        """
        bent = 1.0 + (self.residual / HUBER) ** 2
        by_u = (bent**power * self.u).swapaxes(-1, -2)
        by_s = (bent**power * self.s).swapaxes(-1, -2)
        slope = self.residual / np.sqrt(bent)
        us = by_u @ self.s
        ss = by_s @ self.s * (1.0 + damping * np.eye(6)) + 1e-9 * np.eye(6)
        gradient = (self.s.swapaxes(-1, -2) @ slope, self.u.swapaxes(-1, -2) @ slope)
        along = np.linalg.solve(
            ss, np.concatenate([us.swapaxes(-1, -2), gradient[0]], -1)
        )
        left = np.sum(by_u @ self.u - us @ along[..., :-1], axis=(0, 1)) + np.diag(
            self.prior
        )
        return along, left, (gradient[1] - us @ along[..., -1:])[..., 0]
