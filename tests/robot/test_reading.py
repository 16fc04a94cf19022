"""Any quadruped's MJCF becomes an Anatomy that moves as the original does, or is
refused by name."""

import math
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from odd_robots import (
    PLAIN_JOINTS,
    anymal_like,
    disagreement,
    leg_numbers,
    link_numbers,
    plain,
    playground,
    read,
    sprung,
    urdf,
    without_a_base,
    written,
)

from bp2_rl.base.assets import asset_path
from bp2_rl.robot.compiling import ReadingError, compile_file
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.kinematics import foot_position
from bp2_rl.robot.reading import read_mjcf

GO1 = "go1/xmls/go1_mjx_feetonly.xml"
FULL, SPOT = "go1/xmls/go1_mjx_fullcollisions.xml", "spot/xmls/spot_mjx.xml"
PUBLIC = [(playground(path), 1e-9) for path in (GO1, FULL, SPOT)]


@pytest.fixture(scope="module")
def go1() -> Path:
    return playground(GO1)


# --- It moves as the original ---------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("path", "rounding"), [*PUBLIC, (asset_path("bp2_mjcf/bp2.xml"), 1e-12)]
)
def test_a_public_robot_moves_as_its_model_does(path: Path, rounding, seed: int):
    assert (
        max(disagreement(compile_file(path)[0], read_mjcf(path), seed=seed)) < rounding
    )


# --- What it says ---------------------------------------------------------------------


def test_go1_is_read_from_its_public_model(go1: Path):
    reading = read_mjcf(go1)
    assert reading.anatomy.mass == pytest.approx(12.743448)
    assert [joint.name for joint in reading.joints[:3]] == [
        "FR_hip_joint",
        "FR_thigh_joint",
        "FR_calf_joint",
    ]
    assert reading.contacts == ("FR", "FL", "RR", "RL")
    leg = reading.anatomy.legs[0]
    assert (leg.thigh_length, leg.lower_length, leg.foot_radius) == pytest.approx(
        (0.213, 0.236, 0.023)
    )
    assert leg.ranges == ((-0.863, 0.863), (-0.686, 4.501), (-2.818, -0.888))
    assert leg.bend == -1
    assert leg.toe is None
    hip, knee = reading.joints[1:3]
    assert (hip.peak_torque, knee.peak_torque, knee.stiffness, knee.armature) == (
        23.7,
        35.55,
        35.0,
        0.005,
    )
    assert (knee.friction, knee.damping, knee.actuator_damping) == (1.0, 0.0, 0.5), (
        "a loop has its damping somewhere"
    )


def test_where_the_position_loop_has_a_damping_a_joint_keeps_its_own(tmp_path: Path):
    text = anymal_like().replace('_HFE" axis', '_HFE" damping="0.1" axis')
    hip = read(tmp_path, text).joints[1]
    assert (hip.damping, hip.actuator_damping) == (0.1, 2.0)


def test_a_keyframe_tells_how_it_stands():
    reading = read_mjcf(playground("go1/xmls/scene_mjx_feetonly_flat_terrain.xml"))
    assert reading.anatomy.stand == pytest.approx((0.1, 0.9, -1.8, -0.1, 0.9, -1.8) * 2)


BEYOND = "the keyframe 'home' leaves the joints' ranges by up to 0.02 rad, at 'FR_knee'"
# thigh and lower leg of 0.21 and 0.23 m, 0.82 of them apart
STRAIGHT_KNEE = -math.acos(((0.82 * 0.44) ** 2 - 0.21**2 - 0.23**2) / (2 * 0.21 * 0.23))


