"""The judge: processes beside a training that measure each exported policy in C MuJoCo,
from a standing start.

Its processes run on processors that the training leaves idle. `measure_launches`
defines a policy's top speed. `judge_policy` finds the speed that a robot holds where the
fastest command makes it fall.
"""

import contextlib
import dataclasses
import functools
import math
import os
from collections.abc import Generator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from pathlib import Path

from bp2_rl.base.processes import processors, spawned
from bp2_rl.env.observations import layout_of
from bp2_rl.learning.judged import JudgeResult
from bp2_rl.learning.policy import PolicyCard, blank_policy, load_policy
from bp2_rl.robot import conventions
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.settings.env import EnvConfig
from bp2_rl.settings.task import TaskConfig
from bp2_rl.simulation.metrics import HELD
from bp2_rl.simulation.parallel import begin_worker
from bp2_rl.simulation.policy_runner import ActionFunction
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.trajectory import Trajectory, best_window
from bp2_rl.simulation.world import World

AT_A_TIME = 8  # most policies that are judged side by side
# the training gets three times the share; at 19 a training on all processors would
# starve the judge
NICE = 5
HEADROOM = 1.1
"""Factor from the speed that ends a training to the fastest command of its judge's
launches: robots run a little slower than they are told."""


@dataclasses.dataclass(frozen=True)
class JudgedLaunch:
    """A test launch of a policy from a stand, to a share of the training's fastest
    command, on its robot or a worse one."""

    # m/s2, at which the command rises; in a training with gentler launches as in those
    acceleration: float
    hold: float  # s
    # of the sensors' noise, as strong as in training; None: no noise
    noise_seed: int | None = None
    share: float = 1.0  # of the fastest command of the training
    friction: float = 1.0  # factor
    mass: float = 1.0  # factor
    latency: float = 0.0  # s, added to the robot's

    def ramp(self, env: EnvConfig) -> Ramp:
        """Return the command ramp of this launch for a training with the environment
        `env`."""
        acceleration = min(self.acceleration, env.commands.acceleration[1])
        return Ramp(self.speed(env), acceleration, self.hold).under(env.control)

    def speed(self, env: EnvConfig) -> float:
        """Return the final commanded speed of this launch for a training with the
        environment `env`, m/s."""
        return self.share * env.commands.max_forward

    def robot(self, hardware: HardwareSpec) -> HardwareSpec:
        """Return the robot of this launch: the training's, with changed friction, mass
        and latency."""
        losses = dataclasses.replace(
            hardware.losses, latency=hardware.losses.latency + self.latency
        )
        return dataclasses.replace(
            hardware,
            friction=hardware.friction * self.friction,
            mass_scale=hardware.mass_scale * self.mass,
            losses=losses if self.latency else hardware.losses,
        )


JUDGED_LAUNCHES = (
    JudgedLaunch(acceleration=3.0, hold=HELD, noise_seed=1),
    JudgedLaunch(acceleration=6.0, hold=1.0, noise_seed=2),
    JudgedLaunch(
        acceleration=3.0,
        hold=1.0,
        noise_seed=3,
        friction=0.75,
        mass=1.05,
        latency=0.005,
    ),
)
"""The judge's launches of every policy: the first gives the top speed, the others show
whether a small change makes the robot fall.

In the last launch the built robot has a friction of 0.6. No benchmark repeats these
launches, so that no benchmark reports a result by which a policy was chosen.
"""
SLOWER_LAUNCHES = [
    dataclasses.replace(launch, share=0.7**k)
    for k in range(1, 7)
    for launch in JUDGED_LAUNCHES
]
"""The judge's launches to slower commands, the fastest first: 0.7, 0.49 ... 0.12 of the
fastest command."""


@dataclasses.dataclass(frozen=True)
class LaunchResult:
    """The result of a launch: the command at a fall, or the best speed."""

    fell: bool
    best_speed: float  # m/s, best 1-s mean; 0 where the robot fell
    command: float = math.inf  # m/s, at its end
    fell_told: float = 0.0  # m/s, the command when it fell
    held: float = 0.0  # m/s, best 5-s mean; 0 after a fall, or in a shorter launch

    @property
    def followed(self) -> float:
        """The best speed, m/s, less twice its excess over the command."""
        return self.best_speed - 2.0 * max(self.best_speed - self.command, 0.0)


def measure_launches(
    policy: ActionFunction,
    env: EnvConfig,
    launches: Sequence[JudgedLaunch],
) -> list[LaunchResult]:
    """Simulate launches of a policy on robots of its environment; return each launch's
    top speed and fall."""
    world = World(env.terrain.hardest)
    requests = [
        RunRequest(
            launch.ramp(env),
            launch.robot(env.hardware),
            world=world,
            noise_seed=launch.noise_seed,
        )
        for launch in launches
    ]
    runs = simulate(policy, requests, env)
    return [
        _result(run, one.speed(env)) for run, one in zip(runs, launches, strict=True)
    ]


