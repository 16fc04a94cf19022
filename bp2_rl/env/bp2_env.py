"""BP2Env: high-speed running of BP2 as a Brax environment."""

import dataclasses
from functools import cached_property

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from brax import envs
from flax import struct
from jaxtyping import Array, Float

from bp2_rl.env import commands, observations, randomization, rewards
from bp2_rl.env.commands import CommandState
from bp2_rl.env.config import EnvConfig
from bp2_rl.env.controller import Controller, ControllerState, motors_of
from bp2_rl.env.physics.c import CPhysics
from bp2_rl.env.physics.interface import Effort, Impl, Physics, Simulator
from bp2_rl.env.physics.mjx import MjxPhysics
from bp2_rl.env.randomization import Randomization
from bp2_rl.gait.reference import Reference
from bp2_rl.robot import specs
from bp2_rl.robot.model import MOTOR_QPOS, MOTOR_QVEL, SPRING_QPOS, SPRING_QVEL, load_model

SPEED_BINS = (0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0)
"""Lower edges of the bins of commanded speed for which tracking errors are reported, m/s."""


class PipelineState(struct.PyTreeNode):
    """Everything that starts anew with an episode."""

    physics: Physics
    controller: ControllerState
    command: CommandState
    randomization: Randomization
    mean_torque: Float[Array, "... 12"]  # Nm, over the last control step


