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
import optax
from brax import envs
from brax.envs.wrappers import training as brax_training
from brax.training import acting
from brax.training.acme.running_statistics import RunningStatisticsState
from brax.training.agents.ppo.losses import PPONetworkParams
from brax.training.types import Transition
from jax import monitoring
from jax.sharding import NamedSharding, PartitionSpec

from bp2_rl.base.errors import UserError
from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.learning.ppo import PPO, TrainState, make_transition
from bp2_rl.robot import conventions
from bp2_rl.settings.ppo import PPOConfig

PartName = Literal[
    "physics", "environment", "resets", "policy", "sgd", "acting", "brax", "training"
]
PARTS: tuple[PartName, ...] = get_args(PartName)
"""The parts of training that can be timed, in the order of the report.

physics: the physics steps, with motors that hold their targets. environment: control
steps with zero actions, and the fresh episodes that they need. resets: those episodes
alone. policy: the actor's actions. sgd: all epochs of gradient steps. acting:
environment and policy, as the learner runs them. brax: the same by stock Brax, its
wrappers and its `generate_unroll`. training: the whole train step.
"""

Networks = tuple[PPONetworkParams, RunningStatisticsState]
Observation = jax.Array | Mapping[str, jax.Array]
Specs = PartitionSpec | tuple[PartitionSpec, ...]
OUT_OF_MEMORY = "out of memory"
COMPILED, FROM_CACHE = (
    "/jax/core/compile/backend_compile_duration",
    "/jax/compilation_cache/cache_hits",
)
"""Names of JAX's events for a compiled program, and for a program read from the cache
on disk."""
EVERYWHERE, ROBOTS, TIMES_ROBOTS = (
    PartitionSpec(),
    PartitionSpec("robots"),
    PartitionSpec(None, "robots"),
)

WARM_UP = 2  # calls: all that compiles must have compiled by then
FEWEST = 3  # timed calls, however long they take
MOST = 1000


class BenchPart(NamedTuple):
    """A jitted program to time: `program(carry, *fixed) -> (carry, anything)`, called
    repeatedly."""

    name: PartName
    program: jax.stages.Wrapped
    carry: object
    fixed: tuple[object, ...]


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


@dataclasses.dataclass(frozen=True)
class Case:
    """The timings of all parts of training with one number of robots and devices."""

    robots: int
    devices: int
    measurements: tuple[PartTiming, ...] = ()
    # see `share_out`
    shares: dict[str, float] = dataclasses.field(default_factory=dict)
    error: str | None = None  # why measuring ended early

    def rate(self, part: PartName) -> float | None:
        """Return the control steps per second of a part, None where it was not
        measured."""
        return next(
            (m.control_steps_per_second for m in self.measurements if m.part == part),
            None,
        )


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


