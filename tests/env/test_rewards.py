"""Every row of Table S4 against numbers worked by hand from the printed formulas."""

import functools
import math

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
# float32 exponentials are good to a few units in the last place.
close = pytest.approx


def joint(value: float, index: int = 0) -> jax.Array:
    return ZERO.at[index].set(value)


def attitude(x: float, z: float) -> jax.Array:
    """The row of a body whose up is (x, 0, z) against level."""
    up = jnp.array([x, 0.0, z])
    return rewards.body_attitude(up, jnp.array([0.0, 0.0, 1.0]))


def tracking(forward: float, yaw_rate: float, *shape: TrackingShape) -> jax.Array:
    """The row of a robot told 10 m/s ahead."""
    told = jnp.array([10.0, 0.0])
    v, omega = jnp.array([forward, 0.0]), jnp.array([yaw_rate])
    return rewards.velocity_tracking(v, told, omega, jnp.zeros(1), 0.6, *shape)


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
        (lambda: tracking(9.5, math.sqrt(0.5)), 0.511070),
        # width 5, command 10: exp(-2 x 4 / (1 + 4)) = exp(-1.6) of the linear term
        (lambda: tracking(8.0, 0.0, TrackingShape(width=5.0)), 0.6 * 0.201897 + 0.4),
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
    assert float(row()) == close(expected, rel=1e-5 if expected > 1e-9 else 1e-3)


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
    perfect = {
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


def test_a_fall_costs_one():
    assert total(PAPER["relaxed"], terminal=jnp.array(1.0))["terminal"] == -1.0


def test_only_soles_that_come_down_near_the_ground_land_hard():
    config = RewardConfig(landing=2.0)
    assert total(config)["landing"] == 0.0
    height, rate = (
        jnp.array([0.0, 0.025, 0.05, 0.0]),
        jnp.array([-5.0, -5.0, -5.0, 5.0]),
    )
    assert total(config, sole_height=height, sole_rate=rate)["landing"] == close(
        -2.0 * 1.5
    )
    deep = total(
        config, sole_height=height - 0.01, sole_rate=jnp.array([-10.0, 0.0, 0.0, 0.0])
    )
    assert deep["landing"] == close(-2.0 * 4.0)


def test_only_motors_beyond_their_no_load_speed_are_too_fast():
    config = RewardConfig(overspeed=3.0)
    assert total(config, qd_n=jnp.full(12, -1.0))["overspeed"] == 0.0
    assert total(config, qd_n=jnp.array([1.5, -1.25] + [0.9] * 10))[
        "overspeed"
    ] == close(-3.0 * 0.75)


def test_who_is_to_stand_need_do_nothing():
    config, busy = RewardConfig(stand=0.5), jnp.full(12, -0.1)
    assert total(config, mean_action=busy)["stand"] == 0.0
    still = {"command": jnp.zeros(3), "v": jnp.zeros(2)}
    assert total(config, **still)["stand"] == 0.0
    assert total(config, mean_action=busy, **still)["stand"] == close(-0.5 * 1.2)
    assert (
        total(config, mean_action=busy, command=jnp.array([0.0, 0.0, 0.1]))["stand"]
        == 0.0
    )
    assert total(RewardConfig(), mean_action=busy, **still)["stand"] == 0.0


def test_symmetry_reads_the_abduction_joints():
    # FR abad is joint 0, FL 3, RR 6, RL 9; equal angles on both sides lean the legs to
    # one side.
    leaning = ZERO.at[jnp.array([0, 3])].set(0.05)  # (0.1)^2 x 100 = 1
    assert total(PAPER["relaxed"], q=leaning)["symmetry"] == close(
        0.1 * 0.367879, rel=1e-5
    )
    assert total(PAPER["relaxed"], q=joint(0.5, 1))["symmetry"] == close(0.1)


def test_a_tail_gives_the_reward_a_slope_at_any_error():
    v_cmd, omega_cmd = jnp.array([15.0, 0.0]), jnp.array([1.0])

    def score(speed, yaw_rate, w, tail=0.3, reach=1.0, yaw_reach=1.0):
        shape = TrackingShape(width=9.0, tail=tail, reach=reach, yaw_reach=yaw_reach)
        return float(
            rewards.velocity_tracking(
                jnp.array([speed, 0.0]),
                v_cmd,
                jnp.array([yaw_rate]),
                omega_cmd,
                w,
                shape,
            )
        )

    assert score(15.0, 1.0, 0.5) == close(1.0, rel=1e-5)
    # At 10 m/s of 15 the bell exp(-50 / 3.78) is all but gone; 0.3 (1 - 5 / (1 + 15 /
    # 2)) is left.
    assert score(10.0, 0.0, 1.0) == close(0.123531, rel=1e-5)
    assert score(10.0, 0.0, 1.0, tail=0.0) < 1e-5
    assert score(6.5, 0.0, 1.0) < 1e-15  # where the line ends
    # 0.7 exp(-2) + 0.3 (1 - 1 / (1 + 1 / 2)) of the yaw rate
    assert score(0.0, 0.0, 0.0) == close(0.194735, rel=1e-5)
    # Lines that end sooner: 0.3 (1 - 5 / (0.5 + 15 / 2)), and 0.7 exp(-2 0.36) + 0.3 (1
    # - 0.6 / (0.25 + 1 / 2)).
    assert score(10.0, 0.0, 1.0, reach=0.5) == close(0.1125, rel=1e-4)
    assert score(0.0, 0.4, 0.0, yaw_reach=0.25) == close(0.400727, rel=1e-5)


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


def test_narrow_shapes_tell_slow_motion_and_small_yaw_rates_apart():
    still, turn, slow = jnp.zeros(1), jnp.array([0.3]), jnp.array([0.5, 0.0])
    shape = TrackingShape(floor=0.2, width=8.0, yaw_width=0.3)
    yaw = functools.partial(rewards.velocity_tracking, slow, slow, still, turn, 0.0)
    assert float(yaw()) == close(0.835270, rel=1e-5)  # exp(-0.18)
    assert float(yaw(shape)) == close(0.135335, rel=1e-5)  # exp(-2)
    late = functools.partial(
        rewards.velocity_tracking, jnp.zeros(2), slow, still, still, 1.0
    )
    assert float(late()) == close(0.606531, rel=1e-5)  # exp(-0.5)
    # exp(-0.5 / (0.04 + 0.00390625))
    assert float(late(shape)) == close(1.13318e-5, rel=1e-3)
