"""Actor and critic networks: Brax's MLPs, or MLPs that are left-right symmetric by
construction.

A policy pi is equivariant where the mirror image of an observation leads to the mirror
image of the action, pi(M o) = M pi(o), and a critic is invariant where V(M o) = V(o).
An MLP whose hidden units come in pairs that a mirror exchanges is both, for any
weights. In the basis of parities, which is of sums and of differences of the pairs,
each of its layers is two blocks: even to even and odd to odd. So it has half the
weights of an MLP of the same width. It is computed as one: block by block its weights
would take half the multiplications, but XLA is slower so on processors.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from brax import envs
from brax.training import distribution
from brax.training import networks as brax_networks
from brax.training.acme import running_statistics
from brax.training.acme.running_statistics import RunningStatisticsState
from brax.training.agents.ppo import networks
from flax import linen
from jaxtyping import Array, Float

from bp2_rl.base import arrays
from bp2_rl.robot.observation import Mirror
from bp2_rl.settings.ppo import PPOConfig

ACTIVATIONS = {
    "swish": linen.swish,
    "elu": linen.elu,
    "tanh": linen.tanh,
    "relu": linen.relu,
}
POLICY, CRITIC = "state", "privileged_state"
"""Keys of the policy's and the critic's observation in the observation dictionary."""
FIRST_OUTPUTS = partial(jax.nn.initializers.variance_scaling, 1e-4, "fan_in", "uniform")
"""Initialiser of the policy's last layer: small, so that training begins on the
reference motion, not on noise."""
Layer = tuple[arrays.Array, arrays.Array]
"""Weight and bias."""
Bases = tuple[Float[np.ndarray, "_ _"], Float[np.ndarray, "_ _"]]
HIDDEN = jax.nn.initializers.lecun_uniform()
HALF = float(np.sqrt(0.5))


def make_networks(env: envs.Env, config: PPOConfig) -> networks.PPONetworks:
    """Return actor and critic; the actor is a Gaussian policy with a state-independent
    standard deviation.

    They are symmetric if `config.symmetric` is set and the environment has `mirrors`,
    the `Mirror` of each observation and of the `action`.
    """
    sizes = env.observation_size
    mirrors = mirrors_of(env, config)
    if mirrors:
        return _symmetric_networks(mirrors, config)
    asymmetric = isinstance(sizes, dict) and CRITIC in sizes
    return networks.make_ppo_networks(
        sizes,
        env.action_size,
        preprocess_observations_fn=_normalize,
        policy_hidden_layer_sizes=config.policy_layers,
        value_hidden_layer_sizes=config.value_layers,
        activation=ACTIVATIONS[config.activation],
        value_obs_key=CRITIC if asymmetric else POLICY,
        distribution_type="normal",
        noise_std_type="log",
        init_noise_std=config.initial_std,
        mean_kernel_init_fn=FIRST_OUTPUTS,
    )


def mirrors_of(env: envs.Env, config: PPOConfig) -> Mapping[str, Mirror]:
    """Return the mirrors under which the networks are symmetric; empty where they are
    not symmetric."""
    return getattr(env, "mirrors", {}) if config.symmetric else {}


def reflect(
    mirrors: Mapping[str, Mirror], observation: Mapping[str, Array]
) -> dict[str, Array]:
    """Return the mirror images of observations (any batch axes)."""
    return {
        name: jnp.asarray(mirrors[name].sign, x.dtype)
        * x[..., np.asarray(mirrors[name].order)]
        for name, x in observation.items()
    }


def dense_layers(
    params: Mapping[str, Any], mirrors: Mapping[str, Mirror]
) -> list[Layer]:
    """Return the layers (weight, bias) of an ordinary MLP with the same outputs as the
    policy.

    It computes the mean action of these policy parameters. The arrays are NumPy's: some
    fifty small operations would be compiled for a GPU one by one.
    """
    tree = jax.device_get(params["params"])
    if mirrors:
        blocks = tree["SymmetricMLP_0"]
        return _assemble(
            blocks, mirrors[POLICY].parities(), mirrors["action"].parities()
        )
    layers = [tree["MLP_0"][f"hidden_{i}"] for i in range(len(tree["MLP_0"]))] + [
        tree["Dense_0"]
    ]
    return [(layer["kernel"], layer["bias"]) for layer in layers]


class SymmetricMLP(linen.Module):
    """An equivariant MLP from vectors that `inputs` reflects to vectors that `outputs`
    reflects.

    In each hidden layer half of the units are mirror images of the others; the last
    layer is linear.
    """

    inputs: Mirror
    outputs: Mirror
    layer_sizes: Sequence[int]
    activation: Callable[[Array], Array]
    dtype: np.dtype  # of the hidden layers' computation
    output_kernel_init: jax.nn.initializers.Initializer = HIDDEN

    @linen.compact
    def __call__(
        self, x: Float[Array, "*batch inputs"]
    ) -> Float[Array, "*batch outputs"]:
        """Return the MLP's outputs for a batch of inputs."""
        first, last = self.inputs.parities(), self.outputs.parities()
        sizes = [
            tuple(basis.shape[1] for basis in first),
            *((size // 2, size // 2) for size in self.layer_sizes),
            tuple(basis.shape[1] for basis in last),
        ]
        blocks = {}
        for i, (given, wanted) in enumerate(itertools.pairwise(sizes)):
            init = self.output_kernel_init if i == len(self.layer_sizes) else HIDDEN
            blocks[f"even_{i}"] = self.param(f"even_{i}", init, (given[0], wanted[0]))
            if wanted[1]:
                blocks[f"odd_{i}"] = self.param(f"odd_{i}", init, (given[1], wanted[1]))
            blocks[f"bias_{i}"] = self.param(
                f"bias_{i}", jax.nn.initializers.zeros, (wanted[0],)
            )
        *hidden, (weight, bias) = _assemble(blocks, first, last)
        x = x.astype(self.dtype)
        for one, offset in hidden:
            x = self.activation(x @ one.astype(self.dtype) + offset.astype(self.dtype))
        return x.astype(weight.dtype) @ weight + bias


def _assemble(
    blocks: Mapping[str, arrays.Array], first: Bases, last: Bases
) -> list[Layer]:
    """Assemble each layer (weight, bias) of a symmetric MLP from its two blocks.

    The arrays are of the blocks' library, NumPy or JAX.

    W = E W_even E'^T + O W_odd O'^T with the bases E, O of the inputs and E', O' of the
    outputs.
    """
    hidden = sum(name.startswith("even_") for name in blocks) - 1
    layers = []
    for i, (given, wanted) in enumerate(
        itertools.pairwise([first, *[None] * hidden, last])
    ):
        parts = [blocks[name] for name in (f"even_{i}", f"odd_{i}") if name in blocks]
        weight = sum(
            _of_units(_of_units(part, given, parity).T, wanted, parity).T
            for parity, part in enumerate(parts)
        )
        layers.append((weight, _of_units(blocks[f"bias_{i}"], wanted, 0)))
    return layers


def _of_units(
    x: Float[arrays.Array, "parity ..."], bases: Bases | None, parity: int
) -> Float[arrays.Array, "units ..."]:
    """Return rows for units from rows for their even (parity 0) or odd (1)
    combinations.

    Hidden units have no `bases`: theirs are (1, 1) and (1, -1) of each pair, which
    takes no multiplications.
    """
    xp = x.__array_namespace__()
    if bases is None:
        return HALF * xp.concat([x, (1.0, -1.0)[parity] * x])
    return xp.asarray(bases[parity], dtype=x.dtype) @ x


class SymmetricPolicy(linen.Module):
    """Policy network: the mean action, and a standard deviation that mirrored actions
    share."""

    inputs: Mirror
    outputs: Mirror
    layer_sizes: Sequence[int]
    activation: Callable[[Array], Array]
    dtype: np.dtype
    initial_std: float

    @linen.compact
    def __call__(self, x: Float[Array, "*batch inputs"]) -> tuple[Array, Array]:
        """Return (mean, standard deviation) of the action, each of shape (*batch,
        outputs)."""
        how = (self.activation, self.dtype, FIRST_OUTPUTS())
        mean = SymmetricMLP(self.inputs, self.outputs, self.layer_sizes, *how)(x)
        pairs = np.unique(
            np.minimum(self.outputs.order, np.arange(len(self.outputs.order))),
            return_inverse=True,
        )[1]
        constant = jax.nn.initializers.constant(np.log(self.initial_std))
        log_std = self.param("log_std", constant, (int(pairs.max()) + 1,))
        return mean, jnp.broadcast_to(jnp.exp(log_std)[pairs], mean.shape)


def _symmetric_networks(
    mirrors: Mapping[str, Mirror], config: PPOConfig
) -> networks.PPONetworks:
    critic_input = CRITIC if CRITIC in mirrors else POLICY
    options = (ACTIVATIONS[config.activation], jnp.dtype(config.dtype))
    actor = SymmetricPolicy(
        mirrors[POLICY],
        mirrors["action"],
        config.policy_layers,
        *options,
        config.initial_std,
    )
    critic = SymmetricMLP(
        mirrors[critic_input], Mirror((0,), (1,)), config.value_layers, *options
    )

    def network(
        module: linen.Module,
        key: str,
        finish: Callable[..., Array | tuple[Array, Array]],
    ) -> brax_networks.FeedForwardNetwork:
        def apply(
            statistics: RunningStatisticsState,
            params: Mapping[str, Mapping[str, Any]],
            observation: Mapping[str, Array],
        ) -> Array | tuple[Array, Array]:
            chosen = brax_networks.normalizer_select(statistics, key)
            return finish(module.apply(params, _normalize(observation[key], chosen)))

        empty = jnp.zeros((1, len(mirrors[key].order)))
        return brax_networks.FeedForwardNetwork(
            init=lambda random: module.init(random, empty), apply=apply
        )

    make: Any = (
        networks.PPONetworks
    )  # a dataclass, though pyright does not follow Brax's way to `flax.struct`
    return make(
        policy_network=network(actor, POLICY, lambda out: out),
        value_network=network(critic, critic_input, lambda out: out[..., 0]),
        parametric_action_distribution=distribution.NormalDistribution(
            event_size=len(mirrors["action"].order)
        ),
    )


def _normalize(observation: Any, preprocessor_params: RunningStatisticsState) -> Any:
    return running_statistics.normalize(observation, preprocessor_params)
