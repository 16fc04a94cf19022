"""The track of a run: its way along the line of its start, and its use of a lane."""

import dataclasses

import numpy as np
from jaxtyping import Float

from bp2_rl.base.metric import metric
from bp2_rl.robot.kinematics import foot_position
from bp2_rl.simulation.samples import Samples

LANE_WIDTH = 1.22  # m, of a running track (World Athletics, Technical Rule 14.4)


@dataclasses.dataclass(frozen=True)
class Lane:
    """How much of the track's width was used, from the line through the start along the
    first heading."""

    trunk_offset: float = metric(
        "Trunk off the line", "m", meaning="greatest, of its centre"
    )
    # of the trunk's corners: BP2's is 0.44 m wide, 0.80 m long, at its heading
    trunk_reach: float = metric(
        "Trunk's side", "m", meaning="greatest distance from the line", card=True
    )
    foot_reach: float = metric(
        "Feet's outer edge", "m", meaning="greatest distance from the line", card=True
    )
    used: float = metric(
        "Lane used",
        form=".0%",
        meaning=f"of \u00b1{LANE_WIDTH / 2:.2f} m, by trunk and feet",
    )
    # all of it stayed within half a lane's width to either side
    kept: bool = metric("Lane kept", card="lane_kept", shown=False)


def track_position(
    run: Samples,
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Return the trunk's centre along the line of its start and to the left, m.

    The line goes through the start along the first heading.
    """
    along, left = _on_track(run, run.qpos[:, None, :2])
    return along[:, 0], left[:, 0]


def time_at(run: Samples, distance: float) -> float | None:
    """Return when the trunk's centre first was `distance` (m) ahead, s.

    The time is interpolated between samples; None if the robot never arrived.
    """
    along = track_position(run)[0]
    there = int(np.argmax(along >= distance))
    if along[there] < distance:
        return None
    before = max(there - 1, 0)
    return float(np.interp(distance, along[[before, there]], run.time[[before, there]]))


def measure_lane(run: Samples) -> Lane:
    """Measure how far trunk and feet came from the line."""
    trunk, feet = (
        float(np.max(np.abs(edges))) for edges in (trunk_edges(run), foot_edges(run))
    )
    offset = float(np.max(np.abs(track_position(run)[1])))
    used = max(trunk, feet) / (LANE_WIDTH / 2)
    return Lane(offset, trunk, feet, used, kept=used <= 1.0)


def trunk_edges(run: Samples) -> Float[np.ndarray, "N 2"]:
    """Return the trunk's rightmost and leftmost corners, m to the left of the line."""
    turned = run.heading - run.heading[0]
    half_length, half_width = run.hardware.anatomy.footprint
    half = half_width * np.abs(np.cos(turned)) + half_length * np.abs(np.sin(turned))
    return track_position(run)[1][:, None] + half[:, None] * np.array([-1.0, 1.0])


def foot_edges(run: Samples) -> Float[np.ndarray, "N 2"]:
    """Return the rightmost and leftmost edges of the feet, m to the left of the line."""
    left = _on_track(run, foot_centres(run)[:, :, :2])[1]
    radius = run.hardware.anatomy.geometry.foot_radius
    return np.stack(
        [np.min(left - radius, axis=1), np.max(left + radius, axis=1)], axis=-1
    )


def foot_centres(run: Samples) -> Float[np.ndarray, "N 4 3"]:
    """Return the centres of the feet's spheres in the world, m.

    A centre is a radius above the sole, up the lower leg.
    """
    joints = run.joint_position.reshape(-1, 4, 3)
    feet = foot_position(
        joints,
        run.spring_compression + run.hardware.anatomy.geometry.foot_radius,
        run.hardware,
    )
    w, v = run.qpos[:, None, 3:4], run.qpos[:, None, 4:7]
    turn = 2.0 * np.cross(v, feet)
    return run.qpos[:, None, :3] + feet + w * turn + np.cross(v, turn)


def _on_track(
    run: Samples, points: Float[np.ndarray, "N n 2"]
) -> tuple[Float[np.ndarray, "N n"], Float[np.ndarray, "N n"]]:
    """Return the points' coordinates along the line of the start and to its left, m."""
    x, y = np.moveaxis(points - run.qpos[0, :2], -1, 0)
    cos, sin = np.cos(run.heading[0]), np.sin(run.heading[0])
    return cos * x + sin * y, cos * y - sin * x
