"""PPO as one pure function over one state: `train_step(TrainState) -> (TrainState,
metrics)`.

Networks and running statistics are Brax's, and so is the loss, but for rounding; the
loop is ours because Brax's cannot resume exactly, gives every device the same
randomisation, and normalises advantages per device.

The program is written for global arrays on a 1-D device mesh with the axis `robots`;
one device is the same code. Physics and policy run in a `shard_map` (robots never talk
to each other); the SGD part is partitioned by the compiler. Every random number belongs
to a robot or to the whole, never to a device, and shuffling stays within blocks of
robots, so the result does not depend on how many devices hold the robots.
"""

import concurrent.futures
import contextlib
import functools
from collections.abc import Callable, Generator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from brax import envs
from brax.training.acme import running_statistics, specs
from brax.training.agents.ppo import losses, networks
from brax.training.agents.ppo.optimizer import adaptive_kl_learning_rate
from brax.training.types import Transition
from flax import struct
from jax.flatten_util import ravel_pytree
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array

from bp2_rl.base.errors import UserError
from bp2_rl.learning.batched_env import BatchedEnv, Tree
from bp2_rl.learning.loss import ppo_loss
from bp2_rl.learning.networks import make_networks, mirrors_of, reflect
from bp2_rl.settings.ppo import MAX_BLOCKS, PPOConfig

make_transition: Any = Transition  # Brax annotates its trees as if they were arrays
Learned = tuple[losses.PPONetworkParams, optax.OptState]
"""What a gradient step changes: parameters and the optimiser's state."""
NOT_FINITE = "not_finite"
"""Name of the metric that is 1 if a train step was not finite and left the state
unchanged."""


class TrainState(struct.PyTreeNode):
    """The complete state of a training: networks, normaliser, optimiser, robots, random
    key and step."""

    params: losses.PPONetworkParams
    # of the policy's parameters over the last train steps; this average is exported
    average: Any
    normalizer: running_statistics.RunningStatisticsState
    optimizer: optax.OptState
    fleet: envs.State
    key: Array
    step: Array  # train steps done


class Programs(NamedTuple):
    """The two compiled functions that a learner computes with."""

    init: Any  # jitted: key -> TrainState
    train_step: Any  # jitted: TrainState, which it consumes -> (TrainState, metrics)


