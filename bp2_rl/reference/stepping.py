"""Properties that all trots share: the pairs of legs, the feet's places, and the
ground's motion under the robot.

Functions take arrays of NumPy or JAX and import neither JAX nor jaxtyping, so that a
robot's own computer shares them.
"""

import numpy as np

from bp2_rl.base.arrays import Array
from bp2_rl.robot.hardware import HardwareSpec

# cycles by which FR, FL, RR, RL are ahead: FL goes with RR, FR with RL
TROT = np.array([0.5, 0.0, 0.0, 0.5])
# a gait that steps by less than this share of its full steps counts no foot as lifted
STANDING = 0.05


def nominal_feet(hardware: HardwareSpec) -> np.ndarray:
    """Return where the feet are set on the ground, below the hips, seen from above ("4
    2"), m."""
    geometry = hardware.anatomy.geometry
    return geometry.origins[:, :2] + np.stack([np.zeros(4), geometry.lateral], axis=-1)


def foot_circle(hardware: HardwareSpec) -> float:
    """Return the distance of the outermost foot from the trunk's centre, seen from
    above, m."""
    return float(np.max(np.linalg.norm(nominal_feet(hardware), axis=-1)))


def square_speed(command: Array, circle: float) -> Array:
    """Square of the planar speed demanded of the outermost foot, yaw included, ("..."),
    (m/s)^2.

    Args:
        command: ("... 3"), m/s forward, m/s to the left, rad/s.
        circle: m, distance of that foot from the trunk's centre.
    """
    vx, vy, yaw_rate = command[..., 0], command[..., 1], command[..., 2]
    return vx**2 + vy**2 + (circle * yaw_rate) ** 2


def ground(nominal: Array, v: Array, yaw_rate: Array, tau: Array) -> Array:
    """Return where points of the ground ("... 4 2") are, seen from the trunk, `tau`
    seconds after they were at `nominal`.

    The trunk moves at `v` in its own frame and turns at omega = `yaw_rate`, so p' = -v
    - omega x p. The solution is R(-omega tau) nominal - V v with V the integral of
    R(-omega u) du from 0 to tau: a chord, of direction R(-omega tau / 2) and length tau
    sinc(omega tau / 2).

    Args:
        nominal: ("4 2"), m.
        v: ("... 2"), m/s.
        yaw_rate: ("... 1"), rad/s.
        tau: ("... 4"), s.
    """
    half = yaw_rate * tau / 2.0
    y = half * half
    # sinc by its series: |half| is below 0.3
    chord = tau * (1.0 - y / 6.0 * (1.0 - y / 20.0 * (1.0 - y / 42.0)))
    return turn(-2.0 * half, nominal) - chord[..., None] * turn(-half, v[..., None, :])


def turn(angle: Array, p: Array) -> Array:
    """Return points p ("... 2"), or ("4 2"), turned by an angle ("... 4") about z."""
    xp = angle.__array_namespace__()
    c, s = xp.cos(angle), xp.sin(angle)
    return xp.stack(
        [c * p[..., 0] - s * p[..., 1], s * p[..., 0] + c * p[..., 1]], axis=-1
    )
