"""BP2Env: high-speed running of BP2 as a Brax environment."""

import dataclasses
import functools
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import NoneType
from typing import Any, get_args

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

# isort: off
from bp2_rl.robot import mjx  # noqa: F401  # before Brax, which imports MJX and lets it print
from brax import base, envs, kinematics
from brax.io import image, mjcf
# isort: on

from bp2_rl.base.errors import UserError, require_kind, require_one_of
from bp2_rl.env import commands, observations, randomization, rewards, termination
from bp2_rl.env.controller import Controller, Targets, motors_of
from bp2_rl.env.episode import NUM_KEYS, EpisodeStarts, PipelineState
from bp2_rl.env.metrics import StepOutcome, metrics
from bp2_rl.env.named import CONFIGS
from bp2_rl.env.physics.interface import LONGEST_LATENCY, Effort, Physics, PhysicsEngine
from bp2_rl.env.physics.kernel import KernelPhysics
from bp2_rl.env.physics.mjx import MjxPhysics
from bp2_rl.env.termination import Fall
from bp2_rl.robot import conventions
from bp2_rl.robot.coordinates import joint_positions, joint_velocities
from bp2_rl.robot.ground import Ground, over_ground
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import load_model
from bp2_rl.robot.named import robot_names
from bp2_rl.robot.observation import Mirror
from bp2_rl.settings.env import EnvConfig, Impl
from bp2_rl.settings.presets import with_task
from bp2_rl.settings.task import Task
from bp2_rl.settings.training import TrainConfig


