"""The network as ONNX is the one that was trained, ordinary or symmetric."""

import jax
import jax.numpy as jnp
import numpy as np
import onnxruntime
import pytest
from aim import Aim
from brax.training.acme import running_statistics, specs

from bp2_rl.deploy.network import to_onnx
from bp2_rl.env.observations import LAYOUT, mirrors_under, size_of
from bp2_rl.learning.networks import dense_layers, make_networks, mirrors_of
from bp2_rl.learning.policy import make_policy
from bp2_rl.settings.env import EnvConfig
from bp2_rl.settings.ppo import PPOConfig

SIZE = size_of(LAYOUT)


class Shapes(Aim):
    """Environment that has only the sizes that networks are built from."""

    mirrors = mirrors_under(EnvConfig())

    @property
    def observation_size(self):
        return {"state": SIZE}

    @property
    def action_size(self):
        return 12


@pytest.mark.parametrize(
    ("activation", "symmetric"),
    [
        ("swish", False),
        ("elu", False),
        ("tanh", False),
        ("relu", False),
        ("swish", True),
    ],
)
def test_onnxruntime_answers_as_the_trained_network(make_card, activation, symmetric):
    config = PPOConfig(
        policy_layers=(32, 16),
        value_layers=(8,),
        activation=activation,
        symmetric=symmetric,
    )
    networks, keys = (
        make_networks(Shapes(), config),
        jax.random.split(jax.random.PRNGKey(0), 3),
    )
    observation = {"state": 1.0 + 3.0 * jax.random.normal(keys[0], (20, SIZE))}
    statistics = running_statistics.init_state(
        {"state": specs.Array((SIZE,), jnp.float32)}
    )
    statistics = running_statistics.update(statistics, observation)
    started = jax.jit(networks.policy_network.init)(keys[2])
    params = jax.tree.map(
        lambda x: x + 0.3 * jax.random.normal(keys[1], x.shape), started
    )
    expected, _ = jax.jit(networks.policy_network.apply)(
        statistics, params, observation
    )
    card = make_card(activation=activation, hidden_layer_sizes=config.policy_layers)
    policy = make_policy(
        dense_layers(params, mirrors_of(Shapes(), config)), statistics, card
    )
    session = onnxruntime.InferenceSession(to_onnx(policy))
    (found,) = session.run(["actions"], {"obs": np.asarray(observation["state"])})
    assert np.abs(expected).max() > 0.5
    # float32 sums in another order
    np.testing.assert_allclose(np.asarray(found), expected, rtol=0, atol=2e-5)