def _result(run: Trajectory, command: float) -> LaunchResult:
    if run.fell_at is not None:
        return LaunchResult(True, 0.0, command, fell_told=float(run.command[-1, 0]))
    best, held = (
        0.0 if window is None else max(window.speed, 0.0)
        for window in (best_window(run, 1.0), best_window(run, HELD))
    )
    return LaunchResult(False, best, command, held=held)


def judge_policy(
    policy: ActionFunction,
    env: EnvConfig,
    *,
    until: float | None = None,
    slower: bool = True,
) -> JudgeResult:
    """Make the judge's launches of a policy; where the robot falls in the first, make
    the slower ones, too, if `slower`.

    All slower launches run side by side, since 18 robots take less than twice as long
    as three. For a training that ends at the speed `until`, m/s, the fastest command is
    no more than `HEADROOM` times that.
    """
    share = min(HEADROOM * until / env.commands.max_forward, 1.0) if until else 1.0

    def launched(launches: Sequence[JudgedLaunch]) -> list[LaunchResult]:
        scaled = [
            dataclasses.replace(launch, share=share * launch.share)
            for launch in launches
        ]
        return measure_launches(policy, env, scaled)

    launches = launched(JUDGED_LAUNCHES)
    if not (slower and launches[0].fell):
        return combine(launches)
    slower_launches = launched(SLOWER_LAUNCHES)
    count = len(launches)
    groups = [
        slower_launches[k : k + count] for k in range(0, len(slower_launches), count)
    ]
    upright = (group for group in groups if not any(launch.fell for launch in group))
    return combine(launches, next(upright, ()))


def combine(
    launches: Sequence[LaunchResult], slower: Sequence[LaunchResult] = ()
) -> JudgeResult:
    """Combine the results of a policy's launches.

    Where the robot falls in the first launch, the longest, its policy ranks by the
    slower launches, whose mean speed counts as one launch. So a policy that stays up in
    the first launch, at 0.7 of the fastest command or more, comes before one that
    falls.

    Args:
        launches: to the fastest command.
        slower: as many launches, to the fastest slower command at which no robot fell;
            empty where every command made one fall, or where none was tried.
    """
    fell = launches[0].fell
    counted = slower if fell else launches
    mean = sum(launch.followed for launch in counted) / len(launches)
    commands_at_falls = [launch.fell_told for launch in launches if launch.fell]
    return JudgeResult(
        launches[0].best_speed,
        len(commands_at_falls),
        len(launches),
        mean / len(launches) if fell else mean,
        min(commands_at_falls, default=0.0),
        min(counted[0].held, counted[0].command) if counted else 0.0,
        launches[0].command,
    )


@contextlib.contextmanager
def open_judge(
    card: PolicyCard, cache: str | None, until: float | None = None
) -> Generator["JudgeProcesses"]:
    """Start the judge processes of a training; launches still running at the end of the
    block are killed.

    Args:
        card: of the training's policies, for whose network the processes compile before
            there is any.
        cache: where JAX keeps compiled programs, if anywhere.
        until: the speed that ends the training, m/s, if one does.
    """
    count = min(max(processors() - 1, 1), AT_A_TIME)
    with spawned(count, functools.partial(_begin, cache), abandon=True) as pool:
        # The processes end with the thread that submits the first task, so this thread
        # does.
        for _ in range(count):
            pool.submit(_warm_up, card, slower=until is None)
        yield JudgeProcesses(pool, count, card.env.task, until)


class JudgeProcesses:
    """A `learning.exports.Judge` that judges `places` policies at a time, in processes.

    A process makes a policy's launches side by side: three take a quarter longer than
    one.
    """

    def __init__(
        self,
        pool: ProcessPoolExecutor,
        count: int,
        task: TaskConfig,
        until: float | None,
    ):
        self._pool, self._task, self._until = pool, task, until
        self.places = count

    def submit(self, policy: Path, *, slower: bool = True) -> Future[JudgeResult]:
        """Queue the policy folder for its launches, with the slower ones where it falls
        if `slower`."""
        return self._pool.submit(_judge, policy, self._task, self._until, slower)


# --- In the workers -------------------------------------------------------------------


def _begin(cache: str | None) -> None:
    """Set up a judge process: low priority, one thread, and no GPU."""
    if hasattr(os, "nice"):  # not on Windows
        os.nice(NICE)
    os.environ["XLA_FLAGS"] = (
        f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false".strip()
    )
    begin_worker(cache)


def _warm_up(card: PolicyCard, *, slower: bool) -> None:
    """Compile the launches, and simulate the standing robots from which they begin."""
    for launches in (JUDGED_LAUNCHES, SLOWER_LAUNCHES)[: 1 + slower]:
        brief = [
            dataclasses.replace(launch, hold=conventions.CONTROL_STEP, share=1e-3)
            for launch in launches
        ]
        measure_launches(blank_policy(card), card.env, brief)


def _judge(
    policy: Path,
    task: TaskConfig,
    until: float | None,
    slower: bool,
) -> JudgeResult:
    loaded = load_policy(policy, layout_of=layout_of, task=task.code)
    env = loaded.card.env
    return judge_policy(loaded, env, until=until, slower=slower)
