"""The kernel on rough ground and on slopes beside C MuJoCo's height fields and tilted
gravity."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from landing import converged, random_states

from bp2_rl.robot.bp2 import FOOT_RADIUS
from bp2_rl.robot.conventions import GRAVITY
from bp2_rl.robot.ground import Grid, HeightField, Stairs, draw_heights
from bp2_rl.robot.hardware import BUILT
from bp2_rl.robot.kernel.design import Design, Masses, Robots
from bp2_rl.robot.kernel.step import MuJoCoState, step
from bp2_rl.robot.model import MOTOR_QVEL, NV, foot_geom_ids, load_model

ROBOTS = 200
FRICTION = 0.8


def accelerations(states, ground, gravity):
    """(qpos, qvel, torque), a robot a row -> MuJoCo's qacc by the kernel, and the feet's
    distances from the ground, m."""
    design = Design.of(load_model(BUILT, visual=False, feet_only=True))
    design = dataclasses.replace(design, gravity=tuple(jnp.asarray(gravity)))
    masses = Masses.of(design, jnp.ones((18, ROBOTS)), jnp.zeros((3, ROBOTS)))
    robots = Robots(design, masses, jnp.full(ROBOTS, FRICTION))
    ground = jax.tree.map(lambda x: jnp.full(ROBOTS, x), ground)

    @jax.jit
    def run(qpos, qvel, torque):
        force = jnp.zeros((NV, ROBOTS)).at[MOTOR_QVEL].set(torque.T)
        before = MuJoCoState(qpos.T, qvel.T, jnp.zeros((NV, ROBOTS)))
        after, distance = step(robots, before, force, ground)
        return after.qacc_warmstart.T, distance.T

    return map(np.asarray, run(*states))


def planes_met(ground, centres):
    """(..., 3) -> the normals of the planes that feet with these centres meet, and the
    centres' distances from the planes."""
    x, y, z = np.moveaxis(centres, -1, 0)
    plane = ground.met_at(x, y, z)
    normal = np.stack([-plane.slope_x, -plane.slope_y, np.ones(x.shape)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return normal, (z - plane.height) * normal[..., 2]


def field(kind, amplitude, cell):
    grid = Grid(draw_heights(kind, 3, 64, 64))
    return HeightField(grid, amplitude, cell, 32.0, 32.0)


@pytest.mark.parametrize(
    ("ground", "degrees", "least"),
    [
        (field("rough", 0.06, 0.4), 0.0, 100),
        (field("rough", 0.04, 0.15), 20.0, 100),
        (field("waves", 0.05, 0.2), 0.0, 100),
        (Stairs(0.1, 0.3, 7.0), 20.0, 150),
        (Stairs(0.17, 0.25, 12.0), 0.0, 150),
    ],
)
def test_one_step_on_ground_that_is_not_flat_is_that_of_c_mujoco(
    ground, degrees, least
):
    """To 1e-4 of each state's largest acceleration, where every foot that C MuJoCo lets
    touch has one contact, with the plane that the foot meets; under tilted gravity, too.

    Near edges C MuJoCo has contacts with several planes, the kernel with one. A foot in
    a valley may touch the plane beside it alone: one state in a hundred at most.
    """
    rng, slope = np.random.default_rng(1), math.radians(degrees)
    states = random_states(np.random.default_rng(0), ROBOTS, thrown=0.0)
    model = load_model(BUILT, visual=False, feet_only=True, scene=ground.lay)
    converged(model).geom_friction[:, 0], model.opt.ccd_tolerance = FRICTION, 1e-9
    tilt = -0.8 * math.sin(slope), 0.6 * math.sin(slope), -math.cos(slope)
    model.opt.gravity = GRAVITY * np.array(tilt)
    data, geoms = mujoco.MjData(model), foot_geom_ids(model).tolist()
    for qpos in states[0]:
        data.qpos = qpos
        mujoco.mj_kinematics(model, data)
        # the first of many places where the lowest foot is within 8 mm of touching
        moves = rng.uniform((-2.0, -2.0, -0.5), (2.0, 2.0, 2.0), (4000, 3))
        feet = data.geom_xpos[geoms] + moves[:, None]
        lowest = planes_met(ground, feet)[1].min(axis=1) - FOOT_RADIUS
        qpos[:3] += moves[np.argmax(abs(lowest) < 0.008)]
    states = [x.astype(np.float32) for x in states]
    found, distances = accelerations(states, ground, model.opt.gravity)
    errors, elsewhere = [], 0
    for i, (qpos, qvel, torque) in enumerate(zip(*states, strict=True)):
        mujoco.mj_resetData(model, data)
        data.qpos, data.qvel, data.qfrc_applied[MOTOR_QVEL] = qpos, qvel, torque
        mujoco.mj_forward(model, data)
        normals, distance = planes_met(ground, data.geom_xpos[geoms])
        np.testing.assert_allclose(distances[i], distance, rtol=0, atol=2e-6)
        # a foot comes before a box and after a field, and the normal points to the latter
        pairs, frames = data.contact.geom, data.contact.frame
        feet = [geoms.index(next(g for g in pair if g in geoms)) for pair in pairs]
        frames = frames * np.where(np.isin(pairs[:, :1], geoms), -1.0, 1.0)
        touch = np.flatnonzero(distance < FOOT_RADIUS)
        if len(set(feet)) < len(feet):
            continue
        if set(feet) == set(touch) and np.allclose(
            frames[:, :3], normals[feet], 0, 1e-4
        ):
            errors.append(abs(found[i] - data.qacc).max() / abs(data.qacc).max())
        else:
            elsewhere += 1
    assert max(errors) < 1e-4
    assert len(errors) > least
    assert elsewhere <= ROBOTS / 100


@pytest.mark.parametrize(
    ("ground", "period"),
    [
        (HeightField(Grid(draw_heights("rough", 0, 16, 16)), 0.05, 0.2, 3.0, 5.0), 3.2),
        (Stairs(0.1, 0.3, 4.0), 9.0),
    ],
)
def test_ground_repeats_itself_and_is_the_same_for_numpy_and_jax(ground, period):
    """float32 loses a few 1e-6 of a cell, and a riser's slope is 1e5."""
    x, y, z = np.random.default_rng(2).uniform(-1.6, 1.6, (3, 1000))
    here, there = ground.met_at(x, y, z), ground.met_at(x + period, y - 9.6, z)
    np.testing.assert_allclose(here, there, rtol=1e-10, atol=1e-8)
    in_jax = ground.below(jnp.asarray(x), jnp.asarray(y)).height
    np.testing.assert_allclose(in_jax, ground.below(x, y).height, atol=1e-6)


@pytest.mark.parametrize(("height", "run"), [(0.1, 0.3), (0.25, 0.2)])
def test_a_foot_meets_the_closest_point_of_the_stairs(height, run):
    """Of points 0.2 mm apart on the profile, laid out step by step: as far away, and
    where the plane's normal from the foot's centre ends. Down is the mirror image of
    up; a foot inside a step, less deep than the step is high, has a negative distance.
    """
    edges = [3.0 + n for n in range(10) for _ in range(2)]  # treads and steps
    levels = [10.0 - n for n in range(11) for _ in range(2)]
    x, z = run * np.array([-3.0, *edges, 18.0]), height * np.array(levels)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(z)))])
    at = np.arange(0.0, along[-1], 2e-4)
    profile = np.stack([np.interp(at, along, x), np.interp(at, along, z)])
    rng, ground = np.random.default_rng(0), Stairs(height, run, 0.0)
    x = rng.uniform(-1.0 * run, 15.0 * run, 200)
    level = height * np.clip(9.0 - np.floor(x / run - 3.0), 0.0, 10.0)
    z = level + rng.uniform(-height, min(0.2, run), x.size)
    gaps = np.hypot(*(np.stack([x, z])[:, :, None] - profile[:, None])).min(axis=1)
    for way in (1.0, -1.0):
        centres = np.stack([way * x, np.zeros(x.size), z], axis=1)
        normal, distance = planes_met(ground, centres)
        np.testing.assert_allclose(distance, np.sign(z - level) * gaps, atol=4e-5)
        met = centres - normal * distance[:, None]
        met = np.stack([way * met[:, 0], met[:, 2]])[:, :, None] - profile[:, None]
        assert np.hypot(*met).min(axis=1).max() < 2e-4
    assert np.ptp(normal[:, 2]) > 0.999
