"""Drake against C MuJoCo, which shares no code with it, and against closed forms."""

import dataclasses

import mujoco
import numpy as np
import pytest
from runs import no_action

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError
from bp2_rl.learning.policy import load_policy
from bp2_rl.robot.conventions import GRAVITY
from bp2_rl.robot.hardware import BUILT, ROBOTS
from bp2_rl.robot.model import foot_geom_ids, load_model
from bp2_rl.robot.named import find_robot
from bp2_rl.settings.env import ControlConfig, EnvConfig
from bp2_rl.settings.terrain import Terrain
from bp2_rl.simulation.rollout import RunRequest, rollout, simulate
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.world import Push, World

pytest.importorskip("pydrake")
from bp2_rl.simulation.drake import DrakeRobot

STIFFNESS = 3e5  # N/m, of the ground under the built robot's feet
STANDING = EnvConfig(control=ControlConfig(mode="absolute"))
SHIPPED = [
    *ROBOTS,
    *(path.stem for path in sorted(asset_path("robots").glob("*.toml"))),
]


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def in_the_air(model, rng):
    """Return MuJoCo's data in a random state, far from the ground and from the joints'
    limits."""
    data = mujoco.MjData(model)
    data.qpos[:] = model.key("stand").qpos
    data.qpos[:3] += rng.uniform(-1.0, 1.0, 3) + np.array([0.0, 0.0, 5.0])
    data.qpos[3:7] = rng.normal(size=4)
    mujoco.mju_normalize4(data.qpos[3:7])
    data.qpos[7:] += rng.uniform(-0.2, 0.2, model.nq - 7)
    limited = np.flatnonzero(model.jnt_limited)
    at, (low, high) = model.jnt_qposadr[limited], model.jnt_range[limited].T
    data.qpos[at] = np.clip(data.qpos[at], low + 0.05, high - 0.05)
    data.qvel[:] = rng.uniform(-5.0, 5.0, model.nv)
    return data


# --- Without contact ------------------------------------------------------------------


@pytest.mark.parametrize("name", SHIPPED)
def test_inertia_and_bias_forces_are_mujocos(name, rng):
    """To float64's rounding: of the mass matrix, rotors included; of gravity, Coriolis
    and centrifugal forces."""
    model = load_model(find_robot(name), visual=False, weighed=True)
    robot, inertia = (
        DrakeRobot(model, BUILT.contact_time),
        np.zeros((model.nv, model.nv)),
    )
    for _ in range(20):
        data = in_the_air(model, rng)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, inertia)
        robot.set_state(data.qpos, data.qvel)
        np.testing.assert_allclose(
            robot.mass_matrix(), inertia, atol=1e-12 * np.max(inertia)
        )
        forces = robot._plant.CalcBiasTerm(
            robot._context
        ) - robot._plant.CalcGravityGeneralizedForces(robot._context)
        np.testing.assert_allclose(
            robot._turn.T @ forces[robot._v],
            data.qfrc_bias,
            atol=1e-12 * np.max(np.abs(data.qfrc_bias)),
        )


@pytest.mark.parametrize("name", ["ideal", "built", "go1"])
def test_one_step_in_the_air_is_mujocos(name, rng):
    """Under torques, losses, springs and their stops: the same Euler step, with dampers
    taken implicitly.

    Solid legs may meet, which the two take differently, so they pass through each other
    here.
    """
    model = load_model(
        dataclasses.replace(find_robot(name), solid_legs=False),
        visual=False,
        weighed=True,
    )
    robot = DrakeRobot(model, BUILT.contact_time)
    for _ in range(20):
        data = in_the_air(model, rng)
        # no more than any motor has: MuJoCo would clip it
        data.ctrl[:] = rng.uniform(-15.0, 15.0, 12)
        data.qfrc_applied[:] = rng.uniform(-50.0, 50.0, model.nv)
        mine = mujoco.MjData(model)
        for name in ("qpos", "qvel", "ctrl", "qfrc_applied"):
            getattr(mine, name)[:] = getattr(data, name)
        before = data.qvel.copy()
        mujoco.mj_step(model, data)
        robot.step(mine)
        assert data.ncon == 0
        largest = np.max(np.abs(data.qvel - before))
        np.testing.assert_allclose(mine.qvel, data.qvel, atol=1e-9 * largest)
        np.testing.assert_allclose(mine.qpos, data.qpos, atol=1e-5)
        assert mine.time == data.time


# --- On the ground --------------------------------------------------------------------