class BP2Env(envs.Env):
    """Environment in which a quadruped, by default BP2, follows a velocity command
    (v_x, v_y, omega_z) on flat ground, or on the ground of `config.terrain`.

    One control step is 5 ms: 5 physics steps of 1 ms, with the joint torque (PD,
    envelope, motor) recomputed at each. Actions are 12 joint position targets (see
    `ControlConfig`). Observations: `state`, what the policy sees
    (`observations.layout_of`, noisy), and `privileged_state` for the critic. The reward
    is Table S4. An episode ends when the robot falls or its physics stops being finite;
    time limits are the wrapper's.

    `impl` chooses the physics engine (`env.physics.interface`). `num_robots` is the
    largest batch that `warp` steps at once; the other engines ignore it. A task in the
    settings adds terms to the reward, reasons to end an episode, and terms to both
    observations.

    `state.info` holds `rng` and `curriculum` (the robot's level in [0, 1], which
    outlives episodes).
    """

    def __init__(
        self,
        config: EnvConfig,
        *,
        impl: Impl = "jax",
        num_robots: int = 1,
    ):
        self.config = config
        if config.task.source and config.task.code is None:
            raise UserError(
                f"the settings name the task {config.task.source} without its code: pass task="
            )
        self.reward_terms = rewards.terms_of(config)
        self._privileged = observations.privileged_terms(config)
        if (latency := config.hardware.losses.latency) > LONGEST_LATENCY:
            raise UserError(
                f"hardware.losses.latency ({latency:g} s) must be at most {LONGEST_LATENCY:g} s in training: targets "
                "are remembered for so long; more is for C MuJoCo alone"
            )
        self.mj_model = load_model(config.hardware, visual=False, feet_only=True)
        self.controller = Controller(config)
        self.engine = _make_engine(impl, self.mj_model, config, num_robots)
        self.starts = EpisodeStarts(config, self.controller, self.mj_model)
        self.trunk = int(self.mj_model.body("trunk").id)

    # --- The Brax interface -----------------------------------------------------------

    def reset(self, rng: Array) -> envs.State:
        """Return a new robot at curriculum level 0; `rng` is one PRNG key."""
        return self._start_episode(rng, jnp.zeros(()))

    def restart(self, state: envs.State, rng: Array) -> envs.State:
        """Return a new episode for the robot of `state`, which keeps its curriculum
        level."""
        return self._start_episode(rng, state.info["curriculum"])

    def step(self, state: envs.State, action: Float[Array, "12"]) -> envs.State:
        """Take one control step (5 ms)."""
        before: PipelineState = state.pipeline_state  # pyright: ignore[reportAssignmentType]  # Brax names only its own
        rng, key_noise, key_command, key_push = jax.random.split(state.info["rng"], 4)

        finite = jnp.where(jnp.all(jnp.isfinite(action)), action, 0.0)
        controller, targets, reference = self.controller.act(
            before.controller, before.command.current, finite
        )
        physics, effort, foot_contact = self._simulate(before, targets, key_push)
        fall = self._fall(physics, before.randomization.ground, action)
        physics, effort = self._replace_exploded(physics, effort, fall)

        motion = observations.trunk_motion(physics.qpos, physics.qvel)
        after = before.replace(physics=physics, controller=controller)
        now = self._privileged_inputs(after, foot_contact)
        fall = fall._replace(
            own=termination.own_falls(self.config.task.task.terminations, now)
        )
        outcome = StepOutcome(before.command.current, reference, effort, motion, fall)
        after = self._average(before, after, outcome)
        inputs = self._reward_inputs(before, after, outcome).replace(now=now)
        terms = rewards.reward_terms(inputs, self.config, self.reward_terms)

        level = state.info["curriculum"]
        command, raised = commands.advance(
            before.command, level, motion.velocity[0], key_command, self.config
        )
        lowered = jnp.maximum(level - self.config.curriculum.lower_by, 0.0)
        level = jnp.where(fall.happened, lowered, raised)
        after, obs = self._observe(
            after.replace(command=command), foot_contact, key_noise
        )
        return dataclasses.replace(
            state,
            pipeline_state=after,
            obs=obs,
            reward=sum(terms.values()),
            done=fall.happened.astype(jnp.float32),
            metrics=metrics(outcome, terms, level),
            info={**state.info, "rng": rng, "curriculum": level},
        )

    @property
    def observation_size(self) -> dict[str, int]:
        """Sizes of the policy's and of the critic's observation."""
        return {
            "state": observations.size_of(observations.layout_of(self.config)),
            "privileged_state": len(self.mirrors["privileged_state"].sign),
        }

    @property
    def mirrors(self) -> dict[str, Mirror]:
        """Mirrors of both observations and of the action, for a robot with left and
        right exchanged, half a cycle on."""
        return observations.mirrors_under(self.config)

    @property
    def action_size(self) -> int:
        """Length of an action: 12, a target for each motor."""
        return conventions.NUM_MOTORS

    @property
    def backend(self) -> str:
        """Brax's name for the family of physics engines; `impl` names the engine in
        use."""
        return "mjx"

    @property
    def dt(self) -> float:
        """Return the control step, s."""
        return conventions.CONTROL_STEP

    # --- To look at it with Brax's tools ----------------------------------------------

    @functools.cached_property
    def sys(self) -> base.System:
        """Return the robot with its looks, for `brax.io` alone: nothing here is
        simulated in Brax."""
        # that Brax's physics is not maintained, which nothing here uses
        with warnings.catch_warnings():
            warnings.filterwarnings(
                "ignore", message="Brax System", category=UserWarning
            )
            return mjcf.load_model(load_model(self.config.hardware))

    def render(
        self,
        trajectory: Sequence[PipelineState] | PipelineState,
        height: int = 240,
        width: int = 320,
        camera: str | None = None,
    ) -> Sequence[np.ndarray] | np.ndarray:
        """Return pictures of a robot's `pipeline_state`s, drawn with a GL library."""
        states: Any = (
            trajectory if isinstance(trajectory, PipelineState) else list(trajectory)
        )
        return image.render_array(self.sys, states, height, width, camera)

    def brax_state(self, state: PipelineState) -> base.State:
        """Return one robot's state with its links' places, for `brax.io.html.render`."""
        x, xd = kinematics.forward(self.sys, state.q, state.qd)
        return base.State(q=state.q, qd=state.qd, x=x, xd=xd, contact=None)  # pyright: ignore[reportCallIssue]

    # --- The parts of a step ----------------------------------------------------------

    def _start_episode(self, rng: Array, level: Float[Array, ""]) -> envs.State:
        rng, *keys, key_noise = jax.random.split(rng, NUM_KEYS + 2)
        episode, reference = self.starts.draw(keys, level)
        episode, obs = self._observe(episode, reference.contact, key_noise)
        zero, false = jnp.zeros(()), jnp.zeros((), bool)
        outcome = StepOutcome(
            command=episode.command.current,
            reference=reference,
            effort=Effort(
                torque=jnp.zeros(conventions.NUM_MOTORS),
                power=jnp.zeros(conventions.NUM_MOTORS),
            ),
            motion=observations.trunk_motion(
                episode.physics.qpos, episode.physics.qvel
            ),
            fall=Fall(
                false,
                false,
                false,
                false if self.config.hardware.solid_legs else None,
                {
                    termination.name: false
                    for termination in self.config.task.task.terminations
                },
            ),
        )
        return envs.State(
            pipeline_state=episode,  # pyright: ignore[reportArgumentType]  # Brax names only its own
            obs=obs,
            reward=zero,
            done=zero,
            metrics=metrics(outcome, dict.fromkeys(self.reward_terms, zero), level),
            info={"rng": rng, "curriculum": level},
        )

    def _simulate(
        self, state: PipelineState, targets: Targets, key: Array
    ) -> tuple[Physics, Effort, Float[Array, "4"]]:
        """Push the robot now and then, and run the physics engine; see
        `PhysicsEngine`."""
        pushed = randomization.push(state.physics.qvel, self.config.randomization, key)
        # TF32 would move contacts by millimetres
        with jax.default_matmul_precision("highest"):
            return self.engine(
                state.physics.replace(qvel=pushed), targets, state.randomization
            )

    def _fall(
        self, physics: Physics, ground: Ground | None, action: Float[Array, "12"]
    ) -> Fall:
        """Return whether and why the episode ends; see `termination`."""
        pose = over_ground(physics.qpos, ground)
        fall = termination.fall_in_training(
            pose, physics.qvel, physics.torque, action, self.config
        )
        if ground is None:
            return fall
        shank = observations.shank_in_ground(physics.qpos, ground, self.config.hardware)
        return fall._replace(too_low=fall.too_low | shank)

    def _replace_exploded(
        self, physics: Physics, effort: Effort, fall: Fall
    ) -> tuple[Physics, Effort]:
        """Put a robot at rest in place of an exploded one, whose episode is over."""
        physics = jax.tree.map(
            lambda new, rest: jnp.where(fall.exploded, rest, new),
            physics,
            self.starts.at_rest(),
        )
        return physics, jax.tree.map(lambda x: jnp.where(fall.exploded, 0.0, x), effort)

    def _average(
        self, before: PipelineState, after: PipelineState, outcome: StepOutcome
    ) -> PipelineState:
        """Return `after` with the torque, the tracking error and the action averaged
        over time, for the rewards."""
        error = outcome.motion.horizontal - before.command.current
        memory, dt = self.config.reward.tracking_shape.memory, conventions.CONTROL_STEP
        action, window = after.controller.last_action, rewards.ACTION_AVERAGING
        return after.replace(
            mean_torque=outcome.effort.torque,
            tracking_error=rewards.exponential_average(
                before.tracking_error, error, memory, dt
            ),
            mean_action=rewards.exponential_average(
                before.mean_action, action, window, dt
            ),
        )

    def _reward_inputs(
        self, before: PipelineState, after: PipelineState, outcome: StepOutcome
    ) -> rewards.RewardInputs:
        config, physics, reference = self.config, after.physics, outcome.reference
        peak, size = config.hardware.joint_peak_torque, config.hardware.size
        moving = np.array([size.speed, size.speed, size.rate])
        velocity = outcome.motion.horizontal
        if config.reward.tracking_shape.memory:
            velocity = before.command.current + after.tracking_error
        ground = after.randomization.ground
        height, rate = observations.soles(
            physics.qpos, physics.qvel, config.hardware, ground
        )
        no_load_speed = randomization.as_drawn(
            config.hardware.joint_no_load_speed, after.randomization.no_load_speed
        )
        return rewards.RewardInputs(
            command=before.command.current / moving,
            z=over_ground(physics.qpos, ground)[2] / size.length,
            z_ref=reference.height / size.length,
            e_z=outcome.motion.e_z,
            e_z_ref=reference.up,
            q=joint_positions(physics.qpos),
            q_ref=reference.joint_position,
            qd=joint_velocities(physics.qvel) / size.rate,
            qd_ref=reference.joint_velocity / size.rate,
            v=velocity[:2] / size.speed,
            yaw_rate=velocity[2] / size.rate,
            tau_n=after.mean_torque / peak,
            tau_n_last=before.mean_torque / peak,
            power=outcome.effort.power / size.power,
            action=after.controller.last_action,
            last_action=before.controller.last_action,
            mean_action=after.mean_action,
            terminal=outcome.fall.happened.astype(jnp.float32),
            sole_height=height / size.length,
            sole_rate=rate / size.speed,
            qd_n=joint_velocities(physics.qvel) / no_load_speed,
        )

    def _observe(
        self, state: PipelineState, foot_contact: Float[Array, "4"], key: Array
    ) -> tuple[PipelineState, dict[str, Array]]:
        """Return the state in which the controller remembers its observation, and the
        observations of policy and critic."""
        config, physics = self.config.randomization, state.physics
        command = state.command.current
        measurement = observations.sense(
            physics.qpos, physics.qvel, state.randomization.gravity
        )
        noiseless = self.controller.frame(state.controller, command, measurement)
        if config.enabled:
            measurement = observations.add_noise(measurement, config, key)
        controller, noisy = self.controller.observe(
            state.controller, command, measurement
        )
        privileged = observations.observe(
            self._privileged, self._privileged_inputs(state, foot_contact)
        )
        obs = {
            "state": noisy,
            "privileged_state": jnp.concatenate([noiseless, privileged]),
        }
        return state.replace(controller=controller), obs

    def _privileged_inputs(
        self, state: PipelineState, foot_contact: Float[Array, "4"]
    ) -> observations.PrivilegedInputs:
        """Return what the critic, and the reward terms and terminations of a task, look at."""
        physics = state.physics
        return observations.PrivilegedInputs(
            episode=state,
            velocity=observations.trunk_motion(physics.qpos, physics.qvel).velocity,
            foot_contact=foot_contact,
            trunk_mass=state.randomization.mass[self.trunk],
        )


