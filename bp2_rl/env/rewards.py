"""Table S4, row by row: every reward term as a pure function, and the speed-dependent
schedule.

Each function returns one term *without* its base coefficient (the imitation terms
together carry c_m, the tracking term c_v; see `speed_schedule`). `reward_terms` puts
the terms together.

The coefficients are written for BP2. Lengths, speeds and powers of another robot come
divided by the factors of its `Size`, which have no unit and are 1 for BP2. So m, m/s,
rad/s and W below are those of a robot of BP2's size.
"""

import functools
import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

from bp2_rl.base.errors import UserError
from bp2_rl.env.observations import PrivilegedInputs, own_number
from bp2_rl.robot import conventions
from bp2_rl.settings.env import EnvConfig, RewardConfig, Schedule, TrackingShape

Scalar = Float[Array, ""]
PAPER_SHAPE = TrackingShape()
# s, time constant of the average of actions for `standing_still_penalty`
ACTION_AVERAGING = 0.2


def squared_norm(x: Float[Array, " n"]) -> Scalar:
    """Return |x|^2."""
    return jnp.sum(jnp.square(x))


def body_height(z: Scalar, z_ref: Scalar) -> Scalar:
    """Return r_h / c_h, the reward for a trunk as high as the reference's; heights in
    m."""
    return jnp.exp(-80.0 * jnp.square(z - z_ref))


def body_attitude(e_z: Float[Array, "3"], e_z_ref: Float[Array, "3"]) -> Scalar:
    """Return r_R / c_R, the reward for a trunk's vertical axis near the reference's;
    unit vectors."""
    return jnp.exp(-80.0 * squared_norm(e_z - e_z_ref))


def joint_position_imitation(
    q: Float[Array, "12"], q_ref: Float[Array, "12"]
) -> Scalar:
    """Return r_q / c_m, the reward for joint angles near the reference's; rad."""
    return 0.2 * jnp.exp(-2.0 * squared_norm(q_ref - q))


def joint_velocity_imitation(
    qd: Float[Array, "12"], qd_ref: Float[Array, "12"]
) -> Scalar:
    """Return r_qd / c_m, the reward for joint speeds near the reference's; rad/s."""
    return 0.7 * jnp.exp(-0.02 * squared_norm(qd_ref - qd))


def exponential_average(
    mean: Float[Array, " n"], now: Float[Array, " n"], time: float, dt: float
) -> Float[Array, " n"]:
    """Return the exponential average with time constant `time`, dt seconds after it was
    `mean`; `now` if `time` is 0."""
    return now if time == 0.0 else mean - math.expm1(-dt / time) * (now - mean)


def velocity_tracking(
    v: Float[Array, " n"],
    v_cmd: Float[Array, " n"],
    omega: Float[Array, " m"],
    omega_cmd: Float[Array, " m"],
    w: float,
    shape: TrackingShape = PAPER_SHAPE,
) -> Scalar:
    """Return r_v / c_v, the reward for velocities near the commanded ones; m/s and
    rad/s. The environment passes the horizontal velocity and the yaw rate.

    The paper rewards exp(-2 |e|^2), which has no slope where the error is large, beyond
    2 m/s, nor where it is small, as in slow motion and in fast turns; see
    `TrackingShape`.
    """
    square_width = shape.floor**2 + squared_norm(v_cmd) / shape.width**2
    linear = _tracking_term(v - v_cmd, v_cmd, square_width, shape.tail, shape.reach)
    angular = _tracking_term(
        omega - omega_cmd, omega_cmd, shape.yaw_width**2, shape.tail, shape.yaw_reach
    )
    return w * linear + (1.0 - w) * angular


def _tracking_term(
    error: Float[Array, " n"],
    command: Float[Array, " n"],
    square_width: Scalar | float,
    tail: float,
    reach: float,
) -> Scalar:
    bell = jnp.exp(-2.0 * squared_norm(error) / square_width)
    if tail == 0.0:
        return bell
    line = 1.0 - jnp.linalg.norm(error) / (reach + 0.5 * jnp.linalg.norm(command))
    return (1.0 - tail) * bell + tail * jnp.maximum(line, 0.0)


def torque_regularization(
    tau_n: Float[Array, "12"], tau_n_last: Float[Array, "12"], dt: float
) -> Scalar:
    """Return r_tau / c_tau, the reward for small and steady torques; torques over the
    peak torque, at this control step and at the last, dt seconds before."""
    return 0.9 * jnp.exp(-0.5 * squared_norm(tau_n)) + 0.1 * jnp.exp(
        -0.1 * squared_norm(tau_n - tau_n_last) / dt
    )


def power_regularization(power: Float[Array, "12"]) -> Scalar:
    """Return r_P / c_P for the actuators' mechanical power, W.

    The reward decays five times as fast with braking power as with driving power.
    """
    # Both exponents are kept <= 0 so that the branch not taken cannot overflow.
    phi = jnp.where(
        power > 0,
        jnp.exp(-0.01 * jnp.maximum(power, 0.0)),
        jnp.exp(0.05 * jnp.minimum(power, 0.0)),
    )
    return jnp.mean(phi)


