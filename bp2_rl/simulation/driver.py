"""What moves a robot in C MuJoCo: 200 times a second from its state to the joint targets of the next milliseconds."""

import collections
import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bp2_rl.env.commands import eased
from bp2_rl.env.controller import Controller
from bp2_rl.env.observations import add_noise, measure
from bp2_rl.env.physics.interface import ages, in_force
from bp2_rl.reference.interface import Reference
from bp2_rl.robot import specs
from bp2_rl.robot.kinematics import yaw_of
from bp2_rl.settings.env import EnvConfig, RandomizationConfig
from bp2_rl.simulation.operator import HeadingHold

Array = Any  # numpy or jax array
ActionFunction = Callable[[Array], Array]  # observation -> action, deterministic
JointTargets = tuple[Float[np.ndarray, "12"], Float[np.ndarray, "12"]]  # rad, rad/s


class Driver:
    """One robot's controller, in float32 on the CPU, as on the robot, and the targets that are still on their way.

    Args:
        policy: observation -> action.
        config: the environment that the policy and its controller take the robot for.
        operator: who steers.
        latency: s, after which joint targets act; until the first does, the robot stands.
        command: in force at first, m/s and rad/s.
    """

    def __init__(
        self,
        policy: ActionFunction,
        config: EnvConfig,
        operator: HeadingHold,
        *,
        latency: float,
        command: Float[np.ndarray, "3"],
    ):
        self._behind = control_steps_behind(latency)
        still: JointTargets = np.array(specs.STAND_JOINTS), np.zeros(specs.NUM_MOTORS)
        kept = max(self._behind) + 1
        self._issued = collections.deque([still] * kept, maxlen=kept)
        self._device = jax.devices("cpu")[0]
        with jax.default_device(self._device):
            self._control = _compiled_control_step(policy, config, operator)
            self._state = Controller(config).init()
        self._next_command = command.astype(np.float32)
        self.command = self._next_command
        """What the policy was told last, m/s and rad/s."""
        self.reference: Reference | None = None
        """The reference at the end of the last tick's control step."""

    def tick(
        self, qpos: Float[np.ndarray, "23"], qvel: Float[np.ndarray, "22"], scheduled: Float[np.ndarray, "3"]
    ) -> list[JointTargets]:
        """What the joints follow in each millisecond of a control step that begins in this state.

        Args:
            qpos: as the robot and its operator know it.
            qvel: the velocities that belong to `qpos`.
            scheduled: the command at the end of the control step, before the operator steers.
        """
        self.command = self._next_command
        with jax.default_device(self._device):
            self._state, targets, self.reference, told = self._control(self._state, self.command, qpos, qvel, scheduled)
        self._issued.append((np.asarray(targets.position, np.float64), np.asarray(targets.velocity, np.float64)))
        self._next_command = np.asarray(told)
        return [self._issued[-1 - late] for late in self._behind]


def control_steps_behind(latency: float) -> list[int]:
    """How many control steps ago the target was issued that acts in each ms of a control step."""
    longest = math.ceil(latency / specs.CONTROL_STEP - 1e-6) + 1
    return [int(in_force(age, np.array(latency))) for age in ages(longest)]


def control_step(
    policy: ActionFunction, config: EnvConfig, operator: HeadingHold, noise: RandomizationConfig | None = None
) -> Callable[..., Any]:
    """One tick of 200 Hz.

    (controller state, command, qpos, qvel, scheduled command) -> (controller state, targets, reference, next command).
    With sensor noise of these deviations two more arguments come last: a random key, and how much of the noise, 0 to 1.
    """
    controller = Controller(config)

    def control(state, command, qpos, qvel, scheduled, key: Any = None, share: Any = None):
        command, qpos, qvel, scheduled = (jnp.asarray(x, jnp.float32) for x in (command, qpos, qvel, scheduled))
        measured = measure(qpos, qvel)
        if noise is not None:
            noisy = add_noise(measured, noise, key)
            measured = jax.tree.map(lambda clean, with_noise: clean + share * (with_noise - clean), measured, noisy)
        observation, state = controller.observe(state, command, measured)
        action = policy(observation)
        asked = operator.steer(scheduled, qpos[1], yaw_of(qpos[3:7]))
        next_command = eased(command, asked, config.control)
        # With the reference, though nobody asks for it: without it XLA rounds the targets otherwise.
        return *controller.act(state, command, action), next_command

    return control


# One compilation serves all runs of a policy: a benchmark may need many.
@functools.lru_cache(maxsize=8)
def _compiled_control_step(policy: ActionFunction, config: EnvConfig, operator: HeadingHold) -> Callable[..., Any]:
    return jax.jit(control_step(policy, config, operator))
