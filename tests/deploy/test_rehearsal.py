"""The robot that stands in for the real one, the link to it, and rehearsals over
both."""

import dataclasses
import json
import subprocess
import sys
import time

import mujoco
import numpy as np
import pytest
from plain_simulation import PlainRobot

from bp2_rl.deploy.onboard.link import SENSORS, Radio
from bp2_rl.robot.actuator import bus_power
from bp2_rl.robot.hardware import BUILT, IDEAL
from bp2_rl.robot.model import MOTOR_QPOS, MOTOR_QVEL, load_model
from bp2_rl.simulation.simulator import RobotSetup, settled

STAND = np.array([0.0, 0.62, -1.24] * 4)
BODIES = "body_mass", "body_inertia", "dof_armature"


@pytest.mark.parametrize(("name", "hardware"), [("built", BUILT), ("ideal", IDEAL)])
def test_the_robot_of_a_bundle_moves_as_the_benchmarks_does(
    bundle, onboard, shipped, name, hardware
):
    """Under kicks whose torques reach the envelope and the bus's power, from the same
    stand."""
    robot = onboard.robot.SimulatedRobot(bundle, name)
    rng, hardest = np.random.default_rng(0), 0.0
    start_only = dataclasses.replace(hardware, envelope="start")
    plain = PlainRobot(
        RobotSetup(dataclasses.replace(shipped.card.env, hardware=start_only))
    )
    plain.data[0].qpos[:], plain.data[0].ctrl[:] = robot.data.qpos, robot.data.ctrl
    for data in (robot.data, plain.data[0]):
        data.qvel[:] = np.random.default_rng(1).normal(0.0, 3.0, 22)
        data.qvel[MOTOR_QVEL] *= 4.0
    powers = []
    for kick in range(18):
        position, velocity = (
            STAND + rng.uniform(-0.6, 0.6, 12),
            rng.uniform(-3.0, 3.0, 12),
        )
        # drive with some 90 Nm, then brake with 54 Nm, so that power flows out and back
        if kick % 3 < 2:
            qd = robot.data.qvel[MOTOR_QVEL]
            position, velocity = (
                robot.data.qpos[MOTOR_QPOS].copy(),
                qd + (30.0, -18.0)[kick % 3] * np.sign(qd),
            )
        for _ in range(5):
            qd = robot.data.qvel[MOTOR_QVEL].copy()
            torque = plain.millisecond(position, velocity)
            robot.millisecond(onboard.controller.DriveTargets(position, velocity))
            assert robot.data.ctrl == pytest.approx(torque, abs=1e-8)
            hardest = max(hardest, float(np.max(np.abs(torque))))
            powers.append(float(bus_power(plain.motors[0], torque, qd)))
    assert hardest > 100.0
    assert robot.data.qpos == pytest.approx(plain.data[0].qpos, abs=1e-10)
    if hardware is BUILT:  # both limits of its bus were reached
        assert max(powers) == pytest.approx(BUILT.losses.bus_power_out, rel=1e-6)
        assert min(powers) == pytest.approx(-BUILT.losses.bus_power_in, rel=1e-6)


@pytest.mark.parametrize("name", ["go1", "mini_cheetah"])
def test_another_robot_of_a_bundle_moves_as_the_benchmarks_does(onboard, another, name):
    policy, folder = another(name)
    robot, rng = onboard.robot.SimulatedRobot(folder, "own"), np.random.default_rng(0)
    env = policy.card.env
    start_only = dataclasses.replace(
        env, hardware=dataclasses.replace(env.hardware, envelope="start")
    )
    simulator = settled([RobotSetup(start_only)])
    assert robot.data.qpos == pytest.approx(simulator.data[0].qpos, abs=1e-12)
    ours, judges = robot.model, simulator.models[0]
    for what in (*BODIES, "body_pos", "body_iquat", "jnt_range", "dof_damping"):
        found, expected = getattr(ours, what), getattr(judges, what)
        # XML: six digits
        assert found == pytest.approx(expected, rel=2e-5, abs=1e-6), what
    # so that the laws alone are compared
    robot.model, robot.data = judges, mujoco.MjData(judges)
    robot.data.qpos[:], robot.data.ctrl[:] = (
        simulator.data[0].qpos,
        simulator.data[0].ctrl,
    )
    stand, hardest = np.array(env.hardware.anatomy.stand), np.zeros(12)
    for _ in range(40):
        position, velocity = (
            stand + rng.uniform(-1.0, 1.0, 12),
            rng.uniform(-3.0, 3.0, 12),
        )
        for _ in range(5):
            torque = simulator.millisecond(position[None], velocity[None])[0]
            robot.millisecond(onboard.controller.DriveTargets(position, velocity))
            assert robot.data.ctrl == pytest.approx(torque, abs=1e-8)
            hardest = np.maximum(hardest, np.abs(torque))
    # the envelope was reached
    assert (
        np.sum(hardest > 0.99 * np.broadcast_to(env.hardware.joint_peak_torque, 12))
        >= 3
    )
    assert robot.data.qpos == pytest.approx(simulator.data[0].qpos, abs=1e-9)


