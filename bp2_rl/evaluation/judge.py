"""The judge: processes beside a training that measure each exported policy in C MuJoCo, from a standing start.

Its processes run on processors that the training leaves idle. `measure_launches` defines a policy's top speed.
"""

import contextlib
import dataclasses
import functools
import math
import os
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path

import jax
import numpy as np

from bp2_rl.base.workers import processors, spawned
from bp2_rl.env.observations import layout_of
from bp2_rl.learning.exports import JudgeResult
from bp2_rl.learning.policy import Policy, load_policy
from bp2_rl.robot import conventions
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.metrics import HELD
from bp2_rl.simulation.parallel import compute_here
from bp2_rl.simulation.policy_runner import ActionFunction
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import Trajectory
from bp2_rl.simulation.windows import best_window

AT_A_TIME = 4  # most policies that are judged side by side
NICE = 5  # the training gets three times the share; at 19 a training on all processors would starve the judge


@dataclasses.dataclass(frozen=True)
class JudgedLaunch:
    """A launch from a standing start, on the training's robot or a worse one, to a share of its fastest command."""

    acceleration: float  # m/s2, at which the command rises; in a training with gentler launches as in those
    hold: float  # s
    noise_seed: int | None = None  # of the sensors' noise, as strong as in training; None: no noise
    share: float = 1.0  # of the fastest command of the training
    friction: float = 1.0  # factor
    mass: float = 1.0  # factor
    latency: float = 0.0  # s, added to the robot's

    def ramp(self, env: EnvConfig) -> Ramp:
        """Return the commands of this launch in a training's environment."""
        acceleration = min(self.acceleration, env.commands.acceleration[1])
        return Ramp(self.speed(env), acceleration, self.hold).under(env.control)

    def speed(self, env: EnvConfig) -> float:
        """Return the last command of this launch in a training's environment, m/s."""
        return self.share * env.commands.max_forward

    def robot(self, hardware: HardwareSpec) -> HardwareSpec:
        """Return the robot that is launched."""
        losses = dataclasses.replace(hardware.losses, latency=hardware.losses.latency + self.latency)
        return dataclasses.replace(
            hardware,
            friction=hardware.friction * self.friction,
            mass_scale=hardware.mass_scale * self.mass,
            losses=losses if self.latency else hardware.losses,
        )


JUDGED_LAUNCHES = (
    JudgedLaunch(acceleration=3.0, hold=HELD, noise_seed=1),
    JudgedLaunch(acceleration=6.0, hold=1.0, noise_seed=2),
    JudgedLaunch(acceleration=3.0, hold=1.0, noise_seed=3, friction=0.75, mass=1.05, latency=0.005),
)
"""The first launch gives a policy's top speed; the others, once the first has ended without a fall, show whether that
was luck. In the last one the built robot has a friction of 0.6. No benchmark launches so by itself: none reports what a
policy was chosen by."""


@dataclasses.dataclass(frozen=True)
class LaunchResult:
    """How a launch ended."""

    fell: bool
    best_speed: float  # m/s, best 1-s mean; 0 where the robot fell
    command: float = math.inf  # m/s, at its end

    @property
    def followed(self) -> float:
        """The speed, m/s, less what is beyond the command: too fast is as wrong as too slow."""
        return self.best_speed - 2.0 * max(self.best_speed - self.command, 0.0)


LaunchFuture = Future[list[LaunchResult]]


def measure_launches(
    policy: ActionFunction, env: EnvConfig, launches: Sequence[JudgedLaunch], kept: Path | None = None,
    length: float = 0.0,
) -> list[LaunchResult]:  # fmt: skip
    """Launch a policy on robots of its environment, all at once; return each one's top speed and whether it fell.

    Where `kept` names a file, the last `length` seconds of the first launch are saved there.
    """
    requests = [RunRequest(one.ramp(env), one.robot(env.hardware), noise_seed=one.noise_seed) for one in launches]
    first, *_ = runs = list(simulate(policy, requests, env))
    if kept is not None:
        with contextlib.suppress(OSError):  # the results do not depend on it
            first.between(max(len(first) * first.dt - length, 0.0), math.inf).save(kept)
    return [_result(run, one.speed(env)) for run, one in zip(runs, launches, strict=True)]


