"""The watchdog: checks every measurement, and stops the policy if sensors, clocks or
links give impossible values.

A fault has a name, which is in the table of docs/deploy.md, and one line: what is seen,
and what is probably wrong. Single values are compared with limits at once. Over each
`window` of time, joint speeds are compared with the change of joint angles, the gyro
with the change of `up`, and joint angles with their targets.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .contents import JointFrame, Settings, WatchdogLimits


class SensorReading(NamedTuple):
    """One measurement of the encoders and the IMU.

    Joints are in the order of `joints` in `deploy.json`.
    """

    joint_position: np.ndarray  # (12) rad
    joint_velocity: np.ndarray  # (12) rad/s
    # (3) the world's vertical in the body frame (x forward, y left, z up)
    up: np.ndarray
    angular_velocity: np.ndarray  # (3) rad/s, body frame
    time: float  # s, arrival time, by the clock of `step`


class SensorFault(Exception):
    """A fault for which the policy is stopped; the message is `name: what is seen; what
    is probably wrong`."""


SENSORS = {"joint_position": 12, "joint_velocity": 12, "up": 3, "angular_velocity": 3}
"""Number of values in each array of a measurement."""
Q, QD, UP, GYRO = slice(0, 12), slice(12, 24), slice(24, 27), slice(27, 30)
HUGE = 1e100  # of any sensor's unit
CLOCK = "stamp a measurement on arrival with the clock of `now`, by default time.monotonic(), in seconds"


class Watchdog:
    """Checks measurements and targets, keeps the newest measurement, and raises
    `SensorFault` for impossible ones.

    Args:
        settings: the content of `deploy.json`.
        frame: of the measurements' joint angles.
    """

    def __init__(self, settings: Settings, frame: JointFrame):
        self.limits = WatchdogLimits(**settings["watchdog"])
        self._frame, self._joints = frame, frame.names
        self._dt = 1.0 / settings["rates"]["policy"]
        self._range = np.array(settings["joint_range"])
        self._middle = self._range.mean(axis=1)
        self._half = np.ptp(self._range, axis=1) / 2.0
        self.used: dict[str, float] = {}
        """Largest share of each limit that was reached so far, by the fault's name;
        above 1 is a fault."""
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

    def look(
        self, given: object, now: object, target: np.ndarray
    ) -> SensorReading | None:
        """Check a new measurement and the clock; return the newest measurement, None
        before the first.

        Args:
            given: the caller's measurement; None if there is none.
            now: s, by the controller's clock.
            target: rad, the joint targets in force.

        Raises:
            SensorFault: what is given cannot be, or there has been nothing new for too
                long.
        """
        limits, time = self.limits, _number(now)
        latest = math.inf if self._newest is None else self._now + limits.window
        if not self._now <= time <= latest or math.isinf(time):
            raise SensorFault(
                f"clock: `now` went from {self._now:g} to {time:g} s between two calls; use a clock that only goes "
                "on, and call `step` every 5 ms"
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
        unheard = self._unheard * self._dt / limits.rate
        self._judge(
            "silence",
            max(time - self._heard, unheard) / limits.silence,
            lambda: (
                f"no new measurement for {1e3 * (time - self._heard):.0f} ms and {self._unheard} calls; is the link "
                "up, do its time and `now` go on?"
            ),
        )
        counted = max(
            self._ticks * self._dt / limits.rate,
            self._now - self._counted_from - limits.window,
        )
        if counted > limits.window + limits.silence:
            self._require_rate()
        return self._newest

    def check_targets(
        self, position: np.ndarray, velocity: np.ndarray, before: np.ndarray
    ) -> None:
        """Raise SensorFault for joint targets that are not finite, too fast, or too far
        from the last.

        Args:
            position: rad, which the caller keeps within the joints' ranges.
            velocity: rad/s.
            before: rad, the targets of the tick before.

        Raises:
            SensorFault: a target must not leave.
        """
        step = np.abs(position - before) / self.limits.target_step
        share = np.maximum(step, np.abs(velocity) / self.limits.joint_speed)
        self._judge_joints(
            "targets",
            share,
            lambda joint: (
                f"is told {share[joint]:.3g} of the largest step or speed; is reference.npz or deploy.json damaged?"
            ),
        )

    # --- One measurement --------------------------------------------------------------

    def _read(self, given: object) -> tuple[np.ndarray, float]:
        """Return the 30 values of a measurement as an array in the bundle's joint
        frame, and its time."""
        try:
            *parts, stamp = given  # pyright: ignore[reportGeneralTypeIssues]
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
            named = zip((*SENSORS, "time"), (*arrays, np.array(time)), strict=True)
            wrong = next(name for name, part in named if not np.isfinite(part).all())
            raise SensorFault(
                f"not finite: {wrong}; a sensor is unplugged or its driver failed"
            )
        # huge ones so that no share of a limit overflows
        values = np.minimum(np.maximum(values, -HUGE), HUGE)
        joints = values[: UP.start].reshape(2, 12)
        values[: UP.start] = self._frame.inward(joints).ravel()
        return values, time

    def _compare_with_limits(self, values: np.ndarray) -> None:
        """Raise SensorFault if a value of a measurement is beyond its sensor's
        limit."""
        limits, q, qd = self.limits, values[Q], values[QD]
        self._judge_joints(
            "range",
            (np.abs(q - self._middle) - self._half) / limits.joint_margin,
            lambda joint: (
                f"is at {q[joint]:.2f} rad, beyond {self._range[joint, 0]:g} to {self._range[joint, 1]:g}; is it in "
                "degrees, is its sign or its zero wrong?"
            ),
        )
        self._judge_joints(
            "joint speed",
            np.abs(qd) / limits.joint_speed,
            lambda joint: (
                f"has {qd[joint]:.0f} rad/s, more than {limits.joint_speed:g}; is it in deg/s or rpm, or before the "
                "gear?"
            ),
        )
        x, y, z, *gyro = values[UP.start :].tolist()
        fastest = max(gyro, key=abs)
        self._judge(
            "turning",
            abs(fastest) / limits.turning,
            lambda: (
                f"angular_velocity has {fastest:.0f} rad/s, more than {limits.turning:g}; is it in deg/s?"
            ),
        )
        length = math.hypot(x, y, z)
        self._judge(
            "up",
            abs(length - 1.0) / limits.up_length,
            lambda: f"its length is {length:.2f}, not 1; is it an acceleration?",
        )
        tilt = math.acos(max(-1.0, min(z / length, 1.0)))
        self._judge(
            "tilt",
            tilt / limits.tilt,
            lambda: (
                f"up is ({x:.2f}, {y:.2f}, {z:.2f}), {math.degrees(tilt):.0f} deg off; has the robot fallen over, or "
                "is up gravity (it is 0, 0, 1 when level)?"
            ),
        )

    def _accept(self, values: np.ndarray, stamp: float, target: np.ndarray) -> None:
        """Store a new measurement; check its time, and compare it with the measurements
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
        change, jump = np.concatenate((values[Q], values[UP])), values[UP] - last.up
        gap, off = change - self._travel, values[Q] - target
        row = np.concatenate((change, self._travel, gap, target, off, jump))
        self._count += 1
        self._sum += row
        self._squares += row * row
        if stamp - self._began >= limits.window:
            self._compare_changes()
            self._count_calls()
            self._begin(rate, stamp)

    # --- Measurements one after another -----------------------------------------------

    def _begin(self, rate: np.ndarray, stamp: float) -> None:
        """Start a new window of measurements."""
        self._rate, self._travel = rate, np.zeros(15)
        self._sum, self._squares, self._count = np.zeros(72), np.zeros(72), 0
        self._began = stamp

    def _count_calls(self) -> None:
        """Restart the count of calls of `step`, which a pause between measurements does
        not end."""
        self._counted_from, self._ticks = self._now, 0

    def _find_frozen(self, stamp: float, target: np.ndarray) -> None:
        """Raise SensorFault for values that do not change: of the IMU, or of a joint
        whose target moves."""
        still = stamp - self._since
        for name, place in (("up", UP), ("angular_velocity", GYRO)):
            repeated = float(still[place].min())
            self._judge(
                "frozen",
                repeated / self.limits.frozen,
                lambda name=name, repeated=repeated: (
                    f"{name} has repeated its values for {1e3 * repeated:.0f} ms, with new stamps; does its driver "
                    "still read the IMU?"
                ),
            )
        moved = np.abs(target - self._held) / self.limits.frozen_target
        self._judge_joints(
            "frozen",
            np.minimum(still[Q] / self.limits.frozen, moved),
            lambda joint: (
                f"has repeated its angle for {1e3 * still[joint]:.0f} ms while its target moved; does its driver still "
                "read the encoder?"
            ),
        )

    def _require_rate(self) -> None:
        """Raise SensorFault if `step` is called at another rate than the policy's."""
        calls = self._ticks / max(self._now - self._counted_from, 1e-9)
        if not 1.0 / self.limits.rate <= calls * self._dt <= self.limits.rate:
            raise SensorFault(
                f"rate: `step` is called {calls:.4g} times a second, not {1.0 / self._dt:.0f}"
            )

    def _compare_changes(self) -> None:
        """Check, over a window, speeds against changes of position, joints against
        targets, and the rate of `step` calls."""
        self._require_rate()
        limits, mean = self.limits, self._sum / self._count
        variance = np.maximum(self._squares / self._count - mean * mean, 0.0)
        up, gyro, gap, jump = (
            variance.reshape(24, 3)[[4, 9, 14, 23]].sum(axis=1).tolist()
        )
        # Noise of `up` is in its change alone; half of its jumps from one measurement
        # to the next is noise.
        self._compare_up(np.array((up - jump / 2.0, gyro, (up + gyro - gap) / 2.0)))
        change, travel, apart = np.sqrt(variance[:45].reshape(3, 15)[:, Q])
        mismatch = limits.mismatch * np.maximum(change, travel)

        def wrong_speed(joint: int) -> str:
            times = travel[joint] / max(change[joint], 1e-9)
            against = apart[joint] > math.hypot(change[joint], travel[joint])
            sign = " and against it" if against else ""
            return f"has {times:.2g} times the speed at which its angle changes{sign}; check its unit and its sign"

        share = apart / np.hypot(limits.joint_noise, mismatch)
        self._judge_joints("joint velocity", share, wrong_speed)
        self._compare_targets(
            variance[Q], variance[45:57], variance[57:69], np.abs(mean[57:69])
        )

    def _compare_up(self, powers: np.ndarray) -> None:
        """Compare the rotation of `up` with the gyro over a window; raise SensorFault
        if they differ."""
        limits = self.limits
        self._turned = 0.5 * (self._turned + powers)
        up, gyro, shared = self._turned.tolist()
        larger = max(up, gyro, limits.turned**2)
        alike = shared / larger if larger > limits.turned**2 else 1.0
        self._judge(
            "gyro",
            (1.0 - alike) / limits.unlike,
            lambda: (
                f"angular_velocity is {math.sqrt(gyro / max(up, 1e-12)):.2g} times what up turns by, {alike:.0%} alike; "
                "is it in deg/s, is a sign or an axis wrong, one dead?"
            ),
        )

    def _compare_targets(
        self, joint: np.ndarray, target: np.ndarray, off: np.ndarray, aside: np.ndarray
    ) -> None:
        """Compare joints with their targets by variances and mean; raise SensorFault
        for wrong or dead joints."""
        limits, swing = self.limits, self.limits.swing**2
        aside = aside / limits.off_target
        self._judge_joints(
            "off target",
            aside,
            lambda joint: (
                f"is {aside[joint]:.3g} of `off_target` off; is its motor off, its sign or its zero wrong, or is it "
                "blocked?"
            ),
        )
        swinging = np.minimum(joint, target) > swing
        against = np.where(swinging, (off - joint - target) / 2.0, 0.0)
        self._judge_joints(
            "opposed",
            against / np.sqrt(np.maximum(joint * target, 1e-12)) / limits.opposed,
            lambda _: (
                "moves against its targets; is its sign wrong, or are two joints exchanged?"
            ),
        )
        moving = np.where(target > 2.25 * swing, target, 0.0)
        self._judge_joints(
            "still",
            limits.still * np.sqrt(moving / np.maximum(joint, 1e-12)),
            lambda _: (
                "hardly moves while its target does; is its encoder dead, its motor off, or is it blocked?"
            ),
        )

    def _judge_joints(
        self, name: str, shares: np.ndarray, seen: Callable[[int], str]
    ) -> None:
        """Record the largest of the joints' shares of a limit; raise SensorFault if it
        is above 1 or NaN."""
        worst = int(np.argmax(shares))
        self._judge(
            name, float(shares[worst]), lambda: f"{self._joints[worst]} {seen(worst)}"
        )

    def _judge(self, name: str, share: float, seen: Callable[[], str]) -> None:
        """Record a share of a limit; raise SensorFault if it is above 1 or NaN."""
        if not share <= 1.0:
            raise SensorFault(f"{name}: {seen()}")
        self.used[name] = max(self.used.get(name, 0.0), share)


def _number(value: object) -> float:
    """Convert a value to a float; NaN if that fails."""
    try:
        return float(value)  # pyright: ignore[reportArgumentType]
    except Exception:  # whatever a driver hands over, the loop goes on
        return math.nan
