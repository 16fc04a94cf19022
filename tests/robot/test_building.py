"""A model built from an Anatomy is BP2's hand-written one where the Anatomy is BP2's,
and any other stands, too."""

import dataclasses
import functools

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from odd_robots import anymal_like
from scipy.spatial.transform import Rotation

from bp2_rl.base.assets import asset_path
from bp2_rl.robot.anatomy import Anatomy, six
from bp2_rl.robot.building import build_spec, standing
from bp2_rl.robot.conventions import MOTOR_NAMES
from bp2_rl.robot.hardware import IDEAL, HardwareSpec
from bp2_rl.robot.model import (
    SOLE_SITES,
    TRUNK_GEOMS,
    foot_geom_ids,
    load_model,
)
from bp2_rl.robot.reading import read_mjcf
from bp2_rl.robot.robot_file import load_robot


@pytest.fixture(scope="module")
def bp2() -> Anatomy:
    """Return the Anatomy of BP2, with the numbers of `robot.bp2`."""
    return IDEAL.anatomy


@pytest.fixture(scope="module")
def rigid(tmp_path_factory: pytest.TempPathFactory) -> Anatomy:
    path = tmp_path_factory.mktemp("odd") / "robot.xml"
    path.write_text(anymal_like())
    return read_mjcf(path).anatomy


def names(model: mujoco.MjModel, kind: str, count: int) -> list[str]:
    return [name for i in range(count) if (name := getattr(model, kind)(i).name)]


def inertia_in_body(model: mujoco.MjModel, body: int) -> np.ndarray:
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[body])
    return axes.reshape(3, 3) @ np.diag(model.body_inertia[body]) @ axes.reshape(3, 3).T


def accelerations(model: mujoco.MjModel, seed: int) -> np.ndarray:
    """Return what a random state with loaded feet does under random torques."""
    draws, data = np.random.default_rng(seed), mujoco.MjData(model)
    data.qpos[:] = load_model().key("stand").qpos + 0.02 * draws.normal(size=model.nq)
    data.qvel[:] = draws.normal(size=model.nv)
    data.ctrl[:] = 10.0 * draws.normal(size=model.nu)
    mujoco.mj_normalizeQuat(model, data.qpos)
    mujoco.mj_forward(model, data)
    assert data.ncon > 0
    return data.qacc.copy()


def test_the_model_built_of_bp2s_numbers_is_bp2s(bp2: Anatomy):
    """The XML by hand has the numbers of `robot.bp2`."""
    named = dataclasses.replace(bp2, name="bp2 on flat ground")
    built, written = build_spec(named).compile(), load_model(solid_free(IDEAL))
    assert (built.nq, built.nv, built.nu) == (written.nq, written.nv, written.nu)
    for kind, count in (
        ("body", "nbody"),
        ("joint", "njnt"),
        ("actuator", "nu"),
        ("sensor", "nsensor"),
        ("site", "nsite"),
        ("tendon", "ntendon"),
        ("camera", "ncam"),
        ("light", "nlight"),
    ):
        ours = names(built, kind, getattr(built, count))
        assert ours == names(written, kind, getattr(written, count))
    solids = names(built, "geom", built.ngeom)
    assert set(solids) == set(names(written, "geom", written.ngeom))
    close = functools.partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-12)
    for i in range(1, built.nbody):
        close(built.body(i).mass, written.body(i).mass)
        # the trunk is placed by the keyframe
        for field in ("pos", "ipos") if i > 1 else ("ipos",):
            close(getattr(built.body(i), field), getattr(written.body(i), field))
        ours, theirs = inertia_in_body(built, i), inertia_in_body(written, i)
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-18)
    for sole in SOLE_SITES:
        close(built.site(sole).pos, written.site(sole).pos)
    for beam in TRUNK_GEOMS:
        close(built.geom(beam).quat, written.geom(beam).quat)
    for name in solids:
        ours, theirs = built.geom(name), written.geom(name)
        for field in ("size", "pos") if name != "floor" else ():
            close(getattr(ours, field), getattr(theirs, field), err_msg=name)
        for field in [
            "friction",
            "solref",
            "contype",
            "conaffinity",
            "priority",
            "condim",
        ]:
            np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field))


