"""The shipped policy as a bundle, once for all tests, and the bundle's code as a
robot's computer runs it."""

import functools
import importlib
import sys
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from synthetic import make_card, still_policy

from bp2_rl.base.assets import asset_path
from bp2_rl.deploy.bundle import write_bundle
from bp2_rl.learning.policy import load_policy
from bp2_rl.settings.presets import preset
from bp2_rl.settings.terrain import Terrain
from bp2_rl.simulation.world import World

UPHILL = World(Terrain("waves", 0.05, slope=0.05))


@pytest.fixture(scope="session")
def shipped():
    return load_policy(asset_path("policies/built"))


@pytest.fixture(scope="session")
def bundle(shipped, tmp_path_factory):
    folder = tmp_path_factory.mktemp("deploy") / "bundle"
    write_bundle(folder, shipped)
    return folder


@pytest.fixture(scope="session")
def uphill(shipped, tmp_path_factory):
    """Return the world of waves that rise, and the bundle to be rehearsed there."""
    folder = tmp_path_factory.mktemp("deploy") / "uphill"
    write_bundle(folder, shipped, UPHILL)
    return UPHILL, folder


@pytest.fixture(scope="session")
def onboard(bundle):
    """Import the modules in the bundle, not bp2_rl's, whose every call is checked here
    and takes ten times as long."""
    sys.path.insert(0, str(bundle))
    names = [
        "computer",
        "controller",
        "motion",
        "link",
        "robot",
        "rehearse",
        "contents",
        "seal",
    ]
    yield SimpleNamespace(
        **{name: importlib.import_module(f"onboard.{name}") for name in names}
    )
    sys.path.remove(str(bundle))
    for name in [name for name in sys.modules if name.split(".")[0] == "onboard"]:
        del sys.modules[name]


@pytest.fixture(scope="session")
def another(tmp_path_factory):
    """Return a maker of a named robot's untrained policy, which follows the kinematic
    trot and uses all observations, and of its bundle."""

    @functools.cache
    def make(name):
        card = make_card(env=preset("imitation", "smoke", robot=name).env)
        drawn = partial(np.random.default_rng(0).normal, 0.0, 0.03)
        policy = still_policy(card, drawn, width=16)
        folder = tmp_path_factory.mktemp("deploy") / name
        write_bundle(folder, policy)
        return policy, folder

    return make


@pytest.fixture(scope="session")
def controller(onboard, bundle):
    return onboard.controller.OnboardController(bundle)


@pytest.fixture(scope="session")
def rehearse(onboard):
    """Rehearse without sockets and clocks, as fast as possible and each time alike;
    return (measurement, command, targets) of each tick.

    `heard` makes of a datagram's kind and numbers what is heard; `before` is called
    with each millisecond's time.
    """

    def run(world, controller, heard=lambda _, values: values, before=None):
        inbox, ticks = onboard.computer.Inbox(), []
        controller.reset()
        for k in range(world.milliseconds):
            now = k * onboard.robot.DT
            if before:
                before(now)
            for kind, values in world.says(k, now):
                inbox.take(kind, heard(kind, values), now)
            if k % onboard.robot.TICK == 0:
                targets = inbox.tick(controller, now)
                world.hears(targets, now)
                ticks.append((inbox.measurement, inbox.command, targets))
            world.millisecond(k, now)
        return ticks

    return run
