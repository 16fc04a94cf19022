"""Motor numbers are found again from logs that C MuJoCo made with motors of other
numbers."""

import dataclasses

import mujoco
import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.robot.actuator import Actuator, pd_torque, torque_limits
from bp2_rl.robot.hardware import Losses
from bp2_rl.robot.model import load_model
from bp2_rl.robot.named import find_robot_file, shipped_files
from bp2_rl.robot.robot_file import load_robot
from bp2_rl.tools.identify.excite import excitation, excitation_text
from bp2_rl.tools.identify.fit import Rig, cut_windows, predicted_error, rig_of
from bp2_rl.tools.identify.log import describe_log, read_log
from bp2_rl.tools.identify.outcome import identified_file, identify
from bp2_rl.tools.identify.swing import Motors

SECONDS = 8.0
QUANTUM, NOISE = 0.38e-3, 0.2e-3  # rad, of the encoders
PHYSICS = 1e-4  # s, fine beside the fit's 1 ms
ROBOT = find_robot_file("go1")
TRUTH = Motors(
    torque_scale=np.array([0.95, 0.85, 1.08]),
    no_load_speed=np.array([26.0, 33.0, 18.0]),
    friction=np.array([0.5, 0.4, 0.3]),
    viscosity=np.array([0.05, 0.03, 0.06]),
    armature=np.array([0.0045, 0.0055, 0.006]),
    corner_speed=np.array([17.0, 19.0, 11.0]),
    delay=np.array([0.0026]),
)


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


@pytest.fixture(scope="module")
def log_file(tmp_path_factory):
    """A log of a hanging Go1 whose motors are `TRUTH`."""
    hardware, gains = ROBOT.hardware, ROBOT.gains
    assert gains is not None
    _, targets = excitation(hardware, gains, SECONDS)
    bare = dataclasses.replace(hardware, losses=Losses())
    model = load_model(bare, timestep=PHYSICS, visual=False, feet_only=True, scene=hung)
    model.dof_armature[:] = four(TRUTH.armature)
    data = mujoco.MjData(model)
    data.qpos[:] = targets[0]
    drive = Actuator(
        stiffness=four(gains.stiffness),
        damping=four(gains.damping),
        peak_torque=four(hardware.peak_torque),
        corner_speed=four(TRUTH.corner_speed),
        no_load_speed=four(TRUTH.no_load_speed),
    )
    gear_loss = 1.0 - hardware.losses.gear_efficiency
    steps = round(0.002 / PHYSICS)
    late = round(float(TRUTH.delay[0]) / PHYSICS)
    angles = np.empty_like(targets)
    for row in range(len(targets)):
        angles[row] = data.qpos
        for step in range(steps):
            target = targets[max((row * steps + step - late) // steps, 0)]
            q, qd = data.qpos.copy(), data.qvel.copy()
            asked = pd_torque(drive, q, qd, target, np.zeros(12))
            torque = np.clip(asked, *torque_limits(drive, qd)) * four(
                TRUTH.torque_scale
            )
            most = four(TRUTH.friction) + gear_loss * np.abs(torque)
            resisted = most * np.tanh(qd / 0.02) + four(TRUTH.viscosity) * qd
            data.qfrc_applied[:] = torque - resisted
            mujoco.mj_step(model, data)
    noise = np.random.default_rng(0).normal(scale=NOISE, size=angles.shape)
    measured = np.round((angles + noise) / QUANTUM) * QUANTUM
    path = tmp_path_factory.mktemp("log") / "hanging.npz"
    names = [joint.name for joint in ROBOT.anatomy.joints]
    np.savez(
        path,
        time=0.002 * np.arange(len(targets)),
        q=measured,
        q_target=targets,
        joint_names=np.array(names),
    )
    return path


@pytest.fixture(scope="module")
def found(log_file):
    return identify(read_log(log_file, ROBOT.anatomy), ROBOT)


# two steps of the fit a row, and Coulomb friction rounded near rest, leave a per cent
@pytest.mark.parametrize(
    ("name", "within"),
    [
        ("torque_scale", 0.02),
        ("no_load_speed", 0.02),
        ("armature", 0.02),
        ("friction", 0.04),
        ("corner_speed", 0.05),
        ("viscosity", 0.15),
        ("delay", 0.04),
    ],
)
def test_a_hanging_robots_motors_are_found_again(found, name, within):
    values = [one.value for one in found.numbers if one.name == name]
    np.testing.assert_allclose(values, getattr(TRUTH, name), rtol=within)


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
    """With the truth in place of a fit, what is left is noise."""
    log = read_log(log_file, ROBOT.anatomy)
    rig = rig_of(ROBOT.hardware, [35.0] * 3, [0.5] * 3)
    error = predicted_error(Rig(*rig[:3], TRUTH, TRUTH), TRUTH, cut_windows(log, 25))
    assert np.sqrt(np.mean(error[-1] ** 2)) < 0.004


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
    np.savetxt(
        tmp_path / "log.csv", rows, delimiter=",", header=",".join(head), comments=""
    )
    again = read_log(tmp_path / "log.csv", turned)
    np.testing.assert_allclose(again.q, log.q, atol=1e-12)
    np.testing.assert_allclose(again.q_target, log.q_target, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda log: log.pop("time"), "no column `time`"),
        (lambda log: log.update(q=57.3 * log["q"]), "radians"),
        (lambda log: log.update(time=log["time"][::-1]), "time does not rise"),
        (lambda log: log["q"].__setitem__((3, 4), np.nan), "not a number"),
        (lambda log: log.pop("q_target"), "no columns q_target"),
        (lambda log: log.update(joint_names=np.array(["x"] * 12)), "no column"),
        (lambda log: log.update(contact=np.zeros((len(log["time"]), 4))), "give `up`"),
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


def test_targets_stay_within_the_joints_ranges_and_ask_for_more_than_the_motors_have():
    hardware, gains = ROBOT.hardware, ROBOT.gains
    assert gains is not None
    _, targets = excitation(hardware, gains)
    ranges = np.array([leg.ranges for leg in hardware.anatomy.legs]).reshape(12, 2)
    assert np.all(targets > ranges[:, 0])
    assert np.all(targets < ranges[:, 1])
    jump = np.max(np.abs(np.diff(targets, axis=0)), axis=0)
    assert np.all(jump * four(gains.stiffness) > four(hardware.peak_torque))
    assert excitation_text(hardware, gains).startswith("time,q_target.FR_hip_joint")