@settings(deadline=None, max_examples=30)  # the first example reads the scene
@given(
    moments=st.tuples(st.floats(1e-6, 1.0), st.floats(1e-6, 1.0)),
    turn=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
)
def test_a_flat_plate_is_built_however_it_is_turned(moments, turn):
    """Of a plate the largest moment is the sum of the others, which rounding exceeds in
    two cases of five."""
    axes = Rotation.from_euler("xyz", turn).as_matrix()
    plate = np.array([*moments, sum(moments)])
    go1 = load_robot(asset_path("robots/go1.toml")).anatomy
    trunk = dataclasses.replace(go1.trunk, inertia=six(axes @ np.diag(plate) @ axes.T))
    built = build_spec(dataclasses.replace(go1, trunk=trunk)).compile()
    # eigh loses 1e-16 of the largest moment.
    np.testing.assert_allclose(
        np.sort(built.body("trunk").inertia), np.sort(plate), rtol=1e-9, atol=1e-14
    )


def solid_free(hardware):
    return dataclasses.replace(hardware, solid_legs=False)


@pytest.mark.parametrize("seed", range(5))
def test_bp2_built_and_bp2_written_move_alike(bp2: Anatomy, seed: int):
    ours, theirs = (
        accelerations(model, seed)
        for model in (build_spec(bp2).compile(), load_model())
    )
    # the solver's own tolerance is 1e-8
    np.testing.assert_allclose(ours, theirs, atol=1e-9 * np.abs(theirs).max())


def test_what_hardware_changes_in_bp2_it_changes_in_a_built_model(bp2: Anatomy):
    hardware = HardwareSpec(body=bp2, gear_ratio=bp2.gear_ratio, solid_legs=True)
    model = load_model(hardware, visual=False, weighed=True)
    assert model.nsensordata == 12
    assert model.actuator_forcerange.max() == IDEAL.joint_peak_torque
    solid = dataclasses.replace(IDEAL, solid_legs=True)
    assert model.ngeom == load_model(solid, visual=False).ngeom


def test_a_rigid_shank_has_no_spring_and_both_cameras_see_it(rigid: Anatomy):
    model = build_spec(rigid).compile()
    assert (model.nq, model.nv, model.nu) == (19, 18, 12)
    assert (model.ntendon, model.nmesh) == (0, 0)
    driven = [model.joint(joint).name for joint in model.actuator_trnid[:, 0]]
    assert driven == list(MOTOR_NAMES)
    assert {"track", "front"} <= set(names(model, "camera", model.ncam))


def test_full_inertias_are_kept_and_scale_with_the_mass(rigid: Anatomy):
    twice = HardwareSpec(body=rigid, mass_scale=2.0)
    doubled, once = load_model(twice), build_spec(rigid).compile()
    for i in range(1, once.nbody):
        ours, theirs = inertia_in_body(doubled, i), 2.0 * inertia_in_body(once, i)
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("name", ["bp2", "rigid"])
def test_the_keyframe_stands_on_the_ground(name: str, request):
    model = build_spec(request.getfixturevalue(name)).compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    mujoco.mj_forward(model, data)
    feet = foot_geom_ids(model)
    soles = data.geom_xpos[feet, 2] - model.geom_size[feet, 0]
    assert min(soles) == pytest.approx(0.0, abs=1e-12)
    # the toe's axis is tilted
    np.testing.assert_allclose(data.site("FR_sole").xpos[2], soles[0], atol=0.02)


def test_stiffer_springs_sag_less(bp2: Anatomy):
    soft, hard = standing(bp2, 3000.0), standing(bp2, 12000.0)
    assert soft[10] == pytest.approx(4.0 * hard[10])
    assert soft[2] < hard[2]