@pytest.mark.parametrize(("name", "hardware"), [("built", BUILT), ("ideal", IDEAL)])
def test_the_robot_of_a_bundle_is_the_judges_and_stands_still_at_first(
    bundle, onboard, name, hardware
):
    robot, judges = onboard.robot.SimulatedRobot(bundle, name), load_model(hardware)
    for what in (*BODIES, "jnt_stiffness", "geom_friction", "geom_solref"):
        found, expected = getattr(robot.model, what), getattr(judges, what)
        assert found == pytest.approx(expected, rel=1e-5), what
    assert robot._q.tolist() == list(MOTOR_QPOS)
    for _ in range(200):
        robot.millisecond(onboard.controller.DriveTargets(STAND, np.zeros(12)))
    assert np.max(np.abs(robot.data.qvel)) < 0.01
    assert not robot.fallen


def test_a_bad_link_loses_its_share_and_keeps_the_order(onboard):
    link = onboard.link.BadLink(0.05, 0.005, seed=3)
    for k in range(4000):
        link.put(k, 0.005 * k)
    assert link.take(0.0049) == []
    assert link.take(0.0051) in ([0], [])
    rest = link.take(1e3)
    assert rest == sorted(rest)
    assert 4000 - link.lost == pytest.approx(len(rest), abs=1)
    # four standard deviations
    assert link.lost / 4000 == pytest.approx(0.05, abs=0.014)


def test_a_radio_hears_its_peer_alone_and_whole_datagrams(onboard):
    link = onboard.link
    robot, computer, stranger = link.Radio(), link.Radio(), link.Radio()
    try:
        robot.connect(computer.port)
        computer.connect(robot.port)
        stranger.connect(computer.port)
        stranger.send(link.SENSORS, np.ones(30))
        robot.send(link.SENSORS, np.arange(30.0))
        robot.send(link.COMMAND, (1.0, 2.0, 3.0))
        packets = computer.receive(2.0)
        while len(packets) < 2:
            packets += computer.receive(2.0)
        assert [kind for kind, _ in packets] == [link.SENSORS, link.COMMAND]
        assert packets[0][1].tolist() == list(range(30))
        robot._socket.send(b"S\x01")  # torn
        stranger.send(link.COMMAND, (9.0, 9.0, 9.0))
        assert computer.receive(0.2) == []
    finally:
        for radio in (robot, computer, stranger):
            radio.close()


def test_it_runs_on_the_ground_of_its_bundle_with_lost_and_late_datagrams(
    onboard, uphill, shipped, rehearse
):
    """On the judge's field of heights, under its gravity, and falls over the ground."""
    world, folder = uphill
    controller = onboard.controller.OnboardController(folder)
    launch = 10.74**2 / (2.0 * 2.4)  # m, then it holds the speed to 5 m from the end
    room = world.end - 5.0 - launch
    assert controller.settings["rehearsal"]["hold"] == pytest.approx(room / 10.74)
    plan = onboard.robot.RehearsalPlan(speed=3.0, acceleration=3.0, hold=2.0)
    rehearsal = onboard.robot.RehearsalWorld(folder, "built", plan)
    robot, judges = rehearsal.robot, load_model(BUILT, scene=world.lay)
    for what in ("hfield_data", "hfield_size", "geom_conaffinity"):
        found, expected = getattr(robot.model, what), getattr(judges, what)
        assert found == pytest.approx(expected, abs=2e-6), what
    env = dataclasses.replace(shipped.card.env, hardware=BUILT)
    stand = settled([RobotSetup(env, world)]).qpos[0]
    assert robot.data.qpos == pytest.approx(stand, abs=1e-12)
    # gravity tilts by 0.05 rad, the trunk in its stand hardly
    assert robot.sensors()[24:27] == pytest.approx((0.05, 0.0, 1.0), abs=0.02)
    rehearse(rehearsal, controller)
    outcome = rehearsal.outcome()
    assert (controller.fault, outcome["fell_at"]) == ("", None)
    assert outcome["mean_speed"] == pytest.approx(3.0, abs=0.5)
    assert outcome["lost"] / outcome["sent"] == pytest.approx(0.05, abs=0.03)
    robot.data.qpos[:3] = 9.8, 0.8, 0.34  # on a crest of 50 mm
    assert robot.fallen


@pytest.mark.parametrize(
    ("robot", "fault", "speed", "height"),
    [
        # m: on its feet, swaying on its springs
        *(("built", fault, 0.02, 0.55) for fault in ("nan", "silence")),
        # from a run no stand can be had, but it is commanded all the same
        *(("built", fault, 3.0, None) for fault in ("nan", "silence")),
        ("go1", "silence", 0.02, 0.27),
        ("mini_cheetah", "silence", 0.02, 0.3),
    ],
)
def test_a_robot_whose_sensors_fail_ends_in_a_commanded_stand(
    onboard, bundle, another, rehearse, robot, fault, speed, height
):
    folder, name = bundle, robot
    if robot != "built":
        (_, folder), name = another(robot), "own"
    plan = onboard.robot.RehearsalPlan(
        speed, acceleration=3.0, fault=fault, fault_at=1.1, after=0.9
    )
    world = onboard.robot.RehearsalWorld(folder, name, plan)
    controller = onboard.controller.OnboardController(folder)
    rehearse(world, controller)
    assert controller.fault.startswith(
        "not finite: joint_position" if fault == "nan" else "silence: "
    )
    # the policy was at work: a commanded stand is still
    assert np.ptp(world.targets[900:1100], axis=0).max() > 1e-3
    stand = controller.settings["control"]["stand"]
    assert np.abs(world.targets[-500:] - stand).max() < 1e-9
    if height:
        assert world.fell_at is None
        assert world.robot.data.qpos[2] == pytest.approx(height, abs=0.03)


