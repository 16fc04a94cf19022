"""Robots side by side do what the judge's do one by one, whatever each of them is."""

import dataclasses

import numpy as np
import pytest

from bp2_rl.robot.specs import BUILT, IDEAL
from bp2_rl.settings.env import EnvConfig
from bp2_rl.simulation.machine import Numerics
from bp2_rl.simulation.operator import HeadingHold
from bp2_rl.simulation.rollout import rollout_mujoco
from bp2_rl.simulation.schedule import Course, Ramp
from bp2_rl.simulation.team import MOST, RunRequest, rollout_team
from bp2_rl.simulation.world import Push, World

CONFIG = EnvConfig(reference="kinematic")
RAMP = Ramp((1.5, 0.0, 0.0), acceleration=10.0, hold=0.1)
SLIPPERY = dataclasses.replace(BUILT, friction=0.3)
LATE = dataclasses.replace(BUILT, losses=dataclasses.replace(BUILT.losses, latency=0.012))


def tire(machine, torque):
    """Half of the peak torque after 50 ms, each joint's own, and enough after 200."""
    if machine.data.time > 0.0495:
        machine.motors = dataclasses.replace(machine.motors, peak_torque=np.linspace(40.0, 50.0, 12))
    return machine.data.time > 0.1995


TRIES = (
    RunRequest(RAMP, BUILT, name="built"),
    RunRequest(Ramp((2.0, 0.0, 0.0), acceleration=10.0, hold=0.2), IDEAL, name="ideal"),
    RunRequest(
        RAMP, SLIPPERY, HeadingHold(heading_gain=9.0, limit=2.0), gyro_bias=0.5, name="slippery, steered astray"
    ),
    RunRequest(RAMP, LATE, name="late"),
    RunRequest(RAMP, BUILT, world=World(slope=0.05), name="uphill"),
    RunRequest(RAMP, BUILT, world=World(roughness=0.02, seed=1, pushes=(Push(0.05, 0.5, 0.3),)), name="rough, pushed"),
    RunRequest(RAMP, BUILT, world=World(pushes=(Push(0.01, 2.0, 0.0),)), finish=0.05, name="there"),
    RunRequest(RAMP, BUILT, numerics=Numerics(steps=4, motors_each_step=True), name="fine"),
    RunRequest(RAMP, IDEAL, numerics=Numerics(steps=2), name="ideal, finer"),
    RunRequest(RAMP, BUILT, watch=tire, name="tired"),
    RunRequest(Course().hold(0.3), BUILT, world=World(pushes=(Push(0.01, 6.0, 0.0),)), name="down"),
)


def answering(observation):
    """Actions that depend on what is seen, so that a wrong pose, operator or gyro shows."""
    return 0.3 * observation[..., 5:17] - 0.2 * observation[..., :12]


@pytest.fixture(scope="module")
def together():
    return list(rollout_team(answering, CONFIG, TRIES))


@pytest.mark.parametrize("i", range(len(TRIES)), ids=[one.name for one in TRIES])
def test_each_runs_as_it_would_alone(together, i):
    one, run = TRIES[i], together[i]
    given = {
        field.name: getattr(one, field.name) for field in dataclasses.fields(RunRequest) if field.name != "schedule"
    }
    alone = rollout_mujoco(answering, one.schedule, CONFIG, **given)
    assert (len(run), run.fell_at, run.name, run.hardware) == (len(alone), alone.fell_at, one.name, one.hardware)
    # A batch rounds otherwise than one robot, in the controller's float32: 1e-7 rad at each control step.
    np.testing.assert_allclose(run.qpos, alone.qpos, atol=5e-5)
    np.testing.assert_allclose(run.command, alone.command, atol=1e-5)
    np.testing.assert_allclose(run.target, alone.target, atol=5e-5)
    assert np.quantile(np.abs(run.torque - alone.torque), 0.99) < 0.05  # Nm
    assert np.quantile(np.abs(run.foot_force - alone.foot_force), 0.99) < 2.0  # N
    assert run.mass == pytest.approx(alone.mass)


def test_they_do_end_in_different_ways(together):
    ran = dict(zip([one.name for one in TRIES], together, strict=True))
    assert ran["down"].fell_at is not None
    assert ran["there"].fell_at is None
    assert len(ran["there"]) < len(ran["built"]) < len(ran["ideal"])
    assert len(ran["tired"]) == 200
    for name in ("slippery, steered astray", "late", "uphill", "rough, pushed", "fine", "tired"):
        k = min(len(ran[name]), len(ran["built"]))
        assert np.abs(ran[name].qpos[:k] - ran["built"].qpos[:k]).max() > 1e-3, name


def test_more_than_fit_beside_each_other_run_in_turn():
    tries = [RunRequest(Course().hold(0.005 * (2 + i % 5)), IDEAL, name=f"{i}") for i in range(MOST + 3)]
    runs = list(rollout_team(answering, CONFIG, tries))
    assert [run.name for run in runs] == [one.name for one in tries]
    assert [len(run) for run in runs] == [5 * (2 + i % 5) for i in range(MOST + 3)]
    np.testing.assert_allclose(runs[-1].qpos, runs[1].qpos, atol=1e-9)
    assert list(rollout_team(answering, CONFIG, [])) == []
