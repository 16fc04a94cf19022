"""The MuJoCo model: its mass and stance, and the agreement of MJX and C MuJoCo on its
motion."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from landing import (
    DT,
    MOTOR,
    converged,
    land_on_mjx,
    land_on_mujoco,
    landing,
)

from bp2_rl.base import assets
from bp2_rl.base.assets import asset_path
from bp2_rl.robot import actuator as act
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.conventions import LEGS, MOTOR_NAMES
from bp2_rl.robot.hardware import IDEAL, HardwareSpec
from bp2_rl.robot.model import (
    FOOT_GEOMS,
    MOTOR_QPOS,
    MOTOR_QVEL,
    SPRING_QPOS,
    SPRING_QVEL,
    TRUNK_GEOMS,
    ModelError,
    foot_geom_ids,
    load_model,
    load_spec,
)


def at_key(model: mujoco.MjModel, name: str) -> mujoco.MjData:
    """Return the state of a keyframe."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(name).id)
    mujoco.mj_kinematics(model, data)
    return data


@pytest.fixture(scope="module")
def standing() -> tuple[mujoco.MjModel, mujoco.MjData, np.ndarray]:
    """Return BP2 after 3 s under joint PD at its standing targets: model, state, and
    the foot forces (4, 3) in the world."""
    model = converged(load_model())
    data = at_key(model, "stand")
    target, torque = np.array(bp2.STAND_JOINTS), np.zeros(12)
    for _ in range(3000):
        q, qd = data.qpos[MOTOR_QPOS], data.qvel[MOTOR_QVEL]
        torque = data.ctrl[:] = act.joint_torque(
            MOTOR, torque, q, qd, target, np.zeros(12), DT
        )
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    return model, data, foot_forces(model, data)


