"""One policy on many randomised robots at once, all under the same command schedule.

Each robot is drawn as in training (friction, masses, motors, gains, latency, sensor noise, pushes) and starts at rest.
The robots run in the training environment itself, with BP2's kernel or MJX as its physics, so that what is disturbed
here is what was disturbed there.
"""

import dataclasses
import math
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.env.episode import PipelineState
from bp2_rl.env.observations import trunk_motion
from bp2_rl.robot import conventions
from bp2_rl.robot.clearance import clearance
from bp2_rl.robot.coordinates import compressions, joint_positions
from bp2_rl.robot.kinematics import yaw_of
from bp2_rl.settings.env import EnvConfig, RandomizationConfig, ResetConfig
from bp2_rl.simulation.operator import HEADING_HOLD, HeadingHold
from bp2_rl.simulation.policy_runner import ActionFunction
from bp2_rl.simulation.rollout import sampled_commands
from bp2_rl.simulation.schedule import Schedule


@dataclasses.dataclass(frozen=True)
class BatchRun:
    """What N robots did, sampled at each of T control steps; samples after a robot's fall mean nothing."""

    time: Float[np.ndarray, " T"]  # s
    command: Float[np.ndarray, " T"]  # m/s, scheduled forward speed
    speed: Float[np.ndarray, "T N"]  # m/s, forward in the heading frame
    offset: Float[np.ndarray, "T N"]  # m, to the left of the line through the start
    fell_at: Float[np.ndarray, " N"]  # s; inf for robots that did not fall
    leg_room: Float[np.ndarray, " N"]  # m, least between legs or of a leg and the trunk, before a fall
    robots: dict[str, Float[np.ndarray, " N"]]  # what was drawn: friction, latency (s), mass (kg), strength
    steady_from: float  # s, from when the command is held


def rollout_batch(
    policy: ActionFunction,
    schedule: Schedule,
    config: EnvConfig,
    *,
    robots: int,
    seed: int = 0,
    randomization: RandomizationConfig | None = None,
    operator: HeadingHold = HEADING_HOLD,
    impl: Literal["kernel", "jax"] = "kernel",
) -> BatchRun:
    """Run many robots from a standing start, each with its own draw of `randomization`.

    Args:
        policy: observation -> action, for one robot.
        schedule: the command that all are given.
        config: the policy's environment; its own randomisation and starts are not used.
        robots: how many.
        seed: of everything that is drawn.
        randomization: from what the robots are drawn; the ranges of training by default.
        operator: the outer loop that keeps each robot on its line.
        impl: the physics engine: `kernel`, BP2's own, or `jax`, MJX.
    """
    hardware = config.hardware
    config = dataclasses.replace(
        config,
        # In this environment solid legs would end a run; it tells how deep they are in each other instead.
        hardware=dataclasses.replace(hardware, solid_legs=False),
        randomization=randomization or RandomizationConfig(),
        reset=ResetConfig(standing_fraction=1.0, joint_noise=0.0),
    )
    env = BP2Env(config, impl=impl, num_robots=robots)
    commands = sampled_commands(schedule)
    keys = jax.random.split(jax.random.PRNGKey(seed), robots)

    def control_step(state: Any, command: jax.Array) -> tuple[Any, tuple[jax.Array, ...]]:
        actions = jax.vmap(policy)(state.obs["state"])

        def step(state: Any, action: jax.Array) -> Any:
            qpos = state.pipeline_state.physics.qpos
            return env.step(state, action, command=operator.steer(command, qpos[1], yaw_of(qpos[3:7])))

        state = jax.vmap(step)(state, actions)
        after: PipelineState = state.pipeline_state
        physics = after.physics
        speed = jax.vmap(trunk_motion)(physics.qpos, physics.qvel).velocity[:, 0]
        joints = joint_positions(physics.qpos).reshape(-1, 4, 3)
        room = clearance(joints, compressions(physics.qpos), hardware).least
        return state, (speed, physics.qpos[:, 1], state.done, room)

    @jax.jit
    def run(keys: jax.Array, commands: jax.Array) -> tuple[Any, Any]:
        start = jax.vmap(env.reset)(keys)
        robots: Any = start.pipeline_state
        return robots.randomization, jax.lax.scan(control_step, start, commands[1:])[1]

    drawn, (speed, offset, down, room) = jax.device_get(run(keys, jnp.asarray(commands, jnp.float32)))
    steps = len(commands) - 1
    time = conventions.CONTROL_STEP * np.arange(1, steps + 1)
    up = np.cumsum(down, axis=0) == 0
    return BatchRun(
        time=time,
        command=commands[1:, 0],
        speed=np.asarray(speed, np.float64),
        offset=np.asarray(offset, np.float64),
        fell_at=np.where(np.any(down, axis=0), time[np.argmax(down, axis=0)], math.inf),
        leg_room=np.min(np.where(up, np.asarray(room, np.float64), math.inf), axis=0),
        robots={
            "friction": np.asarray(drawn.friction, np.float64),
            "latency": np.asarray(drawn.latency, np.float64),
            "mass": np.asarray(drawn.mass, np.float64) @ env.mj_model.body_mass,
            "strength": np.asarray(drawn.strength, np.float64).min(axis=1),
        },
        steady_from=schedule.steady_from,
    )
