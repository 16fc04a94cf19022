"""One truth: the numbers in the XML are those of bp2.py, and bp2.py's are the
paper's."""

import functools
import math

import mujoco
import numpy as np
import pytest

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.conventions import LEGS, MOTOR_NAMES
from bp2_rl.robot.hardware import BUILT, IDEAL, HardwareSpec, robot_name
from bp2_rl.robot.model import FOOT_GEOMS, SPRING_QVEL, load_model

assert_same = functools.partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-12)


@pytest.fixture(scope="module")
def xml() -> mujoco.MjModel:
    """The hand-written file as it stands, with no HardwareSpec applied."""
    return mujoco.MjModel.from_xml_path(str(asset_path("bp2_mjcf/bp2.xml")))


def test_table_s3_is_a_quarter_of_the_robot():
    quarter = bp2.TRUNK_QUARTER_MASS + bp2.THIGH_MASS + bp2.SHANK_MASS + bp2.TOE_MASS
    assert 4 * quarter == pytest.approx(35.8)


def test_scaling_numbers_of_the_paper():
    """m g v / (tau w) and the Froude number at 10.74 m/s follow from the published
    parts."""
    v = bp2.OUTDOOR_TOP_SPEED
    power_ratio = (
        bp2.TOTAL_MASS * conventions.GRAVITY * v / (bp2.PEAK_TORQUE * bp2.NO_LOAD_SPEED)
    )
    # 1.477; with g = 9.80 the printed number
    assert power_ratio == pytest.approx(1.475, rel=2e-3)
    assert v**2 / (conventions.GRAVITY * bp2.STANDING_HEIGHT) == pytest.approx(
        21.4, abs=0.05
    )


def test_corner_speed_is_the_least_that_gives_the_published_power():
    power = bp2.PEAK_TORQUE * bp2.CORNER_SPEED
    assert power == pytest.approx(1765.0, rel=1e-3)


def test_xml_applying_the_default_hardware_changes_nothing(xml):
    scene = mujoco.MjModel.from_xml_path(str(asset_path("bp2_mjcf/scene_flat.xml")))
    applied = load_model()
    for field in dir(scene):
        written, loaded = getattr(scene, field), getattr(applied, field)
        if isinstance(written, np.ndarray) and np.issubdtype(written.dtype, np.number):
            assert_same(loaded, written, err_msg=field)
    assert scene.opt.timestep == conventions.PHYSICS_STEP
    assert xml.nbody == applied.nbody


@pytest.mark.parametrize("leg", LEGS)
def test_xml_leg_masses_and_inertias(xml, leg):
    thigh, shank, toe, abad = (
        xml.body(f"{leg}_{part}") for part in ("thigh", "shank", "toe", "abad")
    )
    fore = 1.0 if leg[0] == "F" else -1.0
    assert [b.mass[0] for b in (abad, thigh, shank, toe)] == [
        bp2.ABAD_MASS,
        bp2.THIGH_MASS,
        bp2.SHANK_MASS,
        bp2.TOE_MASS,
    ]
    assert_same(abad.inertia, [bp2.ABAD_INERTIA] * 3)
    assert_same(
        thigh.inertia, [bp2.THIGH_INERTIA, bp2.THIGH_INERTIA, bp2.THIGH_TWIST_INERTIA]
    )
    assert_same(
        shank.inertia, [bp2.SHANK_INERTIA, bp2.SHANK_INERTIA, bp2.SHANK_TWIST_INERTIA]
    )
    assert_same(toe.inertia, [bp2.TOE_INERTIA] * 3)
    assert_same(abad.ipos, [fore * bp2.ABAD_COM_FORE_AFT, 0, 0])
    assert_same(thigh.ipos, [0, 0, -bp2.THIGH_COM])
    assert_same(shank.ipos, [0, 0, -(bp2.SHANK_LENGTH + bp2.SHANK_COM)])
    assert_same(toe.ipos, [0, 0, -(bp2.TOE_LENGTH + bp2.TOE_COM)])


@pytest.mark.parametrize("leg", LEGS)
def test_xml_leg_geometry(xml, leg):
    fore, side = (1.0 if leg[0] == "F" else -1.0), (1.0 if leg[1] == "L" else -1.0)
    lateral = abs(IDEAL.bp2.hip_laterals[conventions.LEGS.index(leg)])
    assert_same(
        xml.body(f"{leg}_abad").pos, [fore * bp2.HIP_FORE_AFT, side * lateral, 0]
    )
    assert_same(xml.body(f"{leg}_thigh").pos, [0, side * bp2.THIGH_LATERAL, 0])
    assert_same(xml.body(f"{leg}_shank").pos, [0, 0, -bp2.THIGH_LENGTH])
    toe = bp2.SHANK_LENGTH + bp2.SPRING_REST_LENGTH
    assert_same(xml.body(f"{leg}_toe").pos, [0, 0, -toe])
    assert_same(xml.site(f"{leg}_sole").pos, [0, 0, -bp2.TOE_LENGTH])
    foot = xml.geom(f"{leg}_foot")
    assert foot.size[0] == bp2.FOOT_RADIUS
    assert_same(foot.pos, [0, 0, bp2.FOOT_RADIUS - bp2.TOE_LENGTH])


