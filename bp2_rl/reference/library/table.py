"""A motion library made ready for interpolation: cubics of trunk, feet and springs,
straight lines of torques."""

import functools
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bp2_rl.base.arrays import Number, hermite_coefficients
from bp2_rl.base.errors import UserError
from bp2_rl.reference.library.file import COORDINATES, TRUNK, by_leg, load_library
from bp2_rl.robot.anatomy import Anatomy, LegGeometry

STANDING_PAIR = np.array([1, 2])  # FL, RR: on the ground in the first segment
ON_GROUND = 0.028
"""Largest distance of a standing foot from the ground, over half a leg's length; with
legs 2 % longer it is more."""


class LibraryTable(NamedTuple):
    """A library made ready for interpolation; N intervals in each of its two segments.

    A row of 23 is x, height and pitch of the trunk, then for each leg x and z of the
    foot's centre and the spring's compression, then for each leg the torques of hip and
    knee.
    """

    # speed, durations of stance and flight, x of fore and hind foot in mid-stance
    strides: Float[np.ndarray, "S 5"]
    cubics: Float[np.ndarray, "2 N S 4 23"]  # coefficients by the share of an interval
    height: float  # m, least over the speeds of the trunk's mean height

    @property
    def speeds(self) -> Float[np.ndarray, " S"]:
        """Speeds of the library's motions, ascending, m/s."""
        return self.strides[:, 0]


@functools.lru_cache(maxsize=8)
def load_table(path: Path, anatomy: Anatomy) -> LibraryTable:
    """Return a motion library as a table for interpolation; raise `UserError` if robot
    or legs are not the library's.

    Raises:
        UserError: the file cannot be read, or its motions are another robot's.
    """
    library, legs = load_library(path), anatomy.geometry
    if library.robot != anatomy.name:
        raise UserError(
            f"motion library {path} is of {library.robot}, and the robot is {anatomy.name}: make one with "
            "`bp2 trajopt library build --robot ROBOT`, and name it by --env.library.path"
        )
    q, v, tau = (array.astype(float) for array in (library.q, library.v, library.tau))
    places, rates = _with_feet(q, v, legs)
    feet = by_leg(places[:, 0, :, TRUNK:])[..., STANDING_PAIR, 1]
    off = np.abs(places[:, 0, :, 1:2] + feet - legs.foot_radius[STANDING_PAIR])
    if off.max() > ON_GROUND * anatomy.leg_length:
        flags = (
            f"problem.hardware.body.leg-length {anatomy.leg_length:g}"
            if anatomy.sprung
            else "robot ROBOT"
        )
        raise UserError(
            f"motion library {path} has standing feet {1e3 * off.max():.0f} mm off the ground with legs of "
            f"{anatomy.leg_length:g} m: make one with `bp2 trajopt library build --{flags}`, "
            "and name it by --env.library.path"
        )
    durations = library.durations.astype(float)
    cubics = _cubics(durations, places, rates, tau)
    middle = by_leg(_in_the_middle(cubics[:, 0])[:, TRUNK:COORDINATES])
    mean_height = np.sum(durations * q[..., 1].mean(axis=2), axis=1) / durations.sum(
        axis=1
    )
    return LibraryTable(
        strides=np.column_stack(
            [library.speeds.astype(float), durations, middle[:, STANDING_PAIR, 0]]
        ),
        cubics=np.moveaxis(cubics, 0, 2),
        height=float(mean_height.min()),
    )


