"""A robot file becomes a robot that stands, or one line that says what is wrong with
it."""

import dataclasses
import json
import random
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from odd_robots import (
    PLAIN_JOINTS,
    anymal_like,
    disagreement,
    drawn_crouching,
    leg_numbers,
    link_numbers,
    plain,
    playground,
    read,
    sprung,
    urdf,
    written,
)

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import from_json, to_json
from bp2_rl.cli import robot as command
from bp2_rl.robot.anatomy import Anatomy
from bp2_rl.robot.compiling import compile_file
from bp2_rl.robot.hardware import BUILT, HardwareSpec
from bp2_rl.robot.kinematics import foot_position, joint_angles
from bp2_rl.robot.model import load_model
from bp2_rl.robot.reading import RobotReading, read_mjcf
from bp2_rl.robot.robot_file import (
    GainNumbers,
    RobotFile,
    load_robot,
    mirrored,
    robot_text,
)
from bp2_rl.robot.sheet import sheet, stand, trained_gains
from bp2_rl.settings.presets import preset

SHIPPED = sorted(asset_path("robots").glob("*.toml"))
GO1 = asset_path("robots/go1.toml").read_text()


def write(folder: Path, text: str) -> Path:
    path = folder / "robot.toml"
    path.write_text(text)
    return path


def filled_in(
    folder: Path, model: str, pointing: bool = True, **named: Any
) -> tuple[RobotFile, RobotReading]:
    """Return what `new` and `check` make of a model, and the model's reading."""
    reading, name = read(folder, model, **named), written(folder, model).name
    text = robot_text(reading, name if pointing else None, **named)
    return load_robot(write(folder, text)), reading


def line_of(text: str, start: str) -> str:
    (line,) = [line for line in text.splitlines() if line.startswith(start)]
    return line


def require_that_kinematics_find_the_stand(robot: RobotFile) -> None:
    target = np.reshape(robot.anatomy.stand, (4, 3))
    feet = foot_position(target, 0.0, robot.hardware)
    found = joint_angles(feet, 0.0, robot.hardware)
    np.testing.assert_allclose(found, target, atol=1e-9)


# --- What a file makes ----------------------------------------------------------------


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_a_robot_that_ships_stands(path: Path):
    robot = load_robot(path)
    assert len(path.read_text().splitlines()) <= 150
    assert robot.top_speed is not None
    assert robot.sources
    assert robot.assumed
    stood = stand(robot)
    assert (stood.fallen_after, stood.feet_down, stood.touching) == (None, 4, ())
    assert np.all(np.abs(stood.torque) < 0.5 * robot.hardware.joint_peak_torque)
    assert not re.search("(?m)^!", sheet(robot, stood))
    require_that_kinematics_find_the_stand(robot)


@pytest.mark.parametrize(
    ("name", "path"),
    [("go1", "go1/xmls/go1_mjx_feetonly.xml"), ("spot", "spot/xmls/spot_mjx.xml")],
)
def test_the_joints_of_a_robot_that_ships_are_its_models(name: str, path: str):
    ours = load_robot(asset_path(f"robots/{name}.toml")).anatomy
    public = read_mjcf(playground(path)).anatomy
    require_same_joints(ours, public, 1e-7)
    if name == "go1":
        assert ours.mass == pytest.approx(public.mass, rel=1e-6)
        for leg in (1, 3):  # of the right shanks the model has no mirror image
            inertias = [
                [link.inertia for link in anatomy.legs[leg].links]
                for anatomy in (ours, public)
            ]
            np.testing.assert_allclose(*inertias, rtol=1e-5, atol=1e-9)


def require_same_joints(ours: Anatomy, theirs: Anatomy, rounding: float) -> None:
    """Require the same joint names and signs, and offsets within the file's rounding to
    seven digits."""
    for joint, original in zip(ours.joints, theirs.joints, strict=True):
        assert (joint.name, joint.sign) == (original.name, original.sign)
        assert joint.offset == pytest.approx(original.offset, abs=rounding)


