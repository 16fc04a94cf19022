"""Robots from tables of published numbers, and BP2 on other legs, against C MuJoCo and
closed forms."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.paper.published import read_robots
from bp2_rl.paper.scaling.robots import (
    bp2_variants,
    on_legs_of,
    read_legs,
    rigid_robot,
    rigid_shanks,
)
from bp2_rl.robot.anatomy import Anatomy
from bp2_rl.robot.hardware import BUILT, HardwareSpec
from bp2_rl.robot.model import load_spec

MASSES = {robot.robot: robot.mass for robot in read_robots()}
LEGS = {legs.robot: legs for legs in read_legs()}


def leg_share(anatomy: Anatomy) -> float:
    """Return the share of a robot's mass that is in its legs from the thighs down."""
    legs = sum(link.mass for leg in anatomy.legs for link in leg.links[1:])
    return legs / anatomy.mass


def inertia(hardware: HardwareSpec) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass, centre of mass and inertia about it of a robot that hangs with
    straight legs, in C MuJoCo."""
    model = load_spec(hardware).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = np.eye(1, model.nq, 3)[0]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mass, center, total = (
        float(model.body_mass.sum()),
        np.array(data.subtree_com[1]),
        np.zeros((3, 3)),
    )
    for body in range(1, model.nbody):
        turn, away = data.ximat[body].reshape(3, 3), data.xipos[body] - center
        steiner = model.body_mass[body] * (
            away @ away * np.eye(3) - np.outer(away, away)
        )
        total += turn @ np.diag(model.body_inertia[body]) @ turn.T + steiner
    return mass, center, total


@pytest.mark.parametrize("name", LEGS)
def test_a_tabled_robot_weighs_what_is_published(name):
    robot = rigid_robot(LEGS[name], MASSES[name])
    assert robot.mass == pytest.approx(MASSES[name], rel=1e-9)
    assert not robot.anatomy.sprung
    assert (
        robot.anatomy.legs[1].reach()[1]
        <= LEGS[name].thigh + LEGS[name].shank + LEGS[name].foot_radius
    )
    # every robot's: Aliengo's heavy motors are in its abduction
    assert 0.1 < leg_share(robot.anatomy) < 0.4


def test_a_foot_is_a_point_at_the_shanks_end():
    legs = dataclasses.replace(LEGS["Unitree A1"], foot_mass=0.5)
    assert legs.shank_mass is not None
    assert legs.shank_com is not None
    assert legs.shank_inertia is not None
    shank = rigid_robot(legs, 13.7).anatomy.legs[0].shank
    mass, com = (
        legs.shank_mass + 0.5,
        (legs.shank_mass * legs.shank_com + 0.5 * legs.shank) / (legs.shank_mass + 0.5),
    )
    about_knee = (
        legs.shank_inertia + legs.shank_mass * legs.shank_com**2 + 0.5 * legs.shank**2
    )
    assert (shank.mass, -shank.com[2]) == pytest.approx((mass, com))
    assert shank.inertia[1] + mass * com**2 == pytest.approx(about_knee)


def test_legs_that_are_heavier_than_the_robot_are_refused():
    with pytest.raises(UserError, match="heavier than its 3 kg"):
        rigid_robot(LEGS["Unitree A1"], 3.0)


def test_welding_the_toes_moves_no_mass():
    sprung, rigid = inertia(BUILT), inertia(rigid_shanks(BUILT))
    for one, other in zip(sprung, rigid, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-12)


def test_on_ones_own_legs_one_stays_as_one_is():
    rigid = rigid_shanks(BUILT)
    for one, other in zip(
        inertia(rigid), inertia(on_legs_of(rigid.anatomy, rigid)), strict=True
    ):
        np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-12)


def test_other_legs_are_scaled_to_bp2s_mass():
    go2 = rigid_robot(LEGS["Unitree Go2"], MASSES["Unitree Go2"])
    variants = bp2_variants({"x": go2})
    scale = (BUILT.anatomy.mass / go2.anatomy.mass) ** (1.0 / 3.0)
    for name, variant in variants.items():
        assert variant.anatomy.mass == pytest.approx(BUILT.anatomy.mass), name
        assert variant.peak_torque == BUILT.peak_torque, name
    other = variants["BP2, rigid legs of x"].anatomy
    assert other.leg_length == pytest.approx(scale * go2.anatomy.leg_length)
    assert leg_share(other) == pytest.approx(leg_share(go2.anatomy))
    assert math.isclose(
        leg_share(variants["BP2, thighs x 2"].anatomy),
        leg_share(BUILT.anatomy) + 4.0 * 2.2 / 35.8,
    )