def test_a_standing_robot_weighs_on_the_ground_what_it_weighs():
    request = RunRequest(Ramp(0.0, hold=1.0), BUILT)
    [run] = simulate(no_action, [request], STANDING, backend="drake")
    assert run.fell_at is None
    assert run.backend == "Drake"
    force = run.foot_force[-200:].mean(axis=0)
    assert np.sum(force[:, 2]) == pytest.approx(run.mass * GRAVITY, rel=1e-3)
    np.testing.assert_allclose(np.sum(force[:, :2], axis=0), 0.0, atol=0.5)
    model = load_model(BUILT, visual=False, weighed=True)
    data, feet = mujoco.MjData(model), foot_geom_ids(model)
    data.qpos[:] = run.qpos[-1]
    mujoco.mj_kinematics(model, data)
    depth = model.geom_size[feet, 0] - data.geom_xpos[feet, 2]
    np.testing.assert_allclose(STIFFNESS * depth, run.foot_force[-1, :, 2], rtol=0.02)


def test_a_robot_that_slides_is_slowed_by_friction():
    """Coulomb's law: all feet slide, so friction is mu times the weight."""
    hardware = dataclasses.replace(BUILT, friction=0.2)
    world = World(pushes=(Push(0.0, 1.5, 0.0),))
    [run] = simulate(
        no_action,
        [RunRequest(Ramp(0.0, hold=0.4), hardware, world=world)],
        STANDING,
        backend="drake",
    )
    assert run.fell_at is None
    friction, pressing = (
        np.sum(run.foot_force[100:300, :, 0]),
        np.sum(run.foot_force[100:300, :, 2]),
    )
    assert friction / pressing == pytest.approx(-0.2, rel=1e-2)


def dragged(step, model, slip):
    """Return the vertical force (N) on a foot in 8 ms from its landing at 2 m/s, while
    it slips at a speed (m/s).

    Trunk and joints are too heavy to feel it: the toe alone moves, on its spring, under
    a leg that hangs straight down.
    """
    data = mujoco.MjData(model)
    data.qpos[8::4] = np.pi / 2  # the other legs are level
    data.qpos[8] = 0.0
    data.qpos[2], data.qpos[3] = 0.7, 1.0  # with the sole on the ground
    data.qvel[0], data.qvel[2] = slip, -2.0
    forces = []
    for _ in range(8):
        step(data)
        forces.append(data.sensordata[2])
    return np.array(forces)


def test_slip_lifts_a_foot_in_mujoco_and_not_in_drake():
    """By Coulomb's law the normal force knows nothing of slip. MuJoCo's friction is
    convex: slip adds to the landing.

    A damped contact takes a foot that slips at v as one that lands faster by mu v.
    """
    model = load_model(
        dataclasses.replace(BUILT, solid_legs=False), visual=False, weighed=True
    )
    model.opt.gravity[:], model.jnt_limited[:] = 0.0, 0
    model.body_mass[1], model.body_inertia[1] = 1e7, 1e7
    model.dof_armature[
        model.jnt_dofadr[model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE]
    ] = 1e6
    mujoco.mj_setConst(model, mujoco.MjData(model))
    drake = DrakeRobot(model, BUILT.contact_time)
    for step, lifts in (
        (drake.step, False),
        (lambda data: mujoco.mj_step(model, data), True),
    ):
        still, slips = (dragged(step, model, slip) for slip in (0.0, 10.0))
        assert np.max(still) > 400.0
        if lifts:
            assert np.max(slips) == pytest.approx(
                (2.0 + 0.8 * 10.0) / 2.0 * np.max(still), rel=0.2
            )
        else:
            # Drake lags damping by a step
            np.testing.assert_allclose(slips, still, atol=0.03 * np.max(still))


def test_the_policy_that_ships_runs_as_fast_as_in_mujoco():
    policy, schedule = load_policy(asset_path("policies/built")), Ramp(6.0, hold=1.0)
    c, drake = (
        rollout(policy, schedule, backend=backend) for backend in ("mujoco", "drake")
    )
    assert c.fell_at is None
    assert drake.fell_at is None
    assert drake.metrics.mean_speed == pytest.approx(c.metrics.mean_speed, rel=0.1)
    assert not np.array_equal(drake.qpos, c.qpos)


# --- What is refused ------------------------------------------------------------------


def test_rough_ground_is_refused():
    rough = World(terrain=Terrain("rough", 0.01))
    request = RunRequest(Ramp(0.0, hold=0.1), BUILT, world=rough)
    with pytest.raises(
        UserError, match="Drake has flat ground and slopes alone; use --backend mujoco"
    ):
        next(simulate(no_action, [request], STANDING, backend="drake"))
