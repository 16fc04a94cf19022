"""The judge beside a training: what each of its policies does in C MuJoCo, from a standing start.

It works in processes of its own, on processors that the training leaves idle.
"""

import contextlib
import dataclasses
import functools
import math
import os
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path

import jax
import numpy as np

from bp2_rl.base.workers import processors, spawned
from bp2_rl.env.observations import layout_of
from bp2_rl.learning.exports import Verdict
from bp2_rl.learning.policy import Policy, load_policy
from bp2_rl.robot import specs
from bp2_rl.robot.specs import HardwareSpec
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.bodies import SwiftMachine
from bp2_rl.simulation.driver import ActionFunction
from bp2_rl.simulation.metrics import HELD, best_window
from bp2_rl.simulation.parallel import compute_here
from bp2_rl.simulation.rollout import rollout_mujoco
from bp2_rl.simulation.schedule import Ramp

AT_A_TIME = 2  # policies that are judged at the most: they come one after the other
NICE = 5  # a training beside it goes first, three to one; at 19 one that fills all processors would starve it


@dataclasses.dataclass(frozen=True)
class Launch:
    """From a standing start to the fastest command of the training, on the robot of the run or one a little worse."""

    acceleration: float  # m/s2, at which the command rises
    hold: float  # s
    friction: float = 1.0  # factor
    mass: float = 1.0  # factor
    latency: float = 0.0  # s, more than the robot's

    def ramp(self, env: EnvConfig) -> Ramp:
        """What is commanded."""
        ramp = Ramp((env.commands.max_forward, 0.0, 0.0), acceleration=self.acceleration, hold=self.hold)
        return ramp.under(env.control)

    def robot(self, hardware: HardwareSpec) -> HardwareSpec:
        """Who is launched."""
        losses = dataclasses.replace(hardware.losses, latency=hardware.losses.latency + self.latency)
        return dataclasses.replace(
            hardware,
            friction=hardware.friction * self.friction,
            mass_scale=hardware.mass_scale * self.mass,
            losses=losses if self.latency else hardware.losses,
        )


LAUNCHES = (
    Launch(acceleration=3.0, hold=HELD),
    Launch(acceleration=6.0, hold=1.0),
    Launch(acceleration=3.0, hold=1.0, friction=0.75, mass=1.05, latency=0.005),
)
"""The first one gives the speed; the others show whether that was luck. On the built robot the last one is on friction
0.6."""


@dataclasses.dataclass(frozen=True)
class Launched:
    """What came of a launch."""

    fell: bool
    speed: float  # m/s, mean of the best second; 0 where it fell


def launch(
    policy: ActionFunction, env: EnvConfig, launch: Launch, kept: Path | None = None, length: float = 0.0
) -> Launched:
    """Launch a policy on the robot of its environment, and keep the last `length` seconds of the run, if wanted."""
    run = rollout_mujoco(policy, launch.ramp(env), env, hardware=launch.robot(env.hardware), machine=SwiftMachine)
    best = best_window(run, 1.0)
    fell = run.fell_at is not None
    if kept is not None:
        with contextlib.suppress(OSError):  # no verdict hangs on it
            run.between(max(len(run) * run.dt - length, 0.0), math.inf).save(kept)
    return Launched(fell, best.speed if best is not None and not fell else 0.0)


def judge(launched: Sequence[Launched]) -> Verdict:
    """The verdict on a policy with these `LAUNCHES`."""
    mean = sum(one.speed for one in launched) / len(launched)
    return Verdict(launched[0].speed, sum(one.fell for one in launched), len(launched), mean)


@contextlib.contextmanager
def judging(env: EnvConfig, cache: str | None) -> Iterator["Workers"]:
    """The judge of a training in this environment; what he is still at when the block ends is left undone.

    Args:
        env: of the training.
        cache: where JAX keeps compiled programs, if anywhere.
    """
    count = min(max(processors() - 1, 1), AT_A_TIME * len(LAUNCHES))
    with spawned(count, functools.partial(_begin, cache), abandon=True) as pool:
        # Who first submits a task starts the workers, which end with its thread.
        for _ in range(count):
            pool.submit(_warm_up, env)
        yield Workers(pool, places=max(count // len(LAUNCHES), 1))


class Workers:
    """A `learning.policies.Judge` that deals out the launches of a policy to processes."""

    def __init__(self, pool: ProcessPoolExecutor, places: int):
        self._pool, self.places = pool, places

    def submit(self, policy: Path, kept: Path | None = None, length: float = 0.0) -> "Launching":
        """Launch the policy in this folder; in the file `kept`, if named, the first launch's last seconds are kept."""
        first = self._pool.submit(_launch, policy, LAUNCHES[0], kept, length)
        return Launching([first, *(self._pool.submit(_launch, policy, one) for one in LAUNCHES[1:])])


class Launching:
    """A `learning.policies.Hearing` in other processes."""

    def __init__(self, launches: Sequence[Future[Launched]]):
        self._launches = launches

    def speed(self) -> float:
        """m/s, of the first launch, once it has ended."""
        first = self._launches[0]
        return first.result().speed if first.done() and not first.cancelled() and not first.exception() else 0.0

    def done(self) -> bool:
        """Whether all launches have ended."""
        return all(one.done() for one in self._launches)

    def result(self) -> Verdict:
        """The verdict."""
        return judge([one.result() for one in self._launches])


# --- In the workers ---------------------------------------------------------------------------------------------


def _begin(cache: str | None) -> None:
    """Be slow when others are busy, keep to one thread, and leave the GPU and Ctrl-C to the training."""
    if hasattr(os, "nice"):  # not on Windows
        os.nice(NICE)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false".strip()
    compute_here()
    jax.config.update("jax_compilation_cache_dir", cache)


def _warm_up(env: EnvConfig) -> None:
    """Compile, and settle the robots from whose stand all launches begin."""
    for one in LAUNCHES:
        launch(_keep_still, env, dataclasses.replace(one, hold=specs.CONTROL_STEP, acceleration=1e3))


def _keep_still(observation: np.ndarray) -> np.ndarray:
    return 0.0 * observation[..., : specs.NUM_MOTORS]


def _launch(policy: Path, one: Launch, kept: Path | None = None, length: float = 0.0) -> Launched:
    loaded = _load(policy)
    return launch(loaded, loaded.card.env, one, kept, length)


@functools.lru_cache(maxsize=1)
def _load(policy: Path) -> Policy:
    return load_policy(policy, layout_of=layout_of)