@pytest.mark.parametrize(
    ("knee_range", "legs", "knee", "said"),
    [
        ("-2.6 -0.3", ["0 1.28 -2.62"] * 4, -2.6, BEYOND),
        (
            "-2.6 0",
            ["0 0 0"] * 4,
            STRAIGHT_KNEE,
            "the model has no keyframe of a stand: ASSUMED",
        ),
        (
            "-2.6 -0.3",
            ["0 .8 -1.5", "0 .7 -1.4", *["0 .8 -1.5"] * 2],
            -1.5,
            "the keyframe's right legs do not mirror the left ones",
        ),
    ],
    ids=["beyond a range", "straight", "uneven"],
)
def test_a_keyframe_that_does_not_tell_how_it_stands_is_noted(
    knee_range: str, legs: list[str], knee: float, said: str, tmp_path: Path
):
    """A knee beyond its range stands at the range's end."""
    key = f'<keyframe><key name="home" qpos="0 0 .3 1 0 0 0 {" ".join(legs)}"/></keyframe>'
    reading = read(tmp_path, plain(knee_range=knee_range, extra=key))
    assert reading.anatomy.stand[2] == pytest.approx(knee, abs=1e-3)
    (note,) = [note for note in reading.notes if "keyframe" in note]
    assert note.startswith(said)


@pytest.mark.parametrize("kind", ["box", "sphere", "capsule", "mesh"])
def test_a_geom_that_is_fitted_to_a_mesh_is_left_out_as_the_mesh_is(
    kind: str, tmp_path: Path
):
    inertial = '<freejoint/><inertial pos="0 0 0" mass="6" diaginertia=".05 .1 .1"/>'
    mesh = '<asset><mesh name="m" file="gone.stl"/></asset>'
    site = '<site type="box" mesh="m"/>' if kind == "box" else ""
    trunk = f'{inertial}<geom type="{kind}" mesh="m" mass="0"/>{site}'
    fitted = read(tmp_path, plain(trunk=trunk, extra=mesh))
    assert fitted.anatomy == read(tmp_path, plain(trunk=inertial)).anatomy
    heavy = f'<freejoint/><geom type="{kind}" mesh="m"/>'
    with pytest.raises(ReadingError, match="mass of body 'trunk' comes from a mesh"):
        read(tmp_path, plain(trunk=heavy, extra=mesh))


EFFECTS = {
    '<motor joint="{joint}" ctrlrange="-3 3" gear="-9" armature="0.001" damping="0.02"/>': (
        0.081,
        1.62,
        27,
        0,
        0,
    ),
    '<position joint="{joint}" kp="60" kv="2" armature=".02" damping=".4" forcerange="-8 8"/>': (
        0.02,
        0.4,
        8,
        60,
        2,
    ),
    '<position joint="{joint}" kp="60" kv="2" gear="2" forcerange="-30 20" ctrlrange="-4 -1"/>': (
        0,
        0,
        40,
        240,
        8,
    ),
    '<position joint="{joint}" kp="60"/><velocity joint="{joint}" kv="3"/>': (
        0,
        0,
        math.inf,
        60,
        3,
    ),
    '<pid joint="{joint}" kp="50" kv="1" ki="2" forcerange="-30 30"/>': (
        0,
        0,
        30,
        50,
        1,
    ),
    '<general joint="{joint}" gainprm="4" biastype="affine" biasprm="0 -4 -0.5" forcerange="-9 9"/>': (
        0,
        0,
        9,
        4,
        0.5,
    ),
}
"""Actuators, and by hand: armature and damping times gear^2, the peak torque, and gains
times gear^2."""


TENDONS = "".join(
    f'<fixed armature="0.01" damping="0.1"><joint joint="{joint}" coef="2"/></fixed>'
    for joint in PLAIN_JOINTS
)
"""A tendon on each joint, which grows by 2 m/rad."""


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        *(({"actuator": actuator}, found) for actuator, found in EFFECTS.items()),
        ({"extra": f"<tendon>{TENDONS}</tendon>"}, (0.04, 0.4, 30, 0, 0)),
    ],
)
def test_what_an_actuator_or_a_tendon_does_counts_wherever_the_model_says_it(
    parts: dict[str, str], expected: tuple[float, ...], tmp_path: Path
):
    """The differences by which it is measured are exact but for a product's rounding:
    1e-12."""
    path = written(tmp_path, plain(**parts))
    reading = read_mjcf(path)
    for joint in reading.joints:
        found = (
            joint.armature,
            joint.damping,
            joint.peak_torque,
            joint.stiffness,
            joint.actuator_damping,
        )
        assert found == pytest.approx(expected, rel=1e-12)
    assert not re.search("left out|mass matrix", " ".join(reading.notes))
    assert max(disagreement(compile_file(path)[0], reading)) < 1e-12, (
        "rounding alone is left"
    )


