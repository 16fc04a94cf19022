"""The room between legs: the closed form against MuJoCo's own distances, and solid legs
that stop each other."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from bp2_rl.robot import bp2
from bp2_rl.robot.clearance import clearance, segment_distance
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.hardware import IDEAL, HardwareSpec
from bp2_rl.robot.kinematics import foot_position
from bp2_rl.robot.model import (
    FOOT_GEOMS,
    MOTOR_QPOS,
    MOTOR_QVEL,
    SPRING_QPOS,
    TRUNK_GEOMS,
    let_converge,
    load_model,
)

SOLID = IDEAL.changed(solid_legs=True, hind_track=0.26, leg_length=0.36)
FAR = 10.0  # m, up to which MuJoCo measures


def postures(
    number: int, hardware: HardwareSpec = SOLID
) -> tuple[np.ndarray, np.ndarray]:
    """Draw joint angles all over their ranges, and compressions from topped out to on
    the stop: from apart to crossed legs."""
    rng = np.random.default_rng(0)
    ranges = np.array([bp2.ABAD_RANGE, bp2.HIP_RANGE, bp2.KNEE_RANGE])
    joints = rng.uniform(ranges[:, 0], ranges[:, 1], (number, 4, 3))
    return joints, rng.uniform(-0.01, hardware.spring_travel + 0.01, (number, 4))


def test_clearances_are_what_mujoco_measures():
    """Over the pairs of the model's own capsules and spheres; 1e-6 m is the tolerance
    of MuJoCo's distance."""
    model = load_model(SOLID, visual=False)
    data = mujoco.MjData(model)
    parts = {
        leg: [
            model.geom(f"{leg}_{part}").id
            for part in ("solid_thigh", "solid_shank", "solid_toe", "foot")
        ]
        for leg in LEGS
    }
    trunk = [model.geom(name).id for name in TRUNK_GEOMS]
    pairs = [
        (a, b)
        for leg in LEGS
        for other in LEGS
        if leg < other
        for a in parts[leg]
        for b in parts[other]
    ]
    trunk_pairs = [(a, b) for leg in LEGS for a in parts[leg] for b in trunk]
    joints, compression = postures(200)
    measured = []
    for q, c in zip(joints, compression, strict=True):
        data.qpos[3:7] = 1.0, 0.0, 0.0, 0.0
        data.qpos[MOTOR_QPOS], data.qpos[SPRING_QPOS] = q.ravel(), c
        mujoco.mj_kinematics(model, data)
        measured.append(
            [
                min(mujoco.mj_geomDistance(model, data, a, b, FAR, None) for a, b in of)
                for of in (pairs, trunk_pairs)
            ]
        )
    found = clearance(joints, compression, SOLID)
    for each in found:
        assert (each < 0.0).any()
        assert (each > 0.0).any()
    np.testing.assert_allclose(np.stack(found, axis=-1), measured, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(found.least, np.minimum(*found))


def test_jax_says_the_same_in_float32():
    """1e-5 m: segments that are nearly parallel lose digits."""
    joints, compression = postures(1000)
    exact = clearance(joints, compression, SOLID)
    found = jax.jit(lambda q, c: clearance(q, c, SOLID))(
        *(jnp.asarray(x, jnp.float32) for x in (joints, compression))
    )
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("segments", "distance"),
    [
        (((0, 0, 0), (1, 0, 0), (0, 2, 0), (1, 2, 0)), 2.0),  # side by side
        (((0, 0, 0), (1, 0, 0), (3, 0, 4), (5, 0, 4)), 20**0.5),  # parallel, end to end
        (((0, 0, 0), (1, 0, 0), (2, 0, 0), (5, 0, 0)), 1.0),  # in line
        (((-1, 0, 0), (1, 0, 0), (0, -1, 3), (0, 1, 3)), 3.0),  # crosswise
        (((0, 0, 0), (0, 0, 0), (3, 4, 0), (3, 4, 0)), 5.0),  # points
        (((0, 0, 0), (0, 0, 0), (-1, 1, 0), (1, 1, 0)), 1.0),  # a point and a segment
    ],
)
def test_distance_of_segments_that_one_can_see(segments, distance):
    assert segment_distance(*np.array(segments, float)) == pytest.approx(
        distance, abs=1e-12
    )


def press(hardware: HardwareSpec) -> tuple[np.ndarray, np.ndarray, int]:
    """Pull hind legs in the air together with 10 Nm; return by ms the gaps (m) and how
    far RL's sole is left of RR's (m), and the last number of contacts."""
    model = load_model(hardware, visual=False)
    let_converge(model)
    model.opt.gravity[:] = 0.0
    data, gaps, order = mujoco.MjData(model), [], []
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    data.qpos[2], data.qpos[SPRING_QPOS] = 2.0, 0.0
    rear = np.array([6, 9])  # abduction of RR and RL
    for _ in range(400):
        data.ctrl[:] = -3.0 * data.qvel[MOTOR_QVEL]
        data.ctrl[rear] += [10.0, -10.0]
        mujoco.mj_step(model, data)
        posture = data.qpos[MOTOR_QPOS].reshape(4, 3), data.qpos[SPRING_QPOS], hardware
        gaps.append(clearance(*posture).legs)
        order.append(np.diff(foot_position(*posture)[2:, 1])[0])
    return np.array(gaps), np.array(order), data.ncon


def test_solid_legs_stop_each_other_and_others_pass():
    """Contacts are soft: legs that meet at 3 m/s enter each other by less than 15 mm,
    what they travel in 5 ms."""
    gaps, order, contacts = press(HardwareSpec(solid_legs=True))
    assert gaps[0] > 0.2
    assert contacts > 0
    assert gaps.min() > -0.015
    assert -0.001 < gaps[-1] < 0.0  # they lie against each other
    assert order.min() > 0.02
    gaps, order, contacts = press(HardwareSpec())
    assert contacts == 0
    assert gaps.min() < -0.02
    assert order[-1] < -0.05


def test_solid_legs_touch_legs_and_trunk_but_neither_themselves_nor_the_floor():
    model = load_model(HardwareSpec(solid_legs=True), visual=False)
    names = [model.geom(i).name for i in range(model.ngeom)]
    parts = {name: name[:2] for name in names if "solid" in name or name in FOOT_GEOMS}
    for i, first in enumerate(names):
        for j, second in enumerate(names):
            meet = bool(model.geom_contype[i] & model.geom_conaffinity[j]) or bool(
                model.geom_contype[j] & model.geom_conaffinity[i]
            )
            legs = [parts[name] for name in (first, second) if name in parts]
            if len(legs) == 2:
                assert meet == (legs[0] != legs[1]), (first, second)
            elif len(legs) == 1:
                other = second if first in parts else first
                foot = first in FOOT_GEOMS or second in FOOT_GEOMS
                assert meet == (other in TRUNK_GEOMS or foot), (first, second)


def test_training_has_feet_as_its_only_contacts_however_solid_the_legs():
    plain, solid = (
        load_model(HardwareSpec(solid_legs=x), visual=False, feet_only=True)
        for x in (False, True)
    )
    assert plain.ngeom == solid.ngeom
    for field in ("geom_contype", "geom_conaffinity", "geom_type", "geom_size"):
        np.testing.assert_array_equal(getattr(solid, field), getattr(plain, field))