class BP2Env(envs.Env):
    """BP2 follows a velocity command (v_x, v_y, omega_z) on flat ground.

    One control step is 5 ms: 5 physics steps of 1 ms, with the joint torque (PD, envelope, motor) recomputed at
    each. Actions are 12 joint position targets (see `ControlConfig`). Observations: `state`, what the policy sees
    (`observations.LAYOUT`, noisy), and `privileged_state` for the critic. The reward is Table S4. An episode ends
    when the robot falls or its physics stops being finite; time limits are the wrapper's.

    `impl` chooses the physics engine: MJX's `jax` runs anywhere; MJX's `warp` is for NVIDIA GPUs, not exactly
    repeatable, and steps at most `num_robots` robots at once; `c`, C MuJoCo, is the fastest where there is no GPU.

    `state.info` holds `rng` and `curriculum` (the robot's level in [0, 1], which outlives episodes).
    """

    def __init__(self, config: EnvConfig | None = None, *, impl: Impl = "jax", num_robots: int = 1):
        self.config = config = config or EnvConfig()
        self.mj_model = load_model(config.hardware, visual=False, trunk_contact=False)
        self.controller = Controller(config)
        self._simulate = _simulator(impl, self.mj_model, config, num_robots)
        self._trunk = int(self.mj_model.body("trunk").id)
        self._stand = np.asarray(self.mj_model.key("stand").qpos, np.float32)

    # --- The Brax interface --------------------------------------------------------------------------------------

    def reset(self, rng: Array) -> envs.State:
        """A new robot at curriculum level 0; `rng` is one PRNG key."""
        return self._begin(rng, jnp.zeros(()))

    def restart(self, state: envs.State, rng: Array) -> envs.State:
        """A new episode for the robot of `state`, which keeps its curriculum level."""
        return self._begin(rng, state.info["curriculum"])

    def step(self, state: envs.State, action: Float[Array, "12"]) -> envs.State:
        """One control step (5 ms)."""
        config = self.config
        before: PipelineState = state.pipeline_state  # pyright: ignore[reportAssignmentType]  # Brax names only its own
        rng, key_noise, key_command, key_push = jax.random.split(state.info["rng"], 4)

        sound_action = jnp.all(jnp.isfinite(action))
        action = jnp.where(sound_action, action, 0.0)
        controller, targets = self.controller.act(before.controller, action, before.command.current)
        pushed = self._push(before.physics, key_push)
        with jax.default_matmul_precision("highest"):  # TF32 would move contacts by millimetres
            physics, effort, feet = self._simulate(pushed, targets, before.randomization)

        exploded = ~(sound_action & _is_sound(physics, config.termination.max_speed))
        physics = jax.tree.map(lambda new, home: jnp.where(exploded, home, new), physics, self._at_rest())
        effort = jax.tree.map(lambda x: jnp.where(exploded, 0.0, x), effort)
        heading = observations.heading(physics.qpos, physics.qvel)
        too_low = physics.qpos[2] < config.termination.min_height
        tilted = heading.e_z[2] < config.termination.min_up
        fallen = exploded | too_low | tilted

        terms = self._rewards(before, controller, physics, effort, heading, targets.reference, fallen)
        reward = sum(terms.values())

        level = state.info["curriculum"]
        command, raised = commands.advance(
            before.command, level, heading.velocity[0], key_command, config.commands, config.curriculum
        )
        level = jnp.where(fallen, jnp.maximum(level - config.curriculum.lower_by, 0.0), raised)
        after = PipelineState(
            physics=physics,
            controller=controller.replace(command=command.current),
            command=command,
            randomization=before.randomization,
            mean_torque=effort.torque,
        )
        return dataclasses.replace(
            state,
            pipeline_state=after,
            obs=self._observe(after, feet, key_noise),
            reward=reward,
            done=fallen.astype(jnp.float32),
            metrics=_metrics(terms, before.controller.command, heading, effort, level, exploded, too_low, tilted),
            info={**state.info, "rng": rng, "curriculum": level},
        )

    @cached_property
    def observation_size(self) -> dict[str, int]:
        """Sizes of the policy's and of the critic's observation."""
        shapes = jax.eval_shape(self.reset, jax.random.PRNGKey(0)).obs
        return {name: shape.shape[-1] for name, shape in shapes.items()}

    @property
    def action_size(self) -> int:
        """12: one target a motor."""
        return specs.NUM_MOTORS

    @property
    def backend(self) -> str:
        """The physics engine, for Brax."""
        return "mjx"

    @property
    def dt(self) -> float:
        """The control step, s."""
        return specs.CONTROL_STEP

    # --- Starting an episode -------------------------------------------------------------------------------------

    def _begin(self, rng: Array, level: Float[Array, ""]) -> envs.State:
        config = self.config
        rng, key_command, key_stand, key_phase, key_pose, key_robot, key_noise = jax.random.split(rng, 7)
        standing = jax.random.bernoulli(key_stand, config.reset.standing_fraction)
        top = commands.fastest(level, config.commands, config.curriculum)
        command = commands.draw(key_command, None, top, config.commands)
        command = command.replace(current=jnp.where(standing, 0.0, command.current))
        phase = jax.random.uniform(key_phase)
        reference = self.controller.reference(command.current, phase)
        qpos, qvel = self._start_pose(key_pose, standing, reference, command.current)
        pd_target = jnp.stack([reference.joint_position, reference.joint_velocity])
        pipeline_state = PipelineState(
            physics=Physics(
                qpos=qpos,
                qvel=qvel,
                qacc_warmstart=jnp.zeros_like(qvel),
                torque=jnp.zeros(specs.NUM_MOTORS),
                targets=jnp.stack([pd_target, pd_target]),
            ),
            controller=self.controller.init(command.current, phase),
            command=command,
            randomization=randomization.draw(
                key_robot, config.randomization, self.mj_model.nbody, config.hardware.friction
            ),
            mean_torque=jnp.zeros(specs.NUM_MOTORS),
        )
        zero = jnp.zeros(())
        terms = dict.fromkeys(REWARD_TERMS, zero)
        still = observations.heading(qpos, qvel)
        no_effort = Effort(torque=jnp.zeros(specs.NUM_MOTORS), power=jnp.zeros(specs.NUM_MOTORS))
        false = jnp.zeros((), bool)
        return envs.State(
            pipeline_state=pipeline_state,  # pyright: ignore[reportArgumentType]  # Brax names only its own
            obs=self._observe(pipeline_state, reference.contact, key_noise),
            reward=zero,
            done=zero,
            metrics=_metrics(terms, command.current, still, no_effort, level, false, false, false),
            info={"rng": rng, "curriculum": level},
        )

    def _start_pose(
        self, key: Array, standing: Array, reference: Reference, command: Float[Array, "3"]
    ) -> tuple[Array, Array]:
        """(qpos, qvel): on the reference with its velocities, or standing still; both with joint noise."""
        config = self.config.reset
        key_joint, key_velocity = jax.random.split(key)
        joints = jnp.where(standing, self._stand[MOTOR_QPOS], reference.joint_position)
        joints += jax.random.uniform(key_joint, (12,), minval=-config.joint_noise, maxval=config.joint_noise)
        height = jnp.where(standing, self._stand[2], reference.height)
        half_pitch = 0.5 * jnp.where(standing, 0.0, reference.pitch)
        qpos = jnp.zeros(self.mj_model.nq)
        qpos = qpos.at[2].set(height).at[3].set(jnp.cos(half_pitch)).at[5].set(jnp.sin(half_pitch))
        qpos = qpos.at[MOTOR_QPOS].set(joints)
        qpos = qpos.at[SPRING_QPOS].set(jnp.where(standing, self._stand[SPRING_QPOS], reference.spring_compression))
        qvel = jnp.zeros(self.mj_model.nv)
        qvel = qvel.at[:3].set(reference.velocity).at[4].set(reference.pitch_rate).at[5].set(command[2])
        qvel = qvel.at[MOTOR_QVEL].set(reference.joint_velocity).at[SPRING_QVEL].set(reference.spring_velocity)
        spread = config.velocity_noise
        qvel *= 1.0 + jax.random.uniform(key_velocity, qvel.shape, minval=-spread, maxval=spread)
        return qpos, jnp.where(standing, 0.0, qvel)

    def _at_rest(self) -> Physics:
        """A sound state to put in the place of one that is not; the episode is over anyway."""
        rest = jnp.zeros(self.mj_model.nv)
        zero = jnp.zeros(specs.NUM_MOTORS)
        targets = jnp.stack([jnp.asarray(self._stand[MOTOR_QPOS]), zero])
        return Physics(
            qpos=jnp.asarray(self._stand),
            qvel=rest,
            qacc_warmstart=rest,
            torque=zero,
            targets=jnp.stack([targets, targets]),
        )

    # --- Within a control step -----------------------------------------------------------------------------------

    def _push(self, physics: Physics, key: Array) -> Physics:
        """Now and then, a sudden change of the trunk's horizontal velocity."""
        config = self.config.randomization
        if not config.enabled or config.push_velocity == 0.0:
            return physics
        key_when, key_what = jax.random.split(key)
        now = jax.random.bernoulli(key_when, specs.CONTROL_STEP / config.push_interval)
        kick = jax.random.uniform(key_what, (2,), minval=-config.push_velocity, maxval=config.push_velocity)
        return physics.replace(qvel=physics.qvel.at[:2].add(jnp.where(now, kick, 0.0)))

    def _rewards(
        self,
        before: PipelineState,
        controller: ControllerState,
        physics: Physics,
        effort: Effort,
        heading: observations.Heading,
        reference: Reference,
        fallen: Array,
    ) -> dict[str, Array]:
        config = self.config
        peak = config.hardware.joint_peak_torque
        inputs = rewards.RewardInputs(
            command=before.controller.command,
            z=physics.qpos[2],
            z_ref=reference.height,
            e_z=heading.e_z,
            e_z_ref=reference.up,
            q=physics.qpos[MOTOR_QPOS],
            q_ref=reference.joint_position,
            qd=physics.qvel[MOTOR_QVEL],
            qd_ref=reference.joint_velocity,
            v=heading.velocity[:2],
            yaw_rate=heading.yaw_rate,
            tau_n=effort.torque / peak,
            tau_n_last=before.mean_torque / peak,
            power=effort.power,
            action=controller.last_action,
            last_action=before.controller.last_action,
            terminal=fallen.astype(jnp.float32),
        )
        return rewards.table_s4(
            inputs,
            config.reward,
            max_forward=config.commands.max_forward,
            max_lateral=config.commands.max_lateral,
            max_yaw_rate=config.commands.max_yaw_rate,
            dt=specs.CONTROL_STEP,
        )

    def _observe(self, state: PipelineState, feet: Float[Array, "4"], key: Array) -> dict[str, Array]:
        config, physics = self.config.randomization, state.physics
        measurement = observations.measure(physics.qpos, physics.qvel)
        clean = self.controller.observe(state.controller, measurement)
        noisy = clean
        if config.enabled:
            noisy = self.controller.observe(state.controller, observations.add_noise(measurement, config, key))
        heading = observations.heading(physics.qpos, physics.qvel)
        robot = state.randomization
        privileged = jnp.concatenate(
            [
                clean,
                heading.velocity,
                physics.qpos[2:3],
                physics.qpos[SPRING_QPOS],
                physics.qvel[SPRING_QVEL],
                feet,
                state.command.target,
                robot.friction[None],
                robot.mass[self._trunk][None],
                robot.com_offset,
                robot.strength,
                robot.latency[None],
            ]
        )
        return {"state": noisy, "privileged_state": privileged}


