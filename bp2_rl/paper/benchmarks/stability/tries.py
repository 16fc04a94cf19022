"""Stability tests at one speed: under sensor noise, from deviations of the gait, and
with pushes."""

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float

from bp2_rl.learning.policy import Policy
from bp2_rl.paper.benchmarks.stability.group import GroupState, RobotGroup, join
from bp2_rl.paper.benchmarks.stability.measured import (
    PushMetrics,
    RadiusMetrics,
    SpeedMetrics,
    SpeedResult,
    Steady,
    measure_landings,
    measure_section,
    with_sections,
)
from bp2_rl.paper.benchmarks.stability.orbit import TICK, Coordinates, Orbit
from bp2_rl.paper.orbits import returns
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.kinematics import yaw_of
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.settings.env import RandomizationConfig
from bp2_rl.simulation.rollout import sampled_commands
from bp2_rl.simulation.schedule import Ramp

# m, rad, m/s, rad/s, Nm, actions: what counts as one for a coordinate that never moves
SMALLEST = 1e-6
DRAWS = 100  # of the bootstrap
ENOUGH = 4  # states a coordinate, for a map


@dataclasses.dataclass(frozen=True)
class Extent:
    """Extent of the stability tests: numbers of robots, strides, deviations and
    pushes."""

    robots: int = 6  # with noise
    strides: int = 105  # of each, measured
    easing: int = 10  # strides before, under the last command
    deviations: int = 300  # random ones, as large as the scatter under noise
    phases: int = 4  # of the clock, at which the robot is pushed ...
    ways: int = 8  # ... in so many directions
    hardest: float = 8.0  # m/s
    rounds: int = 5  # of bisection
    after: float = 1.2  # s that a push is survived


FULL = Extent()
QUICK = Extent(4, 30, 5, deviations=0, phases=1, ways=4, rounds=4, after=1.0)


@dataclasses.dataclass(frozen=True)
class StabilityTry:
    """Stability tests to run with a robot at one speed."""

    asked: float  # m/s
    speed: float  # m/s, with a stride of ...
    ticks: int  # ... so many control steps
    rise: Ramp  # to the speed, but for its hold
    robot: HardwareSpec
    operator: HeadingHold
    seed: int
    extent: Extent

    @property
    def period(self) -> float:
        """Return the duration of a stride, s."""
        return self.ticks * TICK

    def held(self, robots: int, strides: int) -> Float[np.ndarray, "K N 3"]:
        """Return the commands of `robots` robots that hold the speed for `strides`
        strides."""
        command = np.array([self.speed, 0.0, 0.0])
        return np.tile(command, (strides * self.ticks, robots, 1))

    def group(
        self, policy: Policy, noise: RandomizationConfig | None = None
    ) -> RobotGroup:
        """Return a simulated group of the robot under a policy, with sensor noise or
        without."""
        return RobotGroup(
            policy,
            policy.card.env,
            hardware=self.robot,
            operator=self.operator,
            noise=noise,
        )


