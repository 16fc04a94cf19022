"""BP2Env: the Brax interface, resets on the reference, randomisation, and what happens
to a robot gone wrong."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from mujoco import mjx

from bp2_rl.env import commands, observations, randomization, rewards
from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.env.controller import motion_of, motors_of
from bp2_rl.env.episode import NUM_KEYS
from bp2_rl.env.metrics import SPEED_BINS
from bp2_rl.env.physics.kernel import randomize_design
from bp2_rl.env.physics.mjx import randomize_model
from bp2_rl.env.rewards import TERMS
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.actuator import torque_limits
from bp2_rl.robot.clearance import clearance
from bp2_rl.robot.hardware import BUILT, IDEAL, HardwareSpec
from bp2_rl.robot.kernel.design import Design
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import MOTOR_QPOS, MOTOR_QVEL, SPRING_QPOS, foot_geom_ids
from bp2_rl.settings.env import (
    CommandConfig,
    ControlConfig,
    CurriculumConfig,
    EnvConfig,
    RandomizationConfig,
    ResetConfig,
    RewardConfig,
    TerminationConfig,
    TrackingShape,
)

ROBOTS = 64
KEYS = jax.random.split(jax.random.PRNGKey(0), ROBOTS)
ZERO = jnp.zeros((ROBOTS, 12))
CRITIC_LAYOUT = (
    *observations.LAYOUT,
    *((entry.name, entry.size) for entry in observations.PRIVILEGED),
)


@pytest.fixture(scope="module")
def env() -> BP2Env:
    return BP2Env(EnvConfig())


@pytest.fixture(scope="module")
def reset(env):
    return jax.jit(jax.vmap(env.reset))


@pytest.fixture(scope="module")
def step(env):
    return jax.jit(jax.vmap(env.step))


@pytest.fixture(scope="module")
def start(reset):
    return reset(KEYS)


@pytest.fixture(scope="module")
def standing():
    """Return the states in which standing robots start."""
    env = BP2Env(EnvConfig(reset=ResetConfig(standing_fraction=1.0, joint_noise=0.0)))
    return jax.jit(jax.vmap(env.reset))(KEYS)


def physics(state):
    return state.pipeline_state.physics


def with_physics(state, **changes):
    return state.replace(
        pipeline_state=state.pipeline_state.replace(
            physics=physics(state).replace(**changes)
        )
    )


def test_sizes_are_what_reset_and_step_return(env, start, step):
    after = step(start, ZERO)
    for state in (start, after):
        assert {
            name: obs.shape[1] for name, obs in state.obs.items()
        } == env.observation_size
        assert state.reward.shape == state.done.shape == (ROBOTS,)
    assert (
        env.observation_size["state"]
        == sum(size for _, size in observations.LAYOUT)
        == 47
    )
    assert env.action_size == 12
    assert jax.tree.structure(start) == jax.tree.structure(after)


def test_running_starts_are_on_the_reference_with_its_velocities(env):
    config = EnvConfig(
        # the library's knees are almost straight at times, where float32 is coarse
        reference="kinematic",
        reset=ResetConfig(standing_fraction=0.0, joint_noise=0.0, velocity_noise=0.0),
        randomization=RandomizationConfig(enabled=False),
    )
    state = jax.jit(jax.vmap(BP2Env(config).reset))(KEYS)
    command, controller = (
        state.pipeline_state.command.current,
        state.pipeline_state.controller,
    )
    reference = jax.vmap(motion_of(config))(command, controller.phase)
    # Compiled once with the reset and once by itself: float32 of some 10 rad/s, and of
    # angles that follow from feet at 15 m/s with a leg nearly stretched.
    np.testing.assert_allclose(
        physics(state).qpos[:, MOTOR_QPOS], reference.joint_position, atol=5e-6
    )
    np.testing.assert_allclose(
        physics(state).qvel[:, MOTOR_QVEL],
        reference.joint_velocity,
        rtol=1e-5,
        atol=1e-5,
    )
    np.testing.assert_allclose(
        physics(state).qvel[:, 0], reference.velocity[:, 0], rtol=1e-5, atol=1e-5
    )
    assert np.ptp(command[:, 0]) > 10.0
    np.testing.assert_allclose(physics(state).qpos[:, 2], reference.height, atol=1e-6)
    np.testing.assert_allclose(
        physics(state).qpos[:, SPRING_QPOS], reference.spring_compression, atol=1e-6
    )
    assert np.ptp(controller.phase) > 0.8


def test_standing_starts_are_at_rest_on_the_ground_with_the_command_at_zero(
    env, standing
):
    assert np.all(np.asarray(physics(standing).qvel) == 0.0)
    assert np.all(np.asarray(standing.pipeline_state.command.current) == 0.0)
    assert np.any(np.asarray(standing.pipeline_state.command.target[:, 0]) > 1.0)
    data = mujoco.MjData(env.mj_model)
    data.qpos[:] = np.asarray(physics(standing).qpos[0])
    mujoco.mj_kinematics(env.mj_model, data)
    height = data.geom_xpos[foot_geom_ids(env.mj_model), 2] - bp2.FOOT_RADIUS
    np.testing.assert_allclose(height, 0.0, atol=1e-3)


def test_standing_starts_may_have_to_wait_for_their_first_command():
    """Of a second at most, a third after a third of it: within that time nobody can
    know when it comes."""
    config = EnvConfig(
        reference="none",
        reset=ResetConfig(standing_fraction=1.0, standing_time=(0.0, 1.0)),
        commands=CommandConfig(stand_fraction=0.0),
    )
    env = BP2Env(config)
    drawn = jax.random.split(KEYS[0], (3000, NUM_KEYS))
    start = jax.jit(jax.vmap(env.starts.draw, in_axes=(0, None)))(drawn, jnp.zeros(()))[
        0
    ]

    def step(state, key):
        state, _ = commands.advance(state, jnp.zeros(()), jnp.zeros(()), key, config)
        return state, state.current[0]

    keys = jax.random.split(KEYS[1], 200)
    told = jax.jit(jax.vmap(lambda state: jax.lax.scan(step, state, keys)[1]))
    forward = told(start.command)
    waited = np.argmax(np.asarray(forward) > 0.0, axis=1) * conventions.CONTROL_STEP
    assert np.quantile(waited, [1 / 3, 2 / 3]) == pytest.approx(
        [1 / 3, 2 / 3], abs=0.04
    )
    assert 0.9 < waited.max() <= 1.0 + 3 * conventions.CONTROL_STEP


def test_soles_are_where_mujoco_has_them_and_move_as_there(env):
    data, random = mujoco.MjData(env.mj_model), np.random.default_rng(0)
    motion = np.zeros(6)
    for _ in range(20):
        data.qpos[:] = env.mj_model.key("stand").qpos
        data.qpos[3:] += 0.1 * random.normal(size=20)
        data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
        data.qvel[:] = random.normal(size=22)
        mujoco.mj_kinematics(env.mj_model, data)
        mujoco.mj_comPos(env.mj_model, data)
        mujoco.mj_comVel(env.mj_model, data)
        height, rate = observations.soles(
            jnp.array(data.qpos), jnp.array(data.qvel), env.config.hardware
        )
        for leg, geom in enumerate(foot_geom_ids(env.mj_model)):
            mujoco.mj_objectVelocity(
                env.mj_model, data, mujoco.mjtObj.mjOBJ_GEOM, geom, motion, 0
            )
            # A sole is a point of the leg's axis, as far below the foot's middle as its
            # radius.
            assert abs(height[leg] - data.geom_xpos[geom, 2]) <= bp2.FOOT_RADIUS
            assert rate[leg] == pytest.approx(
                motion[5], abs=bp2.FOOT_RADIUS * float(np.linalg.norm(motion[:3]))
            )


def test_a_standing_robot_without_commands_stays_up(env, step):
    config = dataclasses.replace(
        env.config,
        reset=ResetConfig(standing_fraction=1.0),
        commands=dataclasses.replace(env.config.commands, stand_fraction=1.0),
    )
    state = jax.jit(jax.vmap(BP2Env(config).reset))(KEYS)
    # A fifth of a second: long before the first new command, and pushes of 0.5 m/s
    # included.
    for _ in range(40):
        state = step(state, ZERO)
        assert not np.any(np.asarray(state.done))
    heights = np.asarray(physics(state).qpos[:, 2])
    assert np.all(np.abs(heights - bp2.STANDING_HEIGHT) < 0.05)


def test_training_randomises_each_reset_around_the_friction_that_was_asked_for():
    reset = jax.jit(
        jax.vmap(BP2Env(EnvConfig(hardware=HardwareSpec(friction=0.3))).reset)
    )
    draws = np.concatenate(
        [
            reset(keys).pipeline_state.randomization.friction
            for keys in (KEYS, jax.random.split(jax.random.PRNGKey(1), ROBOTS))
        ]
    )
    assert len(np.unique(draws)) == 2 * ROBOTS
    low, high = RandomizationConfig().friction
    assert np.all((draws >= 0.3 * low) & (draws <= 0.3 * high))
    # 128 uniform draws: the mean's standard deviation is 0.004.
    assert draws.mean() == pytest.approx(0.3 * (low + high) / 2, abs=0.025)


def test_randomisation_reaches_model_and_motors(env):
    robot = randomization.nominal(env.mj_model.nbody, HardwareSpec())
    heavy = robot.replace(
        mass=robot.mass * 1.1, friction=jnp.array(0.5), strength=robot.strength * 0.8
    )
    nominal = mjx.put_model(env.mj_model)
    model = randomize_model(nominal, heavy, env.trunk)
    assert float(model.body_mass.sum()) == pytest.approx(
        1.1 * float(nominal.body_mass.sum()), rel=1e-6
    )
    assert np.all(np.asarray(model.geom_friction[:, 0]) == 0.5)
    motors = randomization.randomize_actuator(motors_of(env.config), heavy)
    assert np.allclose(np.asarray(motors.strength), 0.8)


def test_numbers_of_the_design_that_are_not_drawn_are_left_untouched(env):
    """They are the very same objects, so that the program is the same, too."""
    robot = randomization.draw(
        KEYS[0], RandomizationConfig(), env.mj_model.nbody, BUILT
    )
    design = Design.of(env.mj_model)
    kept, same = jax.tree.flatten(randomize_design(design, robot))
    arrays, structure = jax.tree.flatten(design)
    assert all(ours is before for ours, before in zip(kept, arrays, strict=True))
    assert same == structure  # with the numbers that are known
    model = mjx.put_model(env.mj_model)
    changed = randomize_model(model, robot, env.trunk)
    for field in ("jnt_stiffness", "dof_damping", "dof_armature"):
        assert getattr(changed, field) is getattr(model, field)
    motors = motors_of(EnvConfig(hardware=BUILT))
    drawn = randomization.randomize_actuator(motors, robot)
    for speed in ("corner_speed", "no_load_speed", "braking_speed"):
        assert getattr(drawn, speed) is getattr(motors, speed)
    resistance = Resistance.from_hardware(BUILT)
    assert resistance is not None
    drawn = randomization.randomize_resistance(resistance, robot)
    assert drawn.joint_hold is resistance.joint_hold


def test_a_robot_drawn_with_slower_motors_is_rewarded_as_one_built_so(start):
    slower = IDEAL.changed(
        **{n: 0.5 * IDEAL.parameter(n) for n in ("no_load_speed", "corner_speed")}
    )
    robots = start.pipeline_state.randomization.replace(
        no_load_speed=jnp.full(ROBOTS, 0.5)
    )
    as_drawn = start.replace(
        pipeline_state=start.pipeline_state.replace(randomization=robots)
    )
    ours, theirs = (
        jax.jit(
            jax.vmap(
                BP2Env(
                    EnvConfig(hardware=hardware, reward=RewardConfig(overspeed=3.0)),
                    impl="kernel",
                ).step
            )
        )(before, ZERO)
        for hardware, before in ((IDEAL, as_drawn), (slower, start))
    )
    np.testing.assert_allclose(
        ours.metrics["reward/overspeed"], theirs.metrics["reward/overspeed"], rtol=1e-4
    )
    assert float(jnp.min(ours.metrics["reward/overspeed"])) < 0.0
    np.testing.assert_allclose(ours.reward, theirs.reward, atol=1e-5)


def test_a_push_changes_the_horizontal_velocity_by_at_most_what_was_asked_for():
    config = RandomizationConfig(push_interval=0.01, push_velocity=0.5)
    pushed = jax.vmap(lambda key: randomization.push(jnp.zeros(22), config, key))
    change = np.asarray(pushed(jax.random.split(jax.random.PRNGKey(0), 4000)))
    pushes = change[np.any(change != 0.0, axis=1)]
    # six deviations
    assert len(pushes) == pytest.approx(4000 * conventions.CONTROL_STEP / 0.01, rel=0.1)
    largest = np.zeros(22)
    largest[:2] = 0.5
    assert np.all(np.abs(pushes) <= largest)
    # three deviations
    np.testing.assert_allclose(
        np.std(pushes, axis=0), largest / np.sqrt(3.0), rtol=0.05
    )


def test_motors_brake_as_weakly_as_was_drawn():
    """0 is the hardware's braking, 1 as driving, and between them the line ends at the
    no-load speed over the draw."""
    robot = randomization.nominal(18, BUILT)
    qd = jnp.linspace(-60.0, 60.0, 12)
    for drawn, speed in ((0.0, float("inf")), (0.5, 42.8), (1.0, 21.4)):
        motors = randomization.randomize_actuator(
            motors_of(EnvConfig(hardware=BUILT)), robot
        )
        weak = randomization.randomize_actuator(
            motors_of(EnvConfig(hardware=BUILT)),
            robot.replace(braking=jnp.array(drawn)),
        )
        expected = torque_limits(dataclasses.replace(motors, braking_speed=speed), qd)
        np.testing.assert_allclose(
            torque_limits(weak, qd), expected, rtol=1e-4, atol=1e-3
        )
    weakly = RandomizationConfig(weak_braking=(0.2, 1.0))
    braking = np.asarray(
        jax.vmap(lambda key: randomization.draw(key, weakly, 18, BUILT))(KEYS).braking
    )
    assert braking.min() >= 0.2
    assert 0.5 < braking.mean() < 0.7
    assert randomization.draw(KEYS[0], RandomizationConfig(), 18, BUILT).braking is None


def test_the_critic_sees_the_truth_and_the_policy_sees_noise(start):
    clean, noisy = start.obs["privileged_state"][:, :47], start.obs["state"]
    noise = np.asarray(noisy - clean)
    joint_velocity = slice(3 + 2 + 12, 3 + 2 + 24)
    # 64 x 12 samples: the standard deviation is known to 3 %.
    assert noise[:, joint_velocity].std() == pytest.approx(
        RandomizationConfig().joint_velocity_noise, rel=0.15
    )
    assert np.all(noise[:, :5] == 0.0)


def test_the_critics_observation_is_laid_out_as_named(start, step, env):
    after = step(start, ZERO)
    names, sizes = zip(*CRITIC_LAYOUT, strict=True)
    ends = np.cumsum(sizes)
    parts = np.split(np.asarray(after.obs["privileged_state"]), ends[:-1], axis=1)
    seen = dict(zip(names, parts, strict=True))
    episode = after.pipeline_state
    for name, expected in {
        "command": episode.command.current,
        "last_action": episode.controller.last_action,
        "height": physics(after).qpos[:, 2:3],
        "spring_compression": physics(after).qpos[:, SPRING_QPOS],
        "target_command": episode.command.target,
        "friction": episode.randomization.friction[:, None],
        "trunk_mass": episode.randomization.mass[:, env.trunk, None],
        "strength": episode.randomization.strength,
        "latency": episode.randomization.latency[:, None],
    }.items():
        np.testing.assert_array_equal(seen[name], expected, err_msg=name)
    assert set(np.unique(seen["foot_contact"])) == {0.0, 1.0}


def test_latency_delays_the_targets(start, step):
    """With 10 ms of latency, two control steps pass before an action shows in the
    torque."""

    def torques(latency, action):
        robot = start.pipeline_state.randomization.replace(
            latency=jnp.full(ROBOTS, latency, jnp.float32)
        )
        state = start.replace(
            pipeline_state=start.pipeline_state.replace(randomization=robot)
        )
        for _ in range(4):
            state = step(state, action)
            yield np.asarray(state.pipeline_state.mean_torque)

    at_once, soon, late = (
        [
            np.max(np.abs(other - one))
            for one, other in zip(
                torques(latency, ZERO), torques(latency, ZERO + 0.1), strict=True
            )
        ]
        for latency in (0.0, 0.003, 0.010)
    )
    assert at_once[0] > soon[0] > 1.0
    assert late[:2] == [0.0, 0.0]
    assert late[2] > 1.0


@pytest.mark.parametrize("bad", ["position", "joint velocity", "action"])
def test_a_robot_that_is_not_finite_ends_its_episode_and_harms_nobody(start, step, bad):
    qpos, qvel, healthy = physics(start).qpos, physics(start).qvel, step(start, ZERO)
    state, action = {
        "position": (with_physics(start, qpos=qpos.at[3, 9].set(jnp.nan)), ZERO),
        "joint velocity": (with_physics(start, qvel=qvel.at[3, 9].set(jnp.inf)), ZERO),
        "action": (start, ZERO.at[3].set(jnp.nan)),
    }[bad]
    after = step(state, action)
    assert float(after.done[3]) == 1.0
    assert float(after.metrics["fall/exploded"][3]) == 1.0
    others = np.arange(ROBOTS) != 3
    np.testing.assert_array_equal(
        after.obs["state"][others], healthy.obs["state"][others]
    )
    shown = jax.tree.leaves((after.obs, after.reward, after.metrics))
    assert all(np.isfinite(x).all() for x in shown)


@pytest.mark.parametrize(
    ("pose", "cause"),
    [
        ({2: 0.2}, "fall/too_low"),
        ({2: 1.5, 3: np.cos(0.6), 4: np.sin(0.6), 5: 0.0, 6: 0.0}, "fall/tilted"),
    ],
)
def test_fallen_robots_are_counted_by_cause(start, step, pose, cause):
    qpos = (
        physics(start).qpos.at[:, jnp.array([*pose])].set(jnp.array([*pose.values()]))
    )
    after = step(with_physics(start, qpos=qpos), ZERO)
    assert np.all(np.asarray(after.done) == 1.0)
    assert np.all(np.asarray(after.metrics[cause]) == 1.0)
    assert np.all(np.asarray(after.metrics["reward/terminal"]) == -1.0)


def test_no_episode_begins_with_legs_in_each_other():
    """Noise of 0.5 rad would put some robots' there; they have their legs below their
    hips instead."""
    config = EnvConfig(
        hardware=IDEAL.changed(hind_track=0.28, solid_legs=True),
        reset=ResetConfig(joint_noise=0.5, standing_fraction=0.0),
        termination=TerminationConfig(max_overlap=0.0),
    )
    qpos = np.asarray(physics(jax.jit(jax.vmap(BP2Env(config).reset))(KEYS)).qpos)
    gaps = clearance(
        qpos[:, MOTOR_QPOS].reshape(-1, 4, 3), qpos[:, SPRING_QPOS], config.hardware
    ).least
    assert gaps.min() >= 0.0
    moved = (qpos[:, MOTOR_QPOS[0::3]] == 0.0).all(axis=1)
    assert 0 < moved.sum() < ROBOTS


def test_the_reward_is_the_sum_of_the_rows_and_counts_in_one_speed_bin(start, step):
    after = step(start, ZERO)
    rows = [after.metrics[f"reward/{name}"] for name in TERMS]
    np.testing.assert_allclose(after.reward, np.sum(rows, axis=0), rtol=1e-5, atol=1e-6)
    shares = np.sum([after.metrics[f"share/{lower:g}"] for lower in SPEED_BINS], axis=0)
    np.testing.assert_array_equal(shares, np.ones(ROBOTS))


def test_restart_keeps_the_curriculum_level():
    env = BP2Env(EnvConfig(curriculum=CurriculumConfig(start_speed=4.0)))
    start = jax.jit(jax.vmap(env.reset))(KEYS)
    learned = start.replace(info={**start.info, "curriculum": jnp.full(ROBOTS, 0.7)})
    fresh = jax.jit(jax.vmap(env.restart))(learned, KEYS)
    assert np.all(np.asarray(fresh.info["curriculum"]) == np.float32(0.7))
    assert float(fresh.pipeline_state.command.target[:, 0].max()) > 4.0


def test_every_torque_of_a_random_policy_is_inside_the_envelope(start, step):
    state, strongest = start, 0.0
    for key in jax.random.split(jax.random.PRNGKey(7), 20):
        state = step(state, jax.random.normal(key, (ROBOTS, 12)))
        strongest = max(strongest, float(jnp.max(jnp.abs(physics(state).torque))))
    assert 0.9 * bp2.PEAK_TORQUE < strongest <= bp2.PEAK_TORQUE * (1 + 1e-6)


def test_errors_are_averaged_and_observations_remembered_where_asked_for():
    shape = TrackingShape(memory=0.2)
    config = EnvConfig(
        control=ControlConfig(history=(1,)), reward=RewardConfig(tracking_shape=shape)
    )
    env = BP2Env(config, impl="kernel")
    before = jax.jit(env.reset)(jax.random.PRNGKey(3))
    erred = jnp.array([-1.0, 0.3, 0.5])
    state = before.pipeline_state.replace(tracking_error=erred)
    before = before.replace(pipeline_state=state)
    after = jax.jit(env.step)(before, jnp.full(12, 0.1))
    np.testing.assert_allclose(
        after.pipeline_state.mean_action, 0.1 * (1.0 - np.exp(-0.005 / 0.2)), rtol=1e-4
    )
    command = before.pipeline_state.command.current
    moved = observations.trunk_motion(physics(after).qpos, physics(after).qvel)
    error = jnp.append(moved.velocity[:2], moved.yaw_rate) - command
    kept = np.exp(-0.005 / 0.2)
    expected = kept * np.asarray(erred) + (1.0 - kept) * np.asarray(error)
    np.testing.assert_allclose(
        after.pipeline_state.tracking_error, expected, rtol=1e-4, atol=1e-6
    )
    seen = after.obs["privileged_state"]
    assert len(seen) == observations.size_of(CRITIC_LAYOUT) == 87
    np.testing.assert_array_equal(seen[-3:], after.pipeline_state.tracking_error)
    # What is rewarded is the average: a robot that errs for 5 ms has hardly erred.
    near = command + after.pipeline_state.tracking_error
    weights = rewards.speed_schedule(
        command[0], 15.5, config.reward.imitation, config.reward.tracking
    )
    share = rewards.tracking_balance(15.5, 0.5, 1.0)
    tracked = rewards.velocity_tracking(
        near[:2], command[:2], near[2:], command[2:], share, shape
    )
    assert float(after.metrics["reward/tracking"]) == pytest.approx(
        float(weights[1] * tracked), rel=1e-5
    )
    first, then = before.obs["state"], after.obs["state"]
    np.testing.assert_array_equal(first[47:], 0.0)
    np.testing.assert_array_equal(then[47:], then[:47] - first[:47])
