"""Whether a gait repeats itself under noise, what it makes of deviations, and how hard
it may be pushed.

The definitions are in `bp2_rl.paper.orbits` and docs/notes/stability.md: the section is
strobed at the policy's own clock, the transient is dropped, the noise is that of
training, and each figure stands beside its floor.
"""

import dataclasses

from bp2_rl.base.errors import UserError
from bp2_rl.env.controller import motion_of
from bp2_rl.evaluation.benchmarks.conditions import (
    conditions,
    describe_rise,
    describe_simulator,
    describe_subject,
    robot_of,
)
from bp2_rl.evaluation.benchmarks.outcome import Evaluation, Picture
from bp2_rl.evaluation.benchmarks.run import ramp_to_topspeed
from bp2_rl.learning.policy import Policy
from bp2_rl.paper.benchmarks.options import DeepSetup
from bp2_rl.paper.benchmarks.stability import figures, tables
from bp2_rl.paper.benchmarks.stability.measured import StabilityMetrics
from bp2_rl.paper.benchmarks.stability.orbit import whole_strides
from bp2_rl.paper.benchmarks.stability.tries import (
    FULL,
    QUICK,
    Extent,
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


def stability(policy: Policy, ramp: Ramp, setup: DeepSetup) -> Evaluation:
    """Run the paper's speed and the top one, or the one that was asked for."""
    robot, extent = robot_of(policy, setup), QUICK if setup.quick else FULL
    if setup.robots is not None:
        extent = dataclasses.replace(extent, robots=setup.robots)
    reference = motion_of(dataclasses.replace(policy.card.env, hardware=robot))
    speeds = (
        (ramp.target[0],)
        if setup.quick or setup.speed is not None
        else (SPEED, ramp.target[0])
    )
    tries: dict[float, StabilityTry] = {}
    for speed in speeds:
        found = whole_strides(reference.phase_rate, speed)
        if found is None:
            raise UserError(
                f"no command near {speed:g} m/s has a stride of a whole number of control steps under the policy's "
                f"reference ({policy.card.env.reference}): name another --speed"
            )
        near, ticks = found
        tries.setdefault(
            near,
            StabilityTry(
                asked=speed,
                speed=near,
                ticks=ticks,
                rise=dataclasses.replace(ramp, to=near),
                robot=robot,
                operator=setup.operator,
                seed=setup.seed or 0,
                extent=extent,
            ),
        )
    asked = list(tries.values())
    ran = (
        in_parallel(try_speed, policy, asked)
        if len(asked) > 1
        else [try_speed(policy, asked[0])]
    )
    metrics = StabilityMetrics(
        mass=float(load_model(robot, visual=False).body_mass.sum()),
        speeds=tuple(one.metrics for one in ran),
    )
    followed = any(
        speed.returns is not None and speed.returns.sizes for speed in metrics.speeds
    )
    pushed = any(speed.pushes for speed in metrics.speeds)
    said = conditions(
        policy, describe_strides(asked), describe_simulator("mujoco", robot), setup
    )
    return Evaluation(
        benchmark="stability",
        subject=describe_subject(policy, setup),
        backend="C MuJoCo",
        conditions=said
        | {
            "sensors": describe_noise(extent, setup.seed or 0),
            "definitions": DEFINITIONS,
        },
        verdict=tables.verdict(metrics),
        good=all(tables.steady(speed) for speed in metrics.speeds),
        rows=tables.stability_rows(metrics),
        tiles=tables.TILES,
        pictures=(
            Picture("sections", figures.SECTIONS, figures.section_figure(ran)),
            Picture("spectra", figures.SPECTRA, figures.spectrum_figure(ran[0])),
            Picture("touchdowns", figures.TOUCHDOWNS, figures.touchdown_figure(ran)),
            *(
                (Picture("returns", figures.RETURNS, figures.return_figure(ran)),)
                if followed
                else ()
            ),
            *(
                (Picture("pushes", figures.PUSHES, figures.push_figure(ran)),)
                if pushed
                else ()
            ),
        ),
        metrics=metrics,
        results=tables.stability_results(metrics),
        tables=tables.stability_tables(metrics),
    )


def ramp_to_stability(policy: Policy, setup: DeepSetup) -> Ramp:
    """The launch to the top speed; in the quick version to the paper's, and faster."""
    if setup.quick:
        setup = dataclasses.replace(
            setup,
            speed=setup.speed or SPEED,
            acceleration=setup.acceleration or QUICK_ACCELERATION,
        )
    return ramp_to_topspeed(policy, setup)


DEFINITIONS = (
    "D_c* = |mean of the last third of the section - mean of the first| / RMS distance from the mean; inliers: squared "
    "Mahalanobis distance about a robust mean below 7.81; radius: largest multiplier of the least-squares map from "
    "stride to stride, 95 % by bootstrap; jitter: standard deviation of a touchdown's phase against the clock"
)


def describe_strides(asked: list[StabilityTry]) -> str:
    """The schedule in one line."""
    said = (f"{one.speed:.3f} m/s (stride {1e3 * one.period:g} ms)" for one in asked)
    extent = asked[0].extent
    return (
        f"from a stand {describe_rise(asked[0].rise)} to {' and '.join(said)}; {extent.easing} strides dropped, "
        f"{extent.strides} measured"
    )


def describe_noise(extent: Extent, seed: int) -> str:
    """The sensors' noise in one line."""
    noise = RandomizationConfig()
    return (
        f"{extent.robots} robots with sensor noise of training, seed {seed}: joints {noise.joint_position_noise:g} rad "
        f"and {noise.joint_velocity_noise:g} rad/s, upright {noise.orientation_noise:g}, gyro "
        f"{noise.angular_velocity_noise:g} rad/s; one without; robot as designed, no pushes but where pushes are tried"
    )
