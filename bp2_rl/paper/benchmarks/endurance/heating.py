"""Runs whose motors warm up, and whose torque-speed envelope follows the temperatures.

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

from bp2_rl.base.metric import metric
from bp2_rl.env.controller import motors_of
from bp2_rl.learning.policy import Policy
from bp2_rl.paper.motor_heat import Temperatures, advance, heated
from bp2_rl.paper.thermal_specs import MotorHeat
from bp2_rl.robot import conventions
from bp2_rl.robot.actuator import Actuator, winding_heat
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.measuring import envelope_use
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
    """A rollout's `Watch` that heats the motors, and ends the run when they are too hot
    or weak.

    Args:
        motor: the motors' thermal model.
        cold: the motors at T_0.
        start: s into the run, when the clock starts, a multiple of `UPDATE`.
        pace: how many seconds of heat a second of running stands for.
        window: s, the last before the clock starts, over which the cold gait counts.
    """

    def __init__(
        self,
        motor: MotorHeat,
        cold: Actuator,
        *,
        start: float,
        pace: float = 1.0,
        window: float = WINDOW,
    ):
        self.motor, self.cold, self.pace = motor, cold, pace
        self.window = round(window / DT)  # ms
        self.start = round(start / DT)  # ms
        self.history = [
            Temperatures.uniform(motor.air, (conventions.NUM_MOTORS,))
        ]  # at the start of each update
        self.over: Cause | None = None  # why the run was ended, if it was
        self._step = 0  # ms of running so far
        # W x ms since the last update, of cold motors
        self._heat = np.zeros(conventions.NUM_MOTORS)
        self._places: list[np.ndarray] = []  # m, where the trunk was at the updates

    def __call__(
        self, simulator: Simulator, robot: int, torque: Float[np.ndarray, "12"]
    ) -> bool:
        """Heat a robot's motors for a millisecond under `torque`, Nm; return whether
        the run ends."""
        since = self._step - self.start
        self._step += 1
        if since >= 0:
            self._heat += winding_heat(self.cold, torque)
        if (since + 1) % UPDATE == 0:
            self._places.append(simulator.qpos[robot, :2].copy())
            if since >= 0:
                simulator.set_motors(robot, self._warm_up())
        return self.over is not None

    def _warm_up(self) -> Actuator:
        """Warm the motors by the heat since the last update; return them with their new
        envelope."""
        now = advance(
            self.motor, self.history[-1], self._heat / UPDATE, self.pace * UPDATE * DT
        )
        self.history.append(now)
        self._heat[:] = 0.0
        before = self._places[: self.start // UPDATE]
        cold_speed = self._made_good(before, WINDOW_STEPS)
        if np.max(now.winding) >= self.motor.limit:
            self.over = "winding"
        elif self._made_good(self._places, SECOND) < MARGIN * cold_speed:
            self.over = "torque margin"
        return heated(self.cold, self.motor, now)

    def _made_good(self, places: list[np.ndarray], steps: int) -> float:
        """Return the mean speed over the last `steps` ms of trunk positions, m/s."""
        if len(places) <= steps // UPDATE:
            return 0.0
        way = places[-1] - places[-1 - steps // UPDATE]
        return float(np.linalg.norm(way)) / (steps * DT)


@dataclasses.dataclass(frozen=True)
class HeatingTry:
    """A run to simulate in which a robot's motors warm up while it holds a speed."""

    robot: HardwareSpec
    operator: HeadingHold
    rise: Ramp  # to the speed commanded, but for its hold
    motor: MotorHeat
    longest: float  # s of heat
    pace: float
    cold_window: float = WINDOW  # s, the last before the clock starts

    def at(self, speed: float) -> "HeatingTry":
        """Return the same run at another commanded speed, m/s."""
        return dataclasses.replace(self, rise=dataclasses.replace(self.rise, to=speed))

    @property
    def ramp(self) -> Ramp:
        """Schedule of the command: the rise to the speed, then the hold while the
        motors heat."""
        hold = EASING + self.cold_window + self.longest / self.pace
        return dataclasses.replace(self.rise, hold=hold)

    @property
    def start(self) -> float:
        """Time at which heating starts, s into the run: after a whole number of
        updates."""
        steady = self.ramp.steady_from + EASING + self.cold_window
        return math.ceil(steady / DT / UPDATE) * UPDATE * DT

    def request(self, config: EnvConfig) -> RunRequest:
        """Return the rollout request of this run, for a policy of the environment
        `config`."""
        heating = Heating(
            self.motor,
            motors_of(dataclasses.replace(config, hardware=self.robot)),
            start=self.start,
            pace=self.pace,
            window=self.cold_window,
        )
        return RunRequest(self.ramp, self.robot, self.operator, watch=heating)


