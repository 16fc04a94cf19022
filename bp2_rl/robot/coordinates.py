"""Split MuJoCo's `qpos` and `qvel` of a quadruped into trunk, joints and springs, and
join them again.

`qpos` is the trunk's position (3) and quaternion (4), then per leg the angles of abad,
hip and knee and, where shanks are springs, the compression of the spring. `qvel` is the
trunk's linear velocity (world frame), its angular velocity (body frame), then the rates
of the legs' coordinates. Batched over leading axes; NumPy and JAX arrays alike.
"""

import numpy as np

from bp2_rl.base.arrays import Array, ArrayT

POSE, TWIST = 7, 6  # numbers of the trunk in qpos and in qvel


def joint_positions(qpos: ArrayT) -> ArrayT:
    """Return the angles of the twelve joints ("... 12"), rad, from `qpos`."""
    return _joints(qpos, POSE)


def joint_velocities(qvel: ArrayT) -> ArrayT:
    """Return the speeds of the twelve joints ("... 12"), rad/s, from `qvel`."""
    return _joints(qvel, TWIST)


def compressions(qpos: ArrayT) -> ArrayT:
    """Return the springs' compression ("... 4"), m; zero where shanks are rigid."""
    return _springs(qpos, POSE)


def compression_rates(qvel: ArrayT) -> ArrayT:
    """Return the rate of the springs' compression ("... 4"), m/s; zero where shanks are
    rigid."""
    return _springs(qvel, TWIST)


def with_legs(x: ArrayT, joints: Array, springs: Array) -> ArrayT:
    """Return `qpos` or `qvel` with other joints and springs; with rigid shanks the
    springs are unused."""
    # the legs have 12 or 16 numbers
    xp, trunk = x.__array_namespace__(), x.shape[-1] % 4 + 4
    legs = joints.reshape(*joints.shape[:-1], 4, 3)
    if x.shape[-1] - trunk == 16:
        legs = xp.concat([legs, springs[..., None]], axis=-1)
    return xp.concat([x[..., :trunk], legs.reshape(*joints.shape[:-1], -1)], axis=-1)


def motor_indices(nv: int) -> np.ndarray:
    """Return the indices of the twelve joints in `qvel` and in generalised forces."""
    return np.arange(TWIST, nv).reshape(4, -1)[:, :3].ravel()


def _joints(x: ArrayT, trunk: int) -> ArrayT:
    legs = x[..., trunk:].reshape(*x.shape[:-1], 4, -1)
    return legs[..., :3].reshape(*x.shape[:-1], 12)


def _springs(x: ArrayT, trunk: int) -> ArrayT:
    legs = x[..., trunk:].reshape(*x.shape[:-1], 4, -1)
    return legs[..., 3] if legs.shape[-1] == 4 else 0.0 * legs[..., 0]