def try_speed(policy: Policy, one: StabilityTry) -> SpeedResult:
    """Run a policy at one speed with and without sensor noise, push it, and return the
    results."""
    extent = one.extent
    group = one.group(policy, RandomizationConfig())
    # of the noise: the last robot has none
    share = np.append(np.ones(extent.robots), 0.0)
    commands = sampled_commands(
        dataclasses.replace(one.rise, hold=one.period * extent.easing)
    )
    start = group.standing(len(share), commands[0])
    scheduled = np.repeat(commands[1:, None], len(share), axis=1)
    eased, down, _ = group.run(start, scheduled, seed=one.seed, noisy=share)
    starts: list[GroupState] = []  # of the strides
    passed: list[GroupState] = []  # of the robot without noise, in the last stride

    def keep(step: int, moment: GroupState) -> None:
        if (step + 1) % one.ticks == 0:
            starts.append(moment)
        if step >= (extent.strides - 1) * one.ticks - 1:
            passed.append(moment.of([-1]))

    last, fell, log = group.run(
        eased,
        one.held(len(share), extent.strides),
        seed=one.seed + 1,
        noisy=share,
        until=keep,
    )
    fell = fell | down
    upright = np.flatnonzero(~fell[:-1])
    noisy = [Steady(log.trajectory(i), log.clock[i]) for i in upright.tolist()]
    quiet: Steady | None = None
    radii: tuple[RadiusMetrics, ...] = ()
    pushes: tuple[PushMetrics, ...] = ()
    if not fell[-1]:
        quiet = Steady(log.trajectory(extent.robots), log.clock[-1])
        strides = [state.of(upright) for state in starts]
        radii = measure_returns(policy, one, last.of([-1]), strides)
        pushes = push_all(policy, one, passed)
    metrics = summarize(one, noisy, radii, pushes)
    return with_sections(metrics, noisy, quiet)


def summarize(
    one: StabilityTry,
    noisy: Sequence[Steady],
    radii: tuple[RadiusMetrics, ...],
    pushes: tuple[PushMetrics, ...],
) -> SpeedMetrics:
    """Return the stability metrics of a speed from the robots that did not fall.

    Args:
        one: the speed.
        noisy: robots with noise.
        radii: those of the map from stride to stride, under noise first.
        pushes: the largest pushes survived.
    """
    section = measure_section(noisy)
    landings = measure_landings(noisy, one.period)
    radius = radii[0] if radii else None
    speeds = [robot.run.mean_speed for robot in noisy]
    return SpeedMetrics(
        asked=one.asked,
        commanded=one.speed,
        ticks=one.ticks,
        period=one.period,
        speed=float(np.mean(speeds)) if speeds else None,
        robots=one.extent.robots,
        fell=one.extent.robots - len(noisy),
        strides=section and section.strides,
        drift_over_scatter=section and float(np.median(section.over_scatter)),
        floor=section and section.floor,
        drift=section and float(np.median(section.moved)),
        scatter=section and float(np.median(section.scatter)),
        inliers=section and section.inliers,
        radius_under_noise=radius and radius.radius,
        radius_interval=radius and (radius.low, radius.high),
        touchdown_jitter=max((leg.jitter for leg in landings), default=None),
        variability=max((leg.variability for leg in landings), default=None),
        weakest_push=min((push.survived for push in pushes), default=None),
        sections=(section,) if section else (),
        landings=landings,
        radii=radii,
        pushes=pushes,
    )


# --- The return map -------------------------------------------------------------------


def measure_returns(
    policy: Policy, one: StabilityTry, quiet: GroupState, starts: list[GroupState]
) -> tuple[RadiusMetrics, ...]:
    """Return spectral radii of return maps, fitted to strides under noise and to
    deviations; () with too few strides.

    Coordinates count over their scatter under noise, from stride to stride. They do not
    hold what a policy with a history remembers of the last control steps. Where it has
    one, deviations are given a stride to become part of it.
    """
    group = one.group(policy)
    steered = one.operator.limit > 0.0
    coordinates = Coordinates.of(policy.card.env, one.robot, group.memory, steered)
    base = coordinates.write(coordinates.read(quiet), quiet)
    orbit = Orbit(group, coordinates, one.held(1, 1)[:, 0], base)
    states = np.stack([coordinates.read(state) for state in starts])
    scales = np.maximum(np.std(states, axis=(0, 1)), SMALLEST)
    before = np.reshape(states[:-1], (-1, coordinates.size)) / scales
    after = np.reshape(states[1:], (-1, coordinates.size)) / scales
    under_noise = _radius(before, after, "stride to stride under noise", one.seed)
    if under_noise is None:
        return ()
    rng = np.random.default_rng(one.seed)
    off = scales * rng.standard_normal((one.extent.deviations, len(scales)))
    remembers = bool(policy.card.env.control.history)
    deviations = deviation_radius(orbit, scales, off, one.seed, later=remembers)
    return (under_noise, deviations) if deviations else (under_noise,)


