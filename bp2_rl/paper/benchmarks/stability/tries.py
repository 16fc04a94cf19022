"""One speed, run: under noise, side by side from deviations of its gait, and pushed."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from bp2_rl.learning.policy import Policy
from bp2_rl.paper.benchmarks.stability.coordinates import SMALLEST, Coordinates
from bp2_rl.paper.benchmarks.stability.group import (
    GroupRecording,
    GroupState,
    RobotGroup,
    join,
)
from bp2_rl.paper.benchmarks.stability.measured import (
    MapMetrics,
    PushMetrics,
    RadiusMetrics,
    SpeedMetrics,
    SpeedResult,
)
from bp2_rl.paper.benchmarks.stability.orbit import TICK, Orbit
from bp2_rl.paper.benchmarks.stability.steady import (
    Steady,
    measure_landings,
    measure_sections,
    measure_signals,
    to_show,
)
from bp2_rl.paper.orbits import returns
from bp2_rl.paper.orbits.pushes import largest
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.kinematics import yaw_of
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.settings.env import RandomizationConfig
from bp2_rl.simulation.rollout import sampled_commands
from bp2_rl.simulation.schedule import Ramp

UNSTEERED = HeadingHold(limit=0.0)
DRAWS = 100  # of the bootstrap
ENOUGH = 4  # states a coordinate, for a map


@dataclasses.dataclass(frozen=True)
class Extent:
    """How much is tried."""

    robots: int = 6  # with noise
    strides: int = 105  # of each, measured
    easing: int = 10  # strides before, under the last command
    deviations: int = 300  # random ones, of each size
    # theirs, over each coordinate's scatter under noise
    sizes: tuple[float, ...] = (1e-3, 1.0)
    followed: int = 8  # strides that deviations are followed
    followed_sizes: tuple[float, ...] = (1e-3, 1e-2, 1e-1, 1.0, 3.0)
    per_size: int = 6  # robots that are followed, of each size
    widths: tuple[float, ...] = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # of differences
    directions: int = 6  # that they are taken along
    phases: int = 4  # of the clock, at which the robot is pushed ...
    ways: int = 8  # ... in so many directions
    hardest: float = 8.0  # m/s
    rounds: int = 5  # of bisection
    after: float = 1.2  # s that a push is survived


FULL = Extent()
QUICK = Extent(
    robots=4,
    strides=30,
    easing=5,
    deviations=0,
    sizes=(),
    followed=0,
    followed_sizes=(),
    per_size=0,
    widths=(),
    phases=1,
    ways=4,
    rounds=4,
    after=1.0,
)


@dataclasses.dataclass(frozen=True)
class StabilityTry:
    """One speed."""

    asked: float  # m/s
    speed: float  # m/s, with a stride of ...
    ticks: int  # ... so many control steps
    rise: Ramp  # to it, but for its hold
    robot: HardwareSpec
    operator: HeadingHold
    seed: int
    extent: Extent

    @property
    def period(self) -> float:
        """Return the duration of a stride, s."""
        return self.ticks * TICK

    def held(self, robots: int, strides: int) -> Float[np.ndarray, "K N 3"]:
        """The commands."""
        return np.tile(
            np.array([self.speed, 0.0, 0.0]), (strides * self.ticks, robots, 1)
        )


def try_speed(policy: Policy, one: StabilityTry) -> SpeedResult:
    """All of it at one speed."""
    extent, noise = one.extent, RandomizationConfig()
    group = RobotGroup(
        policy, policy.card.env, hardware=one.robot, operator=one.operator, noise=noise
    )
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
        record=True,
        until=keep,
    )
    fell = fell | down
    ran = [None if fell[robot] else _steady(log, robot) for robot in range(len(share))]
    noisy, quiet = [robot for robot in ran[:-1] if robot is not None], ran[-1]
    metrics = SpeedMetrics(
        asked=one.asked,
        commanded=one.speed,
        ticks=one.ticks,
        period=one.period,
        speed=float(
            np.mean([np.mean(robot.run.ground_velocity[:, 0]) for robot in noisy])
        )
        if noisy
        else None,
        robots=extent.robots,
        fell=int(np.sum(fell[:-1])),
        sections=measure_sections(noisy, quiet),
        signals=measure_signals(noisy, quiet),
        landings=measure_landings(noisy, quiet, one.period),
        returns=None,
        pushes=(),
    )
    if quiet is not None:
        upright = np.flatnonzero(~fell[:-1])
        metrics = dataclasses.replace(
            metrics,
            returns=measure_returns(
                policy, one, last.of([-1]), [state.of(upright) for state in starts]
            ),
            pushes=push_all(policy, one, passed),
        )
    return SpeedResult(metrics, to_show(noisy, quiet, one.period))


def _steady(recording: GroupRecording | None, robot: int) -> Steady:
    assert recording is not None
    return Steady(recording.trajectory(robot), recording.clock[robot])


# --- The return map -------------------------------------------------------------------


def orbit_of(
    policy: Policy, one: StabilityTry, at: GroupState, operator: HeadingHold
) -> Orbit:
    """Return the map from phase 0 to phase 0 of a robot at phase 0."""
    group = RobotGroup(policy, policy.card.env, hardware=one.robot, operator=operator)
    coordinates = Coordinates.of(
        policy.card.env, one.robot, group.memory, steered=operator.limit > 0.0
    )
    base = coordinates.write(coordinates.read(at), at)
    return Orbit(group, coordinates, one.speed, one.ticks, base)


def measure_returns(
    policy: Policy, one: StabilityTry, quiet: GroupState, starts: list[GroupState]
) -> MapMetrics | None:
    """The map about a phase 0 of the robot without noise; None where there are too few
    strides under noise to fit one.

    Coordinates count over their scatter under noise, from stride to stride. They do not
    hold what a policy with a history remembers of the last control steps. Where it has
    one, deviations are given a stride to become part of it, and there are no
    differences, which would leave it as it was.
    """
    extent, rng = one.extent, np.random.default_rng(one.seed)
    remembers = bool(policy.card.env.control.history)
    if remembers:
        extent = dataclasses.replace(extent, widths=())
    orbit = orbit_of(policy, one, quiet, one.operator)
    states = np.stack([orbit.coordinates.read(state) for state in starts])
    scales = np.maximum(np.std(states, axis=(0, 1)), SMALLEST)
    before, after = (
        part.reshape(-1, orbit.coordinates.size) / scales
        for part in (states[:-1], states[1:])
    )
    under_noise = _radius(before, after, "stride to stride under noise", one.seed)
    if under_noise is None:
        return None

    def drawn(scales: Float[np.ndarray, " D"], size: float) -> Float[np.ndarray, "N D"]:
        return size * scales * rng.standard_normal((extent.deviations, len(scales)))

    changes, width, by_differences = _by_differences(orbit, scales, rng, extent)
    unsteered = None
    if extent.sizes and one.operator.limit > 0.0:
        alone = orbit_of(policy, one, quiet, UNSTEERED)
        own, size = scales[: alone.coordinates.size], extent.sizes[-1]
        what = f"deviations of {size:g}, unsteered"
        unsteered = _of_deviations(
            alone, own, drawn(own, size), what, one.seed, later=remembers
        )
    deviations = [
        _of_deviations(
            orbit,
            scales,
            drawn(scales, size),
            f"deviations of {size:g}",
            one.seed,
            later=remembers,
        )
        for size in extent.sizes
    ]
    return MapMetrics(
        coordinates=orbit.coordinates.size,
        under_noise=under_noise,
        deviations=tuple(found for found in deviations if found is not None),
        unsteered=unsteered,
        sizes=extent.followed_sizes,
        growth=_growth(orbit, scales, rng, extent),
        widths=extent.widths,
        changes=changes,
        width=width,
        by_differences=by_differences,
    )


def _of_deviations(
    orbit: Orbit,
    scales: Float[np.ndarray, " D"],
    off: Float[np.ndarray, "N D"],
    what: str,
    seed: int,
    *,
    later: bool,
) -> RadiusMetrics | None:
    """The map fitted to deviations, or to what is left of them a stride later."""
    *_, before, after = (orbit.follow(orbit.at + off, 1 + later) - orbit.at) / scales
    back = np.all(np.isfinite(after), axis=1)
    return _radius(
        before[back], after[back], f"{what}, a stride later" if later else what, seed
    )


def _radius(
    before: np.ndarray, after: np.ndarray, what: str, seed: int
) -> RadiusMetrics | None:
    if len(before) < ENOUGH * before.shape[1]:
        return None
    found = returns.fit(before, after)
    low, high = returns.interval(
        found.radius, returns.bootstrap(before, after, DRAWS, seed)
    )
    return RadiusMetrics(what, len(before), found.radius, low, high, found.unexplained)


def _growth(
    orbit: Orbit,
    scales: Float[np.ndarray, " D"],
    rng: np.random.Generator,
    extent: Extent,
) -> tuple[tuple[float, ...], ...]:
    """Median distance of robots from the one that they began beside, over the initial
    one, by size and stride."""
    sizes = np.repeat(extent.followed_sizes, extent.per_size)
    off = sizes[:, None] * scales * rng.standard_normal((len(sizes), len(scales)))
    states = (
        orbit.follow(
            orbit.at + np.concatenate([np.zeros((1, len(scales))), off]),
            extent.followed,
        )
        / scales
    )
    distance = np.linalg.norm(states[:, 1:] - states[:, :1], axis=-1)
    distance = np.where(np.isfinite(distance), distance, np.inf).reshape(
        len(states), -1, extent.per_size
    )
    middle = np.median(distance, axis=-1)
    return tuple(
        tuple(float(value) for value in line) for line in (middle / middle[0]).T
    )


def _by_differences(
    orbit: Orbit,
    scales: Float[np.ndarray, " D"],
    rng: np.random.Generator,
    extent: Extent,
) -> tuple[tuple[float | None, ...], float | None, float | None]:
    """How slopes change from width to width; the width from which they change least,
    and the radius there."""
    if not extent.widths:
        return (), None, None
    along = scales * rng.standard_normal((extent.directions, len(scales)))
    found = np.median(
        returns.plateau(orbit.step, orbit.at, along, np.array(extent.widths)), axis=1
    )
    changes = tuple(float(value) if math.isfinite(value) else None for value in found)
    if not np.any(np.isfinite(found)):
        return changes, None, None
    width = extent.widths[int(np.nanargmin(found))]
    try:
        return (
            changes,
            width,
            returns.radius(returns.differences(orbit.step, orbit.at, width * scales)),
        )
    except ValueError:
        return changes, width, None


# --- Pushes ---------------------------------------------------------------------------


def push_all(
    policy: Policy, one: StabilityTry, passed: Sequence[GroupState]
) -> tuple[PushMetrics, ...]:
    """The largest push that a robot survives, by the phase of the clock and the
    direction.

    `passed` are its states in a stride, by the control step.
    """
    extent = one.extent
    group = RobotGroup(
        policy, policy.card.env, hardware=one.robot, operator=one.operator
    )
    shares = np.arange(extent.phases) / extent.phases
    pushed = join(*(passed[round(share * one.ticks)] for share in shares))
    kinds = [
        (phase, 2.0 * np.pi * way / extent.ways)
        for phase in range(extent.phases)
        for way in range(extent.ways)
    ]
    starts, directions = (
        pushed.of([phase for phase, _ in kinds]),
        np.array([way for _, way in kinds]),
    )
    commands = one.held(len(kinds), math.ceil(extent.after / one.period))

    def survives(sizes: Float[np.ndarray, " N"]) -> Bool[np.ndarray, " N"]:
        return ~group.run(pushed_by(starts, sizes, directions), commands)[1]

    survived, fatal = largest(survives, len(kinds), extent.hardest, extent.rounds)
    return tuple(
        PushMetrics(
            float(starts.phase[i]),
            float(directions[i]),
            float(survived[i]),
            float(fatal[i]),
        )
        for i in range(len(kinds))
    )


def pushed_by(
    moment: GroupState,
    sizes: Float[np.ndarray, " N"],
    directions: Float[np.ndarray, " N"],
) -> GroupState:
    """Return these robots after a jump of their velocity, m/s, in directions from
    forward to the left, rad."""
    qvel, toward = moment.qvel.copy(), yaw_of(moment.qpos[:, 3:7]) + directions
    qvel[:, :2] += sizes[:, None] * np.stack([np.cos(toward), np.sin(toward)], axis=-1)
    return moment.replace(qvel=qvel)
