"""Measure the training speed of MuJoCo Playground's Go1, as a peer of our training."""

import contextlib
import dataclasses
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

from bp2_rl.base.errors import UserError, not_installed
from bp2_rl.tools.throughput import MOST, WARM_UP

TASK = "Go1JoystickFlatTerrain"
TRAIN_STEPS = 5  # between two looks at the clock


@dataclasses.dataclass(frozen=True)
class PlaygroundRate:
    """The training speed of MuJoCo Playground on one device."""

    # of MJX: Playground's choice, but `jax` without an NVIDIA GPU or without Warp
    impl: str
    robots: int
    control_period: float  # s, of simulated time
    control_steps: int  # that were timed, all robots together
    control_steps_per_second: float


class _TimedEnoughError(Exception):
    """Ends Brax's training after enough timed steps: Brax wants the number of steps
    beforehand."""


def playground_settings(robots: int | None = None) -> dict[str, Any]:
    """Return Playground's settings of Brax's PPO for its Go1, for a number of robots.

    Args:
        robots: how many, a multiple of Playground's 32 minibatches; by default
            Playground's own number, 8192.

    Raises:
        UserError: Playground is not installed, or the robots are no such multiple.
    """
    try:
        from mujoco_playground.config.locomotion_params import brax_ppo_config
    except ImportError as missing:
        raise not_installed(
            "--peer playground", "playground", "playground"
        ) from missing
    settings = brax_ppo_config(TASK).to_dict()
    robots, batches = robots or settings["num_envs"], settings["num_minibatches"]
    if robots % batches:
        raise UserError(
            f"--robots {robots}: Playground's learner needs a multiple of its {batches} minibatches"
        )
    return settings | {"num_envs": robots, "batch_size": robots // batches}


def measure_playground(settings: dict[str, Any], seconds: float) -> PlaygroundRate:
    """Train Playground's Go1 for some seconds; return the training speed.

    It trains in at least two spans of `TRAIN_STEPS`. What Playground resets between
    evaluations is left out, as are the evaluations.
    """
    from mujoco_playground import locomotion, wrapper

    own: Any = locomotion.get_default_config(TASK)
    warp = jax.default_backend() == "gpu" and sys.modules.get("warp")
    impl = str(own.impl) if warp else "jax"
    robots = settings["num_envs"]
    steps = TRAIN_STEPS * robots * settings["unroll_length"]
    settings |= {
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
            _make_env(impl),
            **settings,
            wrap_env_fn=wrapper.wrap_for_brax_training,
            max_devices_per_host=1,
            randomization_fn=randomise,
            run_evals=False,
            progress_fn=look,
        )
    timed = (len(clock) - WARM_UP) * steps
    return PlaygroundRate(
        impl, robots, own.ctrl_dt, timed, timed / (clock[-1] - clock[WARM_UP - 1])
    )


def _make_env(impl: str) -> Any:
    """Make Playground's Go1 environment without its visual meshes, which need a
    download."""
    from mujoco_playground._src import mjx_env
    from mujoco_playground._src.locomotion.go1 import base, go1_constants, joystick

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
