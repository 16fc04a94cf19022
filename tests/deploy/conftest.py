"""The shipped policy as a bundle, once for all tests, and the code in it as a robot's computer has it."""

import importlib
import sys
from types import SimpleNamespace

import pytest

from bp2_rl.base.assets import asset_path
from bp2_rl.deploy.bundle import write_bundle
from bp2_rl.learning.policy import load_policy


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
    """The modules in the bundle: not those of bp2_rl, whose every call is checked here and takes ten times as long."""
    sys.path.insert(0, str(bundle))
    names = ("controller", "motion", "link", "robot", "world", "rehearse")
    yield SimpleNamespace(**{name: importlib.import_module(f"onboard.{name}") for name in names})
    sys.path.remove(str(bundle))
    for name in [name for name in sys.modules if name.split(".")[0] == "onboard"]:
        del sys.modules[name]
