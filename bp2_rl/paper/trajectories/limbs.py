"""Should limbs be light? BP2 with mass moved between trunk and legs, all of it the same, and with other trunks.

The paper wants the inertia of limbs used rather than least, and tries no other legs. Inertias go with the masses, so
a thigh of twice the mass has twice the inertia about its end; what legs gain the trunk loses. A trunk of a thousand
times its inertia is guided: it cannot pitch, as if limbs had nothing to shake.
"""

from bp2_rl.optimiser.problem import Problem
from bp2_rl.paper.trajectories.comparison import ComparedVariant

LIMBS: dict[str, tuple[str, float]] = {
    f"{what} x {factor:g}": (field, factor)
    for what, field, factors in (
        ("thigh", "thigh_mass", (0.5, 1.5, 2.0)),
        ("toe", "toe_mass", (0.5, 1.5, 2.0)),
        ("trunk", "trunk_inertia", (0.5, 2.0, 1e3)),
    )
    for factor in factors
}
"""A field of the hardware, and by what it is multiplied."""


def limb_variants(problem: Problem) -> list[ComparedVariant]:
    """The problem, and with each of them."""
    changed = {
        name: problem.on(**{field: factor * getattr(problem.hardware, field)})
        for name, (field, factor) in LIMBS.items()
    }
    return [
        ComparedVariant(name, name.replace(" ", "-"), one) for name, one in {"as it is": problem, **changed}.items()
    ]
