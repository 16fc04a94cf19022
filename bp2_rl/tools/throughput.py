"""Time the programs of training one by one: their speed, memory and compilation.

Every program advances all robots by one unroll, so that times compare: what the
environment, the policy and the gradient steps take adds up to a train step, but for the
bookkeeping between them. JAX runs asynchronously and compiles on first use; here each
call is waited for, and compilation is timed apart.
"""

import collections
import contextlib
import dataclasses
import re
import statistics
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
from brax import envs
from brax.training.acme.running_statistics import RunningStatisticsState
from brax.training.agents.ppo.losses import PPONetworkParams
from jax import monitoring
from jax.sharding import NamedSharding, PartitionSpec

from bp2_rl.base.errors import UserError
from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.learning.ppo import PPO, TrainState
from bp2_rl.robot import conventions
from bp2_rl.settings.ppo import PPOConfig

PartName = Literal["physics", "environment", "resets", "policy", "sgd", "training"]
PARTS: tuple[PartName, ...] = get_args(PartName)
"""The parts of training that can be timed, in the order of the report.

physics: the physics steps, with motors that hold their targets. environment: control
steps with zero actions, and the fresh episodes that they need. resets: those episodes
alone. policy: the actor's actions. sgd: all epochs of gradient steps. training: the
whole train step.
"""

COMPILED = "/jax/core/compile/backend_compile_duration"
"""JAX's event for each program that is compiled, or read from the disk."""
FROM_CACHE = "/jax/compilation_cache/cache_hits"
"""JAX's event for each program that is only read from the disk."""
EVERYWHERE = PartitionSpec()
ROBOTS = PartitionSpec("robots")
TIMES_ROBOTS = PartitionSpec(None, "robots")

WARM_UP = 2  # calls: all that compiles must have compiled by then
FEWEST = 3  # timed calls, however long they take
MOST = 1000


class TooManyRobotsError(UserError):
    """The devices' memory does not hold that many robots."""


class BenchPart(NamedTuple):
    """A jitted program to time, called repeatedly."""

    name: PartName
    program: jax.stages.Wrapped
    arguments: tuple[Any, ...]
    goes_on: bool = False  # its first result is the first argument of the next call


@dataclasses.dataclass(frozen=True)
class PartTiming:
    """The timing of a part of training at a size; rates are by the median call, an
    unroll of all robots."""

    part: PartName
    robots: int
    devices: int
    control_steps_per_second: float  # all robots together
    physics_steps_per_second: float
    seconds: float  # a call, median
    best_seconds: float
    spread: float  # interquartile range over median
    repeats: int
    compilations: int  # while timed; 0 unless something is wrong
    trace_seconds: float  # Python to StableHLO
    compile_seconds: float  # StableHLO to machine code
    from_cache: bool  # the machine code was read from disk
    program_bytes: int | None  # arguments, results and temporaries on each device


@contextlib.contextmanager
def compilations() -> Generator[collections.Counter[str]]:
    """Count JAX's monitoring events in the block by name, COMPILED and FROM_CACHE among
    them."""
    counts: collections.Counter[str] = collections.Counter()

    def count(event: str, *_: object, **__: object) -> None:
        counts[event] += 1

    monitoring.register_event_duration_secs_listener(count)
    monitoring.register_event_listener(count)
    try:
        yield counts
    finally:
        monitoring.unregister_event_duration_listener(count)
        monitoring.unregister_event_listener(count)


