"""Every row of Table S4 against numbers worked by hand from the printed formulas."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bp2_rl.env import rewards
from bp2_rl.settings.env import CommandConfig, EnvConfig, RewardConfig, TrackingShape
from bp2_rl.settings.presets.rewards import PAPER

ZERO = jnp.zeros(12)
TAIL = {"width": 9.0, "tail": 0.3, "reach": 1.0, "yaw_reach": 1.0}
NARROW = {"floor": 0.2, "width": 8.0, "yaw_width": 0.3}
# float32 exponentials are good to a few units in the last place.
close = pytest.approx


def joint(value: float, index: int = 0) -> jax.Array:
    return ZERO.at[index].set(value)


def attitude(x: float, z: float) -> jax.Array:
    """Return the attitude reward of a body whose up is (x, 0, z), against level."""
    up = jnp.array([x, 0.0, z])
    return rewards.body_attitude(up, jnp.array([0.0, 0.0, 1.0]))


def tracking(
    v: float, v_cmd: float, omega: float, omega_cmd: float, w: float, **shape: float
) -> jax.Array:
    """Return the tracking reward of a robot that runs at v and turns at omega, under
    other commands."""
    return rewards.velocity_tracking(
        jnp.array([v, 0.0]),
        jnp.array([v_cmd, 0.0]),
        jnp.array([omega]),
        jnp.array([omega_cmd]),
        w,
        TrackingShape(**shape),
    )


def symmetry(*abad: float, turn: float = 0.0) -> jax.Array:
    return rewards.straight_symmetry(jnp.array(abad), jnp.array(turn))


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        # exp(-80 x 0.1^2) = exp(-0.8)
        (lambda: rewards.body_height(jnp.array(0.45), jnp.array(0.55)), 0.449329),
        # Pitched by 90 deg: |(1,0,0) - (0,0,1)|^2 = 2; 0.1 rad: 2 - 2 cos 0.1 =
        # 0.00999167
        (lambda: attitude(1.0, 0.0), math.exp(-160)),
        (lambda: attitude(math.sin(0.1), math.cos(0.1)), 0.449628),
        # 0.2 exp(-2 (0.3^2 + 0.4^2)) = 0.2 exp(-0.5)
        (
            lambda: rewards.joint_position_imitation(joint(0.3).at[5].set(-0.4), ZERO),
            0.121306,
        ),
        # 0.7 exp(-0.02 x (3^2 + 4^2)) = 0.7 exp(-0.5)
        (
            lambda: rewards.joint_velocity_imitation(joint(3.0).at[11].set(4.0), ZERO),
            0.424571,
        ),
        # w = 0.6; |v - v_cmd|^2 = 0.25, |omega - omega_cmd|^2 = 0.5: 0.6 exp(-0.5) +
        # 0.4 exp(-1)
        (lambda: tracking(9.5, 10.0, math.sqrt(0.5), 0.0, 0.6), 0.511070),
        # width 5, command 10: exp(-2 x 4 / (1 + 4)) = exp(-1.6) of the linear term
        (
            lambda: tracking(8.0, 10.0, 0.0, 0.0, 0.6, width=5.0),
            0.6 * 0.201897 + 0.4,
        ),
        # A tail gives the reward a slope at any error: at 10 m/s of 15 the bell
        # exp(-50 / 3.78) is all but gone; 0.3 (1 - 5 / (1 + 15 / 2)) is left.
        (lambda: tracking(15.0, 15.0, 1.0, 1.0, 0.5, **TAIL), 1.0),
        (lambda: tracking(10.0, 15.0, 0.0, 1.0, 1.0, **TAIL), 0.123531),
        # 0.7 exp(-2) + 0.3 (1 - 1 / (1 + 1 / 2)) of the yaw rate
        (lambda: tracking(0.0, 15.0, 0.0, 1.0, 0.0, **TAIL), 0.194735),
        # Lines that end sooner: 0.3 (1 - 5 / (0.5 + 15 / 2)), and 0.7 exp(-2 0.36) +
        # 0.3 (1 - 0.6 / (0.25 + 1 / 2)).
        (
            lambda: tracking(10.0, 15.0, 0.0, 1.0, 1.0, **TAIL | {"reach": 0.5}),
            0.1125013,
        ),
        (
            lambda: tracking(0.0, 15.0, 0.4, 1.0, 0.0, **TAIL | {"yaw_reach": 0.25}),
            0.400727,
        ),
        # Narrow shapes tell slow motion and small yaw rates apart: exp(-0.18), exp(-2)
        (lambda: tracking(0.5, 0.5, 0.0, 0.3, 0.0), 0.835270),
        (lambda: tracking(0.5, 0.5, 0.0, 0.3, 0.0, **NARROW), 0.135335),
        # exp(-0.5), exp(-0.5 / (0.04 + 0.00390625))
        (lambda: tracking(0.0, 0.5, 0.0, 0.0, 1.0), 0.606531),
        (lambda: tracking(0.0, 0.5, 0.0, 0.0, 1.0, **NARROW), 1.13318e-5),
        # |tau_n|^2 = 0.5, |change|^2 = 0.01, dt = 0.005:
        # 0.9 exp(-0.25) + 0.1 exp(-0.1 x 0.01 / 0.005) = 0.700921 + 0.081873
        (
            lambda: rewards.torque_regularization(
                joint(0.5).at[1].set(0.5), joint(0.4).at[1].set(0.5), 0.005
            ),
            0.782794,
        ),
        # 11 idle motors: phi(0) = exp(0) = 1. One driving with 100 W: exp(-1); one
        # braking with 20 W: exp(-1).
        (lambda: rewards.power_regularization(joint(100.0)), (11 + 0.367879) / 12),
        (lambda: rewards.power_regularization(joint(-20.0)), (11 + 0.367879) / 12),
        # largest change 0.2: exp(-0.6)
        (
            lambda: rewards.action_smoothness(joint(0.2).at[3].set(-0.1), ZERO),
            0.548812,
        ),
        # (0.1 - 0.05)^2 + (0.02 + 0.02)^2 = 0.0025 + 0.0016 -> exp(-0.41); eta = 0.1
        # -> exp(-1)
        (lambda: symmetry(0.1, -0.05, 0.02, 0.02), 0.663650),
        (lambda: symmetry(0.1, -0.05, 0.02, 0.02, turn=0.1), 0.663650 * 0.367879),
        # legs splayed alike cost nothing; legs that lean to one side cost all
        (lambda: symmetry(-0.2, 0.2, -0.1, 0.1), 1.0),
        (lambda: symmetry(0.2, 0.2, 0.2, 0.2), math.exp(-32)),
        # the larger share of two turns
        (lambda: rewards.turn_activation(jnp.array([9, 0.25, -0.2]), 0.5, 1.0), 0.5),
        (lambda: rewards.turn_activation(jnp.array([9, 0.1, -0.9]), 0.5, 1.0), 0.9),
        # 10.5 / 11.5 = 0.91, capped
        (lambda: rewards.tracking_balance(10.0, 0.5, 1.0), 0.6),
        (lambda: rewards.tracking_balance(1.0, 0.0, 3.0), 0.25),
    ],
)
def test_a_row_of_table_s4_is_what_the_printed_formula_gives(row, expected):
    # float32 exponentials are good to a few units in the last place of the exponent
    assert float(row()) == close(expected, rel=1e-5 if expected > 1e-4 else 1e-3)


def test_power_regularization_is_finite_with_finite_gradient_at_any_power():
    for power in (-1e6, -1.0, 0.0, 1.0, 1e6):
        value, slope = jax.value_and_grad(rewards.power_regularization)(
            jnp.full(12, power)
        )
        assert 0.0 <= float(value) <= 1.0
        assert np.isfinite(slope).all()


@pytest.mark.parametrize(
    ("schedule", "c_J", "c_V", "v", "c_m", "c_v"),
    [
        # imitation stage, Table S4 to the letter: tracking loses weight with speed
        ("literal", 0.6, 0.1, 0.0, 0.1, 0.6),
        ("literal", 0.6, 0.1, 10.0, 0.6, 0.1),
        # as the text describes it: tracking gains weight with speed
        ("text", 0.6, 0.1, 0.0, 0.6, 0.1),
        ("text", 0.6, 0.1, 10.0, 0.1, 0.6),
        # half speed: beta = 0.5^0.3 = 0.812252; c_v = 0.812252 x 0.6 + 0.187748 x 0.1 =
        # 0.506126
        ("text", 0.6, 0.1, 5.0, 0.193874, 0.506126),
        # relaxed stage: both readings agree
        ("literal", 0.1, 0.4, 0.0, 0.4, 0.1),
        ("literal", 0.1, 0.4, 10.0, 0.1, 0.4),
        ("text", 0.1, 0.4, 0.0, 0.4, 0.1),
        ("text", 0.1, 0.4, 10.0, 0.1, 0.4),
        # backwards counts by its size
        ("text", 0.1, 0.4, -5.0, 0.5 - 0.343676, 0.343676),
        # without a schedule: the weights of the table at any speed
        ("off", 0.6, 0.1, 0.0, 0.6, 0.1),
        ("off", 0.6, 0.1, 7.0, 0.6, 0.1),
    ],
)
def test_speed_schedule(schedule, c_J, c_V, v, c_m, c_v):
    got = rewards.speed_schedule(jnp.array(v), 10.0, c_J, c_V, schedule)
    assert [float(x) for x in got] == [close(c_m, abs=1e-5), close(c_v, abs=1e-5)]


@given(
    v=st.floats(-20, 20),
    c_J=st.floats(0, 1),
    c_V=st.floats(0, 1),
    schedule=st.sampled_from(["text", "literal"]),
)
def test_the_schedule_only_moves_weight_between_imitation_and_tracking(
    v, c_J, c_V, schedule
):
    c_m, c_v = (
        float(x) for x in rewards.speed_schedule(jnp.array(v), 10.0, c_J, c_V, schedule)
    )
    low, high = min(c_J, c_V), max(c_J, c_V)
    assert c_m + c_v == close(c_J + c_V, abs=1e-6)
    assert low - 1e-6 <= c_v <= high + 1e-6


def inputs(**changes) -> rewards.RewardInputs:
    up = jnp.array([0.0, 0.0, 1.0])
    perfect: Any = {
        "command": jnp.array([10.0, 0.0, 0.0]),
        "z": jnp.array(0.5),
        "z_ref": jnp.array(0.5),
        "e_z": up,
        "e_z_ref": up,
        "q": ZERO,
        "q_ref": ZERO,
        "qd": ZERO,
        "qd_ref": ZERO,
        "v": jnp.array([10.0, 0.0]),
        "yaw_rate": jnp.array(0.0),
        "tau_n": ZERO,
        "tau_n_last": ZERO,
        "power": ZERO,
        "action": ZERO,
        "last_action": ZERO,
        "mean_action": ZERO,
        "terminal": jnp.array(0.0),
        "sole_height": jnp.full(4, 0.2),
        "sole_rate": jnp.full(4, -9.0),
        "qd_n": ZERO,
    }
    return rewards.RewardInputs(**(perfect | changes))


def total(config: RewardConfig, **changes) -> dict[str, float]:
    commands = CommandConfig(max_forward=10.0, max_lateral=0.5, max_yaw_rate=1.0)
    terms = rewards.reward_terms(
        inputs(**changes), EnvConfig(commands=commands, reward=config)
    )
    return {name: float(value) for name, value in terms.items()}


@pytest.mark.parametrize(
    ("column", "coefficients"),
    [
        (
            "imitation",
            {
                "height": 0.05,
                "attitude": 0.05,
                "joint_position": 0.02,
                "joint_velocity": 0.07,
                "tracking": 0.6,
                "torque": 0.1,
                "smoothness": 0.1,
            },
        ),
        (
            "relaxed",
            {
                "joint_position": 0.02,
                "joint_velocity": 0.07,
                "tracking": 0.4,
                "torque": 0.2,
                "power": 0.1,
                "smoothness": 0.2,
                "symmetry": 0.1,
            },
        ),
    ],
)
def test_a_perfect_robot_at_top_speed_earns_each_coefficient(column, coefficients):
    """A row of your own counts nothing until a stage gives it a coefficient."""
    terms = total(PAPER[column])
    assert {name: term for name, term in terms.items() if term != 0.0} == close(
        coefficients
    )


def test_an_average_forgets_exponentially():
    error = jnp.zeros(3)
    for _ in range(40):
        error = rewards.exponential_average(
            error, jnp.array([1.0, -2.0, 0.0]), 0.2, 0.005
        )
    gained = 1.0 - math.exp(-1.0)  # after as long as it remembers
    np.testing.assert_allclose(error, [gained, -2.0 * gained, 0.0], rtol=1e-5)
    np.testing.assert_array_equal(
        rewards.exponential_average(error, jnp.ones(3), 0.0, 0.005), 1.0
    )


BUSY = {"mean_action": jnp.full(12, -0.1)}
STILL = {"command": jnp.zeros(3), "v": jnp.zeros(2)}
# FR abad is joint 0, FL 3, RR 6, RL 9
LEANING = ZERO.at[jnp.array([0, 3])].set(0.05)


@pytest.mark.parametrize(
    ("config", "row", "changes", "expected"),
    [
        (PAPER["relaxed"], "terminal", {"terminal": jnp.array(1.0)}, -1.0),
        # equal angles on both sides lean the legs to one side: (0.1)^2 x 100 = 1
        (PAPER["relaxed"], "symmetry", {"q": LEANING}, close(0.0367879, rel=1e-5)),
        (PAPER["relaxed"], "symmetry", {"q": joint(0.5, 1)}, close(0.1)),
        # only soles that come down near the ground land hard
        (RewardConfig(landing=2.0), "landing", {}, 0.0),
        (
            RewardConfig(landing=2.0),
            "landing",
            {
                "sole_height": jnp.array([0.0, 0.025, 0.05, 0.0]),
                "sole_rate": jnp.array([-5.0, -5.0, -5.0, 5.0]),
            },
            close(-2.0 * 1.5),
        ),
        (
            RewardConfig(landing=2.0),
            "landing",
            {
                "sole_height": jnp.array([-0.01, 0.015, 0.04, -0.01]),
                "sole_rate": jnp.array([-10.0, 0.0, 0.0, 0.0]),
            },
            close(-2.0 * 4.0),
        ),
        # only motors beyond their no-load speed are too fast
        (RewardConfig(overspeed=3.0), "overspeed", {"qd_n": jnp.full(12, -1.0)}, 0.0),
        (
            RewardConfig(overspeed=3.0),
            "overspeed",
            {"qd_n": jnp.array([1.5, -1.25] + [0.9] * 10)},
            close(-3.0 * 0.75),
        ),
        # who is to stand need do nothing
        (RewardConfig(stand=0.5), "stand", BUSY, 0.0),
        (RewardConfig(stand=0.5), "stand", STILL, 0.0),
        (RewardConfig(stand=0.5), "stand", BUSY | STILL, close(-0.5 * 1.2)),
        (
            RewardConfig(stand=0.5),
            "stand",
            BUSY | STILL | {"command": jnp.array([0.0, 0.0, 0.1])},
            0.0,
        ),
        (RewardConfig(), "stand", BUSY | STILL, 0.0),
    ],
)
def test_a_row_counts_what_it_is_for_and_nothing_else(config, row, changes, expected):
    assert total(config, **changes)[row] == expected


def test_a_tail_ends_where_its_line_does():
    assert float(tracking(10.0, 15.0, 0.0, 1.0, 1.0, **TAIL | {"tail": 0.0})) < 1e-5
    assert float(tracking(6.5, 15.0, 0.0, 1.0, 1.0, **TAIL)) < 1e-15