@pytest.mark.parametrize("leg", LEGS)
def test_xml_solid_legs(xml, leg):
    """Radius, where the axis begins and ends below the joint above it; of the toe,
    below the knee at rest."""
    toe = bp2.SHANK_LENGTH + bp2.SPRING_REST_LENGTH
    for part, radius, start, end in (
        ("thigh", bp2.THIGH_RADIUS, 0.0, bp2.THIGH_LENGTH),
        ("shank", bp2.LOWER_LEG_RADIUS, 0.0, bp2.SHANK_REACH),
        (
            "toe",
            bp2.LOWER_LEG_RADIUS,
            bp2.RODS_BELOW_KNEE - toe,
            bp2.TOE_LENGTH - bp2.FOOT_RADIUS,
        ),
    ):
        geom = xml.geom(f"{leg}_solid_{part}")
        assert_same(geom.size[:2], [radius, (end - start) / 2])
        assert_same(geom.pos, [0, 0, -(start + end) / 2])
        assert_same(geom.friction[0], bp2.LEG_FRICTION)
        assert_same(geom.solref, [bp2.LEG_CONTACT_TIME, 1])
        assert geom.priority[0] > xml.geom(f"{leg}_foot").priority[0]


def test_xml_trunk(xml):
    trunk = xml.body("trunk")
    abads = 4 * (
        bp2.ABAD_INERTIA
        + bp2.ABAD_MASS * (bp2.HIP_FORE_AFT + bp2.ABAD_COM_FORE_AFT) ** 2
    )
    assert trunk.mass[0] == pytest.approx(
        4 * (bp2.TRUNK_QUARTER_MASS - bp2.ABAD_MASS), rel=1e-12
    )
    assert_same(
        trunk.inertia,
        [
            bp2.TRUNK_ROLL_INERTIA,
            bp2.TRUNK_PITCH_INERTIA - abads,
            bp2.TRUNK_YAW_INERTIA,
        ],
    )
    assert_same(trunk.ipos, 0.0)
    for name, side in (("trunk_right", -1.0), ("trunk_left", 1.0)):
        geom = xml.geom(name)
        assert_same(geom.size[:2], [bp2.TRUNK_RADIUS, bp2.TRUNK_REACH])
        assert_same(geom.pos, [0, side * bp2.TRUNK_LATERAL, 0])
        assert_same(np.abs(geom.quat) @ [1, 0, 1, 0], np.sqrt(2.0))  # along x


def test_xml_joints_springs_motors_and_friction(xml):
    for leg in LEGS:
        for joint, joint_range in (
            ("abad", bp2.ABAD_RANGE),
            ("hip", bp2.HIP_RANGE),
            ("knee", bp2.KNEE_RANGE),
        ):
            assert_same(xml.joint(f"{leg}_{joint}").range, joint_range)
            assert xml.joint(f"{leg}_{joint}").armature[0] == pytest.approx(
                IDEAL.reflected_inertia, rel=1e-12
            )
        spring, stop = xml.joint(f"{leg}_spring"), xml.tendon(f"{leg}_stop").id
        assert (spring.stiffness[0], spring.damping[0]) == (
            bp2.SPRING_STIFFNESS,
            bp2.SPRING_DAMPING,
        )
        assert xml.tendon_stiffness[stop] == bp2.SPRING_STOP_STIFFNESS
        assert_same(xml.tendon_lengthspring[stop], [0.0, bp2.SPRING_TRAVEL])
    assert [xml.actuator(i).name for i in range(xml.nu)] == list(MOTOR_NAMES)
    assert_same(xml.actuator_forcerange, [[-bp2.PEAK_TORQUE, bp2.PEAK_TORQUE]] * 12)
    assert {xml.geom(name).friction[0] for name in FOOT_GEOMS} == {bp2.FOOT_FRICTION}
    assert not xml.dof_armature[SPRING_QVEL].any()
    assert xml.opt.gravity[2] == -conventions.GRAVITY


def test_every_number_has_a_unit_and_a_source():
    assert len(conventions.PROVENANCE) > 40
    for number in conventions.PROVENANCE:
        assert math.isfinite(number.value)
        assert number.unit
        assert number.source.startswith(("paper", "DERIVED", "ASSUMED", "standard"))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"gear_ratio": 0.0}, "gear_ratio must be from 0.1 to 1000, got 0"),
        ({"leg_length": float("nan")}, "leg_length must be from 0 to 10, got nan"),
        ({"leg_length": 0.2}, "leg_length .* must exceed shank"),
        (
            {"spring_stiffness": -1.0},
            "spring_stiffness must be from 100 to 1e.07, got -1",
        ),
        ({"corner_speed": 21.4}, "corner_speed .* must be below no_load_speed"),
        ({"mass_scale": float("inf")}, "mass_scale must be from 0.01 to 100, got inf"),
        *(
            ({name: 1e308}, f"hardware.*{name} must be .*, got 1e.308")
            for name in ("leg_length", "mass_scale", "friction")
        ),
        ({"rotor_inertia": 1e308}, "rotor_inertia must be from 0 to 10"),
        (
            {"thigh_mass": 7.0},
            r"thigh_mass \(7\) and toe_mass \(0.5\) must leave the trunk 7.2 kg: .* at most 7.05 kg",
        ),
    ],
)
def test_impossible_hardware_is_refused_in_one_line(change, says):
    with pytest.raises(UserError, match=says) as refusal:
        IDEAL.changed(**change)
    assert "\n" not in str(refusal.value)


def test_a_robot_has_a_name_if_it_is_one_of_those_with_names():
    assert [robot_name(robot) for robot in (IDEAL, BUILT)] == ["ideal", "built"]
    assert robot_name(HardwareSpec(friction=0.5)) is None


def test_gear_ratio_scales_torque_speed_and_inertia():
    geared = HardwareSpec(gear_ratio=17.0)
    assert geared.joint_peak_torque == pytest.approx(2 * IDEAL.joint_peak_torque)
    assert geared.joint_no_load_speed == pytest.approx(IDEAL.joint_no_load_speed / 2)
    assert geared.joint_corner_speed == pytest.approx(IDEAL.joint_corner_speed / 2)
    assert geared.reflected_inertia == pytest.approx(4 * IDEAL.reflected_inertia)
