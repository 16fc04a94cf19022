"""The policy runner: computes joint targets from the states of simulated robots, 200
times a second."""

import functools
import math
from collections.abc import Callable, Sequence
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from bp2_rl.base import arrays
from bp2_rl.env.controller import Controller, ControllerState, Targets
from bp2_rl.env.observations import add_noise, sense
from bp2_rl.env.physics.interface import newest_active, target_ages
from bp2_rl.learning.policy import NETWORKS, Policy
from bp2_rl.reference.interface import Reference
from bp2_rl.robot import conventions
from bp2_rl.robot.kinematics import yaw_of
from bp2_rl.robot.operator import HeadingHold
from bp2_rl.settings.env import EnvConfig, RandomizationConfig
from bp2_rl.simulation.laws import filled

# observation -> action, deterministic; arrays of NumPy or JAX
ActionFunction: TypeAlias = Callable[[arrays.Array], arrays.Array]
StepResult = tuple[ControllerState, Targets, Reference, Array]
RESULTS = np.cumsum([3, conventions.NUM_MOTORS, conventions.NUM_MOTORS]).tolist()
"""Ends of the next command, the position and the velocity in a row of results."""
JointTargets = tuple[Float[np.ndarray, "N 12"], Float[np.ndarray, "N 12"]]  # rad, rad/s


class PolicyRunner:
    """The controllers of N robots under one policy, in float32 on the CPU as on the
    real robot.

    Joint targets act after each robot's latency; until the first does, the robot
    stands.

    Args:
        policy: observation -> action, for one robot.
        config: the environment that the policy and its controller take the robots for.
        operators: steer the robots on straight commands, one for each.
        latencies: of the robots, s.
        commands: (N, 3), in force at first, m/s and rad/s.
        noise: the deviations of the sensors' noise; None for sensors without noise.

    Attributes:
        command: (N, 3), what the policy was told last, m/s and rad/s.
        next_command: (N, 3), what the policy is told in the next control step.
        position: (N, D, 12), rad, the joint targets issued last that may still come
            into force, newest last.
        velocity: (N, D, 12), rad/s, the rates of these targets.
    """

    def __init__(
        self,
        policy: ActionFunction,
        config: EnvConfig,
        *,
        operators: Sequence[HeadingHold],
        latencies: Sequence[float],
        commands: Float[np.ndarray, "N 3"],
        noise: RandomizationConfig | None = None,
    ):
        robots = len(operators)
        self._filled = filled(robots)
        self._each = np.arange(robots)
        self._by_operator = {
            operator: [robot for robot, its in enumerate(operators) if its == operator]
            for operator in {*operators}
        }
        self._behind = np.array(
            [control_steps_behind(latency) for latency in latencies]
        )
        self._device = jax.devices("cpu")[0]
        with jax.default_device(self._device):
            function, weights = _split_policy(policy)
            self._weights = jax.device_put(weights)
            self._control = _compiled_control_step(function, config, noise)
            self._controller = Controller(config)
            start, self._unpacked = ravel_pytree(self._controller.init())
            self._state = jnp.tile(start, (len(self._filled), 1))
        depth = int(np.max(self._behind)) + 1
        self.position = np.tile(
            np.array(config.hardware.anatomy.stand), (robots, depth, 1)
        )
        self.velocity = np.zeros_like(self.position)
        self.next_command = self.command = commands.astype(np.float32)
        self._reference: Float[np.ndarray, "P _"] | None = None

    @property
    def state(self) -> ControllerState:
        """Return the internal states of the controllers, a row for each robot."""
        with jax.default_device(self._device):
            return jax.vmap(self._unpacked)(self._state[: len(self._each)])

    @state.setter
    def state(self, state: ControllerState) -> None:
        with jax.default_device(self._device):
            self._state = jax.vmap(_packed)(state)[self._filled]

    @property
    def phase(self) -> Float[np.ndarray, " N"]:
        """The gait phases of the controllers, cycles."""
        # the first number of a packed state
        return np.asarray(self._state, np.float64)[self._each, 0]

    @property
    def reference(self) -> Reference | None:
        """The reference motion at the end of the last control step, a row for each
        robot; None before it."""
        if self._reference is None:
            return None
        with jax.default_device(self._device):
            rows = jnp.asarray(self._reference)[self._each]
            return jax.vmap(self._unpacked_reference)(rows)

    @functools.cached_property
    def _unpacked_reference(self) -> Callable[[Array], Reference]:
        shapes = jax.eval_shape(self._controller.reference, jnp.zeros(3), jnp.zeros(()))
        return ravel_pytree(jax.tree.map(lambda x: jnp.zeros(x.shape), shapes))[1]

    def tick(
        self,
        qpos: Float[np.ndarray, "N nq"],
        qvel: Float[np.ndarray, "N nv"],
        scheduled: Float[np.ndarray, "N 3"],
        *drawn: np.ndarray,
    ) -> list[JointTargets]:
        """Run one control step of all robots; return the joint targets in force in each
        of its milliseconds.

        Args:
            qpos: the positions as measured by the robots and their operators.
            qvel: the velocities that belong to `qpos`.
            scheduled: the commands at the end of the control step, before an operator
                steers.
            drawn: with noise, a random key for each robot (N, 2), and each robot's
                share of the noise, 0 to 1 (N).
        """
        asked = scheduled.copy()
        for operator, its in self._by_operator.items():
            asked[its] = operator.steer(
                asked[its], qpos[its, 1], yaw_of(qpos[its, 3:7])
            )
        self.command = self.next_command
        inputs = np.concatenate(
            [self.command, qpos, qvel, asked], axis=1, dtype=np.float32
        )
        with jax.default_device(self._device):
            self._state, results = self._control(
                self._weights,
                self._state,
                *(x[self._filled] for x in (inputs, *drawn)),
            )
        commands, position, velocity, self._reference = np.split(
            np.asarray(results), RESULTS, axis=1
        )
        self.next_command = commands[self._each]
        for issued, new in ((self.position, position), (self.velocity, velocity)):
            issued[:, :-1] = issued[:, 1:]
            issued[:, -1] = new[self._each]
        return [
            (
                self.position[self._each, -1 - behind],
                self.velocity[self._each, -1 - behind],
            )
            for behind in self._behind.T
        ]


