"""What a fast run does to a robot: speed over how hard soles land, and whether it needs
strong brakes."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from bp2_rl.base.plotting import INK, LEG_COLORS, QUIET, styled
from bp2_rl.evaluation.benchmarks.outcome import Table, show, show_fall
from bp2_rl.learning.policy import Policy, load_policy
from bp2_rl.paper.figures.drawn import Drawn
from bp2_rl.paper.figures.settings import WearSettings
from bp2_rl.robot.conventions import GRAVITY
from bp2_rl.robot.hardware import BUILT
from bp2_rl.simulation.account import account
from bp2_rl.simulation.metrics import PLATE
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.samples import steady_window
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import Trajectory

HOLD = 5.0  # s
WEAK = dataclasses.replace(BUILT, braking_speed=BUILT.no_load_speed)
"""The built robot with brakes no better than its drives."""
COLORS = (QUIET, *LEG_COLORS.values())


@dataclasses.dataclass(frozen=True)
class Wear:
    """A policy's run on the built robot, and one with weak brakes; means and extremes
    of the time held."""

    policy: str
    landing_reward: float  # coefficient in training
    fell_at: float | None  # s
    speed: float  # m/s, mean
    landing: float | None  # m/s, of soles, downwards, mean
    top_out: float  # m/s, greatest, of springs onto their rebound stop
    overspeed: float  # share of motor samples beyond the no-load speed
    room: float  # m, least between legs
    plate_force: float  # body weights, greatest vertical mean over `PLATE`
    weak_fell_at: float | None  # s, with brakes as drives


def wear(settings: WearSettings) -> Drawn:
    """The figure and its table."""
    found = tuple(
        wear_of(str(path), load_policy(path), settings.speed)
        for path in settings.policies
    )
    return Drawn(
        {"policies": found}, (_table(found),), (), {"wear": wear_figure(found)}
    )


def wear_of(name: str, policy: Policy, speed: float) -> Wear:
    """Run a policy from a stand, told to run `speed`, m/s."""
    ramp = Ramp(speed, hold=HOLD).under(policy.card.env.control)
    run, weak = simulate(
        policy, [RunRequest(ramp, hardware=robot) for robot in (BUILT, WEAK)]
    )
    return measure(name, policy.card.env.reward.landing, run, weak.fell_at)


def measure(
    name: str, landing_reward: float, run: Trajectory, weak_fell_at: float | None
) -> Wear:
    """Return what a run wears."""
    metrics, steady = run.metrics, account(steady_window(run))
    return Wear(
        policy=name,
        landing_reward=landing_reward,
        fell_at=run.fell_at,
        speed=metrics.mean_speed,
        landing=steady.ground.landing_down,
        top_out=steady.ground.top_out_speed,
        overspeed=steady.power.overspeed_share,
        room=metrics.leg_clearance,
        plate_force=steady.ground.plate_force / (run.hardware.mass * GRAVITY),
        weak_fell_at=weak_fell_at,
    )


def _table(policies: Sequence[Wear]) -> Table:
    head = (
        "Policy",
        "Landing reward",
        "Speed [m/s]",
        "Fall",
        "Soles land at [m/s]",
        "Springs top out at [m/s]",
        "Motors beyond no load",
        "Room between legs [mm]",
        f"Foot over {1e3 * PLATE:.0f} ms [body weights]",
        "Fall with brakes as drives",
    )
    lines = [
        (
            one.policy,
            f"{one.landing_reward:g}",
            f"{one.speed:.2f}",
            show_fall(one.fell_at),
            show(one.landing, ".1f"),
            f"{one.top_out:.1f}",
            f"{one.overspeed:.1%}",
            f"{1e3 * one.room:.0f}",
            f"{one.plate_force:.1f}",
            show_fall(one.weak_fell_at),
        )
        for one in policies
    ]
    return Table("Held for 5 s on the built robot, in C MuJoCo", head, lines)


@styled
def wear_figure(policies: Sequence[Wear]) -> Figure:
    """Speed over the soles' landing speed; circles are filled where weak brakes do not
    make the robot fall."""
    figure = Figure(figsize=(6.0, 4.0), layout="constrained")
    axes = figure.subplots()
    rewards = sorted({one.landing_reward for one in policies})
    for place, reward in enumerate(rewards):
        color = COLORS[place % len(COLORS)]
        stood = [
            one
            for one in policies
            if one.landing_reward == reward and one.fell_at is None
        ]
        fills = [color if one.weak_fell_at is None else "white" for one in stood]
        axes.scatter(
            np.array([one.landing for one in stood], float),
            [one.speed for one in stood],
            s=36,
            facecolors=fills,
            edgecolors=color,
            linewidths=1.4,
            label=f"landing reward {reward:g}",
            zorder=3,
        )
    axes.set(
        xlim=(0.0, None),
        xlabel="Soles land at [m/s], mean",
        ylabel="Speed held for 5 s [m/s]",
    )
    axes.text(
        0.98,
        0.03,
        "filled: runs on with brakes as drives",
        transform=axes.transAxes,
        ha="right",
        color=INK,
    )
    axes.legend(loc="upper left")
    return figure