@pytest.mark.parametrize("pointing", [True, False])
def test_a_file_filled_in_from_a_model_is_that_model(pointing: bool, tmp_path: Path):
    robot, reading = filled_in(tmp_path, anymal_like(), pointing)
    legs = slice(0, None) if pointing else slice(1, None, 2)
    ours, theirs = (
        [leg.anchor + leg.hip + leg.foot for leg in a.legs[legs]]
        for a in (robot.anatomy, reading.anatomy)
    )
    np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-9)
    assert robot.hardware.peak_torque == (80.0, 80.0, 80.0)
    assert np.ravel(robot.hardware.reflected_inertia)[0] == pytest.approx(0.02)
    assert robot.gains == GainNumbers((80.0, 80.0, 80.0), (2.0, 2.0, 2.0))
    require_same_joints(robot.anatomy, reading.anatomy, 1e-6)
    if pointing:
        for numbers in (leg_numbers, link_numbers):
            ours, theirs = numbers(robot.anatomy), numbers(reading.anatomy)
            np.testing.assert_allclose(ours, theirs)
        said = sheet(robot, stand(robot))
        assert line_of(said, "FL_knee ").split()[1] == "-LF_KFE"
        assert "no keyframe" in said
    model = load_model(robot.hardware)
    assert (model.nq, model.nv, model.nu) == (19, 18, 12)


@pytest.mark.parametrize("pointing", [True, False])
@pytest.mark.parametrize(
    ("fore", "hind"),
    [
        ((0.2, 0.8, -1.5), (0.2, 0.8, -1.5)),
        ((-0.1, 0.9, -1.8), (0.15, -0.6, 1.4)),
        ((0.0, 1.28, -2.62), (0, 1, -2)),
    ],
)
def test_a_keyframe_goes_through_a_file_whole(
    fore, hind, pointing: bool, tmp_path: Path
):
    """Abduction, too, and within the ranges that the file is held to: the keyframe may
    leave them."""
    legs = [(side * leg[0], *leg[1:]) for leg in (fore, hind) for side in (-1, 1)]
    angles = " ".join(map(str, np.ravel(legs)))
    key = f'<keyframe><key qpos="0 0 .3 1 0 0 0 {angles}"/></keyframe>'
    model = plain(knee_range="-2.6 2.6", extra=key)
    stands = np.reshape(filled_in(tmp_path, model, pointing)[0].anatomy.stand, (4, 3))
    np.testing.assert_allclose(stands, np.clip(legs, -2.6, 2.6), rtol=1e-6)


@pytest.mark.parametrize(("hip", "knee"), [("", ""), ("-0.6", "1.2")])
def test_the_stand_tells_how_a_knee_bends_that_can_do_both(
    hip: str, knee: str, tmp_path: Path
):
    robot, _ = filled_in(tmp_path, plain(knee_range="-2.6 2.6"))
    if knee:
        text = (tmp_path / "robot.toml").read_text()
        text = re.sub("(?m)^hip = .*$", f"hip = {hip}", text)
        text = re.sub("(?m)^knee = .*$", f"knee = {knee}", text)
        robot = load_robot(write(tmp_path, text))
    assert [leg.bend for leg in robot.anatomy.legs] == [1 if knee else -1] * 4
    require_that_kinematics_find_the_stand(robot)


@pytest.mark.parametrize("pointing", [True, False])
@pytest.mark.parametrize("mass", [3, 6, 25, 60])
def test_what_a_model_does_not_say_is_not_invented(
    mass: int, pointing: bool, tmp_path: Path
):
    """Motors without gains, limits and inertia: the robot stands at any weight, and the
    sheet says what is assumed."""
    trunk = f'<freejoint/><geom type="box" size="0.2 0.09 0.05" mass="{mass}"/>'
    model = plain(actuator='<motor joint="{joint}"/>', trunk=trunk)
    robot, _ = filled_in(tmp_path, model, pointing)
    assert robot.gains is None
    assert {"motors.peak_torque", "motors.armature"} < set(robot.assumed)
    # of a robot of this size, by similarity with BP2
    torque = robot.hardware.size.torque * float(np.max(BUILT.joint_peak_torque))
    # 7 digits in the file
    np.testing.assert_allclose(robot.hardware.peak_torque, [torque] * 3, rtol=1e-6)
    stood = stand(robot)
    assert (stood.fallen_after, stood.feet_down) == (None, 4)
    said = sheet(robot, stood)
    for number in ("peak torque, Nm", "rotor inertia", "corner speed", "no-load speed"):
        assert line_of(said, number).endswith("ASSUMED")
    assert "training's own loop, ASSUMED" in line_of(said, "stands 5 s")