def foot_forces(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the force of the floor on each foot, world frame, N."""
    feet, forces, wrench = list(foot_geom_ids(model)), np.zeros((4, 3)), np.zeros(6)
    for i in range(data.ncon):
        contact = data.contact[i]
        if contact.geom2 in feet:
            mujoco.mj_contactForce(model, data, i, wrench)
            forces[feet.index(contact.geom2)] += (
                contact.frame.reshape(3, 3).T @ wrench[:3]
            )
    return forces


# --- What it is -----------------------------------------------------------------------


def test_state_layout():
    model = load_model()
    driven = [model.joint(joint).name for joint in model.actuator_trnid[:, 0]]
    assert driven == list(MOTOR_NAMES)
    assert [model.actuator(i).name for i in range(model.nu)] == list(MOTOR_NAMES)
    springs = [f"{leg}_spring" for leg in LEGS]
    for names, qpos, qvel in (
        (MOTOR_NAMES, MOTOR_QPOS, MOTOR_QVEL),
        (springs, SPRING_QPOS, SPRING_QVEL),
    ):
        joints = [model.joint(name) for name in names]
        assert [joint.qposadr[0] for joint in joints] == list(qpos)
        assert [joint.dofadr[0] for joint in joints] == list(qvel)


def test_total_mass():
    assert 35.8 <= mujoco.mj_getTotalmass(load_model()) <= 36.2


def legless(spec: mujoco.MjSpec) -> np.ndarray:
    """Return the mass matrix at rest of the trunk and the abduction links alone; the
    first six coordinates are the trunk's."""
    for part in (*spec.tendons, *spec.actuators, *spec.sensors, *spec.keys):
        spec.delete(part)
    for leg in LEGS:
        spec.delete(spec.body(f"{leg}_thigh"))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    return inertia


def test_trunk_pitch_inertia_is_four_quarters_about_the_centre():
    inertia = legless(mujoco.MjSpec.from_file(str(asset_path("bp2_mjcf/bp2.xml"))))
    assert inertia[4, 4] == pytest.approx(bp2.TRUNK_PITCH_INERTIA, rel=1e-9)
    assert inertia[4, 4] == pytest.approx(1.94, abs=0.005)


@pytest.mark.parametrize(
    "change",
    [
        {"thigh_mass": 3.0, "toe_mass": 0.2},
        {"trunk_inertia": 0.5},
        {"thigh_mass": 1.0, "trunk_inertia": 40.0},
    ],
)
def test_a_changed_trunks_inertia_is_the_planar_models(change):
    hardware = IDEAL.changed(**change)
    inertia = legless(load_spec(hardware))
    assert inertia[4, 4] == pytest.approx(hardware.bp2.trunk_pitch_inertia, rel=1e-9)
    assert inertia[0, 0] == pytest.approx(
        4.0 * hardware.bp2.trunk_quarter_mass, rel=1e-9
    )


def test_only_feet_and_trunk_collide_and_only_with_the_floor():
    model = load_model()
    floor = model.geom("floor").id
    collides = {
        model.geom(i).name
        for i in range(model.ngeom)
        if model.geom_conaffinity[i] or model.geom_contype[i]
    }
    assert collides == {"floor", *FOOT_GEOMS, *TRUNK_GEOMS}
    assert model.geom_contype[np.arange(model.ngeom) != floor].max() == 0


@pytest.mark.parametrize("hardware", [HardwareSpec(), IDEAL.changed(leg_length=0.33)])
def test_keyframe_stand_has_its_soles_on_the_floor_and_run_is_in_flight(hardware):
    model = load_model(hardware)
    feet = foot_geom_ids(model)
    stand, run = at_key(model, "stand"), at_key(model, "run")
    np.testing.assert_allclose(stand.geom_xpos[feet, 2], bp2.FOOT_RADIUS, atol=1e-3)
    np.testing.assert_allclose(stand.qpos[MOTOR_QPOS], bp2.STAND_JOINTS, atol=1e-12)
    assert run.geom_xpos[feet, 2].min() > bp2.FOOT_RADIUS + 0.02
    assert run.qvel[0] == 10.0


def test_sensors_measure_the_imu_and_the_joints():
    model = load_model()
    data = at_key(model, "stand")
    data.qvel[3:6] = [0.1, 0.2, 0.3]
    # in free fall an accelerometer at the centre of mass reads nothing but rotation
    data.qpos[2] += 1.0
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.sensor("imu_gyro").data, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(data.sensor("imu_quat").data, [1, 0, 0, 0])
    np.testing.assert_allclose(
        data.sensor("imu_accelerometer").data,
        data.qacc[:3] + np.array([0, 0, 9.81]),
        atol=1e-9,
    )
    angles = [data.sensor(f"{name}_pos").data[0] for name in MOTOR_NAMES]
    assert angles == list(bp2.STAND_JOINTS)


# --- How it stands --------------------------------------------------------------------


def test_settles_at_its_standing_height_and_the_floor_carries_the_weight(standing):
    model, data, forces = standing
    assert data.qpos[2] == pytest.approx(bp2.STANDING_HEIGHT, abs=0.015)
    assert abs(data.qvel).max() < 0.05
    assert data.qpos[3] > 0.9999
    weight = mujoco.mj_getTotalmass(model) * conventions.GRAVITY
    assert forces[:, 2].sum() == pytest.approx(weight, rel=1e-2)


def test_springs_carry_the_axial_part_of_the_foot_force_at_rest(standing):
    """k c = axial contact force less the axial weight of the toe, which hangs below the
    spring: 0.5 kg."""
    model, data, forces = standing
    for i, leg in enumerate(LEGS):
        axis = data.body(f"{leg}_toe").xmat.reshape(3, 3)[:, 2]
        toe_weight = model.body(f"{leg}_toe").mass[0] * conventions.GRAVITY * axis[2]
        spring_force = bp2.SPRING_STIFFNESS * data.qpos[SPRING_QPOS[i]]
        assert spring_force == pytest.approx(forces[i] @ axis - toe_weight, rel=0.02)
        # the toe weighs 6 % of a standing leg's load
        assert spring_force == pytest.approx(forces[i] @ axis, rel=0.07)


@pytest.mark.parametrize("compression", [-0.02, 0.0, 0.05, 0.13, 0.15])
def test_spring_and_its_stops_push_with_the_stated_force(compression):
    model = load_model()
    data = mujoco.MjData(model)
    data.qpos[SPRING_QPOS] = compression
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(
        data.qfrc_passive[SPRING_QVEL], spring_force(compression), atol=1e-9
    )
    np.testing.assert_allclose(data.qfrc_passive[MOTOR_QVEL], 0.0)


def spring_force(compression):
    """Return a spring's force along the compression, N: 6 kN/m everywhere and 30 kN/m
    more outside [0, 0.13] m."""
    beyond = np.maximum(compression - 0.13, 0.0) + np.minimum(compression, 0.0)
    return -6000.0 * compression - 30000.0 * beyond


# --- MJX and C MuJoCo -----------------------------------------------------------------


def test_mjx_and_mujoco_agree_on_a_touchdown_at_10_m_per_s():
    """Trunk and feet over 150 ms, to 1e-4 m; MJX with the model's own few iterations, C
    MuJoCo converged in float64."""
    start = landing(robots=16)
    on_mjx = land_on_mjx(load_model(visual=False, feet_only=True), start)
    on_mujoco = land_on_mujoco(converged(load_model(visual=False)), start)
    depth = bp2.FOOT_RADIUS - on_mujoco[:, :, 1:, 2]
    # nearly every foot lands, one diagonal after the other
    assert (depth.max(axis=1) > 0.0).mean() > 0.9
    np.testing.assert_allclose(on_mjx, on_mujoco, atol=1e-4, rtol=0)


@pytest.mark.parametrize(
    ("impratio", "iterations", "enough"),
    [(1, None, True), (1, 4, False), (10, None, False)],
)
def test_the_models_few_iterations_converge_at_touchdown(impratio, iterations, enough):
    """The XML's solver gives what 50 iterations give; four iterations, or a higher
    impratio, would be mm off."""
    start, models = (
        landing(robots=32),
        [load_model(visual=False), converged(load_model(visual=False))],
    )
    for model in models:
        model.opt.impratio = impratio
    models[0].opt.iterations = iterations or models[0].opt.iterations
    few, many = (land_on_mujoco(model, start) for model in models)
    worst = abs(few - many).max()
    assert worst < 1e-9 if enough else worst > 1e-3


@pytest.mark.parametrize(
    ("softness", "sinks", "pushes"), [(0.005, 0.0060, 800.0), (0.003, 0.0038, 1370.0)]
)
def test_touchdown_softness(softness, sinks, pushes):
    """Depth (m) and impact peak (N) of feet that meet the floor at 3 m/s, as toes do at
    10 m/s; the XML has 5 ms."""
    model = converged(load_model())
    feet = foot_geom_ids(model)
    assert set(model.geom_solref[feet, 0]) == {0.005}
    model.geom_solref[feet, 0] = softness
    data = at_key(model, "stand")
    data.qvel[2] = -3.0
    depth, force = [], []
    for _ in range(50):
        mujoco.mj_step(model, data)
        depth.append(bp2.FOOT_RADIUS - data.geom_xpos[feet, 2].min())
        force.append(foot_forces(model, data)[:, 2].max())
    assert max(depth) == pytest.approx(sinks, rel=0.05)
    assert max(force) == pytest.approx(pushes, rel=0.05)


def test_loaded_feet_creep_slowly():
    """A foot that pushes 700 N down and 300 N back, inside its friction cone, slips at
    less than 0.2 m/s.

    MuJoCo's soft constraints creep; 0.14 m/s is 1.4 % of 10 m/s. It has sunk by about a
    millimetre.
    """
    model = converged(load_model())
    model.dof_damping[MOTOR_QVEL] = 1e5  # locks the joints
    data = at_key(model, "stand")
    data.qpos[SPRING_QPOS] = 0.1
    weight = mujoco.mj_getTotalmass(model) * conventions.GRAVITY
    velocity, depth, forces = [], [], []
    for _ in range(3000):
        push = 4 * 300.0, 0, weight - 4 * 700.0
        data.xfrc_applied[1] = *push, 0, -4 * 300.0 * data.qpos[2], 0
        mujoco.mj_step(model, data)
        heights = data.geom_xpos[foot_geom_ids(model), 2]
        velocity.append(data.qvel[0])
        depth.append(bp2.FOOT_RADIUS - heights.mean())
        forces.append(foot_forces(model, data))
    pushed = np.mean(forces[2000:], axis=(0, 1))[[0, 2]]
    np.testing.assert_allclose(pushed, [-300.0, 700.0], rtol=0.02)
    assert 0.0 < np.mean(velocity[2000:]) < 0.2
    assert np.mean(depth[2000:]) == pytest.approx(1e-3, rel=0.2)


# --- What load_model can change -------------------------------------------------------


def test_changed_hardware_changes_the_robot():
    changed = IDEAL.changed(
        gear_ratio=9.0,
        leg_length=0.33,
        spring_stiffness=5000.0,
        spring_damping=20.0,
        spring_travel=0.1,
        spring_stop_stiffness=2e4,
        rebound_stiffness=2e4,
        rotor_inertia=3e-4,
        mass_scale=1.1,
        friction=0.6,
    )
    model, published = load_model(changed), load_model()
    np.testing.assert_allclose(model.body_mass, 1.1 * published.body_mass)
    np.testing.assert_allclose(model.body_inertia, 1.1 * published.body_inertia)
    np.testing.assert_allclose(model.dof_armature[MOTOR_QVEL], 3e-4 * 81.0)
    np.testing.assert_allclose(model.jnt_stiffness[[4, 8, 12, 16]], 5000.0)
    np.testing.assert_allclose(model.dof_damping[SPRING_QVEL], 20.0)
    np.testing.assert_allclose(model.tendon_lengthspring, [[0.0, 0.1]] * 4)
    np.testing.assert_allclose(model.tendon_stiffness, 2e4)
    np.testing.assert_allclose(model.actuator_forcerange[:, 1], 120.0 * 9.0 / 8.5)
    np.testing.assert_allclose(model.geom_friction[foot_geom_ids(model), 0], 0.6)


def test_mass_moves_between_trunk_and_legs():
    """And inertias with it; the whole weighs what it did."""
    change = IDEAL.changed(thigh_mass=4.4, toe_mass=0.25, trunk_inertia=2.0)
    model, published = load_model(change), load_model()
    trunk = (21.0 - 4 * 1.95) / 21.0
    total, before = np.sum(model.body_mass), np.sum(published.body_mass)
    assert total == pytest.approx(before, rel=1e-12)
    shares = {"thigh": (2.0, 2.0), "toe": (0.5, 0.5), "trunk": (trunk, 2.0 * trunk)}
    for body in range(1, model.nbody):
        part = model.body(body).name.rpartition("_")[2]
        mass, inertia = shares.get(part, (1.0, 1.0))
        np.testing.assert_allclose(
            [model.body_mass[body], *model.body_inertia[body]],
            [
                mass * published.body_mass[body],
                *(inertia * published.body_inertia[body]),
            ],
            rtol=1e-12,
            err_msg=part,
        )


def test_dropping_visuals_and_all_contacts_but_the_feets_keeps_the_physics():
    full, lean = load_model(), load_model(visual=False, feet_only=True)
    assert lean.ngeom == 1 + len(FOOT_GEOMS) + len(TRUNK_GEOMS)
    assert (lean.nsensor, lean.ncam, lean.nlight) == (0, 0, 0)
    accelerations = []
    for model in (full, lean):
        data = at_key(model, "run")
        data.qpos[2] -= 0.05
        mujoco.mj_forward(model, data)
        accelerations.append(data.qacc.copy())
        assert data.ncon > 0
    np.testing.assert_array_equal(*accelerations)


@pytest.mark.parametrize(("feet_only", "contacts"), [(False, 4), (True, 0)])
def test_trunk_lands_on_its_capsules_unless_told_not_to(feet_only, contacts):
    model = load_model(feet_only=feet_only)
    data = mujoco.MjData(model)
    data.qpos[2] = 0.069
    data.qpos[MOTOR_QPOS] = [0.0, 1.5, -0.5] * 4
    data.qpos[8::4] = np.pi  # legs in the air
    mujoco.mj_forward(model, data)
    assert data.ncon == contacts


def test_a_model_that_does_not_compile_is_refused_in_one_line():
    def break_it(spec: mujoco.MjSpec) -> None:
        spec.body("trunk").mass = -1.0

    with pytest.raises(
        ModelError, match="the model of BP2 does not compile"
    ) as refusal:
        load_model(scene=break_it)
    assert "\n" not in str(refusal.value)


def test_assets_are_found_in_a_checkout_and_in_an_installed_package(
    tmp_path: Path, monkeypatch
):
    assert asset_path("bp2_mjcf/bp2.xml").is_file()
    monkeypatch.setattr(assets, "PACKAGE", tmp_path)
    assert asset_path("bp2.xml") == tmp_path.parent / "assets" / "bp2.xml"
    (tmp_path / "assets").mkdir()
    assert asset_path("bp2.xml") == tmp_path / "assets" / "bp2.xml"
