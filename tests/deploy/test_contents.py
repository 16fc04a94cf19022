"""Damaged bundles are refused in one line of one class of error, or run with targets
that are finite and in range."""

import collections
import functools
import json
import operator
import shutil

import numpy as np
import pytest
from damage import damaged_bundles, flipped_bits
from refusals import python

DT = 0.005


@pytest.fixture
def copy(bundle, tmp_path):
    """Copy the bundle to a folder where it may be damaged, without Python's caches and
    the example in C++, which is its owner's to change."""
    unsealed = shutil.ignore_patterns("__pycache__", "main.cpp", "CMakeLists.txt")
    return shutil.copytree(bundle, tmp_path / "bundle", ignore=unsealed)


def outcome(onboard, folder, sealed):
    """Load a bundle, sealed again or not, run it from several phases at several speeds,
    and return how that ended."""
    try:
        if sealed:
            onboard.contents.seal(folder)
        controller = onboard.controller.OnboardController(folder)
    except onboard.contents.BundleError as error:
        return "refused" if "\n" not in str(error) else "more than one line"
    low, high = np.transpose(controller.settings["joint_range"])
    limits, faults = controller.watchdog.limits, set()
    for start, speed in enumerate((0.0, 3.0, 9.0, 15.0)):
        controller.reset(start / 4.0)
        controller.command = np.array([speed, 0.0, 0.0], np.float32)
        before = controller._stand
        for k in range(8):
            level = np.array([1e-9 * k, 0.0, 1.0])
            position = controller._stand + 1e-9 * k
            position, velocity = controller.step(
                (position, np.zeros(12), level, np.full(3, 1e-9 * k), k * DT),
                (speed, 0.0, 0.0),
                k * DT,
            )
            assert np.isfinite([*position, *velocity]).all()
            assert (low <= position).all()
            assert (position <= high).all()
            assert np.abs(velocity).max() <= limits.joint_speed
            assert (
                controller.fault
                or np.abs(position - before).max() <= limits.target_step
            )
            before = position
        faults.add(controller.fault.partition(":")[0])
    return ", ".join(sorted(faults - {""})) or "ran"


def outcomes(onboard, folder, count, seed):
    """Load and run `count` damaged bundles; return the number of bundles by outcome and
    by whether they were sealed again."""
    found = collections.Counter()
    for what, sealed in damaged_bundles(folder, count, seed):
        try:
            found[sealed, outcome(onboard, folder, sealed)] += 1
        except Exception as error:
            raise AssertionError(what) from error
    assert outcome(onboard, folder, sealed=False) == "ran"  # all has been mended
    return found


@pytest.mark.attack
def test_a_damaged_bundle_is_refused_or_runs_within_its_limits(onboard, copy):
    count = 300
    found = outcomes(onboard, copy, count, seed=0)
    assert found[False, "refused"] == count // 2  # no damage passes a seal
    assert found[True, "refused"] >= 10
    assert found[True, "ran"] >= 10


# --- What each kind of damage is told -------------------------------------------------


def refusal(onboard, folder):
    with pytest.raises(onboard.contents.BundleError) as refused:
        onboard.controller.OnboardController(folder)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def edited(folder, name, value):
    """Set a number of deploy.json, by its dotted name."""
    settings = json.loads((folder / "deploy.json").read_text())
    *path, last = (int(part) if part.isdigit() else part for part in name.split("."))
    functools.reduce(operator.getitem, path, settings)[last] = value
    (folder / "deploy.json").write_text(json.dumps(settings))


def test_no_flipped_bit_passes(onboard, copy):
    for name in (
        "policy.onnx",
        "reference.npz",
        "onboard/motion.py",
        "robots/built.xml",
    ):
        content = (copy / name).read_bytes()
        for flipped in flipped_bits(content, 10):
            (copy / name).write_bytes(flipped)
            assert (
                f"{name} is not as it was sealed: if you edited it, run `python -m onboard.seal`"
                in refusal(onboard, copy)
            )
        (copy / name).write_bytes(content)