def test_in_real_time_it_talks_over_udp(onboard, bundle):
    """A second of it: whether the machine has time for it decides how it runs, but not
    that datagrams get through."""
    plan = onboard.robot.RehearsalPlan(speed=0.2, acceleration=2.0, hold=1.0)
    result = onboard.rehearse.in_real_time(bundle, "ideal", plan, None)
    assert result["ticks"] > 50
    assert result["lost"] > 0
    assert result["sent"] > 300
    in_time = min(result["real_time"], 1.0 - result["most_late"] / 200)
    assert result["too_busy"] == (in_time < 0.95 or result["waited_ms"] > 30)


SLOW = """#!{python}
import sys, time
sys.path.insert(0, "{bundle}")
from onboard import computer
step = computer.OnboardController.step
def slow(self, measurement, *rest):
    time.sleep(0.012)
    self.watchdog.used[f"heard {{measurement and measurement.time}}"] = 0.0
    return step(self, measurement, *rest)
computer.OnboardController.step = slow
computer.main("{bundle}")
"""


def test_a_tick_that_takes_too_long_is_late_and_the_next_hears_what_came_meanwhile(
    onboard, bundle, tmp_path
):
    slow = tmp_path / "slow"
    slow.write_text(SLOW.format(python=sys.executable, bundle=bundle))
    slow.chmod(0o755)
    plan = onboard.robot.RehearsalPlan(speed=0.0, hold=0.5)
    result = onboard.rehearse.in_real_time(bundle, "ideal", plan, None, slow)
    heard = sum(name.startswith("heard ") for name in result["used"])
    assert heard > 0.8 * result["ticks"] > 5
    assert result["due"] == 100
    assert result["late"] >= 50  # 12 ms are more than two ticks
    assert result["most_late"] == result["late"]  # in half a second
    assert result["waited_ms"] >= 11
    assert result["too_busy"]


@pytest.mark.parametrize("too_busy", [True, False])
def test_a_machine_that_is_too_busy_is_told_before_any_sensor(onboard, too_busy):
    result = {
        **{
            "real_time": 0.69,
            "late": 300,
            "most_late": 110,
            "due": 700,
            "waited_ms": 41,
            "lost": 3.0,
            "sent": 60.0,
            "ticks": 700,
            "fell_at": 2.1,
        },
        **{
            "wall_ms": (1.0, 2.0, 3.0),
            "cpu_ms": (1.0, 2.0, 3.0),
            "distance": 1.0,
            "beside_line": 0.1,
        },
        **{
            "mean_speed": None,
            "least_second": None,
            "final_speed": 0.0,
            "used": {},
            "too_busy": too_busy,
        },
        "fault": "opposed: RL_knee moves against its targets; is its sign wrong, or are two joints exchanged?",
    }
    shown = onboard.rehearse.show(result, onboard.robot.RehearsalPlan(3.0))
    assert (
        shown.startswith(
            "TOO BUSY    is this machine, 300 of 700 ticks late, 110 of them in a second: "
        )
        == too_busy
    )
    assert ("sign" in shown) != too_busy
    assert "watchdog    opposed" in shown


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--robot", "spot"], "there is no robot 'spot': choose one of built, ideal"),
        (["nowhere"], "no bundle in nowhere: it has no deploy.json"),
    ],
)
def test_a_mistake_is_one_line(onboard, bundle, capsys, arguments, words):
    assert (
        onboard.rehearse.main(
            [str(bundle), *arguments] if arguments[0] == "--robot" else arguments
        )
        == 2
    )
    assert capsys.readouterr().err == f"error: {words.format(bundle=bundle)}\n"


def test_a_signal_ends_a_controller_whose_robot_still_speaks(bundle):
    command = [sys.executable, "-m", "onboard.computer", "."]
    radio, told = Radio(), 0.0
    with subprocess.Popen(
        command, cwd=bundle, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout
        radio.connect(int(process.stdout.readline()))
        begun = time.monotonic()
        while process.poll() is None:
            radio.send(SENSORS, np.zeros(30))
            time.sleep(0.005)
            if not told and time.monotonic() > begun + 1.0:
                process.terminate()
                told = time.monotonic()
            if told and time.monotonic() > told + 10.0:
                process.kill()
        radio.close()
        assert process.returncode == 0
        assert json.loads(process.stdout.read())["ticks"] > 10
