"""Run a policy many times on all processors, and run a fleet of randomised robots."""

import concurrent.futures
import contextlib
import dataclasses
import functools
import math
from collections.abc import Callable, Generator, Sequence
from typing import TypeVar

import jax
import numpy as np
from jaxtyping import Float

from bp2_rl.base.processes import keep_compiled, processors, spawned
from bp2_rl.learning.policy import Policy
from bp2_rl.robot import conventions
from bp2_rl.settings.env import RandomizationConfig
from bp2_rl.simulation.backend import Backend
from bp2_rl.simulation.gait import leg_room
from bp2_rl.simulation.rollout import RunRequest, sampled_commands, simulate
from bp2_rl.simulation.trajectory import Trajectory
from bp2_rl.simulation.world import Draw

# the milliseconds at which control steps begin
EACH = slice(None, None, conventions.SUBSTEPS)

Task = TypeVar("Task")
One = TypeVar("One", bound=RunRequest)
Result = TypeVar("Result")

_kept: list[concurrent.futures.ProcessPoolExecutor] = []


@contextlib.contextmanager
def keep_workers() -> Generator[None]:
    """Keep the worker processes and their compiled programs alive over all benchmarks
    in the block."""
    with _pool(processors()) as pool:
        _kept.append(pool)
        try:
            yield
        finally:
            _kept.remove(pool)


def in_parallel(
    run: Callable[[Policy, Task], Result], policy: Policy, tasks: Sequence[Task]
) -> list[Result]:
    """Return `run(policy, task)` for each task, computed in worker processes.

    `run` and all else must be picklable.
    """
    with _pool(min(processors(), len(tasks))) as pool:
        return list(pool.map(functools.partial(run, policy), tasks))


def simulate_all(
    measure: Callable[[One, Trajectory], Result],
    policy: Policy,
    requests: Sequence[One],
    backend: Backend = "mujoco",
) -> list[Result]:
    """Simulate every request on all processors; return `measure(request, trajectory)`
    for each.

    `measure` and all else must be picklable.
    """
    shares = shares_of(requests, processors())
    work = functools.partial(_measure_all, measure, backend, policy)
    done: dict[int, Result] = {}
    with _pool(len(shares)) as pool:
        parts = pool.map(work, ([requests[i] for i in share] for share in shares))
        for share, part in zip(shares, parts, strict=True):
            done.update(zip(share, part, strict=True))
    return [done[i] for i in range(len(requests))]


def shares_of(requests: Sequence[RunRequest], workers: int) -> list[list[int]]:
    """Share out run requests among workers, with equal work for each; return the
    requests' indices by worker.

    The longest first, as those side by side last as long as the longest of them.
    """
    kinds: dict[object, int] = {}
    alike = sorted(
        range(len(requests)),
        key=lambda i: kinds.setdefault(requests[i].hardware, len(kinds)),
    )
    # Torques of a few robots take as long as four of their physics steps.
    work = np.array(
        [
            request.schedule.duration
            * (request.numerics.steps + 4 * request.numerics.updates)
            for request in (requests[i] for i in alike)
        ]
    )
    worker = (workers * (np.cumsum(work) - work / 2) / max(np.sum(work), 1e-9)).astype(
        int
    )
    # limits the index, which requests of no duration could exceed
    worker = np.minimum(worker, workers - 1)
    shares = [
        [i for i, whose in zip(alike, worker, strict=True) if whose == number]
        for number in range(workers)
    ]
    return [
        sorted(share, key=lambda i: -requests[i].schedule.duration)
        for share in shares
        if share
    ]


def _pool(
    count: int,
) -> contextlib.AbstractContextManager[concurrent.futures.ProcessPoolExecutor]:
    """Return the workers that are kept, or else start `count` for a block."""
    if _kept:
        return contextlib.nullcontext(_kept[-1])
    keep_compiled()
    # At the end of the block all requests are done, or after an interruption no longer
    # needed.
    return spawned(
        max(count, 1),
        functools.partial(begin_worker, jax.config.values["jax_compilation_cache_dir"]),
        abandon=True,
    )


def _measure_all(
    measure: Callable[[One, Trajectory], Result],
    backend: Backend,
    policy: Policy,
    requests: Sequence[One],
) -> list[Result]:
    runs = simulate(policy, requests, backend=backend)
    return [measure(request, run) for request, run in zip(requests, runs, strict=True)]


