"""The files that `bp2 export --format onnx` writes, and the mistakes that it
refuses."""

import dataclasses
import functools
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from refusals import python
from synthetic import still_policy

from bp2_rl.base.errors import UserError
from bp2_rl.cli import export as command
from bp2_rl.deploy.bundle import _describe_robots, write_bundle
from bp2_rl.deploy.onboard.contents import with_infinity
from bp2_rl.deploy.page.folder import write_page
from bp2_rl.learning.policy import save_policy
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.losses import Resistance
from bp2_rl.settings.presets import preset

ALONE = """
import sys
for name in ("jax", "jaxlib", "brax", "flax", "bp2_rl", "mujoco", "scipy", "onnx", "jaxtyping"):
    sys.modules[name] = None  # importing it fails
import numpy as np
from onboard.controller import OnboardController, SensorReading
controller = OnboardController(".")
stand = np.array(controller.settings["control"]["stand"])
level = SensorReading(stand, np.zeros(12), np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.0)
for k in range(10):
    targets = controller.step(level, (1.0, 0.0, 0.0), 0.0)
print(controller.fault, np.isfinite(targets.position).all(), np.abs(targets.position - stand).max() > 1e-3)
"""


def test_friction_by_joint_is_written_by_joint():
    env = preset("imitation", "smoke", robot="go1").env
    losses = dataclasses.replace(
        env.hardware.losses,
        joint_friction=(1.0, 1.0, 3.0),
        joint_viscosity=(0.2, 0.2, 1.0),
    )
    hardware = dataclasses.replace(env.hardware, losses=losses)
    described = _describe_robots(dataclasses.replace(env, hardware=hardware))["own"][
        "losses"
    ]
    ours, theirs = (
        Resistance.from_hardware(hardware),
        Resistance(**with_infinity(json.loads(json.dumps(described)))),
    )
    assert described["joint_friction"] == [1.0, 1.0, 3.0] * 4
    for name, value in vars(ours).items():
        np.testing.assert_array_equal(getattr(theirs, name), value)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MUJOCO_GL", "")  # the command takes it away
    return tmp_path


def test_it_runs_without_jax_and_without_bp2_rl(bundle):
    assert python(bundle, "-c", ALONE) == (0, " True True\n", "")


def test_the_page_about_it_has_a_script_that_runs_in_its_folder(bundle):
    page = Path(__file__).parents[2] / "docs" / "deploy.md"
    (script,) = re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
    assert python(bundle, "-c", script) == (0, "1.8 m run\n", "")


def settings_of(folder, *places):
    """Return the values in deploy.json at these dotted places."""
    settings = json.loads((folder / "deploy.json").read_text())
    return [
        functools.reduce(lambda value, key: value[key], place.split("."), settings)
        for place in places
    ]


def test_its_settings_say_what_a_robot_needs(bundle, shipped):
    card, env = shipped.card, shipped.card.env
    expected = {
        "observation": [list(entry) for entry in card.observation_layout],
        "joints": list(conventions.MOTOR_NAMES),
        "model_joints": [
            {"name": name, "sign": 1, "offset": 0.0} for name in conventions.MOTOR_NAMES
        ],
        "rates": {"policy": 200.0, "drives": 1000.0},
        "gains.stiffness": env.control.stiffness,
        "gains.damping": env.control.damping,
        "policy.weights_sha256": card.weights_sha256,
        "rehearsal": {"speed": 10.74, "hold": 20.0},
        "ground": "flat",
        "watchdog.stand_time": 0.1,
        "watchdog.joint_speed": 100.0,
        "watchdog.turning": 50.0,
    }
    assert settings_of(bundle, *expected) == [*expected.values()]
    ranges, most, robots = settings_of(bundle, "joint_range", "command.most", "robots")
    assert ranges[2] == list(bp2.KNEE_RANGE)
    assert most[0] == env.commands.max_forward
    assert robots.keys() >= {"built", "ideal"}