@pytest.mark.parametrize("pointing", [True, False])
def test_friction_by_joint_goes_through_a_file(pointing: bool, tmp_path: Path):
    joints = [
        'frictionloss="1" damping="0.2"',
        'frictionloss="1" damping="0.2"',
        'frictionloss="3" damping="1"',
    ]
    robot, reading = filled_in(tmp_path, plain(joints=joints), pointing)
    losses = robot.hardware.losses
    assert losses.joint_friction == (1.0, 1.0, 3.0)
    assert losses.joint_viscosity == (0.2, 0.2, 1.0)
    assert not any("differ" in note for note in reading.notes)
    said = sheet(robot, stand(robot))
    assert line_of(said, "friction, Nm").split()[-3:] == ["1", "1", "3"]
    # The knee: 3 Nm and 1 Nm s/rad x 25 rad/s of 30 Nm.
    assert "! joints resist with up to 93% of the peak torque" in said
    assert from_json(HardwareSpec, to_json(robot.hardware)) == robot.hardware


def test_damping_of_a_joint_stays_its_own_where_not_all_have_a_position_loop(
    tmp_path: Path,
):
    """Without [gains] no loop could have it."""
    damped = plain(joints=['damping="0.2"', 'damping="0.2"', 'damping="1"'])
    robot, _ = filled_in(tmp_path, damped.replace("<motor", "<position kp='60'", 2))
    assert robot.gains is None
    assert robot.hardware.losses.joint_viscosity == (0.2, 0.2, 1.0)


def test_feet_that_differ_in_friction_get_a_note(tmp_path: Path):
    foot = '<geom name="FR_foot"'
    slippery = plain().replace(foot, f'{foot} friction="0.2"')
    robot, reading = filled_in(tmp_path, slippery)
    assert robot.hardware.friction == pytest.approx((0.2 + 3.0) / 4.0)
    differ = "the feet's friction differs (0.2, 1, 1, 1): their mean is taken"
    assert differ in reading.notes


@pytest.mark.parametrize(("effort", "velocity"), [(30, 20), (0, 20), (30, 0)])
def test_the_limits_of_a_urdf_are_used_and_said_to_be_its(
    effort: float, velocity: float, tmp_path: Path
):
    """A limit of 0 stands for none."""
    robot, _ = filled_in(tmp_path, urdf(effort=effort, velocity=velocity))
    assert ("motors.peak_torque" in robot.assumed) == (effort == 0)
    assert ("motors.no_load_speed" in robot.assumed) == (velocity == 0)
    assert robot.hardware.no_load_speed == ((velocity or 25.0),) * 3
    if effort and velocity:
        text = (tmp_path / "robot.toml").read_text()
        assert robot.hardware.peak_torque == (30.0, 30.0, 30.0)
        assert line_of(text, "peak_torque").endswith("the URDF's effort")
        assert line_of(text, "no_load_speed").endswith("the URDF's velocity")
    stood = stand(robot)
    assert (stood.fallen_after, stood.feet_down) == (None, 4)


def test_what_a_model_says_is_not_assumed(tmp_path: Path):
    model = plain(actuator=POSITION, joints=('armature="0.02"',) * 3)
    robot, _ = filled_in(tmp_path, model)
    assert robot.assumed == ("motors.corner_speed", "motors.no_load_speed")
    assert robot.gains == GainNumbers((60.0, 60.0, 60.0), (2.0, 2.0, 2.0))
    assert robot.hardware.peak_torque == (30.0, 30.0, 30.0)
    assert robot.hardware.rotor_inertia == (0.02, 0.02, 0.02)
    said = sheet(robot, stand(robot))
    assert not line_of(said, "peak torque, Nm").endswith("ASSUMED")
    assert "[60, 60, 60] Nm/rad" in line_of(said, "stands 5 s")


