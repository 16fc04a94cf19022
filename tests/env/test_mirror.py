from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from bp2_rl.env import observations, randomization
from bp2_rl.env.controller import Controller, motion_of
from bp2_rl.robot.hardware import BUILT
from bp2_rl.robot.model import (
    MOTOR_QPOS,
    MOTOR_QVEL,
    SPRING_QPOS,
    SPRING_QVEL,
    load_model,
)
from bp2_rl.robot.observation import JOINTS, LEG, Mirror
from bp2_rl.settings.env import ControlConfig, EnvConfig

MIRRORS = observations.mirrors_under(EnvConfig())
CRITIC = MIRRORS["privileged_state"]

# what a mirror on the x-z plane does to a vector; to a rotation the opposite
WORLD = np.array([1.0, -1.0, 1.0])


def image(mirror: Mirror, x):
    return np.asarray(mirror.sign) * np.asarray(x)[..., list(mirror.order)]


def mirrored_state(qpos, qvel):
    """Return the mirror image of a state, worked by hand from MuJoCo's coordinates."""
    q, qd = np.array(qpos), np.array(qvel)
    q[:3] *= WORLD
    q[3:7] *= [1, -1, 1, -1]
    qd[:3] *= WORLD
    qd[3:6] *= -WORLD
    q[MOTOR_QPOS], qd[MOTOR_QVEL] = (
        image(JOINTS, qpos[MOTOR_QPOS]),
        image(JOINTS, qvel[MOTOR_QVEL]),
    )
    q[SPRING_QPOS], qd[SPRING_QVEL] = (
        image(LEG, qpos[SPRING_QPOS]),
        image(LEG, qvel[SPRING_QVEL]),
    )
    return q, qd


@pytest.fixture
def state():
    rng = np.random.default_rng(3)
    qpos, qvel = rng.normal(size=23), rng.normal(size=22)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    return qpos, qvel


def test_the_image_of_an_observation_is_what_the_mirrored_robot_observes(state):
    rng = np.random.default_rng(4)
    command, action, phase = rng.normal(size=3), rng.normal(size=12), 0.13
    target, strength, com, error = (
        rng.normal(size=3),
        rng.normal(size=12),
        rng.normal(size=3),
        rng.normal(size=3),
    )
    robot = randomization.nominal(22, BUILT)
    controller = Controller(EnvConfig(hardware=BUILT))

    def observe(state, command, phase, action, target, feet, strength, com, error):
        qpos, qvel = map(jnp.asarray, state)
        drawn = robot.replace(
            strength=jnp.asarray(strength), com_offset=jnp.asarray(com)
        )
        before = controller.init(phase).replace(last_action=jnp.asarray(action))
        seen = controller.frame(
            before, jnp.asarray(command), observations.sense(qpos, qvel)
        )
        episode: Any = SimpleNamespace(
            q=qpos,
            qd=qvel,
            command=SimpleNamespace(target=jnp.asarray(target)),
            randomization=drawn,
            tracking_error=jnp.asarray(error),
        )
        velocity = observations.trunk_motion(qpos, qvel).velocity
        unsensed = observations.PrivilegedInputs(
            episode, velocity, jnp.asarray(feet), drawn.mass[1]
        )
        rest = observations.observe(observations.PRIVILEGED, unsensed)
        return jnp.concatenate([seen, rest])

    turned = [1.0, -1.0, -1.0]
    left = [strength[leg * 3 + i] for leg in (1, 0, 3, 2) for i in range(3)]
    here = observe(
        state,
        command,
        phase,
        action,
        target,
        [1.0, 0.0, 0.0, 0.5],
        strength,
        com,
        error,
    )
    there = observe(
        mirrored_state(*state),
        turned * command,
        phase + 0.5,
        image(JOINTS, action),
        turned * target,
        [0.0, 1.0, 0.5, 0.0],
        left,
        WORLD * com,
        turned * error,
    )
    # float32, through the rotations of a heading.
    np.testing.assert_allclose(image(CRITIC, here), there, rtol=0, atol=2e-6)


def test_physics_does_not_tell_the_robot_from_its_mirror_image():
    model = load_model(BUILT, visual=False)
    rng = np.random.default_rng(5)
    for _ in range(5):
        data, twin = mujoco.MjData(model), mujoco.MjData(model)
        data.qpos[:] = (
            model.key("stand").qpos
            + np.r_[0, 0, -0.005, np.zeros(4), 0.1 * rng.normal(size=16)]
        )
        data.qpos[3:7] += 0.05 * rng.normal(size=4)
        data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
        data.qvel[:] = rng.normal(size=22)
        data.ctrl[:] = 20.0 * rng.normal(size=12)
        twin.qpos[:], twin.qvel[:] = mirrored_state(data.qpos, data.qvel)
        twin.ctrl[:] = image(JOINTS, data.ctrl)
        mujoco.mj_step(model, data)
        mujoco.mj_step(model, twin)
        expected = mirrored_state(data.qpos, data.qvel)
        # The solver stops at a relative 1e-8 of what it minimises; a millisecond makes
        # 1e-3 of an acceleration.
        np.testing.assert_allclose(twin.qvel, expected[1], rtol=0, atol=1e-5)
        np.testing.assert_allclose(twin.qpos, expected[0], rtol=0, atol=1e-8)


@pytest.mark.parametrize("reference", ["collocation", "kinematic"])
@pytest.mark.parametrize(
    "command", [(0.0, 0.0, 0.0), (0.3, 0.1, 0.2), (5.0, 0.0, 0.0), (11.0, -0.2, 0.25)]
)
def test_the_reference_is_its_own_mirror_image_half_a_cycle_later(reference, command):
    motion = motion_of(EnvConfig(reference=reference))
    here = motion(jnp.asarray(command), jnp.asarray(0.2))
    there = motion(
        jnp.asarray(command) * jnp.asarray([1.0, -1.0, -1.0]), jnp.asarray(0.7)
    )
    for name in ("joint_position", "joint_velocity", "torque"):
        np.testing.assert_allclose(
            image(JOINTS, getattr(here, name)),
            getattr(there, name),
            rtol=1e-4,
            atol=1e-4,
            err_msg=name,
        )
    np.testing.assert_allclose(image(LEG, here.contact), there.contact)
    np.testing.assert_allclose(here.height, there.height, rtol=1e-5)


def test_parities_are_what_a_reflection_keeps_and_turns():
    mirror = CRITIC
    even, odd = mirror.parities()
    basis = np.hstack([even, odd])
    np.testing.assert_allclose(basis.T @ basis, np.eye(len(mirror.order)), atol=1e-15)
    np.testing.assert_allclose(image(mirror, even.T), even.T)
    np.testing.assert_allclose(image(mirror, odd.T), -odd.T)


def test_a_reflection_twice_is_nothing():
    remembered = observations.mirrors_under(
        EnvConfig(control=ControlConfig(history=(2, 5)))
    )
    assert len(remembered["state"].order) == 3 * len(MIRRORS["state"].order)
    for mirror in remembered.values():
        x = jax.random.normal(jax.random.PRNGKey(0), (len(mirror.order),))
        np.testing.assert_array_equal(image(mirror, image(mirror, x)), np.asarray(x))