def test_another_robots_settings_are_its_own(another):
    policy, folder = another("go1")
    env = policy.card.env
    # By similarity: a leg's size is 0.64 of BP2's; the motors' no-load speed is 30
    # rad/s in place of 21.4.
    size = env.hardware.anatomy.leg_length / 0.35
    expected = {
        "control.stand": [0.0, 0.9, -1.8] * 4,
        "robots.own.motors.peak_torque": [23.7, 23.7, 35.55] * 4,
        "robots.own.motors.braking_speed": None,
        "gains.stiffness": env.control.stiffness,
        "watchdog.stand_time": pytest.approx(0.1 * size**0.5),
        "watchdog.turning": pytest.approx(50.0 / size**0.5),
        "watchdog.joint_speed": pytest.approx(100.0 * 30.0 / 21.4),
        "rehearsal.speed": pytest.approx(0.6 * env.commands.max_forward, abs=0.005),
    }
    assert settings_of(folder, *expected) == [*expected.values()]
    ranges, robots = settings_of(folder, "joint_range", "robots")
    assert ranges[:3] == [[-0.863, 0.863], [-0.686, 4.501], [-2.818, -0.888]]
    assert list(robots) == ["own"]


def test_the_command_writes_it_and_says_how_to_try_it(here, make_card, capsys):
    save_policy(here / "run" / "policies" / "64", still_policy(make_card()))
    for _ in range(2):  # a bundle that is there is replaced
        assert command.main(["run", "--to", "robot", "--format", "onnx"]) == 0
    assert capsys.readouterr().out.splitlines()[-3:] == [
        "exported run to robot",
        "it may fall where measurements are lost, as in the rehearsal: the relaxed stage trains for that",
        "try it: cd robot && pip install -r requirements.txt && python -m onboard.rehearse",
    ]
    assert {path.name for path in Path("robot").iterdir()} == {
        "deploy.json",
        "manifest.json",
        "onboard",
        "cpp",
        "policy.onnx",
        "reference.npz",
        "requirements.txt",
        "robots",
    }


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["onnx", "--to", "robot", "--report", "report"], "only a copy has one"),
        (["onnx", "--to", "run"], "holds files that are no bundle's"),
        (
            ["onnx", "--to", "run/policies/64/card.json"],
            "cannot write bundle run/policies/64/card.json",
        ),
        (["onnx", "--to", "robot", "--mujoco-package", "x"], "give --format page, too"),
        (["page", "--to", "robot", "--report", "report"], "only a copy has one"),
        (["page", "--to", "robot", "--mujoco-package", "x"], "x cannot be read"),
    ],
)
def test_a_mistake_is_one_line(here, make_card, capsys, arguments, words):
    save_policy(here / "run" / "policies" / "64", still_policy(make_card()))
    assert command.main(["run", "--format", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert words in err
    assert err.count("\n") == 1
    assert not Path("robot").exists()


def test_a_missing_package_is_named_with_the_line_that_installs_it(
    here, make_card, monkeypatch, capsys
):
    save_policy(here / "run" / "policies" / "64", still_policy(make_card()))
    monkeypatch.setitem(sys.modules, "onnxruntime", None)  # importing it fails
    assert command.main(["run", "--to", "robot", "--format", "onnx"]) == 2
    out, error = capsys.readouterr()
    assert (out, error.count("\n")) == ("", 1)
    assert (
        '--format onnx needs the package onnxruntime: pip install -c constraints.txt -e ".[deploy]"'
        in error
    )


@pytest.mark.parametrize("write", [write_bundle, write_page])
def test_what_the_controller_cannot_run_is_refused_by_name(make_card, tmp_path, write):
    layout = (*make_card().observation_layout, ("smell@5", 2))
    policy = still_policy(make_card(observation_layout=layout))
    with pytest.raises(UserError, match="the policy sees smell, which"):
        write(tmp_path / "robot", policy)
    assert not (tmp_path / "robot").exists()


def test_a_folder_that_is_no_bundle_is_refused(onboard, bundle, tmp_path):
    with pytest.raises(ValueError, match=r"no bundle in .*: it has no deploy.json"):
        onboard.controller.OnboardController(tmp_path)
    (tmp_path / "deploy.json").write_bytes((bundle / "deploy.json").read_bytes())
    with pytest.raises(ValueError, match=r"manifest.json cannot be read: No such file"):
        onboard.controller.OnboardController(tmp_path)