@pytest.mark.parametrize("pointing", [True, False])
def test_a_sprung_robot_goes_through_a_file(pointing: bool, tmp_path: Path):
    named = {"feet": TIPS, "foot_radius": 0.012}
    robot, reading = filled_in(tmp_path, sprung(), pointing, **named)
    assert robot.hardware.spring_stiffness == 4000.0
    assert robot.hardware.spring_travel == pytest.approx(0.08)
    for numbers in (leg_numbers, link_numbers):
        ours, theirs = numbers(robot.anatomy), numbers(reading.anatomy)
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-9)
    assert load_model(robot.hardware).nq == 23


def test_a_mirror_image_of_a_mirror_image_is_the_leg():
    leg = load_robot(asset_path("robots/go1.toml")).anatomy.legs[1]
    assert mirrored(mirrored(leg)) == leg
    assert mirrored(leg) != leg


# --- Every shape of robot -------------------------------------------------------------


def longer_hind_legs() -> str:
    """Return the MJCF of the robot `plain` with 3 cm more below each hind knee and
    another weight there."""
    fore, hind = plain().split('<body name="RR_hip_link"')
    more = hind.replace('pos="0 0 -0.21" mass="0"', 'pos="0 0 -0.24" mass="0"').replace(
        'mass="0.2"', 'mass="0.3"'
    )
    return f'{fore}<body name="RR_hip_link"{more}'


def with_an_arm() -> str:
    link = '<inertial pos="0 0 0.1" mass="0.4" diaginertia="1e-3 1e-3 1e-3"/>'
    arm = f'<body pos="0 0 0.05"><joint name="arm" axis="0 1 0"/>{link}</body>'
    return plain().replace('<body name="FR_hip_link"', f'{arm}<body name="FR_hip_link"')


POSITION = '<position joint="{joint}" kp="60" kv="2" forcerange="-30 30"/>'
IN_DEGREES = (
    plain()
    .replace('angle="radian"', 'angle="degree"')
    .replace("-0.8 0.8", "-46 46")
    .replace("-1.5 2.5", "-86 143")
    .replace("-2.6 -0.3", "-149 -17")
)
KEY = '<keyframe><key name="{}" qpos="0 0 .3 1 0 0 0 {}"/></keyframe>'
TIPS = tuple(f"{leg}_tip" for leg in ("fr", "fl", "rr", "rl"))
EVERY_SHAPE = {
    "motors alone": plain(),
    "motors without limits": plain(actuator='<motor joint="{joint}"/>'),
    "no motors": plain(actuator=""),
    "position actuators": plain(actuator=POSITION),
    "position actuators without damping": plain(
        actuator='<position joint="{joint}" kp="60"/>'
    ),
    "a loop of two actuators": plain(
        actuator='<position joint="{joint}" kp="60"/><velocity joint="{joint}" kv="2"/>'
    ),
    "pid": plain(
        actuator='<pid joint="{joint}" kp="60" kv="2" ki="1" forcerange="-30 30"/>'
    ),
    "dc motors": plain(
        actuator='<dcmotor joint="{joint}" motorconst="0.1" resistance="0.5" gear="9" ctrlrange="-24 24"/>'
    ),
    "dampers": plain(
        actuator='<motor joint="{joint}"/><damper joint="{joint}" kv="1" ctrlrange="0 1"/>'
    ),
    "actuators disabled": plain(
        actuator=POSITION.replace("/>", ' group="1"/>'),
        extra='<option actuatorgroupdisable="1"/>',
    ),
    "armature behind gears": plain(
        actuator='<motor joint="{joint}" gear="-9" armature="1e-4" ctrlrange="-3 3"/>'
    ),
    "friction and damping by joint": plain(
        joints=['frictionloss="1"', 'damping="0.2"', 'frictionloss="2"']
    ),
    "springs parallel to joints": plain(
        joints=['stiffness="5" springref="0.1"', "", 'damping="0.1 0.2"']
    ),
    "knees to both sides": plain(knee_range="-3.1416 3.1416"),
    "lopsided knees": plain(knee_range="-2.6 1.9"),
    "knees forwards": plain(knee_range="0.3 2.6"),
    "knees without a range": plain().replace('range="-2.6 -0.3"', ""),
    "a keyframe": plain(
        extra=KEY.format("home", " ".join(["-.1 .8 -1.5", ".1 .8 -1.5"] * 2))
    ),
    "a keyframe beyond the range": plain(
        extra=KEY.format("home", " ".join(["0 1.28 -2.62"] * 4))
    ),
    "a keyframe with straight legs": plain(
        extra=KEY.format("zero", " ".join(["0 0 -.3"] * 4))
    ),
    "capsules across the toes": plain(
        foot='<geom name="{leg}_foot" type="capsule" size="0.02" fromto="0 -0.03 -0.21 0 0.03 -0.21" mass="0"/>'
    ),
    "degrees": IN_DEGREES,
    "defaults": plain(
        extra='<default><joint armature="0.02" damping="0.1" frictionloss="0.2"/></default>'
    ),
    "a fixed base": plain().replace("<freejoint/>", ""),
    "a free joint with a default's armature": plain(
        trunk='<joint type="free"/><geom type="box" size="0.2 0.09 0.05" mass="6"/>',
        extra='<default><joint armature="0.02"/></default>',
    ),
    "geoms fitted to meshes": plain(
        trunk='<freejoint/><inertial pos="0 0 0" mass="6" diaginertia=".05 .1 .1"/><geom type="box" mesh="m"/>',
        extra='<asset><mesh name="m" file="gone.stl"/></asset>',
    ),
    "hind legs of their own": longer_hind_legs(),
    "an arm": with_an_arm(),
    "a URDF": urdf(),
    "a URDF below a dummy": urdf(root="base"),
    "a URDF without limits": urdf(effort=0, velocity=0),
    "turned frames, welded feet, hind knees forwards": anymal_like(),
    "drawn crouching": drawn_crouching(),
    "springs in the shanks": sprung(),
}


