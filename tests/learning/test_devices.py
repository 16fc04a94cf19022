"""A training does not depend on how many devices hold its robots: each count is a
process of its own."""

import os
import subprocess
import sys
from pathlib import Path

import aim
import numpy as np
import pytest


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Train `aim.py` on one device and on four, and return what it saves."""
    folder = tmp_path_factory.mktemp("devices")
    runs = []
    for devices in (1, 4):
        environment = {
            **os.environ,
            "PYTHONPATH": str(Path(__file__).parents[2]),
            "XLA_FLAGS": f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count={devices}",
        }
        runs.append(
            subprocess.Popen(
                [sys.executable, aim.__file__, str(folder / f"{devices}.npz")],
                env=environment,
            )
        )
    assert [run.wait(timeout=240) for run in runs] == [0, 0]
    results = {devices: dict(np.load(folder / f"{devices}.npz")) for devices in (1, 4)}
    assert [int(result["devices"]) for result in results.values()] == [1, 4]
    return results


def test_the_parameters_are_those_of_one_device(trained):
    """After 20 train steps of 4 gradient steps each."""
    # float32 sums in another order, 2e-7 here. A step of Adam is 3e-4: another gradient
    # would show at once. (Longer trainings do part: a sample that rounding puts on the
    # other side of PPO's clip edge changes the gradient.)
    np.testing.assert_allclose(
        trained[4]["params"], trained[1]["params"], rtol=0, atol=1e-5
    )


@pytest.mark.parametrize("devices", [1, 4])
def test_no_two_robots_are_alike(trained, devices):
    """Their keys, what they have drawn from them and the noise of their actions: one of
    each for each robot."""
    result = trained[devices]
    np.testing.assert_array_equal(result["env_keys"], trained[1]["env_keys"])
    np.testing.assert_array_equal(result["targets"], trained[1]["targets"])
    np.testing.assert_allclose(
        result["log_prob"], trained[1]["log_prob"], rtol=0, atol=1e-4
    )
    assert len(np.unique(result["env_keys"], axis=0)) == aim.TINY.num_envs
    assert len(np.unique(result["targets"][:, 0])) == aim.TINY.num_envs
    # The likelihood of an action is that of its noise: equal noise of two robots would
    # show in the fourth decimal.
    assert len(np.unique(np.round(result["log_prob"], 4))) == aim.TINY.num_envs


def test_advantages_are_normalised_over_the_whole_minibatch(trained):
    """Robots on the last device earn most: normalised on each device, they would teach
    nothing of it."""
    ours, whole, parts = (
        trained[4]["gradient"],
        trained[1]["gradient"],
        trained[1]["gradient_by_quarters"],
    )
    scale = np.abs(whole).max()
    # float32 sums in another order
    np.testing.assert_allclose(ours, whole, rtol=0, atol=1e-5 * scale)
    assert np.abs(parts - whole).max() > 0.1 * scale
