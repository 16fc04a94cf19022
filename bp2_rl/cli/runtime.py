"""Set up JAX for the commands: find its devices, and import it without messages.

Import this before anything else of the package.
"""

import concurrent.futures
import os

import jax

from bp2_rl.base.errors import UserError
from bp2_rl.base.processes import without_gl_library

with without_gl_library():
    import bp2_rl.robot.mjx  # noqa: F401


def find_backend() -> str:
    """Return the kind of device on which JAX computes: `cpu`, or an accelerator's.

    Raises:
        UserError: the environment requests a kind that does not exist.
    """
    try:
        return jax.default_backend()
    except (AssertionError, RuntimeError) as error:
        raise UserError(
            f"JAX finds no device of JAX_PLATFORMS={jax.config.values['jax_platforms']}: unset JAX_PLATFORMS, or, for an "
            'NVIDIA GPU, check that nvidia-smi works, and pip install -c constraints.txt -e ".[gpu]"'
        ) from error


def wake_device() -> None:
    """Initialise the device in a thread while imports go on; a GPU's first operation
    takes a second."""
    concurrent.futures.ThreadPoolExecutor(1).submit(jax.numpy.zeros, 1)


def require_accelerator(preset: str) -> None:
    """Raise UserError for the preset `gpu` on a machine without an accelerator, where
    training takes days.

    Raises:
        UserError: the preset is `gpu`, and there is no accelerator.
    """
    if preset == "gpu" and find_backend() == "cpu":
        raise UserError(
            "JAX sees no accelerator, and on processors --preset gpu takes days: use --preset cpu"
        )


def repeat_bit_for_bit() -> None:
    """Make GPU results repeat bit for bit, as CPU results do, at some cost in speed;
    call it before JAX starts."""
    # Of two flags the later one holds.
    os.environ["XLA_FLAGS"] = (
        f"{os.environ.get('XLA_FLAGS', '')} --xla_gpu_deterministic_ops=true".strip()
    )