def _simulator(impl: Impl, model: mujoco.MjModel, config: EnvConfig, num_robots: int) -> Simulator:
    motors = motors_of(config)
    return CPhysics(config.hardware, motors) if impl == "c" else MjxPhysics(model, motors, impl, num_robots)


REWARD_TERMS: tuple[str, ...] = (
    "height",
    "attitude",
    "joint_position",
    "joint_velocity",
    "tracking",
    "torque",
    "power",
    "smoothness",
    "symmetry",
    "terminal",
)


def _is_sound(physics: Physics, max_speed: float) -> Array:
    """Whether every number is finite and no coordinate moves faster than anything real could."""
    finite = jnp.all(jnp.isfinite(physics.qpos)) & jnp.all(jnp.isfinite(physics.qvel))
    # A comparison with NaN is False, so this form also catches what isfinite would.
    return finite & jnp.all(jnp.isfinite(physics.torque)) & jnp.all(jnp.abs(physics.qvel) <= max_speed)


def _metrics(
    terms: dict[str, Array],
    command: Float[Array, "3"],
    heading: observations.Heading,
    effort: Effort,
    level: Array,
    exploded: Array,
    too_low: Array,
    tilted: Array,
) -> dict[str, Array]:
    """Per-step numbers; the learner averages them over robots and steps.

    `error/A` over `share/A` is the mean speed error at commands from A m/s up to the next bin.
    """
    error = jnp.abs(heading.velocity[0] - command[0])
    speed = jnp.abs(command[0])
    metrics = {f"reward/{name}": value for name, value in terms.items()}
    uppers = (*SPEED_BINS[1:], np.inf)
    for lower, upper in zip(SPEED_BINS, uppers, strict=True):
        inside = ((speed >= lower) & (speed < upper)).astype(jnp.float32)
        metrics[f"share/{lower:g}"] = inside
        metrics[f"error/{lower:g}"] = inside * error
    metrics |= {
        "speed_error": error,
        "curriculum_level": level,
        "speed": heading.velocity[0],
        "power": jnp.sum(jnp.maximum(effort.power, 0.0)),
        "fall/exploded": exploded.astype(jnp.float32),
        "fall/too_low": (too_low & ~exploded).astype(jnp.float32),
        "fall/tilted": (tilted & ~too_low & ~exploded).astype(jnp.float32),
    }
    return metrics