class PPO:
    """The learner for one environment.

    A train step lets every robot act for T steps (`unroll`), and then descends the loss
    on minibatches of these steps (`improve`).

    Args:
        env: any `brax.envs.Env`; where its observation is a dictionary, the policy sees
            `state` and the critic `privileged_state`.
        config: hyperparameters.
        devices: the mesh; default all of JAX's, but on a CPU, where they are threads,
            at most as many as fit. Their number must divide `config.shuffle_blocks`.

    Raises:
        UserError: the number of devices does not fit the number of robots.
    """

    def __init__(
        self,
        env: envs.Env,
        config: PPOConfig,
        devices: Sequence[Any] | None = None,
    ):
        self.config = config
        self.fleet = BatchedEnv(env, config.episode_length)
        self.mesh = Mesh(np.array(devices or _devices(config)), ("robots",))
        if config.shuffle_blocks % self.mesh.size:
            raise UserError(
                f"a minibatch of {config.num_envs // config.num_minibatches} robots cannot be spread over "
                f"{self.mesh.size} devices: use 1, 2, 4 ... up to {MAX_BLOCKS}, and make ppo.num_envs / "
                "ppo.num_minibatches a multiple of that"
            )
        # of arrays with a row for each robot
        self.robots = NamedSharding(self.mesh, PartitionSpec("robots"))
        # of all other arrays
        self.everywhere = NamedSharding(self.mesh, PartitionSpec())
        self.network = make_networks(env, config)
        self.mirrors = mirrors_of(env, config)
        # (normaliser, policy) -> (observation, key) -> (action, extras): it explores.
        self.infer = networks.make_inference_fn(self.network)
        self._optimizer = optax.chain(
            optax.clip_by_global_norm(config.max_grad_norm),
            optax.inject_hyperparams(optax.adam)(learning_rate=config.learning_rate),
        )
        self.programs = self.jitted(self._init, self._train_step)

    def jitted(
        self,
        init: Callable[[Array], TrainState],
        train_step: Callable[[TrainState], tuple[TrainState, dict[str, Array]]],
    ) -> Programs:
        """Return `init` and `train_step` as programs jitted for the mesh of devices."""
        # Run once, and on a CPU compiled in half the time.
        options = (
            {"xla_backend_optimization_level": 0}
            if self.mesh.devices.flat[0].platform == "cpu"
            else None
        )
        first = jax.jit(init, out_shardings=self.shardings(), compiler_options=options)
        step = jax.jit(
            train_step,
            donate_argnums=0,
            out_shardings=(self.shardings(), self.everywhere),
        )
        return Programs(first, step)

    def init(self, seed: int) -> TrainState:
        """Return the state before the first train step, spread over the mesh."""
        return self.programs.init(self.first_key(seed))

    def train_step(self, state: TrainState) -> tuple[TrainState, dict[str, Array]]:
        """Return the state after a train step, and its metrics; `state` is consumed."""
        return self.programs.train_step(state)

    def first_key(self, seed: int) -> Array:
        """Return the random key of a run, on every device."""
        return jax.device_put(jax.random.PRNGKey(seed), self.everywhere)

    @contextlib.contextmanager
    def compiling(self) -> Generator[None]:
        """Context manager that compiles the train step in another thread meanwhile; the
        first train step finds it."""
        shape = self.shape
        with concurrent.futures.ThreadPoolExecutor(1) as beside:
            compiled = beside.submit(
                lambda: self.programs.train_step.lower(shape).compile()
            )
            yield
            compiled.result()

    @functools.cached_property
    def shape(self) -> TrainState:
        """Shapes, dtypes and shardings of the train state, for restoring a
        checkpoint."""
        shapes = self.programs.init.eval_shape(self.first_key(0))
        return jax.tree.map(
            lambda leaf, sharding: jax.ShapeDtypeStruct(
                leaf.shape, leaf.dtype, sharding=sharding
            ),
            shapes,
            jax.tree.map(
                lambda sharding, tree: jax.tree.map(lambda _: sharding, tree),
                self.shardings(),
                shapes,
            ),
        )

    def shardings(self) -> TrainState:
        """Return the shardings of the train state's parts: robots are spread, all else
        is on every device."""
        whole: Any = self.everywhere  # one sharding stands for all the leaves below it
        robots: Any = self.robots
        return TrainState(
            params=whole,
            average=whole,
            normalizer=whole,
            optimizer=whole,
            fleet=robots,
            key=whole,
            step=whole,
        )

    # --- One train step, top down -----------------------------------------------------

    def _init(self, key: Array) -> TrainState:
        key, key_policy, key_value, key_fleet = jax.random.split(key, 4)
        network_params: Any = (
            losses.PPONetworkParams
        )  # a dataclass, though pyright does not follow Brax's way to it
        params = network_params(
            policy=self.network.policy_network.init(key_policy),
            value=self.network.value_network.init(key_value),
        )
        fleet = self.fleet.reset(jax.random.split(key_fleet, self.config.num_envs))
        # Brax counts and checks by arrays; the first observations make the normaliser
        # useful from the first step.
        template = jax.tree.map(lambda x: specs.Array(x.shape[1:], x.dtype), fleet.obs)
        normalizer = self.update_normalizer(
            running_statistics.init_state(template, std_eps=1e-4), fleet.obs
        )
        state = TrainState(
            params=params,
            average=jax.tree.map(jnp.copy, params.policy),
            normalizer=normalizer,
            optimizer=self._optimizer.init(params),
            fleet=fleet,
            key=key,
            step=jnp.zeros((), jnp.int32),
        )
        # Some of Brax's scalars are weakly typed; after a step or a restore they are
        # not, which would cause a second compilation.
        return jax.tree.map(lambda x: jnp.asarray(x, jnp.result_type(x)), state)

    def _train_step(self, state: TrainState) -> tuple[TrainState, dict[str, Array]]:
        key, keys, key_sgd = self.draw_keys(state)
        fleet, data, metrics = self.unroll(
            state.params, state.normalizer, state.fleet, keys
        )
        params, optimizer, sgd_metrics = self.improve(state, data, key_sgd)
        average = optax.incremental_update(
            params.policy, state.average, 1.0 - self.config.averaging
        )
        # After the gradient steps, so that these see the observations as the behaviour
        # policy did.
        normalizer = self.update_normalizer(state.normalizer, data.observation)
        after = TrainState(
            params, average, normalizer, optimizer, fleet, key, state.step + 1
        )
        # The fleet ends a faulty robot's episode. Values that are not finite here come
        # from the learner; the state before them is kept, so that it can be saved and
        # studied even if the host learns of the fault late.
        sound = _all_finite((params, normalizer, optimizer, sgd_metrics))
        after = jax.tree.map(lambda new, old: jnp.where(sound, new, old), after, state)
        return after, {**metrics, **sgd_metrics, NOT_FINITE: 1.0 - sound}

    def update_normalizer(
        self, normalizer: running_statistics.RunningStatisticsState, observation: Any
    ) -> running_statistics.RunningStatisticsState:
        """Return the statistics of observations, updated by these, and by their mirror
        images where networks are symmetric."""
        if self.mirrors:
            images = reflect(self.mirrors, observation)
            observation = jax.tree.map(
                lambda x, image: jnp.stack([x, image], axis=1), observation, images
            )
        return running_statistics.update(normalizer, observation)

    def draw_keys(self, state: TrainState) -> tuple[Array, Array, Array]:
        """Return the random keys of a train step: the next step's, a key for each
        robot, and the epochs'."""
        key, key_unroll, key_sgd = jax.random.split(state.key, 3)
        return key, jax.random.split(key_unroll, self.config.num_envs), key_sgd

    def unroll(
        self,
        params: losses.PPONetworkParams,
        normalizer: running_statistics.RunningStatisticsState,
        fleet: envs.State,
        keys: Array,
    ) -> tuple[envs.State, Transition, dict[str, Array]]:
        """Take `unroll_length` control steps; return the fleet, data with axes (robot,
        time), and metrics averaged over both."""
        robots, whole = PartitionSpec("robots"), PartitionSpec()
        local = jax.shard_map(
            self._unroll_local,
            mesh=self.mesh,
            in_specs=(whole, whole, robots, robots),
            out_specs=(robots, robots, robots),
            check_vma=False,
        )
        fleet, data, per_robot = local(params, normalizer, fleet, keys)
        return fleet, data, jax.tree.map(jnp.mean, per_robot)

    def _unroll_local(
        self,
        params: losses.PPONetworkParams,
        normalizer: running_statistics.RunningStatisticsState,
        fleet: envs.State,
        keys: Array,
    ) -> tuple[envs.State, Transition, dict[str, Array]]:
        """Unroll the robots on a device; each robot draws from a key of its own."""
        act = jax.vmap(self.infer((normalizer, params.policy)))
        split = jax.vmap(functools.partial(jax.random.split, num=3))(keys)
        fresh = self.fleet.fresh_episodes(fleet, split[:, 0])

        def control_step(
            carry: tuple[envs.State, dict[str, Array]], time: Array
        ) -> tuple[tuple[envs.State, dict[str, Array]], Transition]:
            fleet, sums = carry
            noise = jax.vmap(functools.partial(jax.random.fold_in, data=time))(
                split[:, 1]
            )
            action, policy_extras = act(fleet.obs, noise)
            after = self.fleet.step(fleet, action, fresh)
            extras = {
                "policy_extras": policy_extras,
                "state_extras": {"truncation": after.info["truncation"]},
            }
            data = make_transition(
                fleet.obs, action, after.reward, 1.0 - after.done, (), extras
            )
            return (after, jax.tree.map(jnp.add, sums, _step_metrics(after))), data

        sums = jax.tree.map(jnp.zeros_like, _step_metrics(fleet))
        length = self.config.unroll_length
        (fleet, sums), data = jax.lax.scan(
            control_step, (fleet, sums), jnp.arange(length)
        )
        data = jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), data)
        # The loss looks at the last next_observation alone.
        data = data._replace(
            next_observation=jax.tree.map(lambda x: x[:, None], fleet.obs)
        )
        return fleet, data, jax.tree.map(lambda x: x / length, sums)

    def improve(
        self, state: TrainState, data: Transition, key: Array
    ) -> tuple[losses.PPONetworkParams, optax.OptState, dict[str, Array]]:
        """Take all epochs of gradient steps on one unroll; return parameters, optimiser
        and mean metrics after them."""

        def minibatch_step(
            carry: Learned, minibatch: Transition
        ) -> tuple[Learned, dict[str, Array]]:
            params, optimizer = carry
            return self.gradient_step(
                state.replace(params=params, optimizer=optimizer), minibatch
            )

        def epoch(carry: Learned, key: Array) -> tuple[Learned, dict[str, Array]]:
            return jax.lax.scan(minibatch_step, carry, self.shuffle(data, key))

        keys = jax.random.split(key, self.config.num_epochs)
        (params, optimizer), metrics = jax.lax.scan(
            epoch, (state.params, state.optimizer), keys
        )
        return (
            params,
            optimizer,
            {f"loss/{name}": jnp.mean(value) for name, value in metrics.items()},
        )

    def gradient_step(
        self, state: TrainState, minibatch: Transition
    ) -> tuple[tuple[Any, Any], dict[str, Array]]:
        """Take one gradient step; return (parameters, optimiser) after it, and the
        metrics of the step."""
        config = self.config
        step = state.step
        params: Any = state.params  # Optax annotates its trees as arrays
        optimizer: Any = state.optimizer
        metrics, gradient = self.differentiate(
            params, state.normalizer, minibatch, step
        )
        kl = metrics["kl_mean"]
        if config.critic_steps:
            learns = (step >= config.critic_steps).astype(jnp.float32)
            gradient = gradient.replace(
                policy=optax.tree.scale(learns, gradient.policy)
            )
            kl *= learns  # at zero the learning rate stays
        if config.desired_kl is not None:
            # Brax asks for a float
            desired: Any = config.desired_kl / (1.0 + step / config.kl_decay)
            optimizer, _ = adaptive_kl_learning_rate(
                optimizer, kl, desired, max_learning_rate=config.max_learning_rate
            )
        updates, optimizer = self._optimizer.update(gradient, optimizer)
        metrics |= {
            "grad_norm": optax.tree.norm(gradient),
            "learning_rate": optimizer[-1].hyperparams["learning_rate"],
        }
        return (optax.apply_updates(params, updates), optimizer), metrics

    def differentiate(self, *inputs: object) -> tuple[dict[str, Array], Any]:
        """Return the terms of `loss` and its gradient by the parameters; the minibatch
        is spread over the mesh."""

        def local(mean: Callable[[Array], Array], *inputs: object) -> Any:
            (_, terms), gradient = jax.value_and_grad(self.loss, has_aux=True)(
                *inputs, mean
            )
            return terms, gradient

        def together(*inputs: object) -> Any:
            # The gradient in one message: on two processors its twenty pieces took a
            # quarter of SGD's time.
            message, pieces = ravel_pytree(
                local(lambda x: jax.lax.pmean(jnp.mean(x), "robots"), *inputs)
            )
            return pieces(jax.lax.pmean(message, "robots"))

        if self.mesh.size == 1:
            return local(jnp.mean, *inputs)
        whole, robots = PartitionSpec(), PartitionSpec("robots")
        in_specs = (whole, whole, robots, whole)
        return jax.shard_map(
            together,
            mesh=self.mesh,
            in_specs=in_specs,
            out_specs=whole,
            check_vma=False,
        )(*inputs)

    def loss(
        self,
        params: losses.PPONetworkParams,
        normalizer: running_statistics.RunningStatisticsState,
        data: Transition,
        step: Array | int = 0,
        mean: Callable[[Array], Array] = jnp.mean,
    ) -> tuple[Array, dict[str, Array]]:
        """Return the loss in train step `step`, and its terms; `data` has axes (robot,
        time); `mean`: of `ppo_loss`."""
        entropy_cost = self.config.entropy_cost / (
            1.0 + step / self.config.entropy_decay
        )
        return ppo_loss(
            self.network, self.config, params, normalizer, data, entropy_cost, mean
        )

    def shuffle(self, data: Tree, key: Array) -> Tree:
        """Return an epoch's minibatches: robots shuffled within blocks, of which each
        minibatch has equal shares."""
        config = self.config
        blocks = config.shuffle_blocks
        size = config.num_envs // config.shuffle_blocks
        keys = jax.random.split(key, blocks)
        order = jax.vmap(lambda key: jax.random.permutation(key, size))(keys)
        spread = NamedSharding(self.mesh, PartitionSpec(None, "robots"))

        def shuffled(x: Array) -> Array:
            x = x.reshape(blocks, size, *x.shape[1:])
            x = jax.vmap(lambda rows, order: rows[order])(x, order)
            x = x.reshape(blocks, config.num_minibatches, -1, *x.shape[2:])
            x = jnp.swapaxes(x, 0, 1).reshape(config.num_minibatches, -1, *x.shape[3:])
            return jax.lax.with_sharding_constraint(x, spread)

        return jax.tree.map(shuffled, data)


def _devices(config: PPOConfig) -> list[Any]:
    devices = jax.devices()
    if devices[0].platform != "cpu" or jax.process_count() > 1:
        return devices
    return devices[: min(2 ** (len(devices).bit_length() - 1), config.shuffle_blocks)]


def _all_finite(tree: object) -> Array:
    return jnp.stack([jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(tree)]).all()


def _step_metrics(state: envs.State) -> dict[str, Array]:
    """Return the metrics of a control step, robot by robot, to be summed over the
    steps."""
    terminated = state.done * (1.0 - state.info["truncation"])
    return {
        **state.metrics,
        "reward": state.reward,
        "reward_square": jnp.square(state.reward),
        "falls": terminated,
        "time_outs": state.info["truncation"],
    }