def measure_case(
    make_env: Callable[[int], envs.Env],
    config: PPOConfig,
    robots: int,
    devices: Sequence[Any],
    parts: Sequence[PartName] = PARTS,
    seconds: float = 2.0,
    tell: Callable[[PartTiming], None] = lambda timing: None,
) -> Case:
    """Time the parts of training with `robots` robots on `devices`.

    Args:
        make_env: the environment for at most so many robots a device.
        config: hyperparameters; `robots` stands in for their `num_envs`.
        robots: all devices together.
        devices: JAX's devices to use.
        parts: what to measure; physics only of BP2Env, brax only on one device.
        seconds: of timed calls for each part; at least three calls are timed.
        tell: receives each timing as soon as it is measured.

    Returns:
        The timings. Where the robots don't fit the devices or their memory, the case
        has an `error` and the timings that came before it.
    """
    measurements: list[PartTiming] = []
    error = None
    try:
        env = make_env(-(-robots // len(devices)))
        learner = PPO(env, dataclasses.replace(config, num_envs=robots), devices)
        state = learner.init(0)
        for part in make_parts(learner, state, parts):
            measurements.append(time_part(part, learner, seconds))
            tell(measurements[-1])
    except (UserError, jax.errors.JaxRuntimeError) as reason:
        error = _explain(reason)
    shares = share_out(measurements)
    return Case(robots, len(devices), tuple(measurements), shares, error)


def share_out(measurements: Sequence[PartTiming]) -> dict[str, float]:
    """Return the share of a train step's time that each part takes; empty if a needed
    part was not timed.

    By the best call of each, which other programs disturbed least. The parts ran by
    themselves, where XLA cannot fuse them with their neighbours: good to a few per cent
    on an idle machine.
    """
    seconds = {m.part: m.best_seconds for m in measurements}
    if not {"environment", "resets", "policy", "sgd", "training"} <= set(seconds):
        return {}
    inner = {name: seconds[name] for name in ("physics", "resets") if name in seconds}
    rest = {"rest of the environment": seconds["environment"] - sum(inner.values())}
    parts = inner | rest | {name: seconds[name] for name in ("policy", "sgd")}
    parts |= {"bookkeeping": seconds["training"] - sum(parts.values())}
    return {name: value / seconds["training"] for name, value in parts.items()}


def time_part(part: BenchPart, learner: PPO, seconds: float) -> PartTiming:
    """Compile a part of a learner, warm it up, and time its calls for some seconds."""
    name, program, carry, fixed = part
    robots, devices = learner.config.num_envs, learner.mesh.size
    with compilations() as before:
        began = time.perf_counter()
        lowered = program.lower(carry, *fixed)
        traced = time.perf_counter()
        size = _program_bytes(lowered.compile())
        compiled = time.perf_counter()
    # Calls find the program that was compiled here.
    for _ in range(WARM_UP):
        carry, _ = jax.block_until_ready(program(carry, *fixed))
    times: list[float] = []
    with compilations() as late:
        while len(times) < FEWEST or (sum(times) < seconds and len(times) < MOST):
            start = time.perf_counter()
            carry, _ = jax.block_until_ready(program(carry, *fixed))
            times.append(time.perf_counter() - start)
    low, median, high = statistics.quantiles(times, n=4, method="inclusive")
    rate = learner.config.steps_per_train_step / median
    return PartTiming(
        part=name,
        robots=robots,
        devices=devices,
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


# --- The parts ------------------------------------------------------------------------


def make_parts(
    learner: PPO, state: TrainState, names: Sequence[PartName]
) -> Iterator[BenchPart]:
    """Yield the named parts of a training as programs to time, in the order of `PARTS`;
    `training` consumes `state`."""
    env, networks = learner.fleet.env, (state.params, state.normalizer)
    keys = jax.random.split(jax.random.PRNGKey(0), learner.config.num_envs)
    keys, zeros = jax.device_put(
        (keys, jnp.zeros((len(keys), env.action_size))), learner.robots
    )
    makers: dict[PartName, Callable[[], BenchPart]] = {
        "environment": lambda: BenchPart(
            "environment",
            _on_each_device(learner, partial(_live, learner)),
            state.fleet,
            (zeros, keys),
        ),
        "resets": lambda: BenchPart(
            "resets",
            _on_each_device(learner, partial(_reset, learner)),
            (),
            (state.fleet, keys),
        ),
        "policy": lambda: _policy(learner, state, keys),
        "sgd": lambda: _sgd(learner, state, keys),
        "acting": lambda: BenchPart(
            "acting", jax.jit(partial(_unroll, learner)), state.fleet, (*networks, keys)
        ),
        "training": lambda: BenchPart(
            "training", learner.programs.train_step, state, ()
        ),
    }
    if isinstance(env, BP2Env):
        makers["physics"] = lambda: _physics(learner, env, state)
    if learner.mesh.size == 1:
        makers["brax"] = lambda: _brax(learner, networks, keys)
    for name in PARTS:
        if name in makers and name in names:
            yield makers[name]()


def _on_each_device(
    learner: PPO,
    function: Callable[..., object],
    in_specs: Specs = ROBOTS,
    out_specs: Specs = ROBOTS,
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

    def aim(robot: Any) -> Any:
        return env.controller.act(
            robot.controller, robot.command.current, jnp.zeros(env.action_size)
        )[1]

    def simulate(
        carry: tuple[()], physics: Any, targets: Any, robots: Any
    ) -> tuple[tuple[()], object]:
        def control_step(physics: Any, _: None) -> tuple[Any, None]:
            with jax.default_matmul_precision("highest"):
                return jax.vmap(env.engine)(physics, targets, robots)[0], None

        return carry, jax.lax.scan(
            control_step, physics, length=learner.config.unroll_length
        )[0]

    fixed = (first.physics, jax.jit(jax.vmap(aim))(first), first.randomization)
    return BenchPart("physics", _on_each_device(learner, simulate), (), fixed)


def _live(
    learner: PPO, fleet: envs.State, action: jax.Array, keys: jax.Array
) -> tuple[envs.State, tuple[()]]:
    fresh = learner.fleet.fresh_episodes(fleet, keys)

    def control_step(fleet: envs.State, _: None) -> tuple[envs.State, None]:
        return learner.fleet.step(fleet, action, fresh), None

    return jax.lax.scan(control_step, fleet, length=learner.config.unroll_length)[0], ()


def _reset(
    learner: PPO, carry: tuple[()], fleet: envs.State, keys: jax.Array
) -> tuple[tuple[()], envs.State]:
    return carry, learner.fleet.fresh_episodes(fleet, keys)


def _unroll(
    learner: PPO,
    fleet: envs.State,
    params: PPONetworkParams,
    normalizer: RunningStatisticsState,
    keys: jax.Array,
) -> tuple[envs.State, object]:
    fleet, *rest = learner.unroll(params, normalizer, fleet, keys)
    return fleet, rest


def _repeat(learner: PPO, observations: Observation) -> Observation:
    """Repeat observations over an unroll, as an argument of a program, so that XLA
    cannot exploit that they are equal."""
    length = learner.config.unroll_length
    repeated = jax.tree.map(
        lambda x: jnp.broadcast_to(x, (length, *x.shape)), observations
    )
    return jax.device_put(repeated, NamedSharding(learner.mesh, TIMES_ROBOTS))


def _policy(learner: PPO, state: TrainState, keys: jax.Array) -> BenchPart:
    def act(
        carry: tuple[()],
        params: PPONetworkParams,
        normalizer: RunningStatisticsState,
        observations: Observation,
        keys: jax.Array,
    ) -> tuple[tuple[()], object]:
        infer = jax.vmap(learner.infer((normalizer, params.policy)))

        def control_step(
            time: jax.Array, observation: Observation
        ) -> tuple[jax.Array, object]:
            return time + 1, infer(
                observation, jax.vmap(partial(jax.random.fold_in, data=time))(keys)
            )

        return carry, jax.lax.scan(
            control_step, jnp.zeros((), jnp.int32), observations
        )[1]

    in_specs = (EVERYWHERE, EVERYWHERE, EVERYWHERE, TIMES_ROBOTS, ROBOTS)
    program = _on_each_device(learner, act, in_specs, (EVERYWHERE, TIMES_ROBOTS))
    observations = _repeat(learner, state.fleet.obs)
    fixed = (state.params, state.normalizer, observations, keys)
    return BenchPart("policy", program, (), fixed)


def _sgd(learner: PPO, state: TrainState, keys: jax.Array) -> BenchPart:
    """Return the gradient steps of training as a program, on data of the policy's own
    actions."""
    policy = _policy(learner, state, keys)
    _, (actions, extras) = policy.program(policy.carry, *policy.fixed)
    observations = _repeat(learner, state.fleet.obs)

    def improve(
        carry: tuple[PPONetworkParams, optax.OptState],
        normalizer: RunningStatisticsState,
        data: Transition,
        key: jax.Array,
    ) -> tuple[tuple[PPONetworkParams, optax.OptState], object]:
        params, optimizer = carry
        before = state.replace(
            params=params, optimizer=optimizer, normalizer=normalizer
        )
        params, optimizer, metrics = learner.improve(before, data, key)
        return (params, optimizer), metrics

    data = batch(learner, observations, actions, extras)
    fixed = (state.normalizer, data, state.key)
    program = jax.jit(improve, out_shardings=learner.everywhere)
    return BenchPart("sgd", program, (state.params, state.optimizer), fixed)


def batch(
    learner: PPO,
    observations: Observation,
    actions: jax.Array,
    extras: Mapping[str, object],
) -> Transition:
    """Return training data with zero rewards and no episode ends, from arrays with axes
    (time, robot)."""

    def build(
        observations: Observation, actions: jax.Array, extras: Mapping[str, object]
    ) -> Transition:
        observations, actions, extras = jax.tree.map(
            lambda x: jnp.swapaxes(x, 0, 1), (observations, actions, extras)
        )
        zeros = jnp.zeros(actions.shape[:2])
        last = jax.tree.map(lambda x: x[:, -1:], observations)
        extras = {"policy_extras": extras, "state_extras": {"truncation": zeros}}
        return make_transition(
            observations, actions, zeros, jnp.ones_like(zeros), last, extras
        )

    return jax.jit(build, out_shardings=learner.robots)(observations, actions, extras)


def _brax(learner: PPO, networks: Networks, keys: jax.Array) -> BenchPart:
    config = learner.config
    env = brax_training.wrap(learner.fleet.env, config.episode_length)

    def act(
        carry: tuple[envs.State, jax.Array],
        params: PPONetworkParams,
        normalizer: RunningStatisticsState,
    ) -> tuple[tuple[envs.State, jax.Array], object]:
        fleet, key = carry
        key, now = jax.random.split(key)
        policy = learner.infer((normalizer, params.policy))
        fleet, data = acting.generate_unroll(
            env, fleet, policy, now, config.unroll_length, ("truncation",)
        )
        return (fleet, key), data

    return BenchPart(
        "brax", jax.jit(act), (jax.jit(env.reset)(keys), keys[0]), networks
    )


# --- What JAX says of itself ----------------------------------------------------------


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


def _explain(reason: Exception) -> str:
    """Say in one line why a size cannot be timed; re-raise errors with other causes
    than size or memory."""
    if isinstance(reason, UserError):
        return str(reason)
    if re.search("RESOURCE_EXHAUSTED|out of memory", str(reason), re.IGNORECASE):
        return OUT_OF_MEMORY
    raise reason