LEFT_OUT = {
    # 9^2 x (0.01 x 10 + 0.003 x 10^2) x 10, without the linear part
    "damping that is not viscous, 324 Nm at 10 rad/s at FR_abad, FR_hip": {
        "actuator": '<motor joint="{joint}" gear="9" damping="0.02 0.01 0.003"/>'
    },
    "damping that is not viscous, 50 Nm at 10 rad/s at FR_hip, FL_hip, RR_hip, RL_hip": {
        "joints": ["", 'damping="0.3 0.5"', ""]
    },
    # K^2 / R x gear^2
    "damping by actuators without stiffness, 1.62 Nm s/rad at FR_abad": {
        "actuator": '<dcmotor joint="{joint}" motorconst="0.1" resistance="0.5" gear="9"/>'
    },
    "damping in proportion to an actuator's command, 2 Nm s/rad at FR_abad": {
        "actuator": '<damper joint="{joint}" kv="2" ctrlrange="0 1"/>'
    },
    "forces of a fluid or against gravity": {"extra": '<option density="1.2"/>'},
    "springs parallel to joints, 7 Nm/rad at FR_knee": {
        "joints": ["", "", 'stiffness="7"']
    },
}


@pytest.mark.parametrize("note", LEFT_OUT)
def test_what_a_file_cannot_hold_is_noted(note: str, tmp_path: Path):
    reading = read(tmp_path, plain(**LEFT_OUT[note]))
    assert any(one.startswith(f"left out: {note}") for one in reading.notes)
    assert len([one for one in reading.notes if "left out" in one]) == 1
    assert reading.joints[1].damping == pytest.approx(
        {0: 1.62, 1: 0.3}.get(list(LEFT_OUT).index(note), 0.0), rel=1e-9
    )


def test_a_dc_motor_peaks_at_standstill(tmp_path: Path):
    """gear K U / R."""
    motor = '<dcmotor joint="{joint}" motorconst="0.1" resistance="0.5" gear="9" ctrlrange="-24 24"/>'
    joints = read(tmp_path, plain(actuator=motor)).joints
    assert {joint.peak_torque for joint in joints} == {43.2}


def test_a_mass_matrix_that_the_file_cannot_hold_is_noted(tmp_path: Path):
    """A rotor at one knee: the file has the mean of four, which the lightest knees feel
    the most."""
    uneven = plain().replace(
        'name="FR_knee" axis="0 1 0"', 'name="FR_knee" axis="0 1 0" armature="0.1"'
    )
    said = " ".join(read(tmp_path, uneven).notes)
    assert "armature, kg m2, at the knee differ (0.1, 0, 0, 0)" in said
    lightest = 1.5e-3 + 0.2 * 0.1**2  # kg m2, of a shank about its knee
    off = float(re.findall(r"mass matrix .* by up to (\S+)", said)[0])
    # two digits
    assert off == pytest.approx(0.025 / lightest, rel=0.01)


def test_legs_that_differ_where_a_file_has_one_number_are_noted(tmp_path: Path):
    """Fore and hind, left and right: every leg has a motor of its own, and a file one
    of abad, hip and knee."""
    hip = 'name="RL_hip" axis="0 1 0"'
    rubbing = f'{hip} range="-1.5 2.5" frictionloss="1"'
    strong = 'joint="FR_knee" ctrlrange="-45 45"'
    text = plain(joints=["", 'frictionloss="1"', 'armature="0.02"'])
    uneven = text.replace(strong.replace("45", "30"), strong).replace(rubbing, hip)
    notes = read(tmp_path, uneven).notes
    for differing in (
        "friction, Nm, at the hip differ (1, 1, 1, 0)",
        "peak torque, Nm, at the knee differ (45, 30, 30, 30)",
    ):
        assert f"the legs' {differing}: their mean is taken" in notes