def deviation_radius(
    orbit: Orbit,
    scales: Float[np.ndarray, " D"],
    off: Float[np.ndarray, "N D"],
    seed: int,
    *,
    later: bool,
) -> RadiusMetrics | None:
    """Return the spectral radius of the return map fitted to deviations, or `later` to
    their remains after a stride."""
    *_, before, after = (orbit.follow(orbit.at + off, 1 + later) - orbit.at) / scales
    back = np.all(np.isfinite(after), axis=1)
    what = "deviations as large as the scatter"
    told = f"{what}, a stride later" if later else what
    return _radius(before[back], after[back], told, seed)


def _radius(
    before: Float[np.ndarray, "N D"],
    after: Float[np.ndarray, "N D"],
    what: str,
    seed: int,
) -> RadiusMetrics | None:
    if len(before) < ENOUGH * before.shape[1]:
        return None
    found = returns.fit(before, after)
    drawn = returns.bootstrap(before, after, DRAWS, seed)
    low, high = returns.interval(found.radius, drawn)
    return RadiusMetrics(what, len(before), found.radius, low, high, found.unexplained)


# --- Pushes ---------------------------------------------------------------------------


def push_all(
    policy: Policy, one: StabilityTry, passed: Sequence[GroupState]
) -> tuple[PushMetrics, ...]:
    """Find the largest push survived, for each phase of the gait clock and push
    direction.

    `passed` are the robot's states in a stride, by the control step.
    """
    extent = one.extent
    group = one.group(policy)
    shares = np.arange(extent.phases) / extent.phases
    pushed = join(*(passed[round(share * one.ticks)] for share in shares))
    starts = pushed.of(np.repeat(np.arange(extent.phases), extent.ways))
    ways = 2.0 * np.pi * np.arange(extent.ways) / extent.ways
    directions = np.tile(ways, extent.phases)
    commands = one.held(len(starts), math.ceil(extent.after / one.period))

    def survives(sizes: Float[np.ndarray, " N"]) -> Bool[np.ndarray, " N"]:
        return ~group.run(push(starts, sizes, directions), commands)[1]

    ends = largest_survived(survives, len(starts), extent.hardest, extent.rounds)
    columns = (starts.phase, directions, *ends)
    return tuple(PushMetrics(*map(float, row)) for row in zip(*columns, strict=True))


def push(
    moment: GroupState,
    sizes: Float[np.ndarray, " N"],
    directions: Float[np.ndarray, " N"],
) -> GroupState:
    """Return the state of robots after pushes: jumps of their velocities by `sizes`,
    m/s.

    Directions are from forward to the left, rad.
    """
    qvel = moment.qvel.copy()
    toward = yaw_of(moment.qpos[:, 3:7]) + directions
    qvel[:, :2] += sizes[:, None] * np.stack([np.cos(toward), np.sin(toward)], axis=-1)
    return dataclasses.replace(moment, qvel=qvel)


def largest_survived(
    survives: Callable[[Float[np.ndarray, " N"]], Bool[np.ndarray, " N"]],
    kinds: int,
    most: float,
    rounds: int,
) -> tuple[Float[np.ndarray, " kinds"], Float[np.ndarray, " kinds"]]:
    """Return for each kind of push, by bisection, a size that is survived and one that
    is not.

    A push of 0 counts as survived, one of `most` as not; the two are most / 2^rounds
    apart. Where survival is not monotonous in the size, one of its ends is found.
    """
    low, high = np.zeros(kinds), np.full(kinds, most)
    for _ in range(rounds):
        middle = 0.5 * (low + high)
        up = survives(middle)
        low, high = np.where(up, middle, low), np.where(up, high, middle)
    return low, high