def compute_here() -> None:
    """Have JAX compute on the CPU in the calling thread; call it before JAX computes
    anything.

    C MuJoCo's robots need a few numbers every millisecond. Passing such a call to
    another thread takes longer than the computation, and much longer on a busy machine.
    """
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_cpu_enable_async_dispatch", False)


def begin_worker(cache: str | None) -> None:
    """Set up JAX in a worker process: the CPU, and the compilation cache of the
    parent."""
    compute_here()
    jax.config.update("jax_compilation_cache_dir", cache)


# --- A fleet ---


@dataclasses.dataclass(frozen=True)
class FleetRun:
    """The motion of N robots at the start of T control steps; speed and offset are 0
    after a fall."""

    time: Float[np.ndarray, " T"]  # s
    command: Float[np.ndarray, " T"]  # m/s, scheduled forward speed
    speed: Float[np.ndarray, "T N"]  # m/s, forward in the heading frame
    offset: Float[np.ndarray, "T N"]  # m, to the left of the line through the start
    fell_at: Float[np.ndarray, " N"]  # s; inf for robots that did not fall
    # m, least between legs or of a leg and the trunk, before a fall
    leg_room: Float[np.ndarray, " N"]
    # what was drawn: friction, latency (s), mass (kg), strength
    robots: dict[str, Float[np.ndarray, " N"]]
    steady_from: float  # s, from when the command is held


def run_fleet(
    policy: Policy,
    request: RunRequest,
    ranges: RandomizationConfig,
    robots: int,
    seed: int = 0,
    backend: Backend = "mujoco",
) -> FleetRun:
    """Run a policy on many randomised robots from a standing start; return their
    motion.

    Args:
        policy: the policy of all robots; `ranges` replace the randomisation of its
            training.
        request: the run of the robot around which they are drawn; its own pushes and
            noise are not used.
        ranges: of the random parameters.
        robots: how many.
        seed: of everything that is drawn.
        backend: the simulator.
    """
    schedule = request.schedule
    hardware = request.hardware or policy.card.env.hardware
    draws = [Draw(ranges, seed, number) for number in range(robots)]
    worlds = [
        dataclasses.replace(
            request.world,
            terrain=request.world.terrain.another(draw.number),
            pushes=draw.pushes(schedule.duration),
        )
        for draw in draws
    ]
    requests = [
        dataclasses.replace(
            request, world=world, noise_seed=draw.noise_seed, drawn=draw
        )
        for world, draw in zip(worlds, draws, strict=True)
    ]
    card = policy.card
    noisy = dataclasses.replace(
        card, env=dataclasses.replace(card.env, randomization=ranges)
    )
    speeds, offsets, falls, rooms, masses = zip(
        *simulate_all(
            _robot_run, dataclasses.replace(policy, card=noisy), requests, backend
        ),
        strict=True,
    )
    commands = sampled_commands(schedule)[:-1, 0]
    speed, offset = (
        np.stack([np.pad(x, (0, len(commands) - len(x))) for x in parts], axis=1)
        for parts in (speeds, offsets)
    )
    drawn = [draw.values(hardware) for draw in draws]
    return FleetRun(
        time=conventions.CONTROL_STEP * np.arange(len(commands)),
        command=commands,
        speed=speed,
        offset=offset,
        fell_at=np.array(falls),
        leg_room=np.array(rooms),
        robots={
            "friction": np.array([float(robot.friction) for robot in drawn]),
            "latency": np.array([float(robot.latency) for robot in drawn]),
            "mass": np.array(masses),
            "strength": np.array([float(np.min(robot.strength)) for robot in drawn]),
        },
        steady_from=schedule.steady_from,
    )


def _robot_run(
    _: RunRequest, run: Trajectory
) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, " K"], float, float, float]:
    """Return a robot's speeds, lane offsets, time of fall, least leg clearance and
    mass."""
    return (
        run.ground_velocity[EACH, 0],
        run.qpos[EACH, 1],
        math.inf if run.fell_at is None else run.fell_at,
        float(np.min(leg_room(run, EACH).least)),
        run.mass,
    )