@pytest.mark.parametrize(
    ("extra", "limit"), [("", 5.0), ('<option actuatorgroupdisable="3"/>', 30.0)]
)
def test_an_actuator_that_is_disabled_limits_nothing(extra, limit, tmp_path: Path):
    both = '<motor joint="{joint}" ctrlrange="-30 30"/><motor joint="{joint}" ctrlrange="-5 5" group="3"/>'
    reading = read(tmp_path, plain(actuator=both, extra=extra))
    assert [joint.peak_torque for joint in reading.joints] == [limit] * 12


def test_without_a_keyframe_every_foot_is_below_its_hip(go1: Path):
    reading = read_mjcf(go1)
    for leg, angles in zip(
        reading.anatomy.legs, np.reshape(reading.anatomy.stand, (4, 3)), strict=True
    ):
        _, hip, knee = angles
        x = leg.thigh_length * math.sin(hip) + leg.lower_length * math.sin(hip + knee)
        assert x == pytest.approx(0.0, abs=1e-9)
    assert any("keyframe" in note for note in reading.notes)


def test_hind_knees_may_bend_the_other_way(tmp_path: Path):
    reading = read(tmp_path, anymal_like())
    bends = [leg.bend for leg in reading.anatomy.legs]
    assert bends[:2] != bends[2:]
    assert [reading.joints[i].name for i in (0, 9)] == ["RF_HAA", "LH_HAA"]
    assert {joint.sign for joint in reading.joints} == {-1, 1}


# --- Feet -----------------------------------------------------------------------------


def foot(*shapes: str) -> str:
    return "".join(
        f'<geom name="{{leg}}_foot{i or ""}" mass="0" {shape}/>'
        for i, shape in enumerate(shapes)
    )


SHAPES = {
    "a sphere": foot('type="sphere" size="0.02" pos="0 0 -0.21"'),
    "a sphere at the outer side": foot(
        'type="sphere" size="0.02" pos="0 {side}e-2 -0.21"'
    ),
    "a capsule across the toe": foot(
        'type="capsule" size="0.02" fromto="0 -0.03 -0.21 0 0.03 -0.21"'
    ),
    "one turned on the left": foot(
        'type="capsule" size="0.02 0.03" pos="0 0 -0.21" euler="{side}.57079632679 0 0"'
    ),
    "one at the outer side": foot(
        'type="capsule" size="0.02" fromto="0 {side}e-2 -0.21 0 {side}e-1 -0.21"'
    ),
    "one that rounding tilts": foot(
        'type="capsule" size="0.02 0.03" pos="0 0 -0.21" euler="1.570796 0 0"'
    ),
    "one that hangs outwards": foot(
        'type="capsule" size="0.02" fromto="0 0 -0.19 0 {side}e-2 -0.21"'
    ),
    "a capsule along the shank": foot(
        'type="capsule" size="0.015" fromto="0 0 -0.02 0 0 -0.21"'
    ),
    "a capsule and a cylinder above": foot(
        'type="capsule" size="0.015" fromto="0 0 0 0 0 -0.21"',
        'type="cylinder" size="0.03" fromto="0 0 0 0 0 -0.15"',
    ),
    "spheres on either side": foot(
        'type="sphere" size="0.02" pos="0 -0.03 -0.21"',
        'type="sphere" size="0.02" pos="0 0.03 -0.21"',
    ),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_a_foot_touches_where_the_models_does_and_left_and_right_are_mirror_images(
    shape: str, tmp_path: Path
):
    """As the robot stands, in C MuJoCo: the lowest point of the model's foot is that of
    the sphere, to rounding."""
    path = written(tmp_path, plain(foot=SHAPES[shape]))
    reading, model = read_mjcf(path), compile_file(path)[0]
    right, left = (
        np.array([leg.foot for leg in reading.anatomy.legs])
        .reshape(2, 2, 3)
        .swapaxes(0, 1)
    )
    np.testing.assert_allclose(right * (1, -1, 1), left, atol=1e-9)
    data, stand = mujoco.MjData(model), np.reshape(reading.anatomy.stand, (4, 3))
    data.qpos[:7], data.qpos[7:] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), stand.ravel()
    mujoco.mj_kinematics(model, data)
    radii = reading.anatomy.geometry.foot_radius
    soles = foot_position(stand, radii, HardwareSpec(body=reading.anatomy))
    for leg, sole, radius in zip(LEGS, soles, radii, strict=True):
        names = [model.geom(geom).name for geom in range(model.ngeom)]
        feet = [i for i, name in enumerate(names) if name.startswith(f"{leg}_foot")]
        lowest = min(_lowest_point(model, data, geom) for geom in feet)
        # six digits of pi / 2 tilt a capsule by 1e-8 m
        assert sole[2] - radius == pytest.approx(lowest, abs=1e-7)