@pytest.mark.parametrize("shape", EVERY_SHAPE)
def test_a_robot_of_any_shape_is_read_exactly_and_stands(
    shape: str, tmp_path: Path, monkeypatch
):
    """Its mass matrix in random poses is C MuJoCo's own of the model, to the rounding
    of angles in degrees. It stands for 1.5 s; robots that ship do for all 5."""
    monkeypatch.setattr("bp2_rl.robot.sheet.STAND_TIME", 1.5)
    joints = PLAIN_JOINTS if "arm" in shape.split() else ()
    feet, radius = (TIPS, 0.012) if shape == "springs in the shanks" else ((), None)
    robot, reading = filled_in(
        tmp_path, EVERY_SHAPE[shape], joints=joints, feet=feet, foot_radius=radius
    )
    model = compile_file(written(tmp_path, EVERY_SHAPE[shape]), joints)[0]
    model.dof_armature[:6] = 0.0  # of the trunk's free joint, which no robot has
    for seed in range(2):
        assert max(disagreement(model, reading, seed=seed)) < 1e-12
    stood = stand(robot)
    assert (stood.fallen_after, stood.feet_down) == (None, 4)
    trained = preset("imitation", "cpu", robot=str(tmp_path / "robot.toml"))
    assert trained.env.gait.height > 0.4


