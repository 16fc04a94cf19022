"""The reference motion without JAX is the one that policies are trained on."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.deploy.reference import playback
from bp2_rl.env.controller import motion_of
from bp2_rl.robot.hardware import BUILT, IDEAL
from bp2_rl.settings.env import EnvConfig

MOMENTS = 600
ROUNDING = 1e-9  # of float64; knees all but straight take a thousandfold of it


def moments():
    """Commands beyond the library's speeds, backwards, sideways, turning and standing, at any phase."""
    rng = np.random.default_rng(0)
    command = rng.uniform((-2.0, -0.5, -1.0), (17.0, 0.5, 1.0), (MOMENTS, 3))
    command[:200, 0] = rng.uniform(-0.3, 0.3, 200)  # where steps grow out of standing
    command[:50] = 0.0
    command[200:350, 1:] = 0.0  # straight on
    return command, rng.uniform(-1.0, 2.0, MOMENTS)


@pytest.mark.parametrize(
    ("reference", "hardware"),
    [("collocation", IDEAL), ("collocation", dataclasses.replace(BUILT, mass_scale=1.2)), ("none", IDEAL)],
    ids=["ideal", "built_and_heavier", "standing"],
)
def test_it_is_the_gait_of_training(onboard, reference, hardware):
    config = dataclasses.replace(EnvConfig(), reference=reference, hardware=hardware)
    gait, (command, phase) = motion_of(config), moments()
    motion = onboard.motion.load_motion(*playback(config))
    with jax.enable_x64(True):
        expected = jax.jit(gait.__call__)(jnp.asarray(command), jnp.asarray(phase))
        rate = np.asarray(jax.jit(gait.phase_rate)(jnp.asarray(command)))
        stepping = np.asarray(jax.jit(gait.stepping)(jnp.asarray(command)))
    played = [motion(at, moment) for at, moment in zip(command.tolist(), phase.tolist(), strict=True)]
    assert [motion.phase_rate(at) for at in command.tolist()] == pytest.approx(rate, abs=ROUNDING)
    assert [motion.stepping(at) for at in command.tolist()] == pytest.approx(stepping, abs=ROUNDING)
    for found, name in zip(zip(*played, strict=True), ("position", "velocity", "torque"), strict=True):
        law = getattr(expected, name if name == "torque" else f"joint_{name}")
        if not (reference == "none" and name == "torque"):  # standing still needs no feed-forward: no policy asks
            assert np.stack(found) == pytest.approx(np.asarray(law), abs=ROUNDING), name
    if reference == "collocation":
        assert np.ptp(np.stack([pose.position for pose in played]), axis=0).max() > 1.0  # it moves


def test_a_gait_that_it_cannot_play_is_refused_by_name(onboard):
    with pytest.raises(UserError, match="trained on the kinematic reference cannot be exported"):
        playback(dataclasses.replace(EnvConfig(), reference="kinematic"))
    with pytest.raises(ValueError, match="'walk': this controller plays collocation, none"):
        onboard.motion.load_motion({"kind": "walk"}, {})
