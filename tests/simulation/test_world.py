"""Slopes, rough ground, pushes, latency and sensors against closed forms."""

import dataclasses
import math

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from runs import no_action, run_one

from bp2_rl.base.errors import UserError
from bp2_rl.env.observations import sense
from bp2_rl.robot.bp2 import STAND_JOINTS
from bp2_rl.robot.conventions import GRAVITY
from bp2_rl.robot.ground import HeightField, draw_heights
from bp2_rl.robot.hardware import IDEAL, Losses
from bp2_rl.robot.kinematics import yaw_of
from bp2_rl.robot.model import load_model
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.settings.env import ControlConfig, EnvConfig
from bp2_rl.settings.terrain import Terrain
from bp2_rl.simulation.schedule import Course, Ramp
from bp2_rl.simulation.simulator import RobotSetup, Simulator, settled
from bp2_rl.simulation.world import LEVEL, Push, World, sensed_pose, shove

STANDING = EnvConfig(control=ControlConfig(mode="absolute"))
TROTTING = EnvConfig()
NOBODY = HeadingHold(limit=0.0)
SLOPE = math.radians(4.0)


def stand(seconds=0.3, **given):
    return run_one(no_action, Course().hold(seconds), STANDING, **given)


# --- Slopes ---------------------------------------------------------------------------


def test_a_robot_in_flight_over_a_slope_falls_along_it():
    """Uphill is +x: gravity's parts are -g sin and -g cos, whatever the robot does with
    its legs."""
    simulator = settled([RobotSetup(STANDING, World(Terrain(slope=SLOPE)))])
    model, data = simulator.models[0], simulator.data[0]
    data.qpos[2] += 1.0
    mujoco.mj_forward(model, data)
    momentum = (
        model.body_mass.sum()
        * np.array([-math.sin(SLOPE), 0.0, -math.cos(SLOPE)])
        * GRAVITY
    )
    np.testing.assert_allclose(-data.qfrc_bias[:3], momentum, rtol=1e-12)


@pytest.mark.parametrize("friction", [0.04, 0.9])
def test_a_robot_slides_down_a_slope_that_is_steeper_than_its_friction(friction):
    """a = -g (sin - mu cos) if it slides; with enough friction it stays, but for the
    sway of its legs."""
    slippery = dataclasses.replace(IDEAL, friction=friction)
    run = stand(0.6, hardware=slippery, world=World(Terrain(slope=SLOPE)))
    late = run.between(0.3, 0.6)
    acceleration = (late.qvel[-1, 0] - late.qvel[0, 0]) / (late.time[-1] - late.time[0])
    slides = min(-GRAVITY * (math.sin(SLOPE) - friction * math.cos(SLOPE)), 0.0)
    # MuJoCo's friction gives way a little before it slides, and the trunk sways on its
    # springs.
    assert acceleration == pytest.approx(slides, abs=0.05)


def test_sensors_on_a_slope_know_the_true_vertical():
    level = np.zeros(23)
    level[3] = 1.0
    up = sense(
        jnp.asarray(sensed_pose(level, World(Terrain(slope=SLOPE)), 0.0, 0.0)),
        jnp.zeros(22),
    ).up
    np.testing.assert_allclose(up, (math.sin(SLOPE), 0.0, math.cos(SLOPE)), atol=1e-6)


# --- Rough ground ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "size", "cell"),
    [("rough", 0.015, 0.1), ("rough", 0.015, 0.4), ("stairs", 0.1, 0.3)],
)
def test_ground_has_the_heights_that_it_says(kind, size, cell):
    """Found from above, with MuJoCo's rays: on points of the grid, edges and planes."""
    world = World(terrain=Terrain(kind, size, cell, seed=1))
    ground = world.ground
    assert ground is not None
    if isinstance(ground, HeightField):
        heights = ground.grid.heights
        assert (heights.min(), heights.max()) == (-1.0, 1.0)
    simulator = Simulator([RobotSetup(STANDING, world)])
    model, data = simulator.models[0], simulator.data[0]
    data.qpos[2] = 50.0
    mujoco.mj_forward(model, data)
    for place in (-5.0, 0.3, 76.0, 130.0, 234.0):
        for x, y in cell * np.array([[0, 5], [0.5, 5], [0.5, 5.5], [0.3, 5.9]]):
            start = np.array([round(place / cell) * cell + x, y, 5.0])
            down, geom = np.array([0.0, 0.0, -1.0]), np.zeros(1, np.int32)
            hit = mujoco.mj_ray(model, data, start, down, None, True, -1, geom)
            expected = ground.below(*start[:2]).height
            # MuJoCo keeps heights in float32
            assert 5.0 - hit == pytest.approx(expected, abs=1e-6)


def test_rough_ground_is_even_around_the_start_and_carries_the_robot():
    world = World(terrain=Terrain("rough", 0.015, cell=0.1))
    other = World(terrain=Terrain("rough", 0.015, cell=0.1, seed=7))
    simulator = settled([RobotSetup(STANDING, one) for one in (world, LEVEL, other)])
    rough, level, _ = simulator.data
    alone = Simulator([RobotSetup(STANDING, other)])
    alone.settle()
    # seeds share a stand
    np.testing.assert_allclose(simulator.qpos[2], alone.qpos[0], atol=1e-9)
    # A sphere on a field of heights may touch two triangles: twice the friction holds
    # the feet a few mrad otherwise.
    np.testing.assert_allclose(rough.qpos, level.qpos, atol=5e-3)
    force = np.sum(stand(world=world).foot_force[-1], axis=0)
    # but for the sway
    assert force[2] == pytest.approx(np.sum(load_model().body_mass) * GRAVITY, rel=0.02)


