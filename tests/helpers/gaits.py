"""Samples of a reference motion over arrays of commands and phases."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from bp2_rl.reference.interface import Reference

ROWS = 2048  # of a compiled call


def sample(gait, command, phase, dtype: type = float) -> Reference:
    """Return the reference over arrays of commands and phases as NumPy, joints and
    torques as legs x (abad, hip, knee)."""
    shape = np.broadcast_shapes(np.shape(command)[:-1], np.shape(phase))
    commands = np.broadcast_to(command, (*shape, 3)).reshape(-1, 3)
    phases = np.broadcast_to(phase, shape).reshape(-1, 1)
    rows = np.hstack([commands, phases]).astype(dtype)
    # few shapes: compiled once
    padding = -len(rows) % (ROWS if len(rows) > 1 else 1)
    padded = np.pad(rows, [(0, padding), (0, 0)], mode="edge")
    parts = [
        _reference(gait, part[:, :3], part[:, 3])
        for part in np.split(padded, max(len(padded) // ROWS, 1))
    ]
    whole = jax.tree.map(lambda *leaf: np.concatenate(leaf)[: len(rows)], *parts)
    by_leg = {
        name: getattr(whole, name).reshape(-1, 4, 3)
        for name in ("joint_position", "joint_velocity", "torque")
    }
    return jax.tree.map(
        lambda leaf: leaf.reshape((*shape, *leaf.shape[1:])), whole.replace(**by_leg)
    )


@functools.partial(jax.jit, static_argnums=0)
def _reference(gait, command, phase):
    return gait(command, phase)


def rate(gait, command) -> np.ndarray:
    """Return the gait's stride frequency under a command, cycles a second."""
    return np.asarray(gait.phase_rate(jnp.asarray(command, float)))


def around(gait, command, phase, step: float = 1e-6) -> list[Reference]:
    """Return the reference at a phase, and `step` seconds before and after."""
    shift = rate(gait, command)
    return [sample(gait, command, phase + dt * shift) for dt in (0.0, -step, step)]


def require_mirror_images(
    left: Reference, right: Reference, rates: float = 1e-7
) -> None:
    """Require that one motion is the other with left and right changed, and its joints'
    speeds to `rates`, rad/s."""
    swap, flip = [1, 0, 3, 2], np.array([-1.0, 1.0, 1.0])
    for name, sides, tolerance in (
        ("joint_position", flip, 1e-9),
        ("joint_velocity", flip, rates),
        ("torque", 1.0, 1e-9),
    ):
        mirrored = getattr(right, name)[..., swap, :] * sides
        np.testing.assert_allclose(
            getattr(left, name), mirrored, atol=tolerance, err_msg=name
        )
    np.testing.assert_allclose(
        left.spring_compression, right.spring_compression[..., swap], atol=1e-9
    )
    np.testing.assert_allclose(left.height, right.height, atol=1e-9)
