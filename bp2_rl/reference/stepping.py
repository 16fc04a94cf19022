"""Properties that all trots share: the pairs of legs, the feet's places, and the ground's motion under the robot."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bp2_rl.robot.hardware import HardwareSpec

TROT = np.array([0.5, 0.0, 0.0, 0.5])  # cycles by which FR, FL, RR, RL are ahead: FL goes with RR, FR with RL
STANDING = 0.05  # a gait that steps by less than this share of its full steps counts no foot as lifted


def nominal_feet(hardware: HardwareSpec) -> Float[np.ndarray, "4 2"]:
    """Where the feet are set, seen from above, m: below the hips."""
    geometry = hardware.anatomy.geometry
    return geometry.origins[:, :2] + np.stack([np.zeros(4), geometry.lateral], axis=-1)


def square_speed(command: Float[Array, "... 3"], hardware: HardwareSpec) -> Float[Array, "..."]:
    """Square of the planar speed demanded of the outermost foot, yaw included, (m/s)^2."""
    vx, vy, yaw_rate = command[..., 0], command[..., 1], command[..., 2]
    radius = float(np.max(np.linalg.norm(nominal_feet(hardware), axis=-1)))
    return vx**2 + vy**2 + (radius * yaw_rate) ** 2


def ground(
    nominal: Float[Array, "4 2"], v: Float[Array, "... 2"], yaw_rate: Float[Array, "... 1"], tau: Float[Array, "... 4"]
) -> Float[Array, "... 4 2"]:
    """Where points of the ground are, seen from the trunk, `tau` seconds after they were at `nominal`.

    The trunk moves at `v` in its own frame and turns at omega = `yaw_rate`, so p' = -v - omega x p. The solution is
    R(-omega tau) nominal - V v with V the integral of R(-omega u) du from 0 to tau: a chord, of direction
    R(-omega tau / 2) and length tau sinc(omega tau / 2).
    """
    half = yaw_rate * tau / 2.0
    y = half * half
    chord = tau * (1.0 - y / 6.0 * (1.0 - y / 20.0 * (1.0 - y / 42.0)))  # sinc by its series: |half| is below 0.3
    return turn(-2.0 * half, nominal) - chord[..., None] * turn(-half, v[..., None, :])


def turn(angle: Float[Array, "... 4"], p: Float[Array, "... 2"]) -> Float[Array, "... 4 2"]:
    """p turned by `angle` about z."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([c * p[..., 0] - s * p[..., 1], s * p[..., 0] + c * p[..., 1]], axis=-1)
