"""The session's pictures: the robot's bodies where C MuJoCo has them."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.hardware import BUILT
from bp2_rl.robot.model import load_model
from bp2_rl.settings.terrain import Terrain
from bp2_rl.simulation.world import World

pytest.importorskip(
    "trimesh",
    reason='needs viser and what comes with it: pip install -c constraints.txt -e ".[play]"',
)

from bp2_rl.play.looks import Looks


@pytest.fixture(scope="module")
def looks():
    return Looks(BUILT)


def test_bodies_are_where_mujoco_has_them_with_the_trunk_above_the_origin(looks):
    rng = np.random.default_rng(0)
    qpos = load_model(BUILT).key("stand").qpos + 0.3 * rng.normal(size=23)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    model = load_model(BUILT, visual=False)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    for name, position, wxyz in zip(looks.bodies, *looks.place(qpos), strict=True):
        turn = Rotation.from_quat(wxyz, scalar_first=True)
        np.testing.assert_allclose(
            position, data.body(name).xpos - np.array([*qpos[:2], 0.0]), atol=1e-12
        )
        np.testing.assert_allclose(
            turn.as_matrix().ravel(), data.body(name).xmat, atol=1e-12
        )
    assert len(looks.bodies) == 1 + 4 * len(LEGS)


def test_every_body_has_a_shape_of_the_robots_size(looks):
    parts = looks.parts()
    assert {body for body, _ in parts} == set(range(1, 1 + len(looks.bodies)))
    data = looks.data
    data.qpos[:] = looks.model.key("stand").qpos
    mujoco.mj_kinematics(looks.model, data)
    corners = [
        mesh.vertices @ data.xmat[body].reshape(3, 3).T + data.xpos[body]
        for (body, _), mesh in parts.items()
    ]
    low, high = np.concatenate(corners).min(axis=0), np.concatenate(corners).max(axis=0)
    # soles on the ground, springs unloaded
    assert low[2] == pytest.approx(0.0, abs=0.02)
    assert 0.6 < high[2] < 0.75
    assert 0.84 < high[0] - low[0] < 1.1
    assert 0.3 < high[1] - low[1] < 0.6


def test_uneven_ground_is_drawn_with_the_planes_on_which_robots_run():
    world = World(Terrain("rough", 0.05, cell=0.5))
    assert world.ground
    looks, steps = Looks(BUILT, world), Looks(BUILT, World(Terrain("stairs", 0.1)))
    assert (looks.has_floor, steps.has_floor) == (False, True)
    [mesh] = looks.ground()
    x, y, z = mesh.triangles_center.T
    # MuJoCo keeps heights in float32
    np.testing.assert_allclose(z, world.ground.below(x, y).height, atol=1e-6)
    assert mesh.area > 240.0 * 12.0