def test_an_owner_seals_the_limits_that_they_edited(onboard, copy):
    edited(copy, "watchdog.tilt", 0.9)
    assert "deploy.json is not as it was sealed" in refusal(onboard, copy)
    said = (0, f"sealed {copy}; changed: deploy.json, cpp/controller.bin\n", "")
    assert python(copy, "-m", "onboard.seal") == said
    assert onboard.controller.OnboardController(copy).watchdog.limits.tilt == 0.9


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("joint_range", [[-100.0, 100.0]] * 12, "joint_range must be from -10 to 10"),
        ("joint_range", [[-1.0, 1.0]] * 11, "joint_range must be from -10 to 10"),
        (
            "control.action_limit",
            1e9,
            "control.action_limit must be from 0.001 to 100, got 1000000000.0",
        ),
        (
            "control.action_scale",
            "0.5",
            "control.action_scale must be from 0.001 to 10, got '0.5'",
        ),
        ("gains.stiffness", 0.0, "gains.stiffness must be from 0.1 to 100000, got 0.0"),
        ("watchdog.tilt", None, "watchdog.tilt takes a number, got None"),
        ("watchdog.silence", 10**400, "watchdog.silence must be from 0.01 to 1"),
        ("watchdog.window", float("nan"), "not JSON compliant"),
        ("control.stand", [3.0] * 12, "control.stand is beyond joint_range"),
        ("policy", None, "TypeError"),
        ("robots", [1.0], "TypeError"),
        ("model_joints.3.sign", 0.5, "a sign is neither 1 nor -1"),
        ("model_joints.3.sign", 0, "a sign is neither 1 nor -1"),
        ("watchdog.bite", 1.0, "unexpected keyword argument 'bite'"),
        ("reference.legs", [], "zip() argument 2 is longer"),
        (
            "reference.kind",
            "walk",
            "reference motion 'walk': this controller plays collocation, kinematic, none",
        ),
        ("observation", [["smell", 3]], "smell"),
        ("observation", [["command", 3]], "dimension"),
        ("format", 4, "has format 4, this controller reads 6: export it anew"),
    ],
)
def test_a_number_out_of_its_bounds_is_named_by_the_seal_and_by_the_controller(
    onboard, copy, capsys, monkeypatch, name, value, told
):
    edited(copy, name, value)
    monkeypatch.setattr(onboard.seal, "__file__", str(copy / "onboard" / "seal.py"))
    assert onboard.seal.main() == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1
    assert error == f"error: {refusal(onboard, copy)}\n"


def with_arrays(onboard, folder, change):
    """Change the arrays of the reference motion in their places, and seal them."""
    with np.load(folder / "reference.npz") as file:
        arrays = dict(file)
    change(arrays)
    np.savez(folder / "reference.npz", **arrays)
    onboard.contents.seal(folder)


@pytest.mark.parametrize(
    "name", ["strides", "cubics", "stand_feet", "leg_origins", "stand_torque"]
)
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e6])
def test_an_array_with_a_number_that_no_motion_has_is_refused(
    onboard, copy, name, value
):
    with_arrays(onboard, copy, lambda arrays: arrays[name].flat.__setitem__(-1, value))
    assert f"{name} holds numbers that are not finite, or beyond 100000" in refusal(
        onboard, copy
    )


def test_a_motion_whose_targets_cannot_be_is_refused(onboard, copy):
    def hurry(arrays):  # a stride takes a twentieth of its time
        arrays["strides"][:, 1:3] *= 0.05

    with_arrays(onboard, copy, hurry)
    assert "of the largest step or speed; is reference.npz" in refusal(onboard, copy)


def test_the_rehearsal_says_what_its_controller_refuses(onboard, copy, capsys):
    edited(copy, "reference.kind", "walk")
    onboard.contents.seal(copy)
    assert onboard.rehearse.main([str(copy)]) == 2
    error = capsys.readouterr().err
    assert (
        f"error: bundle {copy} cannot be used: ValueError(\"reference motion 'walk'"
        in error
    )


def test_a_file_is_read_up_to_a_bound_and_no_device_is(onboard, copy):
    for name in ("deploy.json", "policy.onnx", "reference.npz", "manifest.json"):
        content = (copy / name).read_bytes()
        with (copy / name).open("r+b") as file:
            file.truncate(1 << 40)  # a hole, which takes no room on the disk
        assert "has 1,099,511,627,776 bytes, 67,108,864 at most are read" in refusal(
            onboard, copy
        )
        (copy / name).unlink()
        (copy / name).symlink_to("/dev/zero")
        assert name in refusal(onboard, copy)
        (copy / name).unlink()
        (copy / name).write_bytes(content)
    onboard.controller.OnboardController(copy)


@pytest.mark.parametrize("name", ["go1", "mini_cheetah", "spot", "b2"])
def test_the_bundle_of_another_robot_is_within_all_bounds(onboard, another, name):
    """With room to spare: the reference motion asks for less than half of the speed
    that is a fault."""
    _, folder = another(name)
    controller = onboard.controller.OnboardController(folder)
    assert 0.0 < controller.watchdog.used["targets"] < 0.6