@dataclasses.dataclass(frozen=True)
class HeatingCourse:
    """Temperatures of all windings at each second of running, from the start of
    heating."""

    time: tuple[float, ...]  # s of heat, of the seconds' middle
    winding: tuple[tuple[float, ...], ...]  # C, by motor as `MOTOR_NAMES`


@dataclasses.dataclass(frozen=True)
class AveragingWindow:
    """Mean speed, and each motor's heat, torque and joint speed, over a window of a
    run."""

    speed: float  # m/s, made good
    heat: tuple[float, ...]  # W, of the windings if they were at T_0, mean
    torque: tuple[float, ...]  # Nm, root mean square
    rate: tuple[float, ...]  # rad/s, root mean square
    on_envelope: tuple[float, ...]  # share of the time


def _show_shares(pair: tuple[float, float]) -> str:
    return f"{pair[0]:.1%}, {pair[1]:.1%}"


@dataclasses.dataclass(frozen=True, kw_only=True)
class EnduranceResult:
    """Metrics of a run with warming motors: duration, what ended the run,
    temperatures."""

    commanded_speed: float = metric("Commanded speed", "m/s", "g", card=True)
    speed: float = metric(
        "Speed", "m/s", ".2f", "cold; {m.last.speed:.2f} m/s at the end", card=True
    )
    pace: float
    seconds: float = metric("Lasted", "s", ".1f", "paper: 86 s at 10.74 m/s", card=True)
    cause: Cause = metric(
        "Ended by", form="s", meaning="winding: too hot; margin: too slow", card=True
    )
    motor: str = metric("Motor", form="s", meaning="that ended it", card=True)
    hottest: str = metric(
        "Hottest motor", form="s", meaning="at the end; paper: a rear hip"
    )
    hottest_winding: float = metric("Hottest winding", "°C", ".0f", card=True)
    hottest_case: float = metric("Hottest case", "°C", ".0f", "magnets", card=True)
    mean_rate: float = metric(
        "Mean rate", "K/s", ".2f", "of the hottest winding; paper: 1.8 K/s"
    )
    torque_growth: float = metric(
        "Torque cycle",
        form=".3f",
        meaning="hottest motor's RMS, last over first",
    )
    rate_growth: float = metric(
        "Speed cycle", form=".3f", meaning="its joint's RMS, last over first"
    )
    on_envelope: tuple[float, float] = metric(
        "On the envelope",
        form=_show_shares,
        meaning="hottest motor, first and last seconds",
    )
    outside_envelope: int = metric(
        "Outside the envelope", form="d", meaning="samples, of the hot one; must be 0"
    )
    first: AveragingWindow  # the last before the clock's start
    last: AveragingWindow  # the one before the end
    winding: tuple[float, ...]  # C, at the end
    case: tuple[float, ...]  # C, at the end


@dataclasses.dataclass(frozen=True)
class HeatedRun:
    """Result of a run with warming motors, with the samples that the figures show."""

    endured: EnduranceResult
    course: HeatingCourse
    time: Float[np.ndarray, " M"]  # s of heat, of some milliseconds, drawn at random
    rate: Float[np.ndarray, "M 12"]  # rad/s, then
    torque: Float[np.ndarray, "M 12"]  # Nm, then


def run_hot(policy: Policy, tries: Sequence[HeatingTry]) -> list[HeatedRun]:
    """Simulate runs until motors are too hot or weak, the robot falls or time is up;
    return the results."""
    requests = [one.request(policy.card.env) for one in tries]
    return simulate_all(_measure_heat, policy, requests)


