"""Variants of BP2 with the same motors: other thighs, rigid shanks, rigid legs of other
robots."""

import dataclasses
from collections.abc import Mapping

from bp2_rl.paper.scaling.legs import merged
from bp2_rl.robot.anatomy import Anatomy, Leg, Link
from bp2_rl.robot.hardware import BUILT, HardwareSpec

THIGHS = 0.5, 2.0  # times the mass of BP2's
BP2, RIGID, ON_LEGS = "BP2", "rigid shanks", "rigid, legs of "


def bp2_variants(others: Mapping[str, HardwareSpec]) -> dict[str, HardwareSpec]:
    """Return the hardware of BP2, with other thighs, with rigid shanks, and on rigid
    legs of other robots, by name."""
    rigid = rigid_shanks(BUILT)
    found = {BP2: BUILT}
    for factor in THIGHS:
        found[f"thighs x {factor:g}"] = BUILT.changed(
            thigh_mass=factor * BUILT.bp2.thigh_mass
        )
    found[RIGID] = rigid
    for name, other in others.items():
        found[f"{ON_LEGS}{name}"] = on_legs_of(other.anatomy, rigid)
    return found


def rigid_shanks(hardware: HardwareSpec) -> HardwareSpec:
    """Return a robot whose toes are welded to its shanks where its springs have them at
    rest."""

    def rigid(leg: Leg) -> Leg:
        return (
            leg
            if leg.toe is None
            else dataclasses.replace(
                leg, shank=merged(leg.shank, leg.toe, leg.seat), toe=None
            )
        )

    fr, fl, rr, rl = map(rigid, hardware.anatomy.legs)
    body = dataclasses.replace(hardware.anatomy, legs=(fr, fl, rr, rl))
    return dataclasses.replace(hardware, body=body)


def on_legs_of(other: Anatomy, hardware: HardwareSpec) -> HardwareSpec:
    """Return a robot with rigid shanks on the thighs and shanks of another one, which
    is scaled to the same mass.

    Lengths go with the cube root of the mass. The trunk has what the legs leave. Hips,
    joint ranges and motors stay.

    Args:
        other: the robot whose legs are taken.
        hardware: the robot that gets them.
    """
    body = hardware.anatomy
    scale = (body.mass / other.mass) ** (1.0 / 3.0)

    def refit(leg: Leg, model: Leg) -> Leg:
        return dataclasses.replace(
            leg,
            knee=(0.0, 0.0, scale * model.knee[2]),
            foot=(0.0, 0.0, scale * model.foot[2]),
            foot_radius=scale * model.foot_radius,
            thigh=_scaled(model.thigh, scale, scale**3),
            shank=_scaled(model.shank, scale, scale**3),
        )

    fr, fl, rr, rl = map(refit, body.legs, other.legs)
    trunk = body.mass - sum(link.mass for leg in (fr, fl, rr, rl) for link in leg.links)
    lighter = _scaled(body.trunk, 1.0, trunk / body.trunk.mass)
    return dataclasses.replace(
        hardware, body=dataclasses.replace(body, legs=(fr, fl, rr, rl), trunk=lighter)
    )


def leg_share(anatomy: Anatomy) -> float:
    """Return the share of a robot's mass that is in its legs from the thighs down."""
    return (
        sum(link.mass for leg in anatomy.legs for link in leg.links[1:]) / anatomy.mass
    )


def _scaled(link: Link, length: float, mass: float) -> Link:
    """Return a link with its lengths multiplied by `length` and its mass by `mass`."""
    x, y, z = (length * c for c in link.com)
    xx, yy, zz, xy, xz, yz = (mass * length**2 * i for i in link.inertia)
    return Link(mass * link.mass, (x, y, z), (xx, yy, zz, xy, xz, yz))
