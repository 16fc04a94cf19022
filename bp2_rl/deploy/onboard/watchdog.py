"""The watchdog: it looks at every measurement and stops the policy where sensors,
clocks or links say what cannot be.

A fault has a name, which is in the table of docs/deploy.md, and one line: what is seen,
and what is probably wrong. Single values are compared with limits at once. Over each
`window` of time, joint speeds are compared with the change of joint angles, the gyro
with the change of `up`, and joint angles with their targets.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from .contents import Settings
from .joints import JointFrame


class SensorReading(NamedTuple):
    """What encoders and IMU report; joints in the order of `joints` in
    `deploy.json`."""

    joint_position: np.ndarray  # (12) rad
    joint_velocity: np.ndarray  # (12) rad/s
    # (3) the world's vertical in the body frame (x forward, y left, z up)
    up: np.ndarray
    angular_velocity: np.ndarray  # (3) rad/s, body frame
    time: float  # s, when it arrived, by the clock whose time `step` is told


class SensorFault(Exception):
    """A reason to stop the policy: `name: what is seen; what is probably wrong`."""


@dataclasses.dataclass(frozen=True)
class WatchdogLimits:
    """The limits of the watchdog, `watchdog` in `deploy.json`."""

    silence: float  # s without a new measurement, and s that a new one may be old
    # s, by which a measurement's time may be ahead of the controller's clock
    ahead: float
    # factor, by which the rate of the calls of `step` may differ from the policy's
    rate: float
    stand_time: float  # s, in which the joints are led to the standing pose
    braking: float  # m/s2, at which the command falls where the operator says nothing
    joint_margin: float  # rad, by which a joint may be beyond its range
    joint_speed: float  # rad/s, of a joint and of its target
    target_step: float  # rad, by which a target may change in a tick
    turning: float  # rad/s, of the trunk
    up_length: float  # by which the length of `up` may differ from 1
    tilt: float  # rad, between `up` and the trunk's z axis
    frozen: float  # s, for which a sensor may repeat its value with new stamps
    # rad, by which a joint's target moves before an encoder that repeats its value is
    # frozen
    frozen_target: float
    window: float  # s, over which speeds, changes and targets are compared
    # of an integrated speed from the joint's change that it belongs to: share of the
    # larger of both
    mismatch: float
    joint_noise: float  # rad, which is added to that share
    # least standard deviation of the changes of `up` at which they are compared with
    # the gyro
    turned: float
    # share of what `up`, or the gyro, turns by that the other may not have
    unlike: float
    off_target: float  # rad, of a joint's mean from its targets' mean
    # correlation of a joint with its target, as a negative number's size
    opposed: float
    # rad, the least standard deviation of both for which a correlation counts
    swing: float
    # least standard deviation of a joint over that of its target, where the target's is
    # 1.5 times `swing`
    still: float


SENSORS = {"joint_position": 12, "joint_velocity": 12, "up": 3, "angular_velocity": 3}
"""Entries of each array of a measurement."""
STARTS = np.cumsum([0, *list(SENSORS.values())[:-1]])
Q, QD, UP, GYRO = (
    slice(start, start + size)
    for start, size in zip(STARTS, SENSORS.values(), strict=True)
)
WRONG_JOINTS = {
    "targets": "is told {:.3g} of the largest step or speed; is reference.npz or deploy.json damaged?",
    "off target": "is {:.3g} of `off_target` off; is its motor off, its sign or its zero wrong, or is it blocked?",
    "opposed": "moves against its targets; is its sign wrong, or are two joints exchanged?",
    "still": "hardly moves while its target does; is its encoder dead, its motor off, or is it blocked?",
}
"""What is seen of a joint that uses such a share of a limit, and what is probably
wrong."""
CLOCK = "stamp a measurement on arrival with the clock of `now`, by default time.monotonic(), in seconds"


class Watchdog:
    """Keeps the newest sound measurement, and raises `SensorFault` for what cannot be.

    Args:
        settings: the content of `deploy.json`.
        frame: of the measurements' joint angles.
    """

    def __init__(self, settings: Settings, frame: JointFrame):
        self.limits = limits = WatchdogLimits(**settings["watchdog"])
        self._frame, self._joints, self._dt = (
            frame,
            frame.names,
            1.0 / settings["rates"]["policy"],
        )
        self._range = np.array(settings["joint_range"])
        self._middle = np.concatenate((self._range.mean(axis=1), np.zeros(18)))
        # Beyond `_free` a value uses up its limit, and has used it up `_spare` further
        # on.
        self._free = np.concatenate((np.ptp(self._range, axis=1) / 2.0, np.zeros(18)))
        self._spare = np.repeat(
            (
                limits.joint_margin,
                limits.joint_speed,
                1.0 + limits.up_length,
                limits.turning,
            ),
            list(SENSORS.values()),
        )
        self._reach = self._free + self._spare
        self.used: dict[str, float] = {}
        """The largest share of each limit that measurements have used up so far, by the
        fault's name; 1 is a fault."""
        self.reset()

    def reset(self) -> None:
        """Forget all measurements."""
        self._now, self._counted_from = -math.inf, math.inf
        self._newest: SensorReading | None = None
        # when the newest came in, and how many calls ago
        self._heard, self._unheard = math.inf, 0
        self._turned = np.zeros(3)
        self._values = np.full(30, np.nan)
        # when each value changed last, and each joint's target
        self._since, self._held = np.zeros(30), np.zeros(12)

    def look(self, given: Any, now: Any, target: np.ndarray) -> SensorReading | None:
        """Return the newest measurement, or None before the first.

        Args:
            given: what the caller has for a measurement; None where there is none.
            now: s, by the controller's clock.
            target: rad, the joint targets in force.

        Raises:
            SensorFault: what is given cannot be, or there has been nothing new for too
                long.
        """
        limits, time = self.limits, _number(now)
        latest = math.inf if self._newest is None else self._now + limits.window
        if not self._now <= time <= latest or math.isinf(time):
            seen = f"`now` went from {self._now:g} to {time:g} s between two calls"
            raise SensorFault(
                f"clock: {seen}; use a clock that only goes on, and call `step` every 5 ms"
            )
        self._now = time
        self._ticks, self._unheard = (
            (0, 0) if self._newest is None else (self._ticks + 1, self._unheard + 1)
        )
        if given is not None:
            values, stamp = self._read(given)
            self._compare_with_limits(values)
            if self._newest is None or stamp > self._newest.time:
                self._accept(values, stamp, target)
        if (
            time - self._heard > limits.silence
            or self._unheard * self._dt > limits.rate * limits.silence
        ):
            seen = f"no new measurement for {1e3 * (time - self._heard):.0f} ms and {self._unheard} calls"
            raise SensorFault(
                f"silence: {seen}; is the link up, do its time and `now` go on?"
            )
        counted = self._now - self._counted_from
        if (
            max(self._ticks * self._dt / limits.rate, counted - limits.window)
            > limits.window + limits.silence
        ):
            self._require_rate()
        return self._newest

    def check_targets(
        self, position: np.ndarray, velocity: np.ndarray, before: np.ndarray
    ) -> None:
        """Look at joint targets before they leave.

        Args:
            position: rad, which the caller keeps within the joints' ranges.
            velocity: rad/s.
            before: rad, the targets of the tick before.

        Raises:
            SensorFault: a target is not finite, too fast, or too far from the one
                before.
        """
        step, speed = (
            (position - before) / self.limits.target_step,
            velocity / self.limits.joint_speed,
        )
        self._judge("targets", np.maximum(np.abs(step), np.abs(speed)))

    # --- One measurement --------------------------------------------------------------

    def _read(self, given: Any) -> tuple[np.ndarray, float]:
        """Return a copy of the 30 numbers of a measurement, and its time; lists of
        numbers are read as arrays."""
        try:
            *parts, stamp = given
            arrays = [np.asarray(part) for part in parts]
        except Exception:  # whatever a driver hands over, the loop goes on
            arrays, stamp = [], math.nan
        if len(arrays) != len(SENSORS):
            raise SensorFault(
                "form: the measurement is no SensorReading of four arrays and a time"
            )
        for (name, size), array in zip(SENSORS.items(), arrays, strict=True):
            if array.dtype.kind not in "fiu" or array.dtype.itemsize > 8:
                raise SensorFault(
                    f"form: {name} holds {array.dtype}, not {size} real numbers"
                )
            if array.shape != (size,):
                raise SensorFault(
                    f"form: {name} has the shape {array.shape}, not ({size},)"
                )
        values, time = np.concatenate(arrays, dtype=float), _number(stamp)
        if not (math.isfinite(time) and np.isfinite(values).all()):
            wrong = [
                name
                for name, array in zip(SENSORS, arrays, strict=True)
                if not np.isfinite(array).all()
            ]
            raise SensorFault(
                f"not finite: {(wrong or ['time'])[0]}; a sensor is unplugged or its driver failed"
            )
        values[: UP.start] = self._frame.inward(
            values[: UP.start].reshape(2, 12)
        ).ravel()
        return values, time

    def _compare_with_limits(self, values: np.ndarray) -> None:
        """Compare each value with the limit of its sensor."""
        beyond = np.abs(values - self._middle)
        if (beyond > self._reach).any():
            worst = int(np.argmax(beyond - self._reach > 0.0))
            value, joint = values[worst], self._joints[worst % 12]
            if worst < 12:
                low, high = self._range[worst]
                seen = (
                    f"range: {joint} is at {value:.2f} rad, beyond {low:g} to {high:g}"
                )
                raise SensorFault(
                    f"{seen}; is it in degrees, is its sign or its zero wrong?"
                )
            if worst < 24:
                seen = f"joint speed: {joint} has {value:.0f} rad/s, more than {self.limits.joint_speed:g}"
                raise SensorFault(f"{seen}; is it in deg/s or rpm, or before the gear?")
            if worst >= GYRO.start:
                seen = f"turning: angular_velocity has {value:.0f} rad/s, more than {self.limits.turning:g}"
                raise SensorFault(f"{seen}; is it in deg/s?")
        x, y, z = values[UP].tolist()
        length = math.hypot(x, y, z)
        if abs(length - 1.0) > self.limits.up_length:
            raise SensorFault(
                f"up: its length is {length:.2f}, not 1; is it an acceleration?"
            )
        tilt = math.acos(max(-1.0, min(z / length, 1.0)))
        if tilt > self.limits.tilt:
            why = "has the robot fallen over, or is up gravity (it is 0, 0, 1 when level)?"
            raise SensorFault(
                f"tilt: up is ({x:.2f}, {y:.2f}, {z:.2f}), {math.degrees(tilt):.0f} deg off; {why}"
            )
        q, qd, _, turning = np.maximum.reduceat(
            (beyond - self._free) / self._spare, STARTS
        )
        up = abs(length - 1.0) / self.limits.up_length
        self._use(
            {
                "range": q,
                "joint speed": qd,
                "up": up,
                "turning": turning,
                "tilt": tilt / self.limits.tilt,
            }
        )

    def _accept(self, values: np.ndarray, stamp: float, target: np.ndarray) -> None:
        """Keep a new measurement; look at its time, and at it beside the ones
        before."""
        limits, age = self.limits, self._now - stamp
        if age < -limits.ahead:
            raise SensorFault(
                f"clock: a measurement's time is {-age:.3g} s ahead of the controller's; {CLOCK}"
            )
        if age > limits.silence:
            raise SensorFault(
                f"clock: a new measurement's time is {age:.3g} s old; does it come late? Else {CLOCK}"
            )
        x, y, z, a, b, c = values[UP.start :].tolist()
        # of angles and of up
        rate = np.concatenate(
            (values[QD], (y * c - z * b, z * a - x * c, x * b - y * a))
        )
        last, self._heard, self._unheard = self._newest, self._now, 0
        self._newest = SensorReading(
            values[Q], values[QD], values[UP], values[GYRO], stamp
        )
        changed = values != self._values
        self._since[changed], self._values = stamp, values
        self._held[changed[Q]] = target[changed[Q]]
        if last is None:
            self._count_calls()
        if last is None or stamp - last.time > limits.silence:
            self._begin(rate, stamp)
            return
        self._find_frozen(stamp, target)
        self._travel += 0.5 * (rate + self._rate) * (stamp - last.time)
        self._rate = rate
        change = np.concatenate((values[Q], values[UP]))
        jump = values[UP] - last.up
        row = np.concatenate(
            (
                change,
                self._travel,
                change - self._travel,
                target,
                values[Q] - target,
                jump,
            )
        )
        self._count += 1
        self._sum += row
        self._squares += row * row
        if stamp - self._began >= limits.window:
            self._compare_changes()
            self._count_calls()
            self._begin(rate, stamp)

    # --- Measurements one after another -----------------------------------------------

    def _begin(self, rate: np.ndarray, stamp: float) -> None:
        """Begin a window."""
        self._rate, self._travel = rate, np.zeros(15)
        self._sum, self._squares, self._count = np.zeros(72), np.zeros(72), 0
        self._began = stamp

    def _count_calls(self) -> None:
        """Count the calls of `step` from now on; a pause between measurements does not
        end the count."""
        self._counted_from, self._ticks = self._now, 0

    def _find_frozen(self, stamp: float, target: np.ndarray) -> None:
        """Look for values that do not change: never of an IMU that works, nor of a
        joint whose target moves."""
        limits, still = self.limits, stamp - self._since
        for name, place in (("up", UP), ("angular_velocity", GYRO)):
            if still[place].min() > limits.frozen:
                seen = f"frozen: {name} has repeated its values for {1e3 * still[place].min():.0f} ms"
                raise SensorFault(
                    f"{seen}, with new stamps; does its driver still read the IMU?"
                )
        stuck = (still[Q] > limits.frozen) & (
            np.abs(target - self._held) > limits.frozen_target
        )
        if stuck.any():
            joint = int(np.argmax(stuck))
            seen = f"frozen: {self._joints[joint]} has repeated its angle for {1e3 * still[joint]:.0f} ms"
            raise SensorFault(
                f"{seen} while its target moved; does its driver still read the encoder?"
            )

    def _require_rate(self) -> None:
        """Compare the calls of `step` that were counted with their rate."""
        calls = self._ticks / max(self._now - self._counted_from, 1e-9)
        if not 1.0 / self.limits.rate <= calls * self._dt <= self.limits.rate:
            raise SensorFault(
                f"rate: `step` is called {calls:.4g} times a second, not {1.0 / self._dt:.0f}"
            )

    def _compare_changes(self) -> None:
        """Compare speeds with changes, joints with their targets, and the calls of
        `step` with their rate."""
        self._require_rate()
        mean = self._sum / self._count
        variance = np.maximum(self._squares / self._count - mean * mean, 0.0)
        up, gyro, gap, jump = (
            variance.reshape(24, 3)[[4, 9, 14, 23]].sum(axis=1).tolist()
        )
        # Noise of `up` is in its change alone; half of its jumps from one measurement
        # to the next is noise.
        self._compare_up(np.array((up - jump / 2.0, gyro, (up + gyro - gap) / 2.0)))
        change, travel, gap = np.sqrt(variance[:45].reshape(3, 15)[:, Q])
        share = gap / np.hypot(
            self.limits.joint_noise, self.limits.mismatch * np.maximum(change, travel)
        )
        if share.max() > 1.0:
            worst = int(np.argmax(share))
            times = f"{travel[worst] / max(change[worst], 1e-9):.2g} times"
            sign = (
                " and against it"
                if gap[worst] > math.hypot(change[worst], travel[worst])
                else ""
            )
            seen = f"joint velocity: {self._joints[worst]} has {times} the speed at which its angle changes{sign}"
            raise SensorFault(f"{seen}; check its unit and its sign")
        self._use({"joint velocity": share.max()})
        self._compare_targets(
            variance[Q], variance[45:57], variance[57:69], np.abs(mean[57:69])
        )

    def _compare_up(self, powers: np.ndarray) -> None:
        """Compare what `up` turns by with the gyro: the power of both, and the power
        that they share."""
        limits = self.limits
        self._turned = 0.5 * (self._turned + powers)
        up, gyro, shared = self._turned.tolist()
        larger = max(up, gyro, limits.turned**2)
        share = (
            (1.0 - shared / larger) / limits.unlike
            if larger > limits.turned**2
            else 0.0
        )
        if share > 1.0:
            seen = f"gyro: angular_velocity is {math.sqrt(gyro / max(up, 1e-12)):.2g} times what up turns by"
            raise SensorFault(
                f"{seen}, {shared / larger:.0%} alike; is it in deg/s, is a sign or an axis wrong, one dead?"
            )
        self._use({"gyro": share})

    def _compare_targets(
        self, joint: np.ndarray, target: np.ndarray, off: np.ndarray, aside: np.ndarray
    ) -> None:
        """Compare joints with their targets: variances of both and of their difference,
        and its mean."""
        limits, swing = self.limits, self.limits.swing**2
        opposed = np.where(
            np.minimum(joint, target) > swing, (off - joint - target) / 2.0, 0.0
        )
        self._judge("off target", aside / limits.off_target)
        self._judge(
            "opposed",
            opposed / np.sqrt(np.maximum(joint * target, 1e-12)) / limits.opposed,
        )
        moving = np.where(target > 2.25 * swing, target, 0.0)
        self._judge("still", limits.still * np.sqrt(moving / np.maximum(joint, 1e-12)))

    def _judge(self, name: str, shares: np.ndarray) -> None:
        """Keep the largest of the joints' shares of a limit; raise a fault where it is
        above 1 or no number."""
        worst = int(np.argmax(shares))
        if not shares[worst] <= 1.0:
            raise SensorFault(
                f"{name}: {self._joints[worst]} {WRONG_JOINTS[name].format(shares[worst])}"
            )
        self._use({name: shares[worst]})

    def _use(self, shares: Mapping[str, float]) -> None:
        for name, share in shares.items():
            self.used[name] = max(self.used.get(name, 0.0), float(share))


def _number(value: Any) -> float:
    """Return a value as a float; NaN where it is none."""
    try:
        return float(value)
    except Exception:  # whatever a driver hands over, the loop goes on
        return math.nan