# --- What is refused ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("before", "after", "complaint"),
    [
        ("mass = 5.204", "mass = -5.204", "trunk.mass must be"),
        ("mass = 5.204", "mass = nan", "trunk.mass must be"),
        ("mass = 5.204", 'mass = "heavy"', "trunk.mass takes a number"),
        ("mass = 5.204", "mas = 5.204", "trunk.mas: unknown key"),
        ("hip = 0.9", "hip = 5.2", "outside its range"),
        ("abad_range = [-0.863, 0.863]", "abad_range = [0.863, -0.863]", "low <= high"),
        (
            "inertia = [0.01681283,",
            "inertia = [0.91681283,",
            "trunk.inertia: principal moments",
        ),
        ("foot = [0, 0, -0.213]", "foot = [0, 0, 0.213]", "fore.foot"),
        ("corner_speed = [18.0, 18.0, 12.0]", "corner_speed = 31", "corner_speed"),
        ("armature = 0.005", "", "motors.armature: missing"),
        ("[trunk]", "[torso]", "torso: unknown key"),
        ('name = "Unitree Go1"', "", "name: missing"),
        (
            "anchor = [0.1881, 0.04675, 0]",
            "anchor = [0.1881, -0.24675, 0]",
            "fore: anchor, hip",
        ),
        ("weighed_mass = 12.74", "weighed_mass = 127.4", "one is wrong"),
        ("weighed_mass = 12.74", 'mjcf = "nowhere.xml"', "either `mjcf`"),
        pytest.param(
            GO1,
            f'mjcf = "gone.xml"\n{GO1[: GO1.index("[trunk]")]}',
            "gone.xml cannot be read",
            id="a model that is not there",
        ),
        (
            "[stand]\nhip = 0.9\nknee = -1.8",
            "",
            "it has no [stand]: `bp2 robot new MODEL.xml --numbers`",
        ),
        (
            "[gains]",
            "[spring]\nstiffness = 6000\ndamping = 10\ntravel = 0.1\n[gains]",
            "spring: the legs have no toe",
        ),
    ],
)
def test_a_mistake_is_named(before: str, after: str, complaint: str, tmp_path: Path):
    assert before in GO1
    path = write(tmp_path, GO1.replace(before, after, 1))
    with pytest.raises(UserError) as refusal:
        load_robot(path)
    line = re.escape(f"{path}: ") + ".*" + re.escape(complaint) + ".*"
    assert re.fullmatch(line, str(refusal.value))


@pytest.mark.parametrize(
    "name", ["$\\frac{$", "x" * 100_000, "", "a\nb", "\x1b[31mred", "\u202eder"]
)
def test_a_name_that_no_title_or_terminal_can_show_is_refused(
    name: str, tmp_path: Path, capsys
):
    path = write(tmp_path, GO1.replace('"Unitree Go1"', json.dumps(name), 1))
    assert command.main(["check", str(path), "--out", str(tmp_path / "robot.png")]) == 2
    said = capsys.readouterr().err
    assert re.search(
        "a robot's name takes 1 to 80 printable letters and no [$], got |control character '",
        said,
    )
    assert said.count("\n") == 1
    assert said[:-1].isprintable()
    assert len(said) < 500


@pytest.mark.parametrize(
    "text",
    [
        GO1.replace('name = "Unitree Go1"', f"name.{'a.' * 50_000}a = 1"),
        GO1.replace("[motors]", f"[motors.{'a.' * 50_000}a]"),
        GO1.replace("[motors]", f"[motors]\n{'a . ' * 50_000}a = 1"),
        GO1.replace("[motors]", f"[motors]\n{'a.' * 100_000}a = 1"),
        GO1.replace("[motors]", f"[motors]\nx = {'{a=' * 50_000}1{'}' * 50_000}"),
    ],
    ids=["key", "table", "spaced", "longer", "inline"],
)
def test_a_key_of_many_levels_is_refused_at_once(text: str, tmp_path: Path):
    """Python's reader takes 50,000 levels for minutes, and what it makes of them cannot
    be shown."""
    began = time.monotonic()
    with pytest.raises(
        UserError,
        match=r"is no robot file: it is nested too deeply|bytes, 262,144 at most are read",
    ):
        load_robot(write(tmp_path, text))
    assert time.monotonic() - began < 5.0


def damaged() -> Iterator[bytes]:
    """Yield robot files with a line lost, a value of another kind, bytes cut off,
    changed or from elsewhere."""
    draws, lines = random.Random(0), GO1.splitlines()
    key = "(mass|com|inertia|anchor|hip|knee|foot|size|peak_torque|abad_range) ="
    given = [i for i, line in enumerate(lines) if re.match(key, line)]
    for i in given:
        yield "\n".join(lines[:i] + lines[i + 1 :]).encode()
    values = [
        "nan",
        "inf",
        "-1e300",
        '"x"',
        "[]",
        "{}",
        "1979-05-27",
        "[[[1]]]",
        "true",
        "-5",
        "1" + "0" * 400,
    ]
    for _ in range(100):
        i = draws.choice(given)
        key = lines[i].split(" =")[0]
        yield "\n".join(
            [*lines[:i], f"{key} = {draws.choice(values)}", *lines[i + 1 :]]
        ).encode()
    content = GO1.encode()
    for _ in range(40):
        yield content[: draws.randrange(len(content) - 400)]
    for _ in range(40):
        yield bytes(draws.randrange(256) for _ in range(draws.randrange(1, 400)))
    yield b""
    yield b"[" * 100_000
    yield b"x = " + b"[" * 100_000
    yield b"\xff\xfe" + content
    yield json.dumps({"name": "x"}).encode()
    yield b"a" * (2 << 20)


