"""Runs whose figures of merit are known in closed form, and the card of a policy that
stands."""

import io
import json

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.env.observations import LAYOUT
from bp2_rl.evaluation.report import terminal
from bp2_rl.learning.policy import Policy, PolicyCard
from bp2_rl.robot.conventions import GRAVITY
from bp2_rl.robot.hardware import IDEAL
from bp2_rl.settings.env import ControlConfig, EnvConfig
from bp2_rl.simulation.trajectory import Trajectory

DT = 1e-3
MASS = 36.0


def make_run(
    duration=8.0, speed=5.0, acceleration=2.5, frequency=4.0, duty=0.25, **changes
) -> Trajectory:
    """Return a synthetic trot along x: ramp to `speed`, stride frequency and duty as
    given, no power, forces that carry the weight."""
    samples = round(duration / DT)
    time = np.arange(samples) * DT
    forward = np.minimum(acceleration * time, speed)
    qpos, qvel = np.zeros((samples, 23)), np.zeros((samples, 22))
    qpos[:, 0] = np.cumsum(forward) * DT - forward * DT
    qpos[:, 2], qpos[:, 3] = 0.55, 1.0
    qvel[:, 0] = forward
    phase = (frequency * time[:, None] + np.array([0.5, 0.0, 0.0, 0.5])) % 1.0
    force = np.zeros((samples, 4, 3))
    # two feet at a time carry the weight on average: a half sine of duty x mean = 1/4
    force[:, :, 2] = np.where(
        phase < duty,
        np.sin(np.pi * phase / duty) * MASS * GRAVITY * np.pi / (8 * duty),
        0.0,
    )
    fields = {
        "time": time,
        "qpos": qpos,
        "qvel": qvel,
        "torque": np.zeros((samples, 12)),
        "target": np.zeros((samples, 12)),
        "command": np.stack([forward, 0 * time, 0 * time], axis=-1),
        "foot_force": force,
        "dt": DT,
        "steady_from": speed / acceleration,
        "fell_at": None,
        "mass": MASS,
        "hardware": IDEAL,
        "name": "synthetic trot",
        "backend": "none",
    }
    return Trajectory(**(fields | changes))


def make_card(**changes) -> PolicyCard:
    """Return the card of a tiny policy that acts around the standing pose."""
    fields = {
        "stage": "imitation",
        "observation_layout": LAYOUT,
        "action_size": 12,
        "activation": "swish",
        "hidden_layer_sizes": (4,),
        "env": EnvConfig(control=ControlConfig(mode="absolute")),
        "reference": "none",
        "physics_steps": 123_000_000,
        "seed": 3,
        "versions": {"bp2_rl": "0.1.0"},
        "config_hash": "0" * 12,
        "results": {},
        "created": "2026-11-20T12:00:00+00:00",
    }
    return PolicyCard(**(fields | changes))


def still_policy(card: PolicyCard, draw=np.zeros, width: int = 4) -> Policy:
    """Return a policy of one hidden layer whose weights are `draw(shape)`, by default
    zeros: it never acts."""
    size = card.observation_size
    layers = tuple(
        (np.asarray(draw(shape), np.float32), np.zeros(shape[1], np.float32))
        for shape in ((size, width), (width, 12))
    )
    return Policy(card, np.zeros(size, np.float32), np.ones(size, np.float32), layers)


@pytest.fixture(name="make_card")
def _make_card():
    return make_card


@pytest.fixture
def make_policy():
    """Return a maker of policies with a card alone, which is all that a benchmark
    itself reads."""

    def make(**changes) -> Policy:
        none = np.zeros(0, np.float32)
        return Policy(card=make_card(**changes), mean=none, std=none, layers=())

    return make


@pytest.fixture
def assert_fits():
    """Require that an evaluation's table fits a terminal of 80 columns and has the rows
    that are shown large, and that its metrics survive strict JSON."""

    def assert_fits(evaluation):
        metrics = evaluation.metrics
        written = json.loads(json.dumps(to_json(metrics), allow_nan=False))
        assert from_json(type(metrics), written) == metrics
        assert set(evaluation.tiles) <= {row.label for row in evaluation.rows}
        printed = io.StringIO()
        terminal.print_table(evaluation, Console(file=printed, width=80))
        lines = printed.getvalue().splitlines()
        # title and verdict: nothing is wrapped
        assert len(lines) == len(evaluation.rows) + 2
        assert not any("…" in line for line in lines)

    return assert_fits


@pytest.fixture
def assert_drawn():
    """Require that a figure can be drawn, and is as wide as a page."""

    def assert_drawn(figure):
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png")
        assert Image.open(buffer).width >= 1200

    return assert_drawn


@pytest.fixture
def simulated(monkeypatch):
    """Return a function that replaces a benchmark's `simulate_all` by one with known
    runs."""

    def simulated(module, run):
        monkeypatch.setattr(
            module,
            "simulate_all",
            lambda measure, _, tries: [measure(one, run(one)) for one in tries],
        )

    return simulated


@pytest.fixture(name="make_run")
def _make_run():
    return make_run


@pytest.fixture(scope="session")
def busy_run() -> Trajectory:
    """Return a synthetic run in which every figure has something to show."""
    run = make_run()
    rng = np.random.default_rng(0)
    angle = 2 * np.pi * 4.0 * run.time[:, None] + np.array(
        [0, np.pi / 2, np.pi / 3] * 4
    )
    amplitude = np.array([0.05, 0.6, 0.7] * 4)
    qpos, qvel = run.qpos.copy(), run.qvel.copy()
    qvel[:, 0] += 0.2 * np.sin(2 * np.pi * 8.0 * run.time)
    qpos[:, 1] = 0.1 * np.sin(run.time)
    motors = [7, 8, 9, 11, 12, 13, 15, 16, 17, 19, 20, 21]
    qpos[:, motors] = np.array([0, 0.67, -1.34] * 4) + amplitude * np.sin(angle)
    qvel[:, [i - 1 for i in motors]] = amplitude * 2 * np.pi * 4.0 * np.cos(angle)
    qpos[:, [10, 14, 18, 22]] = run.foot_force[:, :, 2] / 6000.0
    torque = 60.0 * np.sin(angle + 1.0) * np.array([0.3, 1.0, 1.2] * 4) + rng.normal(
        size=angle.shape
    )
    return make_run(qpos=qpos, qvel=qvel, torque=torque, target=qpos[:, motors] + 0.05)