def action_smoothness(
    action: Float[Array, "12"], last_action: Float[Array, "12"]
) -> Scalar:
    """Return r_s / c_s, the reward for small changes of the action."""
    return jnp.exp(-3.0 * jnp.max(jnp.abs(action - last_action)))


def straight_symmetry(abad: Float[Array, "4"], eta: Scalar) -> Scalar:
    """Return r_str, the reward for mirrored abduction angles (FR, FL, RR, RL, rad) on
    straight runs; the table's 0 / 0.1 is its coefficient."""
    front, rear = abad[0] + abad[1], abad[2] + abad[3]
    return jnp.exp(-10.0 * eta) * jnp.exp(
        -100.0 * (jnp.square(front) + jnp.square(rear))
    )


def hard_landing(height: Float[Array, "4"], rate: Float[Array, "4"]) -> Scalar:
    """Beyond Table S4: the sum over soles within 50 mm of the ground (m) of (their
    speed downwards / 5 m/s)^2."""
    near = jnp.clip(1.0 - height / 0.05, 0.0, 1.0)
    return jnp.sum(near * jnp.square(jnp.minimum(rate, 0.0) / 5.0))


def overspeed(qd_n: Float[Array, "12"]) -> Scalar:
    """Beyond Table S4: the sum over motors of the speed beyond the no-load speed;
    `qd_n` is the speed over the no-load speed."""
    return jnp.sum(jnp.maximum(jnp.abs(qd_n) - 1.0, 0.0))


def standing_still_penalty(
    mean_action: Float[Array, "12"], command: Float[Array, "3"]
) -> Scalar:
    """Beyond Table S4: the sum of |mean action| where the command is to stand, else 0.

    Without action the joints' own stiffness holds the standing pose. A penalty on the
    present action instead of its average over `ACTION_AVERAGING` would make a policy
    explore less.
    """
    return jnp.where(jnp.any(command != 0.0), 0.0, jnp.sum(jnp.abs(mean_action)))


def turn_activation(
    command: Float[Array, "3"], max_lateral: float, max_yaw_rate: float
) -> Scalar:
    """eta: 0 for a straight command, 1 at the largest lateral or yaw command. command =
    (v_x, v_y, omega_z)."""
    tiny = 1e-6  # a maximum of 0 means that the command is always 0
    return jnp.maximum(
        jnp.abs(command[1]) / (max_lateral + tiny),
        jnp.abs(command[2]) / (max_yaw_rate + tiny),
    )


def tracking_balance(
    max_forward: float, max_lateral: float, max_yaw_rate: float
) -> float:
    """w: share of the linear velocity in the tracking reward."""
    linear = max_forward + max_lateral
    return min(linear / (linear + max_yaw_rate), 0.6)


def speed_schedule(
    v_x_cmd: Scalar, v_x_max: float, c_J: float, c_V: float, schedule: Schedule = "text"
) -> tuple[Scalar, Scalar]:
    """(c_m, c_v): weights of imitation and of velocity tracking at this commanded
    speed.

    beta = (|v_x_cmd| / v_x_max)^0.3. `literal` is Table S4 to the letter: c_v = beta
    c_V + (1 - beta) c_J and c_m = c_J + c_V - c_v. With the imitation stage's c_J = 0.6
    > c_V = 0.1 this makes tracking *lose* weight with speed, the opposite of what the
    text says ("reducing the constraint imposed by the reference trajectory at high
    commanded velocities"). `text` gives tracking the larger of the two coefficients at
    v_x_max and the smaller at rest, in both stages; in the relaxed stage (c_J < c_V)
    the two readings are the same. `off`: c_J and c_V at all speeds.
    """
    if schedule == "off":
        return jnp.asarray(c_J), jnp.asarray(c_V)
    beta = jnp.clip(jnp.abs(v_x_cmd) / v_x_max, 0.0, 1.0) ** 0.3
    at_rest, at_speed = (
        (c_J, c_V) if schedule == "literal" else (min(c_J, c_V), max(c_J, c_V))
    )
    c_v = beta * at_speed + (1.0 - beta) * at_rest
    return c_J + c_V - c_v, c_v


