"""A run whose motors warm up, and the envelope that their temperatures leave them while
it is under way.

Before the clock starts the robot gets up to speed with motors as warm as the air. From
then on, heat may run faster than motion, as the gait is periodic and a motor's time
constants are a minute and more: at a pace of 4, a second of running heats the motors as
4 seconds do. A pace of 1 is the run as it would be.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float

from bp2_rl.env.controller import motors_of
from bp2_rl.learning.policy import Policy
from bp2_rl.paper.motor_heat import Network, Temperatures, advance, heated
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator, winding_heat
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.metrics import envelope_use
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.simulator import Simulator
from bp2_rl.simulation.trajectory import Trajectory

Cause = Literal["winding", "torque margin", "fall", "none"]
EASING = 2.0  # s under the last command till the gait is steady
WINDOW = 6.0  # s of running, over which work and speed are averaged
# of the cold speed: a robot that makes good less over a second has no torque margin
# left
MARGIN = 0.95
# ms of running, after which the motors get the envelope of their temperatures
UPDATE = 50
POINTS = 6000  # of a cloud of torque over speed
DT = conventions.PHYSICS_STEP
SECOND, WINDOW_STEPS = round(1.0 / DT), round(WINDOW / DT)


class Heating:
    """A `Watch` of a run: warms the motors, and ends the run when they are too hot or
    too weak.

    Args:
        network: the motors' heat.
        cold: the motors at T_0.
        start: s into the run, when the clock starts, a multiple of `UPDATE`.
        pace: how many seconds of heat a second of running stands for.
        limit: C, of a winding.
    """

    def __init__(
        self,
        network: Network,
        cold: Actuator,
        *,
        start: float,
        pace: float = 1.0,
        limit: float = math.inf,
    ):
        self.network, self.cold, self.pace, self.limit = network, cold, pace, limit
        self.start = round(start / DT)  # ms
        self.history = [
            Temperatures.uniform(float(network.air), (conventions.NUM_MOTORS,))
        ]  # at the start of each update
        self.over: Cause | None = None  # why the run was ended, if it was
        self._step = 0  # ms of running so far
        # W x ms since the last update, of cold motors
        self._heat = np.zeros(conventions.NUM_MOTORS)
        self._places: list[np.ndarray] = []  # m, where the trunk was at the updates

    def __call__(
        self, simulator: Simulator, robot: int, torque: Float[np.ndarray, "12"]
    ) -> bool:
        """Return whether a robot's run ends, after a millisecond under this torque,
        Nm."""
        since, self._step = self._step - self.start, self._step + 1
        if since >= 0:
            self._heat += winding_heat(self.cold, torque)
        if (since + 1) % UPDATE == 0:
            self._places.append(simulator.qpos[robot, :2].copy())
            if since >= 0:
                simulator.set_motors(robot, self._warm_up())
        return self.over is not None

    @property
    def cold_speed(self) -> float:
        """m/s, made good over the last window before the clock starts; 0 where it never
        does."""
        return self._made_good(self._places[: self.start // UPDATE], WINDOW_STEPS)

    def _warm_up(self) -> Actuator:
        """Warm the motors up by the heat since the last update; return the motors that
        they are then."""
        now = advance(
            self.network, self.history[-1], self._heat / UPDATE, self.pace * UPDATE * DT
        )
        self.history.append(now)
        self._heat[:] = 0.0
        if np.max(now.winding) >= self.limit:
            self.over = "winding"
        elif self._made_good(self._places, SECOND) < MARGIN * self.cold_speed:
            self.over = "torque margin"
        return heated(self.cold, self.network, now)

    def _made_good(self, places: list[np.ndarray], steps: int) -> float:
        """m/s, over the last so many ms of these."""
        if len(places) <= steps // UPDATE:
            return 0.0
        return float(np.linalg.norm(places[-1] - places[-1 - steps // UPDATE])) / (
            steps * DT
        )


@dataclasses.dataclass(frozen=True)
class HeatingTry:
    """One run."""

    robot: HardwareSpec
    operator: HeadingHold
    rise: Ramp  # to the speed commanded, but for its hold
    network: Network
    limit: float  # C, of a winding
    longest: float  # s of heat
    pace: float
    cold_window: float = WINDOW  # s, the last before the clock starts

    @property
    def speed(self) -> float:
        """m/s, commanded."""
        return self.rise.target[0]

    def at(self, speed: float) -> "HeatingTry":
        """Return this try at another speed, m/s."""
        return dataclasses.replace(self, rise=dataclasses.replace(self.rise, to=speed))

    @property
    def ramp(self) -> Ramp:
        """The schedule."""
        return dataclasses.replace(
            self.rise, hold=EASING + self.cold_window + self.longest / self.pace
        )

    @property
    def start(self) -> float:
        """s into the run, when the clock starts: after a whole number of updates."""
        return (
            math.ceil((self.ramp.steady_from + EASING + self.cold_window) / DT / UPDATE)
            * UPDATE
            * DT
        )


@dataclasses.dataclass(frozen=True)
class HeatingCourse:
    """A run by the second of running, from the clock's start; motors as in
    `conventions.MOTOR_NAMES`."""

    time: tuple[float, ...]  # s of heat, of the seconds' middle
    winding: tuple[tuple[float, ...], ...]  # C
    case: tuple[tuple[float, ...], ...]  # C
    # share of the time on the envelope of the moment
    on_envelope: tuple[tuple[float, ...], ...]
    speed: tuple[float, ...]  # m/s, forward


@dataclasses.dataclass(frozen=True)
class AveragingWindow:
    """How every motor works over a window of running."""

    speed: float  # m/s, made good
    heat: tuple[float, ...]  # W, of the windings if they were at T_0, mean
    torque: tuple[float, ...]  # Nm, root mean square
    rate: tuple[float, ...]  # rad/s, root mean square
    on_envelope: tuple[float, ...]  # share of the time


@dataclasses.dataclass(frozen=True)
class EnduranceResult:
    """How a run with warming motors went."""

    commanded_speed: float  # m/s
    pace: float
    seconds: float  # of heat, from the clock's start to the end
    cause: Cause
    first: AveragingWindow  # the last before the clock's start
    last: AveragingWindow  # the one before the end
    winding: tuple[float, ...]  # C, at the end
    case: tuple[float, ...]  # C, at the end
    # samples of any motor outside the envelope of the moment: must be 0
    outside_envelope: int


@dataclasses.dataclass(frozen=True)
class HeatedRun:
    """A run, and what its figures need."""

    endured: EnduranceResult
    course: HeatingCourse
    time: Float[np.ndarray, " M"]  # s of heat, of some milliseconds, drawn at random
    rate: Float[np.ndarray, "M 12"]  # rad/s, then
    torque: Float[np.ndarray, "M 12"]  # Nm, then


def run_hot(policy: Policy, tries: Sequence[HeatingTry]) -> list[HeatedRun]:
    """Run robots until a winding is too hot, they have no torque margin left, they
    fall, or it was long enough."""
    return simulate_all(
        _measure, policy, [_watched(policy.card.env, one) for one in tries]
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Watched(RunRequest):
    cold_window: float  # s


def _watched(config: EnvConfig, one: HeatingTry) -> _Watched:
    cold = motors_of(dataclasses.replace(config, hardware=one.robot))
    heating = Heating(
        one.network, cold, start=one.start, pace=one.pace, limit=one.limit
    )
    return _Watched(
        one.ramp, one.robot, one.operator, watch=heating, cold_window=one.cold_window
    )


def _measure(one: _Watched, run: Trajectory) -> HeatedRun:
    assert isinstance(one.watch, Heating)
    return hot_run(run, one.watch, one.cold_window)


def hot_run(
    run: Trajectory, heating: Heating, cold_window: float = WINDOW
) -> HeatedRun:
    """What a watched run comes to, with its last `cold_window` seconds before the
    clock's start."""
    history, cold, start = heating.history, heating.cold, heating.start
    winding, case = (
        np.stack([getattr(t, part) for t in history]) for part in ("winding", "case")
    )
    update = np.clip((np.arange(len(run)) - start) // UPDATE, 0, len(history) - 1)
    motors = heated(cold, heating.network, Temperatures(winding[update], case[update]))
    use, end, pace = envelope_use(run, motors), len(run), heating.pace

    def window(stop: int, steps: int) -> AveragingWindow:
        part = slice(max(stop - steps, 0), max(stop, 1))
        torque, rate = run.torque[part], run.joint_velocity[part]
        return AveragingWindow(
            speed=float(np.linalg.norm(run.qpos[part][-1, :2] - run.qpos[part][0, :2]))
            / (len(torque) * DT),
            heat=_each(np.mean(winding_heat(cold, torque), axis=0)),
            torque=_each(np.sqrt(np.mean(torque**2, axis=0))),
            rate=_each(np.sqrt(np.mean(rate**2, axis=0))),
            on_envelope=_each(np.mean(use.near[part], axis=0)),
        )

    seconds = np.arange(start, end - SECOND + 1, SECOND)  # the first sample of each
    middle = update[seconds + SECOND // 2]
    clock = np.arange(start, end)
    shown = np.sort(
        np.random.default_rng(0).choice(clock, min(POINTS, len(clock)), replace=False)
    )
    return HeatedRun(
        endured=EnduranceResult(
            # it was told in float32
            commanded_speed=round(float(run.command[-1, 0]), 6),
            pace=pace,
            seconds=_seconds(run, heating),
            cause="fall" if run.fell_at is not None else heating.over or "none",
            first=window(min(start, end), round(cold_window / DT)),
            last=window(end, WINDOW_STEPS),
            winding=_each(winding[-1]),
            case=_each(case[-1]),
            outside_envelope=int(np.sum(use.outside)),
        ),
        course=HeatingCourse(
            time=_each(pace * DT * (seconds - start + SECOND / 2)),
            winding=tuple(map(_each, winding[middle])),
            case=tuple(map(_each, case[middle])),
            on_envelope=tuple(
                _each(np.mean(use.near[k : k + SECOND], axis=0)) for k in seconds
            ),
            speed=_each(
                np.array(
                    [np.mean(run.ground_velocity[k : k + SECOND, 0]) for k in seconds]
                )
            ),
        ),
        time=pace * DT * (shown - start),
        rate=run.joint_velocity[shown],
        torque=run.torque[shown],
    )


def _seconds(run: Trajectory, heating: Heating) -> float:
    """Return the heating time, s, from the clock's start to the end, or to the instant
    when a winding got too hot."""
    if heating.over != "winding":
        return max(heating.pace * (len(run) - heating.start) * DT, 0.0)
    before, after = (np.max(t.winding) for t in heating.history[-2:])
    share = (heating.limit - before) / (after - before)
    return float(heating.pace * UPDATE * DT * (len(heating.history) - 2 + share))


def _each(values: Float[np.ndarray, " _"]) -> tuple[float, ...]:
    return tuple(round(float(value), 4) for value in values)