def _result(run: Trajectory, command: float) -> LaunchResult:
    best = best_window(run, 1.0)
    fell = run.fell_at is not None
    return LaunchResult(fell, best.speed if best is not None and not fell else 0.0, command)


def combine(launches: Sequence[LaunchResult]) -> JudgeResult:
    """Return the judge's result for a policy from the results of its `JUDGED_LAUNCHES`, or of the first alone."""
    mean = sum(one.followed for one in launches) / len(launches)
    return JudgeResult(launches[0].best_speed, sum(one.fell for one in launches), len(launches), mean)


@contextlib.contextmanager
def open_judge(env: EnvConfig, cache: str | None) -> Generator["JudgeProcesses"]:
    """Start the judge of a training in this environment; launches that still run when the block ends are killed.

    Args:
        env: of the training.
        cache: where JAX keeps compiled programs, if anywhere.
    """
    count = min(max(processors() - 1, 1), 2 * AT_A_TIME)
    with spawned(count, functools.partial(_begin, cache), abandon=True) as pool:
        # The processes end with the thread that submits the first task, so this thread does.
        for _ in range(count):
            pool.submit(_warm_up, env)
        yield JudgeProcesses(pool, count)


class JudgeProcesses:
    """A `learning.exports.Judge` that runs the launches of a policy in `count` processes.

    Launches that follow the first one have a process each; a single process takes them at once, which costs less than
    one by one.
    """

    def __init__(self, pool: ProcessPoolExecutor, count: int):
        self._pool, self.places = pool, max(count // 2, 1)
        first, *others = JUDGED_LAUNCHES
        self._first, self._others = [first], [others] if count == 1 else [[one] for one in others]

    def submit(self, policy: Path, kept: Path | None = None, length: float = 0.0) -> "PendingLaunches":
        """Launch the policy in this folder; save the first launch's last `length` seconds in the file `kept`."""
        first = self._pool.submit(_launch, policy, self._first, kept, length)
        return PendingLaunches(first, lambda: [self._pool.submit(_launch, policy, some) for some in self._others])


class PendingLaunches:
    """A `learning.exports.PendingResult` of launches in other processes.

    Args:
        first: the first launch.
        others: submits the others; called once the first has ended without a fall.
    """

    def __init__(self, first: LaunchFuture, others: Callable[[], Sequence[LaunchFuture]]):
        self._first, self._submit_others = first, others

    @functools.cached_property
    def _others(self) -> Sequence[LaunchFuture]:
        [first] = self._first.result()
        return [] if first.fell else self._submit_others()

    def speed(self) -> float:
        """Return the speed of the first launch, m/s, once it is known; 0 until then."""
        first = self._first
        known = first.done() and not first.cancelled() and not first.exception()
        return first.result()[0].best_speed if known else 0.0

    def done(self) -> bool:
        """Return whether all launches have ended; raise whatever kept one from it."""
        return self._first.done() and all(one.done() for one in self._others)

    def result(self) -> JudgeResult:
        """Return the judge's result."""
        return combine([launch for one in (self._first, *self._others) for launch in one.result()])


# --- In the workers ---------------------------------------------------------------------------------------------


def _begin(cache: str | None) -> None:
    """Run at low priority and on one thread, and leave the GPU to the training."""
    if hasattr(os, "nice"):  # not on Windows
        os.nice(NICE)
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false".strip()
    compute_here()
    jax.config.update("jax_compilation_cache_dir", cache)


def _warm_up(env: EnvConfig) -> None:
    """Compile, and settle the standing robots from which all launches begin."""
    brief = [dataclasses.replace(one, hold=conventions.CONTROL_STEP, acceleration=1e3) for one in JUDGED_LAUNCHES]
    measure_launches(_keep_still, env, brief)


def _keep_still(observation: np.ndarray) -> np.ndarray:
    return 0.0 * observation[..., : conventions.NUM_MOTORS]


def _launch(
    policy: Path, launches: Sequence[JudgedLaunch], kept: Path | None = None, length: float = 0.0
) -> list[LaunchResult]:
    loaded = _load(policy)
    return measure_launches(loaded, loaded.card.env, launches, kept, length)


@functools.lru_cache(maxsize=1)
def _load(policy: Path) -> Policy:
    return load_policy(policy, layout_of=layout_of)
