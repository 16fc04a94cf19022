"""BP2's body, with the numbers that a designer may change."""

import dataclasses
import functools
from typing import Annotated

from bp2_rl.base.bounds import Within, check_bounds
from bp2_rl.base.errors import UserError
from bp2_rl.robot import bp2
from bp2_rl.robot.anatomy import Anatomy, Inertia, Leg, Link, Vector
from bp2_rl.robot.conventions import LEGS


@dataclasses.dataclass(frozen=True)
class BP2Body:
    """BP2's body; `BP2Body()` is the paper's. Mass that is added to the legs is taken
    from the trunk."""

    leg_length: Annotated[float, Within(0.0, 10.0)] = bp2.THIGH_LENGTH
    """m, length of the thigh and of the uncompressed lower leg alike"""
    # m, between fore legs' planes
    fore_track: Annotated[float, Within(2.0 * bp2.THIGH_LATERAL, 10.0)] = bp2.FORE_TRACK
    # m, between the hind feet
    hind_track: Annotated[float, Within(2.0 * bp2.THIGH_LATERAL, 10.0)] = bp2.HIND_TRACK
    thigh_mass: Annotated[float, Within(0.1, 10.0)] = bp2.THIGH_MASS
    """kg, before `mass_scale`; mass added to legs is taken from the trunk, and inertias
    change with masses"""
    toe_mass: Annotated[float, Within(0.05, 10.0)] = bp2.TOE_MASS  # kg, of one
    trunk_inertia: Annotated[float, Within(0.1, 1e4)] = 1.0
    """factor on the trunk's inertia, beside its mass; a large one keeps the trunk from
    pitching"""

    def __post_init__(self) -> None:
        """Raise `UserError` if a value is out of bounds or the legs leave the trunk too
        little mass."""
        check_bounds(self, "hardware.body.")
        most = bp2.QUARTER_MASS - bp2.SHANK_MASS - bp2.LEAST_TRUNK / 4.0
        if self.thigh_mass + self.toe_mass > most:
            raise UserError(
                f"hardware.body.thigh_mass ({self.thigh_mass:g}) and toe_mass ({self.toe_mass:g}) must leave the trunk "
                f"{bp2.LEAST_TRUNK:g} kg: together at most {most:g} kg"
            )

    @property
    def thigh_inertia(self) -> float:
        """Return a thigh's inertia about its centre of mass, across its length, kg m2,
        before masses are scaled."""
        return self.thigh_mass / bp2.THIGH_MASS * bp2.THIGH_INERTIA

    @property
    def toe_inertia(self) -> float:
        """Return a toe's inertia about its centre of mass, across its length, kg m2,
        before masses are scaled."""
        return self.toe_mass / bp2.TOE_MASS * bp2.TOE_INERTIA

    @property
    def trunk_quarter_mass(self) -> float:
        """Mass of a quarter of the trunk with its abduction link, kg; heavier legs
        leave less."""
        return (
            bp2.TRUNK_QUARTER_MASS
            + (bp2.THIGH_MASS - self.thigh_mass)
            + (bp2.TOE_MASS - self.toe_mass)
        )

    @property
    def trunk_inertia_share(self) -> float:
        """Inertia of the trunk without its abduction links, over the paper's BP2."""
        return (
            self.trunk_inertia
            * (self.trunk_quarter_mass - bp2.ABAD_MASS)
            / (bp2.TRUNK_QUARTER_MASS - bp2.ABAD_MASS)
        )

    @property
    def trunk_pitch_inertia(self) -> float:
        """Return the pitch inertia, kg m2, of the trunk with its abduction links about
        its centre."""
        return bp2.TRUNK_PITCH_INERTIA + (self.trunk_inertia_share - 1.0) * (
            bp2.TRUNK_PITCH_INERTIA - _ABAD_LINKS
        )

    @property
    def hip_laterals(self) -> tuple[float, float, float, float]:
        """Lateral offsets of the legs' abduction axes from the trunk's mid-plane, m,
        positive to the left, in the order of `LEGS`."""
        fore, hind = (
            round(track / 2 - bp2.THIGH_LATERAL, 12)
            for track in (self.fore_track, self.hind_track)
        )
        return -fore, fore, -hind, hind

    @functools.cached_property
    def anatomy(self) -> Anatomy:
        """Return BP2's body as an `Anatomy`."""
        share = self.trunk_inertia_share
        roll = bp2.TRUNK_ROLL_INERTIA
        pitch = bp2.TRUNK_PITCH_INERTIA - _ABAD_LINKS
        yaw = bp2.TRUNK_YAW_INERTIA
        return Anatomy(
            name="BP2",
            trunk=Link(
                mass=4.0 * (self.trunk_quarter_mass - bp2.ABAD_MASS),
                com=(0.0, 0.0, 0.0),
                inertia=(share * roll, share * pitch, share * yaw, 0.0, 0.0, 0.0),
            ),
            legs=(self._leg(0), self._leg(1), self._leg(2), self._leg(3)),
            stand=bp2.STAND_JOINTS,
            trunk_size=(
                bp2.TRUNK_REACH + bp2.TRUNK_RADIUS,
                bp2.TRUNK_LATERAL + bp2.TRUNK_RADIUS,
                bp2.TRUNK_RADIUS,
            ),
            weighed_mass=bp2.TOTAL_MASS,
            footprint=(bp2.BODY_LENGTH / 2.0, bp2.BODY_WIDTH / 2.0),
            thigh_radius=bp2.THIGH_RADIUS,
            lower_radius=bp2.LOWER_LEG_RADIUS,
            gear_ratio=bp2.GEAR_RATIO,
        )

    def _leg(self, index: int) -> Leg:
        fore = 1.0 if LEGS[index][0] == "F" else -1.0
        left = 1.0 if LEGS[index][1] == "L" else -1.0
        thigh_twist = self.thigh_mass / bp2.THIGH_MASS * bp2.THIGH_TWIST_INERTIA
        return Leg(
            anchor=(fore * bp2.HIP_FORE_AFT, self.hip_laterals[index], 0.0),
            hip=(0.0, left * bp2.THIGH_LATERAL, 0.0),
            knee=(0.0, 0.0, -self.leg_length),
            foot=(0.0, 0.0, bp2.FOOT_RADIUS - self.leg_length),
            foot_radius=bp2.FOOT_RADIUS,
            abad=Link(
                bp2.ABAD_MASS,
                (fore * bp2.ABAD_COM_FORE_AFT, 0.0, 0.0),
                _round(bp2.ABAD_INERTIA),
            ),
            thigh=Link(
                self.thigh_mass,
                _down(bp2.THIGH_COM),
                _rod(self.thigh_inertia, thigh_twist),
            ),
            shank=Link(
                bp2.SHANK_MASS,
                _down(bp2.SHANK_LENGTH + bp2.SHANK_COM),
                _rod(bp2.SHANK_INERTIA, bp2.SHANK_TWIST_INERTIA),
            ),
            toe=Link(
                self.toe_mass,
                _down(bp2.TOE_LENGTH + bp2.TOE_COM),
                _round(self.toe_inertia),
            ),
            seat=_down(self.leg_length - bp2.TOE_LENGTH),
            ranges=(bp2.ABAD_RANGE, bp2.HIP_RANGE, bp2.KNEE_RANGE),
        )


_ABAD_LINKS = 4.0 * (
    bp2.ABAD_INERTIA + bp2.ABAD_MASS * (bp2.HIP_FORE_AFT + bp2.ABAD_COM_FORE_AFT) ** 2
)
"""Pitch inertia of the four abduction links about the trunk's centre, kg m2."""


def _down(distance: float) -> Vector:
    return 0.0, 0.0, -distance


def _rod(across: float, along: float) -> Inertia:
    return across, across, along, 0.0, 0.0, 0.0


def _round(inertia: float) -> Inertia:
    return inertia, inertia, inertia, 0.0, 0.0, 0.0
