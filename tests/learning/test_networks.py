import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from aim import Aim
from brax.training.acme import running_statistics, specs

from bp2_rl.base.errors import UserError
from bp2_rl.env.observations import mirrors_under
from bp2_rl.learning import networks as networks_module
from bp2_rl.learning.networks import dense_layers, make_networks, mirrors_of, reflect
from bp2_rl.settings.env import EnvConfig
from bp2_rl.settings.ppo import PPOConfig

CONFIG = PPOConfig(policy_layers=(32, 16), value_layers=(16, 8), symmetric=True)
MIRRORS = mirrors_under(EnvConfig())

SIZES = {name: len(MIRRORS[name].order) for name in ("state", "privileged_state")}


class Shapes(Aim):
    """Environment that has only the sizes that networks are built from."""

    mirrors = MIRRORS

    @property
    def observation_size(self):
        return SIZES

    @property
    def action_size(self):
        return 12


@pytest.fixture(scope="module")
def symmetric():
    """Return networks, statistics, policy and critic parameters with every weight at
    work, and observations."""
    networks = make_networks(Shapes(), CONFIG)
    keys = jax.random.split(jax.random.PRNGKey(0), 5)
    observation = {
        name: 1.0 + 3.0 * jax.random.normal(key, (7, size))
        for key, (name, size) in zip(keys, SIZES.items(), strict=False)
    }
    both = jax.tree.map(
        lambda x, y: jnp.stack([x, y], 1), observation, reflect(MIRRORS, observation)
    )
    empty = running_statistics.init_state(
        jax.tree.map(lambda x: specs.Array(x.shape[1:], x.dtype), observation)
    )
    statistics = running_statistics.update(empty, both)
    actor, critic = (
        network.init(key)
        for network, key in (
            (networks.policy_network, keys[2]),
            (networks.value_network, keys[3]),
        )
    )
    moved = jax.tree.map(
        lambda x: x + 0.3 * jax.random.normal(keys[4], x.shape), (actor, critic)
    )
    return networks, statistics, *moved, observation


def test_the_action_of_a_mirror_image_is_the_image_of_the_action(symmetric):
    networks, statistics, actor, _, observation = symmetric
    mean, std = networks.policy_network.apply(statistics, actor, observation)
    mirrored_mean, mirrored_std = networks.policy_network.apply(
        statistics, actor, reflect(MIRRORS, observation)
    )
    assert np.abs(mean).max() > 0.5
    # float32 sums in another order
    np.testing.assert_allclose(
        reflect(MIRRORS, {"action": mean})["action"], mirrored_mean, rtol=0, atol=1e-5
    )
    np.testing.assert_array_equal(std[..., list(MIRRORS["action"].order)], mirrored_std)


def test_the_value_of_a_mirror_image_is_the_value(symmetric):
    networks, statistics, _, critic, observation = symmetric
    values = networks.value_network.apply(statistics, critic, observation)
    mirrored = networks.value_network.apply(
        statistics, critic, reflect(MIRRORS, observation)
    )
    assert np.std(values) > 0.1
    np.testing.assert_allclose(values, mirrored, rtol=0, atol=1e-5)


def test_an_ordinary_network_does_the_same_with_twice_the_weights(symmetric):
    networks, statistics, actor, _, observation = symmetric
    layers = dense_layers(actor, MIRRORS)
    hidden = np.asarray(
        (observation["state"] - statistics.mean["state"]) / statistics.std["state"],
        float,
    )
    for weight, bias in layers[:-1]:
        hidden = np.asarray(jax.nn.swish(hidden @ weight + bias))
    weight, bias = layers[-1]
    mean, _ = networks.policy_network.apply(statistics, actor, observation)
    np.testing.assert_allclose(hidden @ weight + bias, mean, rtol=0, atol=1e-5)
    assert [weight.shape for weight, _ in layers] == list(
        itertools.pairwise((47, 32, 16, 12))
    )
    blocks = [
        block
        for name, block in actor["params"]["SymmetricMLP_0"].items()
        if not name.startswith("bias")
    ]
    assert 2 * sum(block.size for block in blocks) == pytest.approx(
        sum(k.size for k, _ in layers), rel=0.01
    )


def test_layers_are_assembled_in_numpy_as_the_compiled_network_does(symmetric):
    actor, bases = (
        symmetric[2],
        (MIRRORS["state"].parities(), MIRRORS["action"].parities()),
    )
    compiled = jax.jit(lambda blocks: networks_module._assemble(blocks, *bases))(
        actor["params"]["SymmetricMLP_0"]
    )
    layers = dense_layers(actor, MIRRORS)
    assert all(
        isinstance(array, np.ndarray) and array.dtype == np.float32
        for layer in layers
        for array in layer
    )
    # Weights are at most about 1, and XLA may round a product and a sum once where
    # NumPy rounds each.
    jax.tree.map(
        lambda ours, theirs: np.testing.assert_allclose(
            ours, theirs, rtol=0, atol=1.2e-7
        ),
        layers,
        compiled,
    )


def test_without_symmetry_the_networks_are_braxs():
    config = dataclasses.replace(CONFIG, symmetric=False)
    assert not mirrors_of(Shapes(), config)
    params = make_networks(Shapes(), config).policy_network.init(jax.random.PRNGKey(0))
    assert {"MLP_0", "Dense_0"} <= set(params["params"])


def test_half_the_bits_compute_the_same_but_for_rounding(symmetric):
    """bfloat16 keeps 8 bits of a number: 2 to 4 of a thousand, of what the hidden
    layers hold."""
    _, statistics, actor, critic, observation = symmetric
    half = make_networks(Shapes(), dataclasses.replace(CONFIG, dtype="bfloat16"))
    whole = symmetric[0]
    for name, params in (("policy_network", actor), ("value_network", critic)):
        exact, rounded = (
            jax.tree.leaves(
                getattr(networks, name).apply(statistics, params, observation)
            )[0]
            for networks in (whole, half)
        )
        assert rounded.dtype == jnp.float32
        error = np.linalg.norm(rounded - exact) / np.linalg.norm(exact)
        assert 1e-4 < error < 1e-2
    fresh = half.policy_network.init(jax.random.PRNGKey(0))
    assert {leaf.dtype for leaf in jax.tree.leaves(fresh)} == {jnp.dtype("float32")}


def test_layers_of_odd_width_are_refused():
    with pytest.raises(UserError, match="policy_layers must be even"):
        PPOConfig(policy_layers=(32, 15), symmetric=True)
    PPOConfig(policy_layers=(32, 15), symmetric=False)