def control_steps_behind(latency: float) -> list[int]:
    """Return for each ms of a control step how many control steps ago its active joint
    target was issued."""
    longest = math.ceil(latency / conventions.CONTROL_STEP - 1e-6) + 1
    return [int(newest_active(age, np.array(latency))) for age in target_ages(longest)]


def control_step(
    config: EnvConfig, noise: RandomizationConfig | None = None
) -> Callable[..., StepResult]:
    """Return one robot's control step as a function that JAX can compile.

    (policy, controller state, command, qpos, qvel, command asked for) -> (state,
    targets, reference, next command)

    With sensor noise of these deviations two more arguments come last: a random key,
    and how much of the noise, 0 to 1.
    """
    controller = Controller(config)

    def control(
        policy: ActionFunction,
        state: ControllerState,
        command: Array,
        qpos: Array,
        qvel: Array,
        asked: Array,
        *drawn: Array,
    ) -> StepResult:
        measured = sense(qpos, qvel)
        if noise is not None:
            key, share = drawn
            noisy = add_noise(measured, noise, key)
            measured = jax.tree.map(
                lambda clean, with_noise: clean + share * (with_noise - clean),
                measured,
                noisy,
            )
        state, observation = controller.observe(state, command, measured)
        action = policy(observation)
        # Always with the reference: without this output XLA rounds the targets
        # differently.
        told = config.control.tell(command, asked)
        return *controller.act(state, command, action), told

    return control


def _split_policy(
    policy: ActionFunction,
) -> tuple[Callable[..., Array], tuple[object, ...]]:
    """Split a policy into a network function and its weights; a plain function has no
    weights."""
    return (
        (NETWORKS[policy.card.activation], policy.weights)
        if isinstance(policy, Policy)
        else (policy, ())
    )


# One compilation serves all runs of all policies of a network's size: a training or a
# benchmark has many.
@functools.lru_cache(maxsize=8)
def _compiled_control_step(
    function: Callable[..., Array], config: EnvConfig, noise: RandomizationConfig | None
) -> Callable[..., tuple[Array, Array]]:
    """Compile the control step of many robots, with rows of numbers for structures: a
    call takes as long for each array as for the robots.

    (weights, packed states, inputs, keys, shares) -> (packed states, results); a row of
    inputs is command, qpos, qvel and the command asked for, one of results the next
    command, position, velocity and the reference.
    """
    control = control_step(config, noise)
    _, unpacked = ravel_pytree(Controller(config).init())
    nq = config.hardware.anatomy.nq
    at = np.cumsum([3, nq, nq - 1]).tolist()

    def one_robot(
        weights: tuple[object, ...], state: Array, inputs: Array, *drawn: Array
    ) -> tuple[Array, Array]:
        policy = functools.partial(function, *weights)
        after, targets, reference, told = control(
            policy, unpacked(state), *jnp.split(inputs, at), *drawn
        )
        return _packed(after), _packed((told, targets, reference))

    def all_robots(weights: tuple[object, ...], *rows: Array) -> tuple[Array, Array]:
        return jax.vmap(functools.partial(one_robot, weights))(*rows)

    return jax.jit(all_robots)


def _packed(values: object) -> Array:
    return ravel_pytree(values)[0]
