"""The stability benchmark: how well a gait repeats itself under noise, and which pushes
a robot survives.

Robots run under noise, from deviations of their gait, and are pushed.

The definitions are in `bp2_rl.paper.orbits` and docs/notes/stability.md: the section is
strobed at the policy's own clock, the transient is dropped, the noise is that of
training, and each figure stands beside its floor.
"""

import dataclasses
from collections.abc import Sequence

from matplotlib.figure import Figure

from bp2_rl.base.errors import UserError
from bp2_rl.base.metric import Table, card_of, rows_of, table_of
from bp2_rl.base.plotting import FALL, FRONT, QUIET, WIDTH, styled
from bp2_rl.env.controller import motion_of
from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    describe_rise,
    describe_subject,
    robot_of,
)
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture
from bp2_rl.evaluation.benchmarks.run import ramp_to_topspeed
from bp2_rl.learning.policy import Policy
from bp2_rl.paper.benchmarks.options import DeepBenchmarkOptions
from bp2_rl.paper.benchmarks.speeds import table_over_speed
from bp2_rl.paper.benchmarks.stability.measured import (
    SpeedMetrics,
    SpeedResult,
    StabilityMetrics,
)
from bp2_rl.paper.benchmarks.stability.orbit import whole_strides
from bp2_rl.paper.benchmarks.stability.tries import (
    FULL,
    QUICK,
    StabilityTry,
    try_speed,
)
from bp2_rl.robot import bp2
from bp2_rl.robot.model import load_model
from bp2_rl.settings.env import RandomizationConfig
from bp2_rl.simulation.parallel import in_parallel
from bp2_rl.simulation.schedule import Ramp

SPEED = bp2.OUTDOOR_TOP_SPEED
QUICK_ACCELERATION = 5.0  # m/s2
TILES = "Fell", "D_c*", "Radius under noise", "Touchdown jitter", "Weakest push"
SECTIONS = (
    "The trunk's angular velocity each time the clock's phase is 0: with noise (blue, all robots), and of the robot "
    "without (red). Grey: that robot all along its last strides."
)
DEFINITIONS = (
    "D_c* = |mean of the last third of the section - mean of the first| / RMS distance from the mean; inliers: squared "
    "Mahalanobis distance about a robust mean below 7.81; radius: largest multiplier of the least-squares map from "
    "stride to stride, 95 % by bootstrap; jitter: standard deviation of a touchdown's phase against the clock"
)


def stability(policy: Policy, ramp: Ramp, setup: DeepBenchmarkOptions) -> Evaluation:
    """Measure a policy's stability at the paper's speed and its top speed, or at one
    chosen speed."""
    tries = plan_tries(policy, ramp, setup)
    ran = (
        in_parallel(try_speed, policy, tries)
        if len(tries) > 1
        else [try_speed(policy, tries[0])]
    )
    speeds = tuple(one.metrics for one in ran)
    robot = tries[0].robot
    mass = float(load_model(robot, visual=False).body_mass.sum())
    said = conditions(policy, setup, describe_strides(tries))
    told = {"sensors": describe_noise(tries[0]), "definitions": DEFINITIONS}
    columns = [{row.label: row.value for row in rows_of(speed)} for speed in speeds]
    commanded = [speed.commanded for speed in speeds]
    return Evaluation(
        benchmark="stability",
        subject=describe_subject(policy, setup),
        conditions=said | told,
        verdict="; ".join(map(say_stability, speeds)),
        good=all(speed.is_steady for speed in speeds),
        rows=rows_of(speeds[0]),
        tiles=TILES,
        pictures=(Picture("sections", SECTIONS, draw_sections(ran)),),
        metrics=StabilityMetrics(mass, speeds),
        results={f"at {one.commanded:.2f} m/s": card_of(one) for one in speeds},
        tables=(
            table_over_speed("At each command", commanded, columns),
            *(table for speed in speeds for table in detail_tables(speed)),
        ),
    )