def _measure_heat(one: RunRequest, run: Trajectory) -> HeatedRun:
    assert isinstance(one.watch, Heating)
    return measure_heat(run, one.watch)


def measure_heat(run: Trajectory, heating: Heating) -> HeatedRun:
    """Return the result of a run from its trajectory and the temperatures that
    `heating` kept."""
    history, start, pace = heating.history, heating.start, heating.pace
    end = len(run)
    winding = np.stack([now.winding for now in history])
    case = np.stack([now.case for now in history])
    update = np.clip((np.arange(end) - start) // UPDATE, 0, len(history) - 1)
    now = Temperatures(winding[update], case[update])
    use = envelope_use(run, heated(heating.cold, heating.motor, now))

    def window(stop: int, steps: int) -> AveragingWindow:
        part = slice(max(stop - steps, 0), max(stop, 1))
        torque = run.torque[part]
        rate = run.joint_velocity[part]
        places = run.qpos[part]
        way = float(np.linalg.norm(places[-1, :2] - places[0, :2]))
        return AveragingWindow(
            speed=way / (len(torque) * DT),
            heat=_each(np.mean(winding_heat(heating.cold, torque), axis=0)),
            torque=_each(np.sqrt(np.mean(torque**2, axis=0))),
            rate=_each(np.sqrt(np.mean(rate**2, axis=0))),
            on_envelope=_each(np.mean(use.near[part], axis=0)),
        )

    first, last = window(min(start, end), heating.window), window(end, WINDOW_STEPS)
    hot = int(np.argmax(winding[-1]))
    cause = "fall" if run.fell_at is not None else heating.over or "none"
    by_heat = cause in ("winding", "none")
    weak = hot if by_heat else int(np.argmax(last.on_envelope))
    lasted = _heating_time(run, heating)
    warmed = float(winding[-1, hot] - heating.motor.air)
    seconds = np.arange(start, end - SECOND + 1, SECOND)  # the first sample of each
    clock = np.arange(start, end)
    rng = np.random.default_rng(0)
    shown = np.sort(rng.choice(clock, min(POINTS, len(clock)), replace=False))
    return HeatedRun(
        endured=EnduranceResult(
            # it was told in float32
            commanded_speed=round(float(run.command[-1, 0]), 6),
            speed=first.speed,
            pace=pace,
            seconds=lasted,
            cause=cause,
            motor=conventions.MOTOR_NAMES[weak],
            hottest=conventions.MOTOR_NAMES[hot],
            hottest_winding=float(winding[-1, hot]),
            hottest_case=float(np.max(case[-1])),
            mean_rate=warmed / lasted if lasted > 0.0 else 0.0,
            torque_growth=_growth(first.torque[hot], last.torque[hot]),
            rate_growth=_growth(first.rate[hot], last.rate[hot]),
            on_envelope=(first.on_envelope[hot], last.on_envelope[hot]),
            outside_envelope=int(np.sum(use.outside)),
            first=first,
            last=last,
            winding=_each(winding[-1]),
            case=_each(case[-1]),
        ),
        course=HeatingCourse(
            time=_each(pace * DT * (seconds - start + SECOND / 2)),
            winding=tuple(map(_each, winding[update[seconds + SECOND // 2]])),
        ),
        time=pace * DT * (shown - start),
        rate=run.joint_velocity[shown],
        torque=run.torque[shown],
    )


def _heating_time(run: Trajectory, heating: Heating) -> float:
    """Return how long a run's motors heated, s, until its end or a winding's limit."""
    if heating.over != "winding":
        return max(heating.pace * (len(run) - heating.start) * DT, 0.0)
    before, after = (np.max(t.winding) for t in heating.history[-2:])
    share = (heating.motor.limit - before) / (after - before)
    return float(heating.pace * UPDATE * DT * (len(heating.history) - 2 + share))


def _growth(first: float, last: float) -> float:
    return last / first if first > 0.0 else 1.0


def _each(values: Float[np.ndarray, " _"]) -> tuple[float, ...]:
    return tuple(round(float(value), 4) for value in values)
