"""The signs and zeros of a robot's own model travel from its MJCF to its bundle, whose
controller speaks both."""

import dataclasses
import json
import math
from functools import partial

import mujoco
import numpy as np
import pytest
from odd_robots import anymal_like
from synthetic import make_card, still_policy

from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.deploy.bundle import write_bundle
from bp2_rl.learning.policy import load_policy, save_policy
from bp2_rl.robot.compiling import compile_file
from bp2_rl.robot.conventions import MOTOR_NAMES
from bp2_rl.robot.model import foot_geom_ids
from bp2_rl.robot.named import find_robot
from bp2_rl.robot.reading import read_mjcf
from bp2_rl.robot.robot_file import load_robot, robot_text
from bp2_rl.settings.env import EnvConfig
from bp2_rl.settings.presets import preset

DT = 0.005


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """Write the MJCF of a robot with odd signs and zeros, whose knee ranges are on the
    side of the bend."""
    path, text = tmp_path_factory.mktemp("model") / "anymal.xml", anymal_like()
    path.write_text(text)
    reading = read_mjcf(path)
    for leg, joint in zip(reading.anatomy.legs, reading.joints[2::3], strict=True):
        low, high = sorted(
            math.degrees(joint.sign * (leg.bend * angle - joint.offset))
            for angle in (0.2, 2.6)
        )
        text = text.replace(
            f'name="{joint.name}"', f'name="{joint.name}" range="{low} {high}"'
        )
    path.write_text(text)
    return path


@pytest.fixture(scope="module", params=["pointing", "numbers"])
def folder(model, request):
    """Write the bundle of an untrained policy for the model, by its robot file, by
    settings and card on disk."""
    file = model.with_name(f"{request.param}.toml")
    file.write_text(
        robot_text(
            read_mjcf(model), "anymal.xml" if request.param == "pointing" else None
        )
    )
    env = preset("imitation", "smoke", robot=str(file)).env
    card = make_card(env=from_json(EnvConfig, json.loads(json.dumps(to_json(env)))))
    drawn = partial(np.random.default_rng(0).normal, 0.0, 0.03)
    policy = model.with_name(f"{request.param} policy")
    save_policy(policy, still_policy(card, drawn))
    folder = model.with_name(f"{request.param} bundle")
    write_bundle(folder, load_policy(policy))
    return folder


def convention(folder):
    joints = json.loads((folder / "deploy.json").read_text())["model_joints"]
    return [
        np.array([joint[key] for joint in joints]) for key in ("name", "sign", "offset")
    ]


def test_a_bundle_has_each_joints_name_sign_and_zero(folder, model):
    """By MuJoCo: the feet of the robot's model at its angles q are those of the
    bundle's at sign x q + offset."""
    names, sign, offset = convention(folder)
    assert names[:4].tolist() == ["RF_HAA", "RF_HFE", "RF_KFE", "LF_HAA"]
    assert set(sign) == {-1, 1}
    assert np.abs(offset).max() > 0.1
    theirs, ours = (
        compile_file(model)[0],
        mujoco.MjModel.from_xml_path(str(folder / "robots" / "own.xml")),
    )
    q = np.random.default_rng(1).uniform(-0.5, 0.5, 12)
    theirs_feet = feet_of(theirs, names, q, spheres(theirs))
    ours_feet = feet_of(ours, MOTOR_NAMES, sign * q + offset, foot_geom_ids(ours))
    # a file of numbers mirrors the left
    legs = slice(1, None, 2) if folder.name.startswith("numbers") else slice(None)
    # m: XML has six digits
    assert ours_feet[legs] == pytest.approx(theirs_feet[legs], abs=1e-5)


def spheres(model):
    """Return the geoms of the feet, FR FL RR RL."""
    return [
        next(
            g
            for g in range(model.ngeom)
            if model.geom_bodyid[g] == model.body(f"{leg}_FOOT").id
            and model.geom_contype[g]
        )
        for leg in ("RF", "LF", "RH", "LH")
    ]


def feet_of(model, names, angles, geoms):
    """Return the positions of the feet in the trunk's frame, m."""
    data = mujoco.MjData(model)
    data.qpos[:7] = 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
    for name, angle in zip(names, angles, strict=True):
        data.qpos[model.joint(str(name)).qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    return data.geom_xpos[geoms]


def test_the_controller_takes_and_gives_the_models_angles_where_asked(onboard, folder):
    """Two controllers, each told the same in its own convention, answer alike: a
    convention is a rounding apart."""
    names, sign, offset = convention(folder)
    ours, theirs = (
        onboard.controller.OnboardController(folder, convention=c)
        for c in ("bundle", "model")
    )
    stand, rng = np.array(ours.settings["control"]["stand"]), np.random.default_rng(2)
    for k in range(60):
        now, imu = (
            k * DT,
            (np.array([0.0, 0.0, 1.0]) + 1e-9 * (k % 7), np.full(3, 1e-9 * (k % 7))),
        )
        q, qd = stand + rng.normal(0.0, 0.01, 12), rng.normal(0.0, 0.3, 12)
        expected = ours.step((q, qd, *imu, now), (0.5, 0.0, 0.0), now)
        found = theirs.step(
            (sign * (q - offset), sign * qd, *imu, now), (0.5, 0.0, 0.0), now
        )
        # a network of float32
        assert sign * found.position + offset == pytest.approx(
            expected.position, abs=1e-6
        )
        assert sign * found.velocity == pytest.approx(expected.velocity, abs=1e-6)
    assert ours.fault == theirs.fault == ""
    theirs.step(
        (sign * (np.full(12, 9.0) - offset), qd, *imu, now + DT), None, now + DT
    )
    assert theirs.fault.startswith(f"range: {names[2]} is at 9.00 rad")


def test_another_word_for_a_convention_is_refused(onboard, bundle):
    with pytest.raises(
        ValueError, match="there is no convention 'models': did you mean model"
    ):
        onboard.controller.OnboardController(bundle, convention="models")


def test_settings_of_before_have_the_joints_own_names():
    """A run's config.json from before the field is read as it was."""
    hardware = find_robot("go1")
    data = to_json(dataclasses.replace(EnvConfig(), hardware=hardware))
    del data["hardware"]["body"]["joints"]
    joints = from_json(EnvConfig, data).hardware.anatomy.joints
    assert [(joint.name, joint.sign, joint.offset) for joint in joints] == [
        (name, 1, 0.0) for name in MOTOR_NAMES
    ]


def test_conventions_in_a_file_are_twelve(tmp_path, model):
    text = robot_text(read_mjcf(model), None)
    first, rest = text.split('  { name = "RF_HAA"', 1)
    (tmp_path / "robot.toml").write_text(first + rest.split("\n", 1)[1])
    with pytest.raises(
        UserError,
        match="conventions: 11 are given; give the 12 joints', or leave them out",
    ):
        load_robot(tmp_path / "robot.toml")
