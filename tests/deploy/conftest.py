"""The shipped policy as a bundle, once for all tests, and the code in it as a robot's
computer has it."""

import functools
import importlib
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from synthetic import make_card

from bp2_rl.base.assets import asset_path
from bp2_rl.deploy.bundle import write_bundle
from bp2_rl.learning.policy import Policy, load_policy
from bp2_rl.settings.presets import preset


@pytest.fixture(scope="session")
def shipped():
    return load_policy(asset_path("policies/built"))


@pytest.fixture(scope="session")
def bundle(shipped, tmp_path_factory):
    folder = tmp_path_factory.mktemp("deploy") / "bundle"
    write_bundle(folder, shipped)
    return folder


@pytest.fixture(scope="session")
def onboard(bundle):
    """The modules in the bundle: not those of bp2_rl, whose every call is checked here
    and takes ten times as long."""
    sys.path.insert(0, str(bundle))
    names = "controller", "motion", "link", "robot", "rehearse", "contents", "seal"
    yield SimpleNamespace(
        **{name: importlib.import_module(f"onboard.{name}") for name in names}
    )
    sys.path.remove(str(bundle))
    for name in [name for name in sys.modules if name.split(".")[0] == "onboard"]:
        del sys.modules[name]


@pytest.fixture(scope="session")
def another(tmp_path_factory):
    """A robot's policy that nobody trained, which follows the kinematic trot and heeds
    all that it sees; its bundle."""

    @functools.cache
    def make(name):
        card, draws = (
            make_card(env=preset("imitation", "smoke", robot=name).env),
            np.random.default_rng(0),
        )
        shapes = (card.observation_size, 16), (16, 12)
        layers = tuple(
            (
                draws.normal(0.0, 0.03, shape).astype(np.float32),
                np.zeros(shape[1], np.float32),
            )
            for shape in shapes
        )
        scale = np.ones(card.observation_size, np.float32)
        policy = Policy(card, 0.0 * scale, scale, layers)
        folder = tmp_path_factory.mktemp("deploy") / name
        write_bundle(folder, policy)
        return policy, folder

    return make
