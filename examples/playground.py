"""Measure how fast MuJoCo Playground trains its Go1, with Playground's own settings and
Brax's learner, on one device.

    pip install -c constraints.txt -e ".[playground]"
    python examples/playground.py           # Playground's own 8192 robots
    python examples/playground.py 4096      # another number
    python examples/playground.py 8192 jax  # MJX in JAX where Playground's choice is Warp

Our training beside it: `bp2 bench --devices 1 --robots 8192 --parts training`.
"""

import contextlib
import functools
import sys
import time
import xml.etree.ElementTree as ET
from collections.abc import Generator, Sequence
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp
from brax.training.agents.ppo import networks
from brax.training.agents.ppo import train as ppo_train
from mujoco_playground import locomotion, wrapper
from mujoco_playground._src import mjx_env
from mujoco_playground._src.locomotion.go1 import base, go1_constants, joystick
from mujoco_playground.config.locomotion_params import brax_ppo_config

TASK = "Go1JoystickFlatTerrain"
TRAIN_STEPS = 5  # between two readings of the clock
WARM_UP = 2  # looks: all that compiles must have compiled by then
MOST = 1000  # looks


class _TimedEnoughError(Exception):
    """Ends Brax's training after enough timed steps: Brax wants the number of steps
    beforehand."""


def measure_playground(
    robots: int | None = None, seconds: float = 2.0, impl: str | None = None
) -> float:
    """Train Playground's Go1 for some seconds; return the control steps per second,
    summed over all robots.

    It trains in at least two spans of `TRAIN_STEPS`. Evaluations, and the resets
    between them, are left out.

    Args:
        robots: a multiple of Playground's 32 minibatches; by default its own number.
        seconds: of training that is timed.
        impl: `jax` or `warp`; by default `choose_physics()`.
    """
    settings = brax_ppo_config(TASK).to_dict()
    robots, batches = robots or settings["num_envs"], settings["num_minibatches"]
    if robots % batches:
        raise SystemExit(
            f"{robots} robots: Playground's learner needs a multiple of its {batches} minibatches"
        )
    steps = TRAIN_STEPS * robots * settings["unroll_length"]
    settings |= {
        "num_envs": robots,
        "batch_size": robots // batches,
        "num_evals": MOST + 1,
        "num_resets_per_eval": 0,
        "num_timesteps": MOST * steps,
        "network_factory": functools.partial(
            networks.make_ppo_networks, **settings["network_factory"]
        ),
    }
    # Brax annotates its own systems
    randomise: Any = locomotion.get_domain_randomizer(TASK)
    clock: list[float] = []

    def look(*_: object) -> None:
        clock.append(time.perf_counter())
        if len(clock) >= WARM_UP + 2 and clock[-1] - clock[WARM_UP - 1] >= seconds:
            raise _TimedEnoughError

    with _removed_from_jax(), contextlib.suppress(_TimedEnoughError):
        ppo_train.train(
            make_env(impl or choose_physics()),
            **settings,
            wrap_env_fn=wrapper.wrap_for_brax_training,
            max_devices_per_host=1,
            randomization_fn=randomise,
            run_evals=False,
            progress_fn=look,
        )
    timed = (len(clock) - WARM_UP) * steps
    return timed / (clock[-1] - clock[WARM_UP - 1])


def choose_physics() -> str:
    """Return Playground's own choice of MJX, but `jax` without an NVIDIA GPU or without
    Warp."""
    own: Any = locomotion.get_default_config(TASK)
    warp = jax.default_backend() == "gpu" and sys.modules.get("warp")
    return str(own.impl) if warp else "jax"


def make_env(impl: str) -> Any:
    """Make Playground's environment without its visual meshes, which would have to be
    downloaded."""

    def assets() -> dict[str, bytes]:
        found: dict[str, bytes] = {}
        mjx_env.update_assets(found, go1_constants.ROOT_PATH / "xmls", "*.xml")
        mjx_env.update_assets(found, go1_constants.ROOT_PATH / "xmls" / "assets")
        return {
            name: without_meshes(text) if name.endswith(".xml") else text
            for name, text in found.items()
        }

    with mock.patch.object(base, "get_assets", assets):
        return joystick.Joystick("flat_terrain", config_overrides={"impl": impl})


def without_meshes(mjcf: bytes) -> bytes:
    """Return an MJCF file without its meshes and the geoms that show them."""
    root = ET.fromstring(mjcf)
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag == "mesh" or (child.tag == "geom" and "mesh" in child.attrib):
                parent.remove(child)
    return ET.tostring(root)


@contextlib.contextmanager
def _removed_from_jax() -> Generator[None]:
    """Restore in the block a JAX function that Brax still calls and JAX has removed."""

    def device_put_replicated(tree: object, devices: Sequence[object]) -> object:
        return jax.tree.map(
            lambda x: jnp.broadcast_to(x, (len(devices), *jnp.shape(x))), tree
        )

    with mock.patch.object(
        jax, "device_put_replicated", device_put_replicated, create=True
    ):
        yield


if __name__ == "__main__":
    fleet = int(sys.argv[1]) if len(sys.argv) > 1 else None
    physics = sys.argv[2] if len(sys.argv) > 2 else choose_physics()
    rate = measure_playground(fleet, impl=physics)
    period: Any = locomotion.get_default_config(TASK)
    print(
        f"MuJoCo Playground's Go1, MJX {physics}: {rate:,.0f} control steps/s of {1000 * period.ctrl_dt:g} ms"
    )
