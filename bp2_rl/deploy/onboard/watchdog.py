"""The watchdog: it looks at every measurement and stops the policy where sensors, clocks or links say what cannot be.

A fault has a name, which is in the table of docs/deploy.md, and one line: what is seen, and what is probably wrong.
Single values are compared with limits at once. Over each `window` of time, joint speeds are compared with the change of
joint angles, the gyro with the change of `up`, and joint angles with their targets.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np


class SensorReading(NamedTuple):
    """What encoders and IMU report; joints in the order of `joints` in `deploy.json`."""

    joint_position: np.ndarray  # (12) rad
    joint_velocity: np.ndarray  # (12) rad/s
    up: np.ndarray  # (3) the world's vertical in the body frame (x forward, y left, z up)
    angular_velocity: np.ndarray  # (3) rad/s, body frame
    time: float  # s, when it arrived, by the clock whose time `step` is told


class SensorFault(Exception):
    """A reason to stop the policy: `name: what is seen; what is probably wrong`."""


@dataclasses.dataclass(frozen=True)
class WatchdogLimits:
    """The limits of the watchdog, `watchdog` in `deploy.json`."""

    silence: float  # s without a new measurement, and s that a new one may be old
    ahead: float  # s, by which a measurement's time may be ahead of the controller's clock
    rate: float  # factor, by which the rate of the calls of `step` may differ from the policy's
    stand_time: float  # s, in which the joints are led to the standing pose
    braking: float  # m/s2, at which the command falls where the operator says nothing
    joint_margin: float  # rad, by which a joint may be beyond its range
    joint_speed: float  # rad/s
    turning: float  # rad/s, of the trunk
    up_length: float  # by which the length of `up` may differ from 1
    tilt: float  # rad, between `up` and the trunk's z axis
    frozen: float  # s, for which a sensor may repeat its value with new stamps
    frozen_target: float  # rad, by which a joint's target moves before an encoder that repeats its value is frozen
    window: float  # s, over which speeds, changes and targets are compared
    mismatch: float  # of an integrated speed from the change that it belongs to: share of the larger of both
    joint_noise: float  # rad, which is added to that share of a joint's change
    up_noise: float  # which is added to that share of the change of `up`
    off_target: float  # rad, of a joint's mean from its targets' mean
    opposed: float  # correlation of a joint with its target, as a negative number's size
    swing: float  # rad, the least standard deviation of both for which a correlation counts


SENSORS = {"joint_position": 12, "joint_velocity": 12, "up": 3, "angular_velocity": 3}
"""Entries of each array of a measurement."""
STARTS = np.cumsum([0, *list(SENSORS.values())[:-1]])
Q, QD, UP, GYRO = (slice(start, start + size) for start, size in zip(STARTS, SENSORS.values(), strict=True))
CLOCK = "stamp a measurement on arrival with the clock of `now`, by default time.monotonic(), in seconds"


class Watchdog:
    """Keeps the newest sound measurement, and raises `SensorFault` for what cannot be.

    Args:
        settings: the content of `deploy.json`.
    """

    def __init__(self, settings: Mapping[str, Any]):
        self.limits = limits = WatchdogLimits(**settings["watchdog"])
        self._joints, self._dt = settings["joints"], 1.0 / settings["rates"]["policy"]
        self._range = np.array(settings["joint_range"])
        self._middle = np.concatenate((self._range.mean(axis=1), np.zeros(18)))
        # Beyond `_free` a value uses up its limit, and has used it up `_spare` further on.
        self._free = np.concatenate((np.ptp(self._range, axis=1) / 2.0, np.zeros(18)))
        self._spare = np.repeat(
            (limits.joint_margin, limits.joint_speed, 1.0 + limits.up_length, limits.turning), list(SENSORS.values())
        )
        self._reach = self._free + self._spare
        self._noise = np.append(np.full(12, limits.joint_noise), limits.up_noise)
        self.used: dict[str, float] = {}
        """The largest share of each limit that measurements have used up so far, by the fault's name; 1 is a fault."""
        self.reset()

    def reset(self) -> None:
        """Forget all measurements."""
        self._now = -math.inf
        self._newest: SensorReading | None = None
        self._heard = math.inf  # when the newest came in
        self._values = np.full(30, np.nan)
        self._since, self._held = np.zeros(30), np.zeros(12)  # when each value changed last, and each joint's target

    def look(self, given: Any, now: Any, target: np.ndarray) -> SensorReading | None:
        """Return the newest measurement, or None before the first.

        Args:
            given: what the caller has for a measurement; None where there is none.
            now: s, by the controller's clock.
            target: rad, the joint targets in force.

        Raises:
            SensorFault: what is given cannot be, or there has been nothing new for too long.
        """
        time = _number(now)
        if not math.isfinite(time) or time < self._now:
            raise SensorFault(f"clock: `now` went from {self._now:g} to {time:g} s; use a clock that only goes on")
        self._now = time
        self._ticks = 0 if self._newest is None else self._ticks + 1
        if given is not None:
            values, stamp = self._read(given)
            self._compare_with_limits(values)
            if self._newest is None or stamp > self._newest.time:
                self._accept(values, stamp, target)
        if time - self._heard > self.limits.silence:
            seen = 1e3 * (time - self._heard)
            raise SensorFault(f"silence: no new measurement for {seen:.0f} ms; is the link up, does its time go on?")
        return self._newest

    # --- One measurement --------------------------------------------------------------------------------------

    def _read(self, given: Any) -> tuple[np.ndarray, float]:
        """Return a copy of the 30 numbers of a measurement, and its time; lists of numbers are read as arrays."""
        try:
            *parts, stamp = given
            arrays = [np.asarray(part) for part in parts]
        except Exception:  # whatever a driver hands over, the loop goes on
            arrays, stamp = [], math.nan
        if len(arrays) != len(SENSORS):
            raise SensorFault("form: the measurement is no SensorReading of four arrays and a time")
        for (name, size), array in zip(SENSORS.items(), arrays, strict=True):
            if array.dtype.kind not in "fiu" or array.dtype.itemsize > 8:
                raise SensorFault(f"form: {name} holds {array.dtype}, not {size} real numbers")
            if array.shape != (size,):
                raise SensorFault(f"form: {name} has the shape {array.shape}, not ({size},)")
        values, time = np.concatenate(arrays, dtype=float), _number(stamp)
        if not (math.isfinite(time) and np.isfinite(values).all()):
            wrong = [name for name, array in zip(SENSORS, arrays, strict=True) if not np.isfinite(array).all()]
            raise SensorFault(f"not finite: {(wrong or ['time'])[0]}; a sensor is unplugged or its driver failed")
        return values, time

    def _compare_with_limits(self, values: np.ndarray) -> None:
        """Compare each value with the limit of its sensor."""
        beyond = np.abs(values - self._middle)
        if (beyond > self._reach).any():
            worst = int(np.argmax(beyond - self._reach > 0.0))
            value, joint = values[worst], self._joints[worst % 12]
            if worst < 12:
                low, high = self._range[worst]
                seen = f"range: {joint} is at {value:.2f} rad, beyond {low:g} to {high:g}"
                raise SensorFault(f"{seen}; is it in degrees, is its sign or its zero wrong?")
            if worst < 24:
                seen = f"joint speed: {joint} has {value:.0f} rad/s, more than {self.limits.joint_speed:g}"
                raise SensorFault(f"{seen}; is it in deg/s or rpm, or before the gear?")
            if worst >= GYRO.start:
                seen = f"turning: angular_velocity has {value:.0f} rad/s, more than {self.limits.turning:g}"
                raise SensorFault(f"{seen}; is it in deg/s?")
        x, y, z = values[UP].tolist()
        length = math.hypot(x, y, z)
        if abs(length - 1.0) > self.limits.up_length:
            raise SensorFault(f"up: its length is {length:.2f}, not 1; is it an acceleration?")
        tilt = math.acos(max(-1.0, min(z / length, 1.0)))
        if tilt > self.limits.tilt:
            why = "has the robot fallen over, or is up gravity (it is 0, 0, 1 when level)?"
            raise SensorFault(f"tilt: up is ({x:.2f}, {y:.2f}, {z:.2f}), {math.degrees(tilt):.0f} deg off; {why}")
        shares = np.maximum.reduceat((beyond - self._free) / self._spare, STARTS).tolist()
        shares[2] = abs(length - 1.0) / self.limits.up_length
        self._use(("range", "joint speed", "up", "turning", "tilt"), (*shares, tilt / self.limits.tilt))

    def _accept(self, values: np.ndarray, stamp: float, target: np.ndarray) -> None:
        """Keep a new measurement; look at its time, and at it beside the ones before."""
        limits, age = self.limits, self._now - stamp
        if age < -limits.ahead:
            raise SensorFault(f"clock: a measurement's time is {-age:.3g} s ahead of the controller's; {CLOCK}")
        if age > limits.silence:
            raise SensorFault(f"clock: a new measurement's time is {age:.3g} s old; does it come late? Else {CLOCK}")
        x, y, z, a, b, c = values[UP.start :].tolist()
        rate = np.concatenate((values[QD], (y * c - z * b, z * a - x * c, x * b - y * a)))  # of angles and of up
        last, self._heard = self._newest, self._now
        self._newest = SensorReading(values[Q], values[QD], values[UP], values[GYRO], stamp)
        changed = values != self._values
        self._since[changed], self._values = stamp, values
        self._held[changed[Q]] = target[changed[Q]]
        if last is None or stamp - last.time > limits.silence:
            self._begin(rate, stamp)
            return
        self._find_frozen(stamp, target)
        self._travel += 0.5 * (rate + self._rate) * (stamp - last.time)
        self._rate = rate
        change = np.concatenate((values[Q], values[UP]))
        row = np.concatenate((change, self._travel, change - self._travel, target, values[Q] - target))
        self._count += 1
        self._sum += row
        self._squares += row * row
        if stamp - self._began >= limits.window:
            self._compare_changes()
            self._begin(rate, stamp)

    # --- Measurements one after another -----------------------------------------------------------------------

    def _begin(self, rate: np.ndarray, stamp: float) -> None:
        """Begin a window."""
        self._rate, self._travel = rate, np.zeros(15)
        self._sum, self._squares, self._count = np.zeros(69), np.zeros(69), 0
        self._began, self._began_now, self._ticks = stamp, self._now, 0

    def _find_frozen(self, stamp: float, target: np.ndarray) -> None:
        """Look for values that do not change: never of an IMU that works, nor of a joint whose target moves."""
        limits, still = self.limits, stamp - self._since
        for name, place in (("up", UP), ("angular_velocity", GYRO)):
            if still[place].min() > limits.frozen:
                seen = f"frozen: {name} has repeated its values for {1e3 * still[place].min():.0f} ms"
                raise SensorFault(f"{seen}, with new stamps; does its driver still read the IMU?")
        stuck = (still[Q] > limits.frozen) & (np.abs(target - self._held) > limits.frozen_target)
        if stuck.any():
            joint = int(np.argmax(stuck))
            seen = f"frozen: {self._joints[joint]} has repeated its angle for {1e3 * still[joint]:.0f} ms"
            raise SensorFault(f"{seen} while its target moved; does its driver still read the encoder?")

    def _compare_changes(self) -> None:
        """Compare speeds with changes, joints with their targets, and the calls of `step` with their rate."""
        limits, elapsed = self.limits, self._now - self._began_now
        calls = self._ticks / max(elapsed, 1e-9)
        if not 1.0 / limits.rate <= calls * self._dt <= limits.rate:
            raise SensorFault(f"rate: `step` is called {calls:.0f} times a second, not {1.0 / self._dt:.0f}")
        mean = self._sum / self._count
        variance = np.maximum(self._squares / self._count - mean * mean, 0.0)
        # Twelve joints, and the three numbers of up as one.
        change, travel, gap = np.sqrt(np.add.reduceat(variance[:45].reshape(3, 15), range(13), axis=1))
        share = gap / np.hypot(self._noise, limits.mismatch * np.maximum(change, travel))
        joint, target, off = variance[Q], variance[45:57], variance[57:]
        swings = np.minimum(joint, target) > limits.swing**2
        opposed = np.where(swings, (off - joint - target) / 2.0, 0.0) / np.sqrt(np.maximum(joint * target, 1e-12))
        aside = np.abs(mean[57:])
        if share.max() > 1.0:
            worst = int(np.argmax(share))
            times = f"{travel[worst] / max(change[worst], 1e-9):.2g} times"
            sign = " and against it" if gap[worst] > math.hypot(change[worst], travel[worst]) else ""
            if worst < 12:
                seen = f"joint velocity: {self._joints[worst]} has {times} the speed at which its angle changes{sign}"
                raise SensorFault(f"{seen}; check its unit and its sign")
            seen = f"gyro: angular_velocity is {times} what up turns by{sign}"
            raise SensorFault(f"{seen}; is it in deg/s, is a sign wrong, are axes exchanged?")
        if aside.max() > limits.off_target:
            worst = int(np.argmax(aside))
            seen = f"off target: {self._joints[worst]} is {aside[worst]:.2f} rad off its targets"
            raise SensorFault(f"{seen}; is its motor off, its sign or its zero wrong, or is it blocked?")
        if opposed.max() > limits.opposed:
            seen = f"opposed: {self._joints[int(np.argmax(opposed))]} moves against its targets"
            raise SensorFault(f"{seen}; is its sign wrong, or are two joints exchanged?")
        shares = share[:12].max(), share[12], aside.max() / limits.off_target, opposed.max() / limits.opposed
        self._use(("joint velocity", "gyro", "off target", "opposed"), shares)

    def _use(self, names: Sequence[str], shares: Sequence[float]) -> None:
        for name, share in zip(names, shares, strict=True):
            self.used[name] = max(self.used.get(name, 0.0), float(share))


def _number(value: Any) -> float:
    """Return a value as a float; NaN where it is none."""
    try:
        return float(value)
    except Exception:  # whatever a driver hands over, the loop goes on
        return math.nan
