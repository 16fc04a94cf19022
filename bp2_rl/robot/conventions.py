"""Conventions of all robots: the order of legs and joints, rates, gravity and air.

SI units; world z up, x forward, y left; quaternions w-x-y-z; legs in the order FR, FL,
RR, RL; joints of a leg in the order abad, hip, knee (then the passive spring, where
there is one).
"""

from typing import NamedTuple

LEGS = ("FR", "FL", "RR", "RL")
JOINTS = ("abad", "hip", "knee")
MOTOR_NAMES = tuple(f"{leg}_{joint}" for leg in LEGS for joint in JOINTS)
NUM_MOTORS = len(MOTOR_NAMES)
MIRRORED = (1, 0, 3, 2)
"""Index of each leg's mirror image, with left and right exchanged."""


class Provenance(NamedTuple):
    """A number with its symbol, unit and source."""

    symbol: str
    value: float
    unit: str
    source: str


PROVENANCE: list[Provenance] = []


def number(symbol: str, value: float, unit: str, source: str) -> float:
    """Return the value, and note where it comes from."""
    PROVENANCE.append(Provenance(symbol, value, unit, source))
    return value


GRAVITY = number("g", 9.81, "m/s2", "standard, rounded")
AIR_DENSITY = number("rho", 1.2, "kg/m3", "standard, rounded: 20 C at sea level")

POLICY_RATE = number("-", 200.0, "Hz", "paper, Experimental Platform")
FORCE_LOOP_RATE = number("-", 1000.0, "Hz", "paper, Experimental Platform")
PHYSICS_STEP = 1.0 / FORCE_LOOP_RATE
CONTROL_STEP = 1.0 / POLICY_RATE
SUBSTEPS = round(FORCE_LOOP_RATE / POLICY_RATE)
