"""BP2's numbers agree: those in the XML with bp2.py's, and bp2.py's with the
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
from bp2_rl.robot.hardware import BUILT, IDEAL, REAL, ROBOTS, HardwareSpec, robot_name
from bp2_rl.robot.model import SPRING_QVEL, load_model

assert_same = functools.partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-12)


@pytest.fixture(scope="module")
def xml() -> mujoco.MjModel:
    """Return the model of the hand-written file as it stands, with no HardwareSpec
    applied."""
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
def test_xml_solid_legs(xml, leg):
    """How they touch; their sizes are `test_building`'s."""
    for part in ("thigh", "shank", "toe"):
        geom = xml.geom(f"{leg}_solid_{part}")
        assert_same(geom.friction[0], bp2.LEG_FRICTION)
        assert_same(geom.solref, [bp2.LEG_CONTACT_TIME, 1])
        assert geom.priority[0] > xml.geom(f"{leg}_foot").priority[0]


def test_xml_joints_and_gravity(xml):
    """What else is said of joints, springs, motors and feet `HardwareSpec` applies."""
    ranges = [bp2.ABAD_RANGE, bp2.HIP_RANGE, bp2.KNEE_RANGE] * len(LEGS)
    assert_same([xml.joint(name).range for name in MOTOR_NAMES], ranges)
    assert [xml.actuator(i).name for i in range(xml.nu)] == list(MOTOR_NAMES)
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
        ({"gear_raito": 7.0}, "no parameter gear_raito"),
        ({"mass": 30.0}, "no parameter mass"),  # a property
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
    assert [robot_name(robot) for robot in (IDEAL, BUILT, REAL)] == [*ROBOTS]
    assert robot_name(HardwareSpec(friction=0.5)) is None


def test_gear_ratio_scales_torque_speed_and_inertia():
    geared = HardwareSpec(gear_ratio=17.0)
    assert geared.joint_peak_torque == pytest.approx(2 * IDEAL.joint_peak_torque)
    assert geared.joint_no_load_speed == pytest.approx(IDEAL.joint_no_load_speed / 2)
    assert geared.joint_corner_speed == pytest.approx(IDEAL.joint_corner_speed / 2)
    assert geared.reflected_inertia == pytest.approx(4 * IDEAL.reflected_inertia)