class RewardInputs(struct.PyTreeNode):
    """Quantities of Table S4 at a robot's control step, over the factors of the robot's
    `Size`; units are those of a robot of BP2's size."""

    command: Float[Array, "... 3"]  # v_x, v_y, m/s; omega_z, rad/s
    z: Float[Array, "..."]  # m
    z_ref: Float[Array, "..."]  # m
    e_z: Float[Array, "... 3"]
    e_z_ref: Float[Array, "... 3"]
    q: Float[Array, "... 12"]  # rad
    q_ref: Float[Array, "... 12"]  # rad
    qd: Float[Array, "... 12"]  # rad/s
    qd_ref: Float[Array, "... 12"]  # rad/s
    v: Float[Array, "... 2"]  # m/s, horizontal, heading frame
    yaw_rate: Float[Array, "..."]  # rad/s
    tau_n: Float[Array, "... 12"]  # torque over the motor's peak torque
    tau_n_last: Float[Array, "... 12"]
    power: Float[Array, "... 12"]  # W
    action: Float[Array, "... 12"]
    last_action: Float[Array, "... 12"]
    mean_action: Float[Array, "... 12"]  # averaged over `ACTION_AVERAGING`
    terminal: Float[Array, "..."]  # 1 if the robot has fallen
    sole_height: Float[Array, "... 4"]  # m
    sole_rate: Float[Array, "... 4"]  # m/s, upwards
    qd_n: Float[Array, "... 12"]  # joint speed over the motor's no-load speed
    # all else, for the terms of a task; in SI units
    now: PrivilegedInputs | None = None


class SharedValues(NamedTuple):
    """Values that all terms share at one command: see `speed_schedule`,
    `tracking_balance` and `turn_activation`."""

    c_m: Scalar
    c_v: Scalar
    w: float
    eta: Scalar
    dt: float  # s, a control step


RewardFunction = Callable[[RewardInputs, RewardConfig, SharedValues], Scalar]
"""A reward term with its coefficient, as a function of inputs, coefficients and shared
values."""
TERMS: Mapping[str, RewardFunction] = {
    "height": lambda x, c, _: c.height * body_height(x.z, x.z_ref),
    "attitude": lambda x, c, _: c.attitude * body_attitude(x.e_z, x.e_z_ref),
    "joint_position": lambda x, _, at: at.c_m * joint_position_imitation(x.q, x.q_ref),
    "joint_velocity": lambda x, _, at: (
        at.c_m * joint_velocity_imitation(x.qd, x.qd_ref)
    ),
    "tracking": lambda x, c, at: (
        at.c_v
        * velocity_tracking(
            x.v, x.command[:2], x.yaw_rate[None], x.command[2:], at.w, c.tracking_shape
        )
    ),
    "torque": lambda x, c, at: (
        c.torque * torque_regularization(x.tau_n, x.tau_n_last, at.dt)
    ),
    "power": lambda x, c, _: c.power * power_regularization(x.power),
    "smoothness": lambda x, c, _: (
        c.smoothness * action_smoothness(x.action, x.last_action)
    ),
    "symmetry": lambda x, c, at: c.symmetry * straight_symmetry(x.q[0::3], at.eta),
    "terminal": lambda x, c, _: -c.terminal * x.terminal,
    "landing": lambda x, c, _: (
        -c.landing * hard_landing(x.sole_height, x.sole_rate)
        if c.landing
        else jnp.zeros(())
    ),
    "overspeed": lambda x, c, _: (
        -c.overspeed * overspeed(x.qd_n) if c.overspeed else jnp.zeros(())
    ),
    "stand": lambda x, c, _: (
        -c.stand * standing_still_penalty(x.mean_action, x.command)
        if c.stand
        else jnp.zeros(())
    ),
}
"""Reward terms, Table S4's and three more, by their names, as in the metrics
`reward/NAME`."""


def terms_of(config: EnvConfig) -> Mapping[str, RewardFunction]:
    """Return the terms of the reward: `TERMS`, then the task's, times their coefficients.

    Raises:
        UserError: a term of the task has the name of one of `TERMS`, or fails.
    """
    for name, _ in config.task.rewards:
        if name in TERMS:
            raise UserError(
                f"Task: there is a reward term {name} already: rename yours"
            )
    reads = {term.name: term.read for term in config.task.task.rewards}
    own = {
        name: functools.partial(_own_term, name, reads[name], coefficient)
        for name, coefficient in config.task.rewards
    }
    return {**TERMS, **own}


def _own_term(
    name: str,
    read: RewardFunction,
    coefficient: float,
    x: RewardInputs,
    config: RewardConfig,
    at: SharedValues,
) -> Scalar:
    return coefficient * own_number(f"reward term {name}", read, x, config, at)


def reward_terms(
    x: RewardInputs, config: EnvConfig, terms: Mapping[str, RewardFunction] = TERMS
) -> dict[str, Scalar]:
    """Return all reward terms with their coefficients, by name; the reward is their
    sum."""
    reward, size = config.reward, config.hardware.size
    max_forward = config.commands.max_forward / size.speed
    max_lateral = config.commands.max_lateral / size.speed
    max_yaw_rate = config.commands.max_yaw_rate / size.rate
    c_m, c_v = speed_schedule(
        x.command[0], max_forward, reward.imitation, reward.tracking, reward.schedule
    )
    shared = SharedValues(
        c_m=c_m,
        c_v=c_v,
        w=tracking_balance(max_forward, max_lateral, max_yaw_rate),
        eta=turn_activation(x.command, max_lateral, max_yaw_rate),
        dt=conventions.CONTROL_STEP,
    )
    return {name: term(x, reward, shared) for name, term in terms.items()}
