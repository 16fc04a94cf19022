"""The reference motion without JAX is the one that policies are trained on."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bp2_rl.deploy.reference import playback
from bp2_rl.env.controller import motion_of
from bp2_rl.robot.hardware import BUILT, IDEAL
from bp2_rl.robot.named import find_robot
from bp2_rl.settings.env import EnvConfig
from bp2_rl.settings.presets.robots import sized

GO1 = find_robot("go1")
LEGS = [
    dataclasses.replace(leg, bend=1, ranges=(*leg.ranges[:2], (0.1, 2.6)))
    for leg in GO1.anatomy.legs[2:]
]
KNEES_TO_EACH_OTHER = dataclasses.replace(
    GO1,
    body=dataclasses.replace(
        GO1.anatomy,
        legs=(*GO1.anatomy.legs[:2], *LEGS),
        stand=(0.0, 0.9, -1.8) * 2 + (0.0, -0.9, 1.8) * 2,
    ),
)
MOMENTS = 600
ROUNDING = 1e-9  # of float64; knees all but straight take a thousandfold of it


def moments():
    """Commands beyond the library's speeds, backwards, sideways, turning and standing,
    at any phase."""
    rng = np.random.default_rng(0)
    command = rng.uniform((-2.0, -0.5, -1.0), (17.0, 0.5, 1.0), (MOMENTS, 3))
    command[:200, 0] = rng.uniform(-0.3, 0.3, 200)  # where steps grow out of standing
    command[:50] = 0.0
    command[200:350, 1:] = 0.0  # straight on
    return command, rng.uniform(-1.0, 2.0, MOMENTS)


@pytest.mark.parametrize(
    ("reference", "hardware"),
    [
        *(
            ("collocation", IDEAL),
            ("collocation", dataclasses.replace(BUILT, mass_scale=1.2)),
            ("none", IDEAL),
        ),
        *(("kinematic", robot) for robot in (IDEAL, GO1, KNEES_TO_EACH_OTHER)),
        ("none", GO1),
    ],
    ids=[
        "ideal",
        "built_and_heavier",
        "standing",
        "kinematic",
        "kinematic_go1",
        "knees_to_each_other",
        "go1_stands",
    ],
)
def test_it_is_the_gait_of_training(onboard, reference, hardware):
    config = sized(dataclasses.replace(EnvConfig(), hardware=hardware))
    config = dataclasses.replace(config, reference=reference)
    gait, (command, phase) = motion_of(config), moments()
    motion = onboard.motion.load_motion(*playback(config))
    with jax.enable_x64(True):
        expected = jax.jit(gait.__call__)(jnp.asarray(command), jnp.asarray(phase))
        rate = np.asarray(jax.jit(gait.phase_rate)(jnp.asarray(command)))
        stepping = np.asarray(jax.jit(gait.stepping)(jnp.asarray(command)))
    played = [
        motion(at, moment)
        for at, moment in zip(command.tolist(), phase.tolist(), strict=True)
    ]
    assert [motion.phase_rate(at) for at in command.tolist()] == pytest.approx(
        rate, abs=ROUNDING
    )
    assert [motion.stepping(at) for at in command.tolist()] == pytest.approx(
        stepping, abs=ROUNDING
    )
    for found, name in zip(
        zip(*played, strict=True), ("position", "velocity", "torque"), strict=True
    ):
        law = getattr(expected, name if name == "torque" else f"joint_{name}")
        # standing still needs no feed-forward: no policy asks
        if not (reference == "none" and name == "torque"):
            assert np.stack(found) == pytest.approx(np.asarray(law), abs=ROUNDING), name
    if reference != "none":
        # it moves
        assert np.ptp(np.stack([pose.position for pose in played]), axis=0).max() > 1.0


def test_a_gait_that_it_cannot_play_is_refused_by_name(onboard):
    with pytest.raises(
        ValueError, match="'walk': this controller plays collocation, kinematic, none"
    ):
        onboard.motion.load_motion({"kind": "walk"}, {})


def test_a_rate_is_the_derivative(onboard):
    """Each function against a central difference, whose error is some 1e-9 at this
    step."""

    def law(t):
        xp = t.__array_namespace__()
        a, b = xp.sin(3.0 * t) + 1.5, 2.0 - t * t
        parts = xp.stack(
            [a / b, xp.sqrt(b) * a**3, 1.0 / a - xp.cos(t), xp.atan2(a, b), xp.exp(-a)],
            axis=-1,
        )
        kept = [
            xp.maximum(t, 0.3),
            xp.minimum(t, t * t + 0.2),
            xp.clip(t, 0.1, 0.4),
            xp.where(t < 0.2, -t, t * t),
        ]
        return xp.concat(
            [parts, xp.stack([*kept, xp.broadcast_to(2.0, t.shape)], axis=-1)], axis=-1
        )

    time, step = np.array([0.05, 0.25, 0.35, 0.7]), 3e-6
    (value,), (rate,) = onboard.motion.differentiate(
        lambda t: (law(t),), (time,), (np.ones(4),)
    )
    # complex powers round otherwise on some processors
    assert value == pytest.approx(law(time), rel=1e-15, abs=1e-15)
    assert rate == pytest.approx(
        (law(time + step) - law(time - step)) / (2.0 * step), abs=1e-8
    )
