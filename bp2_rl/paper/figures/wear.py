"""The figure of the wear of a robot in a fast run: speed over how hard soles land, and
whether it needs strong brakes."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from bp2_rl.base.metric import metric, show_fall, table_of
from bp2_rl.base.plotting import INK, LEG_COLORS, QUIET, styled
from bp2_rl.learning.policy import Policy, load_policy
from bp2_rl.paper.figures.drawn import Drawn
from bp2_rl.paper.figures.settings import WearFigureSettings
from bp2_rl.robot.conventions import GRAVITY
from bp2_rl.robot.hardware import BUILT
from bp2_rl.simulation.account import account
from bp2_rl.simulation.metrics import PLATE
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import Trajectory, steady_window

HOLD = 5.0  # s
WEAK = dataclasses.replace(BUILT, braking_speed=BUILT.no_load_speed)
"""The built robot with motors that brake no harder than they drive."""
COLORS = (QUIET, *LEG_COLORS.values())


@dataclasses.dataclass(frozen=True)
class Wear:
    """Loads on the built robot in a policy's run: means and extremes while the speed is
    held."""

    policy: str = metric("Policy", form="s")
    landing_reward: float = metric(
        "Landing reward", form="g"
    )  # coefficient in training
    speed: float = metric("Speed", "m/s")  # mean
    fell_at: float | None = metric("Fall", form=show_fall)  # s
    # of soles, downwards, mean
    landing: float | None = metric("Soles land at", "m/s", ".1f")
    # greatest, of springs onto their rebound stop
    top_out: float = metric("Springs top out at", "m/s", ".1f")
    # share of motor samples beyond the no-load speed
    overspeed: float = metric("Motors beyond no load", form=".1%")
    room: float = metric("Room between legs", "mm", ".0f")  # least
    # greatest vertical mean over `PLATE`
    plate_force: float = metric(
        f"Foot over {1e3 * PLATE:.0f} ms", "body weights", ".1f"
    )
    # with brakes as drives
    weak_fell_at: float | None = metric("Fall with brakes as drives", form=show_fall)


def wear(settings: WearFigureSettings) -> Drawn:
    """Draw and tabulate the loads that policies put on the built robot."""
    found = tuple(
        wear_of(str(path), load_policy(path), settings.speed)
        for path in settings.policies
    )
    table = table_of("Held for 5 s on the built robot, in C MuJoCo", found)
    return Drawn({"policies": found}, (table,), {"wear": wear_figure(found)})


def wear_of(name: str, policy: Policy, speed: float) -> Wear:
    """Return the loads on the built robot in a policy's run from a stand to `speed`,
    m/s."""
    ramp = Ramp(speed, hold=HOLD).under(policy.card.env.control)
    run, weak = simulate(
        policy, [RunRequest(ramp, hardware=robot) for robot in (BUILT, WEAK)]
    )
    return measure_wear(name, policy.card.env.reward.landing, run, weak.fell_at)


def measure_wear(
    name: str, landing_reward: float, run: Trajectory, weak_fell_at: float | None
) -> Wear:
    """Measure the loads on the robot in the steady part of a run."""
    metrics = run.metrics
    steady = account(steady_window(run))
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


@styled
def wear_figure(policies: Sequence[Wear]) -> Figure:
    """Draw speed over the soles' landing speed; circles are filled where weak brakes do
    not make the robot fall."""
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