def time_parts(
    make_env: Callable[[int], envs.Env],
    config: PPOConfig,
    devices: Sequence[Any],
    parts: Sequence[PartName] = PARTS,
    seconds: float = 2.0,
) -> Iterator[PartTiming]:
    """Yield the timings of the parts of training on `devices`, as they are measured.

    Args:
        make_env: the environment for at most so many robots a device.
        config: hyperparameters, with the robots of all devices together.
        devices: JAX's devices to use.
        parts: what to measure; physics only of BP2Env.
        seconds: of timed calls for each part; at least three calls are timed.

    Raises:
        UserError: the robots don't fit the devices, or their memory
            (`TooManyRobotsError`).
    """
    try:
        learner = PPO(make_env(-(-config.num_envs // len(devices))), config, devices)
        for part in make_parts(learner, learner.init(0), parts):
            yield time_part(part, learner, seconds)
    except jax.errors.JaxRuntimeError as reason:
        if re.search("RESOURCE_EXHAUSTED|out of memory", str(reason), re.IGNORECASE):
            raise TooManyRobotsError("out of memory") from reason
        raise


def share_out(timings: Sequence[PartTiming]) -> dict[str, float]:
    """Return the share of a train step's time that each part takes; empty if a needed
    part was not timed.

    By the best call of each, which other programs disturbed least. The parts ran by
    themselves, where XLA cannot fuse them with their neighbours: good to a few per cent
    on an idle machine.
    """
    seconds = {m.part: m.best_seconds for m in timings}
    if not {"environment", "resets", "policy", "sgd", "training"} <= set(seconds):
        return {}
    parts = {name: seconds[name] for name in ("physics", "resets") if name in seconds}
    parts["rest of the environment"] = seconds["environment"] - sum(parts.values())
    parts |= {name: seconds[name] for name in ("policy", "sgd")}
    parts["bookkeeping"] = seconds["training"] - sum(parts.values())
    return {name: value / seconds["training"] for name, value in parts.items()}


def time_part(part: BenchPart, learner: PPO, seconds: float) -> PartTiming:
    """Compile a part of a learner, warm it up, and time its calls for some seconds."""
    program = part.program
    arguments = part.arguments
    with compilations() as before:
        began = time.perf_counter()
        lowered = program.lower(*arguments)
        traced = time.perf_counter()
        size = _program_bytes(lowered.compile())
        compiled = time.perf_counter()
    times: list[float] = []

    def call(arguments: tuple[Any, ...]) -> tuple[Any, ...]:
        start = time.perf_counter()
        result = jax.block_until_ready(program(*arguments))
        times.append(time.perf_counter() - start)
        return (result[0], *arguments[1:]) if part.goes_on else arguments

    for _ in range(WARM_UP):  # calls find the program that was compiled here
        arguments = call(arguments)
    times.clear()
    with compilations() as late:
        while len(times) < FEWEST or (sum(times) < seconds and len(times) < MOST):
            arguments = call(arguments)
    low, median, high = statistics.quantiles(times, n=4, method="inclusive")
    rate = learner.config.steps_per_train_step / median
    return PartTiming(
        part=part.name,
        robots=learner.config.num_envs,
        devices=learner.mesh.size,
        control_steps_per_second=rate,
        physics_steps_per_second=rate * conventions.SUBSTEPS,
        seconds=median,
        best_seconds=min(times),
        spread=(high - low) / median,
        repeats=len(times),
        compilations=late[COMPILED],
        trace_seconds=traced - began,
        compile_seconds=compiled - traced,
        from_cache=before[FROM_CACHE] > 0,
        program_bytes=size,
    )


def _program_bytes(program: jax.stages.Compiled) -> int | None:
    """Return the bytes that a program needs on each device, or None if not known.

    Its arguments and results are included.
    """
    memory = program.memory_analysis()
    if memory is None:
        return None
    whole = (
        memory.argument_size_in_bytes
        + memory.output_size_in_bytes
        + memory.temp_size_in_bytes
    )
    return whole - memory.alias_size_in_bytes


# --- The parts ------------------------------------------------------------------------


def make_parts(
    learner: PPO, state: TrainState, names: Sequence[PartName]
) -> Iterator[BenchPart]:
    """Yield the named parts of a training as programs to time, in the order of `PARTS`;
    `training` consumes `state`."""
    env = learner.fleet.env
    keys = jax.device_put(
        jax.random.split(jax.random.PRNGKey(0), learner.config.num_envs),
        learner.robots,
    )
    for name in PARTS:
        if name not in names:
            continue
        match name:
            case "physics":
                if isinstance(env, BP2Env):
                    yield _physics(learner, env, state)
            case "environment":
                yield _environment(learner, state, keys)
            case "resets":
                program = _on_each_device(learner, learner.fleet.fresh_episodes)
                yield BenchPart(name, program, (state.fleet, keys))
            case "policy":
                yield _policy(learner, state, keys)
            case "sgd":
                yield _sgd(learner, state, keys)
            case "training":
                step = learner.programs.train_step
                yield BenchPart(name, step, (state,), goes_on=True)


def _on_each_device(
    learner: PPO,
    function: Callable[..., object],
    in_specs: PartitionSpec | tuple[PartitionSpec, ...] = ROBOTS,
    out_specs: PartitionSpec = ROBOTS,
) -> jax.stages.Wrapped:
    """Compile a function that runs on each device for the robots there, without
    communication."""
    local = jax.shard_map(
        function,
        mesh=learner.mesh,
        in_specs=in_specs,
        out_specs=out_specs,
        check_vma=False,
    )
    return jax.jit(local)


def _physics(learner: PPO, env: BP2Env, state: TrainState) -> BenchPart:
    """Return the physics steps as a program; joints hold the first targets, and every
    call starts from the same state."""
    first: Any = state.fleet.pipeline_state
    still = jnp.zeros(env.action_size)

    def aim(robot: Any) -> Any:
        return env.controller.act(robot.controller, robot.command.current, still)[1]

    def simulate(physics: Any, targets: Any, robots: Any) -> object:
        def control_step(physics: Any, _: None) -> tuple[Any, None]:
            with jax.default_matmul_precision("highest"):
                return jax.vmap(env.engine)(physics, targets, robots)[0], None

        length = learner.config.unroll_length
        return jax.lax.scan(control_step, physics, length=length)[0]

    arguments = (first.physics, jax.jit(jax.vmap(aim))(first), first.randomization)
    return BenchPart("physics", _on_each_device(learner, simulate), arguments)


def _environment(learner: PPO, state: TrainState, keys: jax.Array) -> BenchPart:
    still = jnp.zeros((len(keys), learner.fleet.env.action_size))

    def live(
        fleet: envs.State, action: jax.Array, keys: jax.Array
    ) -> tuple[envs.State, tuple[()]]:
        fresh = learner.fleet.fresh_episodes(fleet, keys)

        def control_step(fleet: envs.State, _: None) -> tuple[envs.State, None]:
            return learner.fleet.step(fleet, action, fresh), None

        length = learner.config.unroll_length
        return jax.lax.scan(control_step, fleet, length=length)[0], ()

    arguments = (state.fleet, jax.device_put(still, learner.robots), keys)
    program = _on_each_device(learner, live)
    return BenchPart("environment", program, arguments, goes_on=True)


def _policy(learner: PPO, state: TrainState, keys: jax.Array) -> BenchPart:
    """The actor acts on the first observations, which are an argument with an axis of
    time: XLA must not see that they are equal."""

    def act(
        params: PPONetworkParams,
        normalizer: RunningStatisticsState,
        observations: jax.Array | Mapping[str, jax.Array],
        keys: jax.Array,
    ) -> object:
        infer = jax.vmap(learner.infer((normalizer, params.policy)))

        def control_step(
            time: jax.Array, observation: jax.Array | Mapping[str, jax.Array]
        ) -> tuple[jax.Array, object]:
            now = jax.vmap(partial(jax.random.fold_in, data=time))(keys)
            return time + 1, infer(observation, now)

        start = jnp.zeros((), jnp.int32)
        return jax.lax.scan(control_step, start, observations)[1]

    length = learner.config.unroll_length
    observations = jax.device_put(
        jax.tree.map(
            lambda x: jnp.broadcast_to(x, (length, *x.shape)), state.fleet.obs
        ),
        NamedSharding(learner.mesh, TIMES_ROBOTS),
    )
    specs = (EVERYWHERE, EVERYWHERE, TIMES_ROBOTS, ROBOTS)
    program = _on_each_device(learner, act, specs, TIMES_ROBOTS)
    arguments = (state.params, state.normalizer, observations, keys)
    return BenchPart("policy", program, arguments)


def _sgd(learner: PPO, state: TrainState, keys: jax.Array) -> BenchPart:
    """Return the gradient steps of training as a program, on noise in the shapes of an
    unroll's data."""
    unroll = (state.params, state.normalizer, state.fleet, keys)
    _, shapes, _ = jax.eval_shape(learner.unroll, *unroll)

    def noise() -> object:
        return jax.tree.map(
            lambda leaf: jax.random.uniform(state.key, leaf.shape, leaf.dtype), shapes
        )

    data = jax.jit(noise, out_shardings=learner.robots)()
    program = jax.jit(learner.improve, out_shardings=learner.everywhere)
    return BenchPart("sgd", program, (state, data, state.key))