def _lowest_point(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Return the height of a sphere's, capsule's or cylinder's lowest point, m."""
    up = float(data.geom_xmat[geom].reshape(3, 3)[2, 2])
    radius, half = model.geom_size[geom, :2]
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER:
        radius *= math.sqrt(1.0 - up**2)
    half = 0.0 if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE else half
    return float(data.geom_xpos[geom, 2] - abs(up) * half - radius)


NO_SPHERES = {
    "has no sphere that could be its foot: name": foot(
        'type="box" size="0.03 0.02 0.01" pos="0 0 -0.22"'
    ),
    "has no sphere": foot(
        'type="cylinder" size="0.02" fromto="0 -0.02 -0.21 0 0.02 -0.21"'
    ),
    "has 'FR_foot', and beyond it 'FR_foot1': name": foot(
        'type="capsule" size="0.015" fromto="0 0 0 0 0 -0.2"',
        'type="box" size="0.03 0.02 0.01" pos="0 0 -0.22"',
    ),
}


@pytest.mark.parametrize("complaint", NO_SPHERES)
def test_a_foot_that_is_no_sphere_is_refused_by_name_and_may_be_named(
    complaint: str, tmp_path: Path
):
    text = plain(foot=NO_SPHERES[complaint])
    with pytest.raises(ReadingError, match=complaint):
        read(tmp_path, text)
    last = "_foot1" if "beyond" in complaint else "_foot"
    feet = [f"{leg}{last}" for leg in LEGS]
    legs = read(tmp_path, text, feet=feet, foot_radius=0.01).anatomy.legs
    assert {leg.foot_radius for leg in legs} == {0.01}
    depth = -0.21 if complaint == "has no sphere" else -0.22
    assert legs[0].foot == pytest.approx((0.0, 0.0, depth))


def test_a_urdfs_link_may_be_named_as_a_foot(tmp_path: Path):
    """A mesh is left out, and the link has nothing else."""
    mesh = '<collision><geometry><mesh filename="package://robot/foot.stl"/></geometry></collision>'
    with pytest.raises(
        ReadingError, match="name a geom, a site or a body in each foot as `feet`"
    ):
        read(tmp_path, urdf(foot=mesh))
    feet = [f"{leg}_foot" for leg in LEGS]
    anatomy = read(tmp_path, urdf(foot=mesh), feet=feet, foot_radius=0.02).anatomy
    assert [leg.foot for leg in anatomy.legs] == [(0.0, 0.0, -0.21)] * 4
    assert anatomy.mass == pytest.approx(13.2 + 4 * 0.05)


# --- What cannot be is refused by name ------------------------------------------------


def arm() -> str:
    return anymal_like().replace(
        '<body name="lidar"',
        '<body name="arm" pos="0.2 0 0.1"><joint name="arm" axis="0 1 0"/><inertial pos="0 0 0.1" mass="1" '
        'diaginertia="0.01 0.01 0.01"/></body><body name="lidar"',
    )


def six_legs() -> str:
    text, extra = anymal_like(), ""
    leg = text[text.index('<body name="LF_HIP"') : text.index('<body name="RF_HIP"')]
    for side in ("L", "R"):
        extra += leg.replace('name="LF_', f'name="{side}M_')
    return text.replace(leg, leg + extra)


def with_ankle(limited: bool) -> str:
    stop = 'range="-40 40"' if limited else ""
    return (
        anymal_like()
        .replace('_FOOT" pos', '_FOOT" gravcomp="0" pos')
        .replace(
            '<inertial pos="0.001 0 0.01"',
            f'<joint axis="0 1 0" {stop}/><inertial pos="0.001 0 0.01"',
        )
    )


REFUSED = {
    "6 limbs": six_legs,
    "5 limbs": arm,
    "a wheel cannot be": lambda: with_ankle(False),
    "an ankle cannot be": lambda: with_ankle(True),
    "the base is lost: read the URDF itself": without_a_base,
    "closes a loop": lambda: anymal_like().replace(
        "<actuator>",
        '<equality><connect body1="LF_SHANK" body2="base" anchor="0 0 0"/></equality><actuator>',
    ),
    "couples joints": lambda: anymal_like().replace(
        "<actuator>",
        '<tendon><fixed><joint joint="LF_HFE" coef="1"/><joint joint="LF_KFE" coef="1"/></fixed></tendon><actuator>',
    ),
    "other joint axes cannot be": lambda: anymal_like().replace(
        '_KFE" axis="0 ', '_KFE" axis="0.1 '
    ),
    "the mass of body 'LF_SHANK' comes from a mesh": lambda: re.sub(
        '<inertial pos="0.01 0.02 -0.1" mass="0.35".*/>',
        '<geom type="mesh" mesh="shell"/>',
        anymal_like(),
    ),
    "not an MJCF": lambda: "<mujoco><worldbody>",
    "holds the name '\\x1b[31m', which no terminal can show": lambda: plain().replace(
        'body name="trunk"', 'body name="&#27;[31m"'
    ),
    "does not tell which leg is which": lambda: anymal_like().replace(
        'pos="-0.', 'pos="0.'
    ),
}


@pytest.mark.parametrize("complaint", REFUSED)
def test_what_cannot_be_is_refused_by_name(complaint: str, tmp_path: Path):
    path = written(tmp_path, REFUSED[complaint]())
    with pytest.raises(ReadingError) as refusal:
        read_mjcf(path)
    line = re.escape(str(path)) + ".*" + re.escape(complaint) + ".*"
    assert re.fullmatch(line, str(refusal.value))


def test_a_base_that_is_fixed_becomes_free(tmp_path: Path):
    """An MJCF's as a URDF's; its keyframe, too, then has the base's place in front."""
    stand = '<keyframe><key name="home" qpos="{}0 .8 -1.5 0 .8 -1.5 0 .8 -1.5 0 .8 -1.5"/></keyframe>'
    fixed, free = (plain(extra=stand.format(x)) for x in ("", "0 0 .4 1 0 0 0 "))
    theirs = read(tmp_path, free)
    ours = read(tmp_path, fixed.replace("<freejoint/>", ""))
    assert ours.anatomy == theirs.anatomy
    told = "body 'trunk' was fixed to the world: it got a free joint"
    assert ours.notes == (told, *theirs.notes)
    torques = f'<keyframe><key name="torques" ctrl="{"1 " * 12}"/></keyframe>'
    control = read(tmp_path, plain(extra=torques).replace("<freejoint/>", ""))
    assert control.anatomy.mass == ours.anatomy.mass


def test_an_inertia_that_no_body_has_becomes_the_nearest_that_one_has(tmp_path: Path):
    """Of moments 1, 1 and 3 the third becomes 2, as a flat plate's; about the same
    axes, and noted."""
    moments = '<inertia ixx="1e-3" iyy="2e-3" izz="2e-3" ixy="0" ixz="0" iyz="-1e-3"/>'
    thigh = '<mass value="1"/><inertia ixx="5e-3" iyy="5e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>'
    reading = read(tmp_path, urdf().replace(thigh, '<mass value="1"/>' + moments))
    np.testing.assert_allclose(
        [leg.thigh.inertia for leg in reading.anatomy.legs],
        [[1e-3, 1.5e-3, 1.5e-3, 0, 0, -0.5e-3]] * 4,
        rtol=1e-8,
        atol=1e-12,
    )
    names = "FR_thigh, FL_thigh, RR_thigh, RL_thigh"
    assert (
        f"no body can have the inertia of {names}: the nearest that one can have is taken"
        in reading.notes
    )


EQUAL_MOMENTS = (
    '<inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="1e-6" ixz="1e-6" iyz="1e-6"/>'
)
"""As descriptions have it of a link that stands for nothing; two of the principal
moments are 0."""


@pytest.mark.parametrize("root", ["", "dummy", "world"])
def test_the_urdf_of_a_robot_is_the_robot(root: str, tmp_path: Path):
    """As the same robot's MJCF has it, base included; some URDFs hang it below a link
    without a mass."""
    theirs, ours = read(tmp_path, plain()), read(tmp_path, urdf(root=root))
    assert ours.anatomy.mass == pytest.approx(13.2, rel=1e-12)
    links = [link_numbers(reading.anatomy) for reading in (ours, theirs)]
    np.testing.assert_allclose(*links, rtol=1e-12, atol=1e-15)
    assert leg_numbers(ours.anatomy) == leg_numbers(theirs.anatomy)
    assert {(joint.peak_torque, joint.speed) for joint in ours.joints} == {(30.0, 20.0)}
    assert any("got a free joint" in note for note in ours.notes)
    massive = f'<inertial><mass value="1e-6"/>{EQUAL_MOMENTS}</inertial>'
    mended = read(tmp_path, urdf(root=root, rooted=massive))
    assert mended.anatomy.mass == pytest.approx(13.2, rel=1e-6), "1e-6 kg on top"
    assert ("no body can have the inertia" in " ".join(mended.notes)) == bool(root)
    path = written(tmp_path, urdf(velocity="fast", root=root))
    speeds = {joint.speed for joint in read_mjcf(path).joints}
    assert speeds == {math.inf}, "no number is no limit"
    assert max(disagreement(compile_file(path)[0], ours)) < 1e-12, (
        "rounding alone is left"
    )


def test_named_joints_weld_the_others(tmp_path: Path):
    names = [
        f"{leg}_{joint}"
        for leg in ("RF", "LF", "RH", "LH")
        for joint in ("HAA", "HFE", "KFE")
    ]
    bare = read(tmp_path, anymal_like()).anatomy
    armed = read(tmp_path, arm(), joints=names).anatomy
    assert armed.mass == pytest.approx(bare.mass + 1.0)
    assert armed.legs == bare.legs


@pytest.mark.parametrize(
    ("named", "complaint"),
    [
        ({"joints": ["FR_hip_joint"] * 12}, "12 names"),
        ({"feet": ["FR", "FL", "RR", "HL"]}, "no such geom, site or body"),
        ({"feet": ["FL", "FR", "RR", "RL"]}, "last link of its leg"),
    ],
)
def test_names_that_are_wrong_are_refused(named, complaint: str, go1: Path):
    with pytest.raises(ReadingError, match=complaint):
        read_mjcf(go1, **named)


def test_a_foot_of_another_shape_needs_a_radius(tmp_path: Path):
    with pytest.raises(ReadingError, match="foot_radius"):
        read(tmp_path, sprung(), feet=["fr_pad", "fl_pad", "rr_pad", "rl_pad"])