def _make_engine(
    impl: Impl, model: mujoco.MjModel, config: EnvConfig, num_robots: int
) -> PhysicsEngine:
    require_one_of("physics", impl, get_args(Impl))
    motors = motors_of(config)
    resistance = Resistance.from_hardware(config.hardware)
    if impl == "kernel":
        return KernelPhysics(model, motors, resistance)
    if config.terrain.kind != "flat":
        raise UserError(
            f"--impl {impl} has flat ground and slopes alone: for terrain.kind {config.terrain.kind} use --impl kernel"
        )
    return MjxPhysics(model, motors, resistance, impl, num_robots)


def make(
    name: str,
    config: EnvConfig | None = None,
    *,
    impl: Impl = "jax",
    num_robots: int = 1,
    task: str | Path | Task | None = None,
) -> BP2Env:
    """Return the environment of this name, or with `config` in place of its settings; see `BP2Env` for the rest.

    Args:
        name: `bp2`; `bp2_ideal`, without losses; or `bp2_kinematic`, on the kinematic gait, at 3 m/s.
        task: your own rewards, terminations and observations, as `preset` takes it or as a `settings.task.Task`, with the
            coefficients of the imitation stage.

    Raises:
        UserError: there is no such environment or task, or it cannot be.

    Examples:
        >>> make("bp2")  # the built robot, the rewards of preset("imitation", "gpu")
        >>> make("bp2", preset("imitation", "cpu", robot="go1").env)  # another robot
    """
    if name in robot_names():
        raise UserError(
            f'{name} is a robot: make("bp2", preset("imitation", "cpu", robot="{name}").env)'
        )
    require_one_of("environment", name, CONFIGS)
    require_kind(
        "make",
        config,
        (EnvConfig, NoneType),
        'settings, such as preset("imitation", "cpu").env',
    )
    require_kind("task", task, (str, Path, Task, NoneType), "a file or a Task")
    if num_robots < 1:
        raise UserError(f"num_robots must be at least 1, got {num_robots}")
    settings = TrainConfig(env=config or CONFIGS[name]())
    if task is not None:
        settings = with_task(settings, task)
    return BP2Env(settings.env, impl=impl, num_robots=num_robots)


for name in CONFIGS:
    envs.register_environment(name, functools.partial(make, name))  # pyright: ignore[reportArgumentType]  # it is only called