@pytest.mark.attack
def test_damaged_files_end_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path, files = tmp_path / "robot.toml", list(damaged())
    assert len(files) >= 200
    for content in files:
        path.write_bytes(content)
        assert (
            command.main(["check", str(path), "--out", str(tmp_path / "robot.png")])
            == 2
        )
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.startswith("error: ")
        assert said.err.count("\n") == 1
        assert str(path) in said.err


@pytest.mark.attack
def test_numbers_that_no_robot_has_end_in_a_sheet_or_in_one_line(
    tmp_path: Path, monkeypatch, capsys
):
    """Every number of the file in turn is made far too large, far too small, or of the
    other sign."""
    monkeypatch.setattr("bp2_rl.robot.sheet.STAND_TIME", 0.02)
    monkeypatch.setattr("bp2_rl.robot.sheet.draw_robot", lambda _: Figure())
    head, path, ended = GO1[GO1.index("[stand]") :], tmp_path / "robot.toml", []
    places = [found.span() for found in re.finditer(r"-?\d+(\.\d+)?(e-?\d+)?", head)]
    for i, (start, end) in enumerate(places):
        factor = (1e4, -1.0, 1e-6)[i % 3]
        text = f"{head[:start]}{factor * float(head[start:end]):.9g}{head[end:]}"
        path.write_text(GO1[: GO1.index("[stand]")] + text)
        ended.append(
            command.main(["check", str(path), "--out", str(tmp_path / "robot.svg")])
        )
        said = capsys.readouterr()
        assert (said.err.count("\n"), bool(said.out)) == (
            (0, True) if ended[-1] == 0 else (1, False)
        ), text
        assert "Traceback" not in said.err
    assert len(places) >= 100
    assert set(ended) == {0, 2}


# --- The sheet ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("stiffness = 35.0", "stiffness = 2.0", "! it falls after"),
        # (0.3 + 0.5 x 30) / 23.7
        (
            "joint_viscosity = 0.02",
            "joint_viscosity = 0.5",
            "! joints resist with up to 65% of the peak torque",
        ),
    ],
)
def test_the_sheet_says_what_to_mend(before: str, after: str, said: str, tmp_path):
    robot = load_robot(write(tmp_path, GO1.replace(before, after)))
    assert said in sheet(robot, stand(robot))


@pytest.mark.parametrize(
    ("knee_range", "doubted"),
    [
        ("-2.6 -0.3", False),
        ("-3.1416 3.1416", False),
        ("-2.9 -2.6", True),
        ("-0.5 -0.4", True),
    ],
)
def test_the_sheet_doubts_a_knee_that_hardly_stretches_a_leg(
    knee_range: str, doubted: bool, tmp_path: Path
):
    robot, _ = filled_in(tmp_path, plain(knee_range=knee_range))
    assert ("! fore legs of 0.44 m reach from" in sheet(robot, stand(robot))) == doubted


def test_the_sheet_says_where_training_has_other_gains():
    robot = load_robot(asset_path("robots/go1.toml"))
    control = preset("imitation", "cpu", robot="go1").env.control
    assert trained_gains(robot) == pytest.approx((control.stiffness, control.damping))
    note = line_of(sheet(robot, stand(robot)), "note: training's loop")
    assert f"{control.stiffness:.3g} Nm/rad" in note
    assert "--env.control.stiffness 35 --env.control.damping 0.5" in note
    own = dataclasses.replace(robot, gains=None)
    assert "training's loop" not in sheet(own, stand(own))
