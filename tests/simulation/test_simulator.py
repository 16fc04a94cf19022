"""The simulator of many robots against a plain loop of one, whatever each robot is."""

import dataclasses

import numpy as np
import pytest
from plain_simulation import PlainRobot, plain_run

from bp2_rl.base.errors import UserError
from bp2_rl.robot.bp2 import STAND_JOINTS
from bp2_rl.robot.hardware import BUILT, IDEAL
from bp2_rl.robot.model import MOTOR_QVEL
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.settings.env import EnvConfig, RandomizationConfig
from bp2_rl.settings.terrain import Terrain
from bp2_rl.simulation.rollout import SIDE_BY_SIDE, RunRequest, simulate
from bp2_rl.simulation.schedule import Course, Ramp
from bp2_rl.simulation.simulator import CONVERGED, Numerics, RobotSetup, Simulator
from bp2_rl.simulation.world import Draw, Push, World

CONFIG = EnvConfig(reference="kinematic")
RAMP = Ramp(1.5, acceleration=10.0, hold=0.1)
BY_JOINT = dataclasses.replace(
    BUILT.losses, joint_friction=(1.0, 2.0, 4.0), joint_viscosity=(0.0, 0.05, 0.3)
)
SLIPPERY = dataclasses.replace(BUILT, friction=0.3, losses=BY_JOINT)
LATE = dataclasses.replace(
    BUILT, losses=dataclasses.replace(BUILT.losses, latency=0.012)
)


def tire(simulator, robot, _):
    """Weaken a robot's motors to half of the peak torque after 50 ms, each joint's own,
    and end its run after 200."""
    time = simulator.data[robot].time
    if time > 0.0495:
        weak = dataclasses.replace(
            simulator.motors[robot], peak_torque=np.linspace(40.0, 50.0, 12)
        )
        simulator.set_motors(robot, weak)
    return time > 0.1995


REQUESTS = (
    RunRequest(RAMP, BUILT, name="built"),
    RunRequest(Ramp(2.0, acceleration=10.0, hold=0.2), IDEAL, name="ideal"),
    RunRequest(
        RAMP,
        SLIPPERY,
        HeadingHold(heading_gain=9.0, limit=2.0),
        gyro_bias=0.5,
        name="slippery, steered astray",
    ),
    RunRequest(RAMP, LATE, name="late"),
    RunRequest(RAMP, BUILT, world=World(Terrain(slope=0.05)), name="uphill"),
    RunRequest(
        RAMP,
        BUILT,
        world=World(
            terrain=Terrain("rough", 0.01, seed=1), pushes=(Push(0.05, 0.5, 0.3),)
        ),
        name="rough, pushed",
    ),
    RunRequest(
        RAMP,
        BUILT,
        world=World(pushes=(Push(0.01, 2.0, 0.0),)),
        finish=0.05,
        name="there",
    ),
    RunRequest(
        RAMP, BUILT, numerics=Numerics(steps=4, motors_each_step=True), name="fine"
    ),
    RunRequest(RAMP, IDEAL, numerics=Numerics(steps=2), name="ideal, finer"),
    RunRequest(RAMP, BUILT, watch=tire, name="tired"),
    RunRequest(
        Course().hold(0.3),
        BUILT,
        world=World(pushes=(Push(0.01, 6.0, 0.0),)),
        name="down",
    ),
)


def answering(observation):
    """Act on what is observed, so that a wrong pose, operator or gyro shows."""
    return 0.3 * observation[..., 5:17] - 0.2 * observation[..., :12]


@pytest.fixture(scope="module")
def together():
    return list(simulate(answering, REQUESTS, CONFIG))


@pytest.mark.parametrize("i", range(len(REQUESTS)), ids=[one.name for one in REQUESTS])
def test_each_runs_as_it_would_alone(together, i):
    one, run = REQUESTS[i], together[i]
    alone, fell = plain_run(answering, CONFIG, one)
    assert (len(run), run.fell_at is not None, run.name) == (
        len(alone["qpos"]),
        fell,
        one.name,
    )
    assert run.hardware == one.hardware
    assert run.mass == pytest.approx(float(np.sum(one.robot(CONFIG).model().body_mass)))
    # A batch rounds otherwise than one robot, in the controller's float32: 1e-7 rad at
    # each control step.
    np.testing.assert_allclose(run.qpos, alone["qpos"], atol=5e-5)
    np.testing.assert_allclose(run.command, alone["command"], atol=1e-5)
    np.testing.assert_allclose(run.target, alone["target"], atol=5e-5)
    assert np.quantile(np.abs(run.torque - alone["torque"]), 0.99) < 0.05  # Nm
    assert np.quantile(np.abs(run.foot_force - alone["foot_force"]), 0.99) < 2.0  # N