def plan_tries(
    policy: Policy, ramp: Ramp, setup: DeepBenchmarkOptions
) -> list[StabilityTry]:
    """Return the tests to run, one for each speed, at strides of whole control steps.

    Raises:
        UserError: the policy's clock has no such stride near a speed.
    """
    robot = robot_of(policy, setup)
    extent = QUICK if setup.quick else FULL
    if setup.robots is not None:
        extent = dataclasses.replace(extent, robots=setup.robots)
    reference = motion_of(dataclasses.replace(policy.card.env, hardware=robot))
    top = ramp.target[0]
    alone = setup.quick or setup.speed is not None
    tries: dict[float, StabilityTry] = {}
    for speed in (top,) if alone else (SPEED, top):
        found = whole_strides(reference.phase_rate, speed)
        if found is None:
            raise UserError(
                f"no command near {speed:g} m/s has a stride of a whole number of control steps under the policy's "
                f"reference ({policy.card.env.reference}): name another --speed"
            )
        near, ticks = found
        one = StabilityTry(
            asked=speed,
            speed=near,
            ticks=ticks,
            rise=dataclasses.replace(ramp, to=near),
            robot=robot,
            operator=setup.operator,
            seed=setup.seed or 0,
            extent=extent,
        )
        tries.setdefault(near, one)
    return list(tries.values())


def ramp_to_stability(policy: Policy, setup: DeepBenchmarkOptions) -> Ramp:
    """Return the command's ramp to the top speed or, in the quick version, to the
    paper's speed."""
    if setup.quick:
        setup = dataclasses.replace(
            setup,
            speed=setup.speed or SPEED,
            acceleration=setup.acceleration or QUICK_ACCELERATION,
        )
    return ramp_to_topspeed(policy, setup)


def say_stability(speed: SpeedMetrics) -> str:
    """Return a few words on how stable running is at one speed."""
    said = f"{speed.commanded:.2f} m/s: "
    if speed.fell or speed.drift_over_scatter is None:
        return f"{said}{speed.fell} of {speed.robots} fell"
    if not speed.radii:
        return f"{said}no fall, D_c* {speed.drift_over_scatter:.2f}"
    return f"{said}radius {speed.radii[0]}"


def detail_tables(speed: SpeedMetrics) -> tuple[Table, ...]:
    """Return the tables of touchdown timing, return maps and pushes at one speed."""
    details = {
        "Touchdowns": speed.landings,
        "Map from stride to stride": speed.radii,
        "Largest push survived": speed.pushes,
    }
    return tuple(
        table_of(f"{title}, {speed.commanded:.2f} m/s", lines)
        for title, lines in details.items()
        if lines
    )


def describe_strides(tries: Sequence[StabilityTry]) -> str:
    """Return a line on the command's schedule, and on the strides dropped and
    measured."""
    said = [f"{one.speed:.3f} m/s (stride {1e3 * one.period:g} ms)" for one in tries]
    extent = tries[0].extent
    return (
        f"from a stand {describe_rise(tries[0].rise)} to {' and '.join(said)}; {extent.easing} strides dropped, "
        f"{extent.strides} measured"
    )


def describe_noise(one: StabilityTry) -> str:
    """Return a line on the sensor noise, and on how many robots run with noise."""
    noise = RandomizationConfig()
    return (
        f"{one.extent.robots} robots with sensor noise of training, seed {one.seed}: joints "
        f"{noise.joint_position_noise:g} rad and {noise.joint_velocity_noise:g} rad/s, upright "
        f"{noise.orientation_noise:g}, gyro {noise.angular_velocity_noise:g} rad/s; one without; robot as designed, no "
        "pushes but where pushes are tried"
    )


@styled
def draw_sections(ran: Sequence[SpeedResult]) -> Figure:
    """Draw roll and yaw rate over pitch rate at the gait clock's phase 0, with a row
    for each speed."""
    figure = Figure(figsize=(WIDTH, 0.5 + 3.5 * len(ran)), layout="constrained")
    panels = figure.subplots(len(ran), 2, squeeze=False)
    for row, found in zip(panels, ran, strict=True):
        for axes, up, name in zip(row, (0, 2), ("Roll", "Yaw"), strict=True):
            if found.loop is not None:
                axes.plot(found.loop[:, 1], found.loop[:, up], color=QUIET, lw=0.7)
            for points in found.noisy:
                axes.plot(points[:, 1], points[:, up], ".", color=FRONT, alpha=0.45)
            if found.quiet is not None:
                axes.plot(found.quiet[:, 1], found.quiet[:, up], ".", color=FALL)
            axes.set(xlabel="Pitch rate [rad/s]", ylabel=f"{name} rate [rad/s]")
        row[0].set_title(f"{found.metrics.commanded:.2f} m/s commanded")
    return figure
