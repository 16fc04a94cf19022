"""Should limbs be light? BP2 with mass moved between trunk and legs, all of it the same, and with other trunks.

The paper wants the inertia of limbs used rather than least, and tries no other legs. Inertias go with the masses, so
a thigh of twice the mass has twice the inertia about its end; what legs gain the trunk loses. A guided trunk cannot
pitch, as if limbs had nothing to shake.
"""

from typing import Any

from bp2_rl.trajopt.comparison import Variant
from bp2_rl.trajopt.problem import Problem

LIMBS: dict[str, dict[str, Any]] = {
    "BP2": {},
    "thigh 1.1 kg": {"thigh_mass": 1.1},
    "thigh 3.3 kg": {"thigh_mass": 3.3},
    "thigh 4.4 kg": {"thigh_mass": 4.4},
    "toe 0.25 kg": {"toe_mass": 0.25},
    "toe 0.75 kg": {"toe_mass": 0.75},
    "toe 1 kg": {"toe_mass": 1.0},
    "trunk's inertia x 0.5": {"trunk_inertia": 0.5},
    "trunk's inertia x 2": {"trunk_inertia": 2.0},
    "trunk guided": {"trunk_inertia": 1e3},
}
"""BP2 weighs 2.2 kg a thigh and 0.5 kg a toe."""


def limb_variants(problem: Problem) -> list[Variant]:
    """The problem with each of them."""
    return [
        Variant(name, name.replace("'", "").replace(" ", "-"), problem.on(**change)) for name, change in LIMBS.items()
    ]