@pytest.mark.parametrize(
    ("robots", "numerics"),
    [(1, CONVERGED), (3, CONVERGED), (1, Numerics(steps=4, motors_each_step=True))],
)
def test_laws_and_steps_are_those_of_the_plain_robot(robots, numerics):
    """The robot with all its losses, whose torque is tried several times a millisecond,
    through 0.1 s of kicks."""
    rng, fastest = np.random.default_rng(0), 0.0
    robot = RobotSetup(EnvConfig(hardware=BUILT), numerics=numerics)
    plain, simulator = PlainRobot(robot), Simulator([robot] * robots)
    for _ in range(20):
        target = np.array(STAND_JOINTS) + rng.uniform(-0.6, 0.6, 12)
        for _ in range(5):
            expected = plain.millisecond(target, np.zeros(12), numerics)
            found = simulator.millisecond(
                np.tile(target, (robots, 1)), np.zeros((robots, 12))
            )
            # A processor may multiply and add in one: that rounds by 1e-16, and a push
            # into the ground is 1e4 as stiff.
            np.testing.assert_allclose(found, np.tile(expected, (robots, 1)), atol=1e-7)
            fastest = max(fastest, np.max(np.abs(simulator.qvel[0, MOTOR_QVEL])))
    assert fastest > simulator.motors[0].corner_speed  # on the envelope's falling line
    np.testing.assert_allclose(
        simulator.qpos, np.tile(plain.data[0].qpos, (robots, 1)), atol=1e-9
    )


def test_drawn_robots_run_side_by_side_as_each_does_alone():
    """Together they are one model with each robot's numbers, alone a model each."""
    requests = [
        RunRequest(RAMP, BUILT, drawn=Draw(RandomizationConfig(), 0, i))
        for i in range(2)
    ]
    together = list(simulate(answering, requests, CONFIG))
    assert together[0].mass != together[1].mass
    for one, run in zip(requests, together, strict=True):
        [alone] = simulate(answering, [one], CONFIG)
        np.testing.assert_allclose(run.qpos, alone.qpos, atol=1e-9)


def test_robots_that_do_not_move_stay_as_they_are():
    simulator = Simulator([RobotSetup(EnvConfig(hardware=BUILT))] * 2)
    before, target = (
        simulator.qpos.copy(),
        np.tile(np.array(STAND_JOINTS) + 0.5, (2, 1)),
    )
    torque = simulator.millisecond(target, np.zeros((2, 12)), np.array([1]))
    np.testing.assert_array_equal(simulator.qpos[0], before[0])
    assert simulator.data[0].time == 0.0
    assert np.max(np.abs(simulator.qpos[1] - before[1])) > 0.0
    assert np.max(np.abs(torque[1])) > 40.0
    simulator.set_motors(1, dataclasses.replace(simulator.motors[1], peak_torque=5.0))
    torque = simulator.millisecond(target, np.zeros((2, 12)))
    assert np.max(np.abs(torque[1])) <= 5.0 + 1e-9
    assert np.max(np.abs(torque[0])) > 40.0


def test_they_do_end_in_different_ways(together):
    ran = dict(zip([one.name for one in REQUESTS], together, strict=True))
    assert ran["down"].fell_at is not None
    assert ran["there"].fell_at is None
    assert len(ran["there"]) < len(ran["built"]) < len(ran["ideal"])
    assert len(ran["tired"]) == 200
    for name in (
        "slippery, steered astray",
        "late",
        "uphill",
        "rough, pushed",
        "fine",
        "tired",
    ):
        k = min(len(ran[name]), len(ran["built"]))
        assert np.abs(ran[name].qpos[:k] - ran["built"].qpos[:k]).max() > 1e-3, name


def test_more_than_fit_beside_each_other_run_in_turn():
    requests = [
        RunRequest(Course().hold(0.005 * (2 + i % 5)), IDEAL, name=f"{i}")
        for i in range(SIDE_BY_SIDE + 3)
    ]
    runs = list(simulate(answering, requests, CONFIG))
    assert [run.name for run in runs] == [one.name for one in requests]
    assert [len(run) for run in runs] == [
        5 * (2 + i % 5) for i in range(SIDE_BY_SIDE + 3)
    ]
    np.testing.assert_allclose(
        runs[-1].qpos, runs[(SIDE_BY_SIDE + 2) % 5].qpos, atol=1e-9
    )
    assert list(simulate(answering, [], CONFIG)) == []


def test_a_function_alone_does_not_say_what_it_was_trained_in():
    with pytest.raises(
        UserError, match=r"runs only with a config: pass config=EnvConfig"
    ):
        simulate(answering, REQUESTS)


def test_a_state_decides_the_future():
    """Of one state there is one future, the solver's first guess included."""
    simulator = Simulator([RobotSetup(EnvConfig(hardware=BUILT))])
    stand, still = np.array([STAND_JOINTS]), np.zeros((1, 12))
    for _ in range(40):
        simulator.millisecond(stand + 0.1, still)
    kept, futures = simulator.state(0), []
    for _ in range(2):
        simulator.set_state(0, kept)
        np.testing.assert_array_equal(simulator.foot_force, 0.0)
        torques = [simulator.millisecond(stand - 0.1, still) for _ in range(20)]
        futures.append(np.append(torques, simulator.qpos))
    np.testing.assert_array_equal(*futures)
