"""How far a leg is stretched, which `kinematics.reach` bounds."""

import numpy as np

from bp2_rl.robot import bp2, kinematics


def leg_extension(feet: np.ndarray) -> np.ndarray:
    """Return the distance of each sole ("... 4 3") from its hip axis, in the leg's
    plane, m."""
    p = feet - kinematics.leg_origins()
    return np.sqrt(np.maximum(np.sum(p * p, axis=-1) - bp2.THIGH_LATERAL**2, 0.0))