def test_a_run_ends_before_its_ground_does():
    assert World(Terrain("waves", 0.02)).end == 234.0
    assert World(Terrain(slope=0.1)).end == LEVEL.end == math.inf


@pytest.mark.parametrize(
    ("text", "world"),
    [
        ("flat", LEVEL),
        ("rough:0.05", World(terrain=Terrain("rough", 0.05))),
        ("waves:0.03:0.4", World(terrain=Terrain("waves", 0.03, cell=0.4))),
        ("slope:-0.1", World(Terrain(slope=-0.1))),
        ("stairs:0.1", World(Terrain("stairs", 0.1, cell=0.3))),
    ],
)
def test_a_ground_is_named_by_its_kind_and_size(text, world):
    assert World(Terrain.of(text)) == world


@pytest.mark.parametrize(
    "text", ["", "rough", "hill:1", "rough:x", "flat:0", "rough:0.1:0.2:3", ":0.1"]
)
def test_what_names_no_ground_is_refused_in_a_line(text):
    with pytest.raises(UserError, match="--terrain takes flat, slope:ANGLE, KIND:SIZE"):
        Terrain.of(text)


def test_seeds_lay_other_ground():
    one, again, other = (draw_heights("rough", seed, 60, 120) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.mean(one != other) > 0.9
    last = Terrain("rough", 0.01, seed=2**32 - 1)
    assert last.another(3).seed == 2
    assert Terrain(slope=0.1).another(3) == Terrain(slope=0.1)


# --- Pushes ---------------------------------------------------------------------------


def test_a_push_is_a_jump_of_the_velocity_in_the_frame_of_the_heading():
    """However the trunk tilts; MuJoCo's free joint has its angular velocity in the
    trunk's frame."""
    data = mujoco.MjData(load_model())
    w, x, y, z = data.qpos[3:7] = np.array([0.9, 0.3, -0.2, 0.25]) / math.sqrt(1.0025)
    data.qvel[:] = 0.1
    assert Push(0.25, 1.0, -0.5).step == 250
    shove(data.qpos, data.qvel, 1.0, -0.5, 0.5)
    jump, turn = data.qvel - 0.1, np.zeros(3)
    ahead = np.array([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)])
    cos, sin = ahead / np.linalg.norm(ahead)  # of the heading
    expected = cos + 0.5 * sin, sin - 0.5 * cos, 0.0
    np.testing.assert_allclose(jump[:3], expected, rtol=1e-12, atol=1e-15)
    mujoco.mju_rotVecQuat(turn, jump[3:6], data.qpos[3:7])
    np.testing.assert_allclose(turn, (0.0, 0.0, 0.5), atol=1e-12)
    np.testing.assert_array_equal(jump[6:], 0.0)


# --- Latency and gyro -----------------------------------------------------------------


@pytest.mark.parametrize("milliseconds", [3, 5, 12, 20])
def test_targets_act_after_the_latency_to_the_ms(milliseconds):
    """The kinematic gait's targets do not depend on the robot: late ones are the same,
    so many ms later."""
    prompt, delayed = (
        run_one(
            no_action,
            Ramp(1.0),
            TROTTING,
            hardware=dataclasses.replace(IDEAL, losses=Losses(latency=1e-3 * ms)),
            operator=NOBODY,
            finish=0.02,
        ).target
        for ms in (0, milliseconds)
    )
    samples = min(len(prompt), len(delayed))
    assert samples > 100
    stand = np.tile(STAND_JOINTS, (milliseconds, 1))
    expected = np.concatenate([stand, prompt])[:samples]
    np.testing.assert_array_equal(delayed[:samples], expected)


def test_a_gyro_strays_by_its_bias_and_leaves_the_rest_of_the_pose():
    qpos = np.zeros(23)
    qpos[3:7] = np.array([0.9, 0.1, 0.2, 0.3]) / math.sqrt(0.95)
    sensed = sensed_pose(qpos, LEVEL, math.radians(0.5), 8.0)
    assert yaw_of(sensed[3:7]) - yaw_of(qpos[3:7]) == pytest.approx(math.radians(4.0))
    up, seen = (sense(jnp.asarray(pose), jnp.zeros(22)).up for pose in (qpos, sensed))
    np.testing.assert_allclose(up, seen, atol=1e-6)  # float32
    assert sensed_pose(qpos, LEVEL, 0.0, 8.0) is qpos


@pytest.mark.parametrize(
    ("named", "impossible"),
    [
        ("terrain.size", lambda: Terrain("rough", -0.01)),
        ("terrain.size", lambda: Terrain("rough", math.nan)),
        ("terrain.slope", lambda: Terrain(slope=-0.6)),
        ("terrain.size", lambda: Terrain("stairs", 0.31)),
        ("terrain.size", lambda: Terrain("flat", 0.1)),
        ("terrain.cell", lambda: Terrain("rough", 0.01, cell=0.01)),
        ("terrain.seed", lambda: Terrain("rough", 0.01, seed=-1)),
        ("push.forward", lambda: Push(1.0, 1e3, 0.0)),
    ],
)
def test_impossible_worlds_and_pushes_are_refused(named, impossible):
    with pytest.raises(UserError, match=named):
        impossible()
