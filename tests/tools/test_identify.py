"""Motor numbers are found again from logs that C MuJoCo made with motors of other
numbers."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.robot.actuator import Actuator, pd_torque, torque_limits
from bp2_rl.robot.clearance import clearance
from bp2_rl.robot.hardware import BUILT, Losses
from bp2_rl.robot.model import load_model
from bp2_rl.robot.named import find_robot_file, shipped_files
from bp2_rl.robot.robot_file import GainNumbers, load_robot
from bp2_rl.tools.identify.excite import DURATION, excitation, excitation_text
from bp2_rl.tools.identify.fit import (
    cut_windows,
    fit_motors,
    predicted_error,
    predictor,
    rig_of,
)
from bp2_rl.tools.identify.log import RobotLog, describe_log, read_log
from bp2_rl.tools.identify.outcome import HANGING, NAMES, identified_file, identify
from bp2_rl.tools.identify.swing import Motors

SECONDS = 9.0
QUANTUM, NOISE = 0.38e-3, 0.2e-3  # rad, of the encoders
PHYSICS = 5e-5  # s, fine beside the fit's 1 ms
ROBOT = find_robot_file("go1")
TRUTH = Motors(
    torque_scale=np.array([0.95, 0.85, 1.08]),
    no_load_speed=np.array([26.0, 33.0, 18.0]),
    friction=np.array([0.5, 0.4, 0.3]),
    viscosity=np.array([0.05, 0.03, 0.06]),
    armature=np.array([0.0045, 0.0055, 0.006]),
    corner_share=np.array([0.65, 0.58, 0.6]),
    delay=np.array([0.0026]),
    inertia=np.ones((4, 3)),
)


WITHIN = {
    "torque_scale": 0.02,
    "no_load_speed": 0.02,
    "armature": 0.02,
    "friction": 0.03,
    "corner_share": 0.03,
    "viscosity": 0.1,
    "delay": 0.04,
    "inertia": 0.02,
}
"""Share of a number by which a fit may miss it."""


def hung(spec: mujoco.MjSpec) -> None:
    """Fix the trunk in the air."""
    for key in list(spec.keys):
        spec.delete(key)
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            spec.delete(joint)
    spec.body("trunk").pos[2] = 5.0


def four(values: object) -> np.ndarray:
    """Return a number of each kind of joint for all twelve joints."""
    return np.tile(np.broadcast_to(np.asarray(values, dtype=float), 3), 4)


def hanging_log(
    path: Path, truth: Motors, seconds: float, inertias: np.ndarray | float = 1.0
):
    """Write a log of a hanging Go1 with these motors, whose bodies have these multiples
    of their mass and inertia."""
    hardware, gains = ROBOT.hardware, ROBOT.gains
    assert gains is not None
    _, targets = excitation(hardware, gains, seconds)
    bare = dataclasses.replace(hardware, losses=Losses())
    model = load_model(bare, timestep=PHYSICS, visual=False, feet_only=True, scene=hung)
    model.body_mass *= inertias
    model.body_inertia *= np.reshape(inertias, (-1, 1))
    model.dof_armature[:] = four(truth.armature)
    data = mujoco.MjData(model)
    data.qpos[:] = targets[0]
    drive = Actuator(
        stiffness=four(gains.stiffness),
        damping=four(gains.damping),
        peak_torque=four(hardware.peak_torque),
        corner_speed=four(truth.corner_share * truth.no_load_speed),
        no_load_speed=four(truth.no_load_speed),
    )
    scale, friction = four(truth.torque_scale), four(truth.friction)
    viscosity, gear_loss = four(truth.viscosity), 1.0 - hardware.losses.gear_efficiency
    steps = round(0.002 / PHYSICS)
    late = round(float(truth.delay[0]) / PHYSICS)
    angles = np.empty_like(targets)
    for row in range(len(targets)):
        angles[row] = data.qpos
        for step in range(steps):
            target = targets[max((row * steps + step - late) // steps, 0)]
            q, qd = data.qpos.copy(), data.qvel.copy()
            asked = pd_torque(drive, q, qd, target, np.zeros(12))
            torque = np.clip(asked, *torque_limits(drive, qd)) * scale
            most = friction + gear_loss * np.abs(torque)
            data.qfrc_applied[:] = torque - most * np.tanh(qd / 0.02) - viscosity * qd
            mujoco.mj_step(model, data)
    noise = np.random.default_rng(0).normal(scale=NOISE, size=angles.shape)
    measured = np.round((angles + noise) / QUANTUM) * QUANTUM
    names = [joint.name for joint in ROBOT.anatomy.joints]
    np.savez(
        path,
        time=0.002 * np.arange(len(targets)),
        q=measured,
        q_target=targets,
        joint_names=np.array(names),
    )


@pytest.fixture(scope="module")
def log_file(tmp_path_factory):
    """A log of a hanging Go1 whose motors are `TRUTH`."""
    path = tmp_path_factory.mktemp("log") / "hanging.npz"
    hanging_log(path, TRUTH, SECONDS)
    return path


@pytest.fixture(scope="module")
def found(log_file):
    gains = ROBOT.gains
    assert gains is not None
    return identify(read_log(log_file, ROBOT.anatomy), ROBOT, gains)


@pytest.mark.parametrize(("name", "within"), WITHIN.items())
def test_a_hanging_robots_motors_are_found_again(found, name, within):
    values = [one.value for one in found.numbers if one.name == name]
    np.testing.assert_allclose(values, np.ravel(getattr(TRUTH, name)), rtol=within)


def test_what_was_found_predicts_rows_that_it_has_not_seen(found):
    for error in found.errors:
        assert error.fitted < 0.003 < error.configured / 4 < error.constant / 40


def test_the_robot_file_has_what_was_found(found, tmp_path):
    source = shipped_files()["go1"]
    (tmp_path / "robot.toml").write_text(
        identified_file(found, ROBOT, source, tmp_path)
    )
    hardware = load_robot(tmp_path / "robot.toml").hardware
    np.testing.assert_allclose(hardware.no_load_speed, TRUTH.no_load_speed, rtol=0.02)
    np.testing.assert_allclose(hardware.rotor_inertia, TRUTH.armature, rtol=0.02)
    peak = np.multiply(ROBOT.hardware.peak_torque, TRUTH.torque_scale)
    np.testing.assert_allclose(hardware.peak_torque, peak, rtol=0.02)


def test_free_legs_move_as_in_mujoco(log_file):
    """With the truth in place of a fit, what is left is the noise of the starts."""
    gains = ROBOT.gains
    assert gains is not None
    windows = cut_windows(read_log(log_file, ROBOT.anatomy), 0.05, 0.05)
    error = predicted_error(
        predictor(rig_of(ROBOT.hardware, gains), 0.002), TRUTH, windows
    )
    assert np.sqrt(np.mean(error[-1] ** 2)) < 0.004


def test_a_sprung_robots_free_legs_are_predicted(log_file):
    """Springs at rest: from rest, without targets, legs fall alike with and without."""
    assert ROBOT.gains is not None
    windows = cut_windows(read_log(log_file, ROBOT.anatomy), 0.05, 0.5)
    error = predicted_error(
        predictor(rig_of(BUILT, ROBOT.gains), 0.002), TRUTH, windows
    )
    assert np.all(np.isfinite(error))


def test_legs_of_a_falling_robot_are_predicted_with_an_accelerometer():
    """In the air the trunk's origin falls and is pushed by the legs; C MuJoCo says how.

    The law's targets move, too: a rate's target is one farther on, by the gains' ratio.
    """
    stiffness, damping = 60.0, 2.0
    bare = dataclasses.replace(ROBOT.hardware, losses=Losses())
    model = load_model(bare, timestep=PHYSICS, visual=False, feet_only=True)
    model.dof_armature[6:] = four(TRUTH.armature)
    data = mujoco.MjData(model)
    data.qpos[2] = 50.0
    steps, rows = round(0.002 / PHYSICS), 400
    q, targets, rates, up, omega, force = (
        np.empty((rows, n)) for n in (12, 12, 12, 3, 3, 3)
    )
    for row in range(rows):
        phase = 20.0 * data.time + np.arange(12)
        targets[row] = np.array(ROBOT.anatomy.stand) + 0.2 * np.sin(phase)
        rates[row] = 4.0 * np.cos(phase)
        q[row], omega[row] = data.qpos[7:], data.qvel[3:6]
        trunk = data.body("trunk").xmat.reshape(3, 3).copy() if row else np.eye(3)
        up[row], before = trunk[2], data.qvel[:3].copy()
        for _ in range(steps):
            slow = stiffness * (targets[row] - data.qpos[7:])
            data.qfrc_applied[6:] = slow + damping * (rates[row] - data.qvel[6:])
            mujoco.mj_step(model, data)
        gained = (data.qvel[:3] - before) / 0.002
        force[row] = trunk.T @ (gained - model.opt.gravity)
    log = RobotLog(
        time=0.002 * np.arange(rows),
        q=q,
        q_target=targets + damping / stiffness * rates,
        qd_target=rates,
        qd=None,
        up=up,
        omega=omega,
        acceleration=force,
        airborne=np.ones((rows, 4), bool),
        hanging=False,
    )
    gains = GainNumbers(stiffness, damping)
    strong = dataclasses.replace(bare, peak_torque=1e3)
    free = TRUTH._replace(
        torque_scale=np.ones(3),
        no_load_speed=np.full(3, 1e4),
        friction=np.zeros(3),
        viscosity=np.zeros(3),
        delay=np.array([1e-9]),
    )
    run = predictor(rig_of(strong, gains), 0.002)
    weighed = dataclasses.replace(log, acceleration=9.81 * up)
    with_it, without = (
        np.sqrt(
            np.mean(predicted_error(run, free, cut_windows(x, 0.05, 0.01))[-1] ** 2)
        )
        for x in (log, weighed)
    )
    assert with_it < 0.0002 < 0.004 < without


def test_windows_keep_away_from_lost_rows(log_file):
    log = read_log(log_file, ROBOT.anatomy)
    kept = np.delete(np.arange(len(log.time)), [1000])
    arrays = {
        field.name: value[kept]
        for field in dataclasses.fields(log)
        if isinstance(value := getattr(log, field.name), np.ndarray)
    }
    windows = cut_windows(dataclasses.replace(log, **arrays), 0.05, 0.002)
    whole = cut_windows(log, 0.05, 0.002)
    # 25 rows of a window, 11 before its start and 7 after its end
    assert whole.kept.sum() - windows.kept.sum() == pytest.approx(4 * 44, abs=8)


def test_a_short_log_says_how_much_is_needed(log_file):
    assert ROBOT.gains is not None
    log = read_log(log_file, ROBOT.anatomy)
    chosen = log.time < 1.0
    windows = cut_windows(log, 0.2, 0.2, chosen=chosen)
    with pytest.raises(UserError, match="too few"):
        fit_motors(rig_of(ROBOT.hardware, ROBOT.gains), windows, HANGING)
    with pytest.raises(UserError, match="no leg is free"):
        cut_windows(log, 0.2, 0.2, chosen=log.time < 0.1)


def test_a_logs_flaws_are_measured(log_file, tmp_path):
    quality = describe_log(read_log(log_file, ROBOT.anatomy))
    assert quality.quantum == pytest.approx(QUANTUM, rel=1e-6)
    assert quality.lost == 0
    with np.load(log_file) as arrays:
        kept = np.delete(np.arange(len(arrays["time"])), [500, 501, 900])
        rate = np.gradient(arrays["q"], 0.002, axis=0)
        late = np.roll(rate, 2, axis=0) * 0.9
        columns = {name: arrays[name][kept] for name in ("time", "q", "q_target")}
        np.savez(
            tmp_path / "log.npz",
            qd=late[kept],
            joint_names=arrays["joint_names"],
            **columns,
        )
    quality = describe_log(read_log(tmp_path / "log.npz", ROBOT.anatomy))
    assert quality.lost == 3
    assert quality.rate_delay == pytest.approx(0.004, abs=5e-4)
    assert quality.rate_gain == pytest.approx(0.9, abs=0.02)


def test_a_csv_of_the_robots_own_joints_is_the_same_log(log_file, tmp_path):
    turned = dataclasses.replace(
        ROBOT.anatomy,
        joints=tuple(
            dataclasses.replace(joint, sign=-1, offset=0.5)
            for joint in ROBOT.anatomy.joints
        ),
    )
    log = read_log(log_file, ROBOT.anatomy)
    names = [joint.name for joint in turned.joints]
    head = ["time", *(f"{what}.{name}" for what in ("q", "q_target") for name in names)]
    rows = np.column_stack([log.time, 0.5 - log.q, 0.5 - log.q_target])
    path = tmp_path / "log.csv"
    np.savetxt(
        path,
        rows,
        delimiter=",",
        header=",".join(head),
        comments="\ufeff",
        encoding="utf-8",
    )
    again = read_log(path, turned)
    np.testing.assert_allclose(again.q, log.q, atol=1e-12)
    np.testing.assert_allclose(again.q_target, log.q_target, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda log: log.pop("time"), "no array `time`"),
        (lambda log: log.update(q=57.3 * log["q"]), "radians"),
        (lambda log: log.update(time=log["time"][::-1]), "time does not rise"),
        (lambda log: log.update(time=1e3 * log["time"]), "s apart"),
        (lambda log: log["q"].__setitem__((3, 4), np.nan), "not a number"),
        (lambda log: log.pop("q_target"), "no column q_target"),
        (lambda log: log.update(joint_names=np.array(["x"] * 12)), "no column"),
        (lambda log: log.update(contact=np.zeros((len(log["time"]), 4))), "give `up`"),
        (lambda log: log.update(contact=np.zeros((4, len(log["time"])))), "the shape"),
        (
            lambda log: log.update(
                up=np.tile((0.0, 0.0, -9.81), (len(log["time"]), 1))
            ),
            "length 1",
        ),
        (
            lambda log: log.update(
                {name: x[:50] for name, x in log.items() if name != "joint_names"}
            ),
            "at least",
        ),
    ],
)
def test_a_log_that_cannot_be_is_refused_in_one_line(
    log_file, tmp_path, change, message
):
    with np.load(log_file) as arrays:
        log = {name: arrays[name] for name in arrays.files}
    change(log)
    np.savez(tmp_path / "log.npz", **log)
    with pytest.raises(UserError, match=message):
        read_log(tmp_path / "log.npz", ROBOT.anatomy)


@pytest.mark.parametrize(
    "content",
    [b"", b"PK\x03\x04broken", b"time,q\n1,x\n"],
    ids=["empty", "broken", "csv"],
)
@pytest.mark.parametrize("suffix", [".npz", ".csv", ".txt"])
def test_a_damaged_log_is_refused_in_one_line(tmp_path, content, suffix):
    path = tmp_path / f"log{suffix}"
    path.write_bytes(content)
    with pytest.raises(UserError) as error:
        read_log(path, ROBOT.anatomy)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", shipped_files())
def test_targets_begin_at_the_stand_keep_off_the_stops_and_keep_legs_apart(name):
    robot = find_robot_file(name)
    assert robot.gains is not None
    anatomy = robot.hardware.anatomy
    _, targets = excitation(robot.hardware, robot.gains)
    low, high = np.array([leg.ranges for leg in anatomy.legs]).reshape(12, 2).T
    assert np.all((targets > low) & (targets < high))
    np.testing.assert_allclose(targets[[0, -1]], [anatomy.stand] * 2, atol=0.01)
    assert np.max(np.abs(targets[1] - targets[0])) < 0.02
    poses = targets[::20].reshape(-1, 4, 3)
    apart = clearance(poses, np.zeros(poses.shape[:2]), robot.hardware)
    assert np.min(apart.legs) > 0.0
    text = excitation_text(robot.hardware, robot.gains)
    assert text.startswith(f"time,q_target.{anatomy.joints[0].name},")


@pytest.mark.skipif("BP2_RECORDING" not in os.environ, reason="needs the recording")
def test_the_recording_of_a_real_robot_is_predicted(tmp_path):
    """Limits in mrad, of abad, hip and knee after 50 ms, from a centred filter and from
    past rows alone."""
    script = Path(__file__).parents[2] / "docs/real_recording.py"
    words = [script, os.environ["BP2_RECORDING"], tmp_path / "log.npz"]
    subprocess.run([sys.executable, *words], check=True)
    robot = find_robot_file("black_panther")
    assert robot.gains is not None
    log = read_log(tmp_path / "log.npz", robot.anatomy)
    errors = identify(log, robot, robot.gains).errors
    found = 1e3 * np.array([error.fitted for error in errors])
    assert np.all(found < [15.0, 40.0, 30.0, 15.0, 44.0, 36.0])


def test_numbers_that_cannot_be_written_are_said_so(found, tmp_path):
    source = tmp_path / "odd.toml"
    text = shipped_files()["go1"].read_text()
    source.write_text(text.replace("[motors]", "[ motors ]"))
    with pytest.raises(UserError, match="a line of its own"):
        identified_file(found, ROBOT, source, tmp_path)


@pytest.fixture(scope="module")
def covered() -> list[bool]:
    """Whether each interval of each robot below holds its truth."""
    return []


@pytest.mark.skipif("BP2_RANDOM_MOTORS" not in os.environ, reason="takes half an hour")
@pytest.mark.parametrize("seed", range(11, 16))
@pytest.mark.parametrize("wrong", [0.0, 0.05], ids=["inertias right", "5 % wrong"])
def test_random_motors_are_found_again(tmp_path, covered, seed, wrong):
    """Where the inertias are wrong, each body has a mistake of its own."""
    random = np.random.default_rng(seed)

    def near(values: object, share: float) -> np.ndarray:
        values = np.asarray(values)
        return values * np.exp(random.uniform(-share, share, values.shape))

    shares = (0.2, 0.2, 0.4, 0.4, 0.3, 0.1)
    motors = [near(x, share) for x, share in zip(TRUTH, shares, strict=False)]
    delay = random.uniform(1e-3, 6e-3, 1).round(4)
    inertias = near(np.ones(14), wrong)
    truth = Motors(*motors, delay=delay, inertia=inertias[2:].reshape(4, 3))
    hanging_log(tmp_path / "log.npz", truth, DURATION, inertias)
    log = read_log(tmp_path / "log.npz", ROBOT.anatomy)
    assert ROBOT.gains is not None
    for one in identify(log, ROBOT, ROBOT.gains).numbers:
        values = np.ravel(getattr(truth, one.name))
        right = values[NAMES[len(values)].index(one.joint)]
        covered.append((one.low or 0.0) <= right <= (one.high or 0.0))
        if not wrong:
            near_enough = 1e-4 if one.name == "delay" else WITHIN[one.name] * right
            assert abs(one.value - right) <= near_enough, one


@pytest.mark.skipif("BP2_RANDOM_MOTORS" not in os.environ, reason="takes half an hour")
def test_nine_of_ten_intervals_hold_the_truth(covered):
    assert np.mean(covered) >= 0.9, f"{sum(covered)} of {len(covered)}"