def _cubics(
    durations: Float[np.ndarray, "S 2"],
    q: Float[np.ndarray, "S 2 K 15"],
    v: Float[np.ndarray, "S 2 K 15"],
    tau: Float[np.ndarray, "S 2 K 8"],
) -> Float[np.ndarray, "S 2 N 4 23"]:
    """Return polynomial coefficients in each of the N = K - 1 intervals: Hermite's
    cubics of q and v, straight lines of tau."""
    h = (durations / (q.shape[2] - 1))[..., None, None]
    cubic = hermite_coefficients(
        h, q[:, :, :-1], q[:, :, 1:], v[:, :, :-1], v[:, :, 1:]
    )
    line = [tau[:, :, :-1], np.diff(tau, axis=2)]
    line += [np.zeros_like(line[1])] * 2
    return np.concatenate([np.stack(cubic, axis=-2), np.stack(line, axis=-2)], axis=-1)


def _in_the_middle(
    cubics: Float[np.ndarray, "... N 4 n"],
) -> Float[np.ndarray, "... n"]:
    """Return the values of a segment's cubics in the middle of the segment."""
    interval, share = divmod(0.5 * cubics.shape[-3], 1.0)
    powers = share ** np.arange(4)[:, None]
    return np.sum(cubics[..., int(interval), :, :] * powers, axis=-2)


def _with_feet(
    q: Float[np.ndarray, "*points 15"],
    v: Float[np.ndarray, "*points 15"],
    legs: LegGeometry,
) -> tuple[Float[np.ndarray, "*points 15"], Float[np.ndarray, "*points 15"]]:
    """Return coordinates and rates with hip and knee replaced by (x, z) of the foot's
    centre, and its rate."""
    (hip, knee, spring), (hip_rate, knee_rate, spring_rate) = (
        np.moveaxis(by_leg(x[..., TRUNK:]), -1, 0) for x in (q, v)
    )
    place, rate = foot_in_plane(
        (q[..., 2:3], hip, knee, legs.lower - legs.foot_radius - spring),
        (v[..., 2:3], hip_rate, knee_rate, -spring_rate),
        legs,
    )

    def row(
        trunk: Float[np.ndarray, "*points 3"], *legs: Float[np.ndarray, "*points 4"]
    ) -> np.ndarray:
        return np.concatenate(
            [trunk, np.stack(legs, axis=-1).reshape(*trunk.shape[:-1], -1)], axis=-1
        )

    return row(q[..., :TRUNK], *place, spring), row(v[..., :TRUNK], *rate, spring_rate)


def foot_in_plane(
    joints: tuple[Number, Number, Number, Number],
    rates: tuple[Number, Number, Number, Number],
    legs: LegGeometry,
) -> tuple[tuple[Number, Number], tuple[Number, Number]]:
    """Return the legs' ends from the trunk's centre, (x, z), and their rates, from
    pitch, hip, knee and length of the lower leg.

    These are the numbers of `optimiser.links`, but not to the last bit: policies were
    trained with this arithmetic.
    """
    pitch, hip, knee, lower = joints
    pitch_rate, hip_rate, knee_rate, lower_rate = rates
    thigh, thigh_rate = pitch + hip, pitch_rate + hip_rate
    # Along the trunk, down from it, down the thigh, down the lower leg: length, its
    # rate, angle, its rate.
    links: tuple[tuple[Number, Number, Number, Number], ...] = (
        (legs.origins[:, 0], 0.0, pitch, pitch_rate),
        (legs.drop - legs.origins[:, 2], 0.0, pitch + np.pi / 2, pitch_rate),
        (legs.thigh, 0.0, thigh + np.pi / 2, thigh_rate),
        (lower, lower_rate, thigh + knee + np.pi / 2, thigh_rate + knee_rate),
    )
    x = np.sum([length * np.cos(angle) for length, _, angle, _ in links], axis=0)
    z = np.sum([-length * np.sin(angle) for length, _, angle, _ in links], axis=0)
    x_rate = np.sum(
        [
            change * np.cos(at) - length * turn * np.sin(at)
            for length, change, at, turn in links
        ],
        axis=0,
    )
    z_rate = np.sum(
        [
            -change * np.sin(at) - length * turn * np.cos(at)
            for length, change, at, turn in links
        ],
        axis=0,
    )
    return (x, z), (x_rate, z_rate)
