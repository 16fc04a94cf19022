"""The five physics steps of a control step in C MuJoCo, on all of the host's processors.

For people without a GPU: on a processor C MuJoCo is several times as fast as MJX, in float64 and with its solver run
to convergence. XLA hands the whole batch to the host; the very same motors run there on NumPy arrays.

The host keeps threads, scratch memory and compiled models, but nothing that a result depends on: equal arguments give
equal bits, in whatever order they come and on however many threads.
"""

import copy
import hashlib
import threading
from collections import deque
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from mujoco import rollout

from bp2_rl.base.errors import UserError
from bp2_rl.base.workers import processors
from bp2_rl.env.controller import Targets
from bp2_rl.env.physics import host_call
from bp2_rl.env.physics.interface import AGES, Effort, Physics, in_force, target_history
from bp2_rl.env.randomization import Randomization, randomize_actuator, randomize_c_model, randomize_resistance
from bp2_rl.robot import losses, specs
from bp2_rl.robot.actuator import Actuator, joint_torque
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import MOTOR_QPOS, MOTOR_QVEL, NQ, NV, let_converge, load_model
from bp2_rl.robot.specs import HardwareSpec

PIECE = 128
"""Robots a thread that go through the five physics steps together: few enough that their models stay in the
processors' caches from one step to the next, and enough that what Python takes for each call is little."""
FASTEST = 1e4
"""A coordinate or speed beyond this (m, rad, m/s, rad/s) is no physics any more, and is kept from MuJoCo."""


class CPhysics:
    """C MuJoCo's batched rollout.

    Args:
        hardware: the robot.
        motors: its motors at full strength.

    Raises:
        UserError: JAX computes on an accelerator.
    """

    def __init__(self, hardware: HardwareSpec, motors: Actuator):
        if jax.default_backend() != "cpu":
            raise UserError(
                f"--impl c is for machines without a GPU, and JAX computes on one ({jax.devices()[0].device_kind}): "
                "set JAX_PLATFORMS=cpu, or train a new run with --impl jax"
            )
        self._target = _target(hardware, motors)

    def __call__(
        self, physics: Physics, targets: Targets, robot: Randomization
    ) -> tuple[Physics, Effort, Float[Array, "4"]]:
        """See `physics.Simulator`."""
        history, remembered = target_history(physics, targets)
        sizes = NQ, NV, NV, specs.NUM_MOTORS, specs.NUM_MOTORS, specs.NUM_MOTORS, len(specs.LEGS)
        results = [jax.ShapeDtypeStruct((size,), jnp.float32) for size in sizes]
        simulate = jax.ffi.ffi_call(self._target, results, vmap_method="broadcast_all")
        qpos, qvel, qacc, torque, mean_torque, mean_power, feet = simulate(
            physics.qpos, physics.qvel, physics.qacc_warmstart, physics.torque, history.position, history.velocity,
            *jax.tree.leaves(robot),
        )  # fmt: skip
        after = Physics(qpos=qpos, qvel=qvel, qacc_warmstart=qacc, torque=torque, targets=remembered)
        return after, Effort(torque=mean_torque, power=mean_power), feet


def _target(hardware: HardwareSpec, motors: Actuator) -> str:
    """The name by which XLA calls the simulation of this robot: the same in every process."""
    name = f"bp2_physics_{hashlib.sha256(repr((hardware, motors)).encode()).hexdigest()[:16]}"
    if name not in _hosts:
        _hosts[name] = _Host(hardware, motors)
        host_call.register(name, _hosts[name])
    return name


class _Host:
    """The part outside XLA."""

    def __init__(self, hardware: HardwareSpec, motors: Actuator):
        self._model, self._motors = load_model(hardware, visual=False, feet_only=True, lean=True), motors
        let_converge(self._model)
        self._models = _Models(self._model)
        self._peak = hardware.joint_peak_torque
        self._resistance = Resistance.from_hardware(hardware)
        self._rest = np.concatenate([[0.0], self._model.key("stand").qpos, np.zeros(NV)])
        self._lock = threading.Lock()  # several devices share the processors: one batch after the other

    @cached_property
    def _threads(self) -> tuple[rollout.Rollout, list[mujoco.MjData]]:
        count = processors()
        return rollout.Rollout(nthread=count), [mujoco.MjData(self._model) for _ in range(count)]

    def __call__(self, results: Sequence[np.ndarray], arguments: Sequence[np.ndarray]) -> None:
        """One control step in XLA's memory; any batch axes are in front."""
        batch = arguments[0].ndim - 1
        given, wanted = ([x.reshape(-1, *x.shape[batch:]) for x in arrays] for arrays in (arguments, results))
        with self._lock, np.errstate(over="ignore", invalid="ignore"):
            models = self._models.of(_randomization(given))
            size = PIECE * len(self._threads[1])
            for piece in (slice(first, first + size) for first in range(0, len(models), size)):
                arrays: list[Any] = [x[piece].astype(np.float64) for x in given]
                qpos, qvel, qacc, torque, *targets = arrays[:6]
                history, robot = Targets(*targets), _randomization(arrays)
                done = self._control_step(models[piece], qpos, qvel, qacc, torque, history, robot)
                for array, result in zip(wanted, done, strict=True):
                    array[piece] = result

    def _control_step(
        self,
        models: list[mujoco.MjModel],
        qpos: Float[np.ndarray, "n 23"],
        qvel: Float[np.ndarray, "n 22"],
        qacc: Float[np.ndarray, "n 22"],
        torque: Float[np.ndarray, "n 12"],
        history: Targets,
        robot: Randomization,
    ) -> tuple[np.ndarray, ...]:
        """(qpos, qvel, qacc, torque, mean torque, mean power, feet); NaN for robots that are no physics any more."""
        robots = np.arange(len(qpos))
        motors, resistance = randomize_actuator(self._motors, robot), self._resistance
        if resistance is not None:
            resistance = randomize_resistance(resistance, robot)
        pool, scratch = self._threads
        state = np.concatenate([np.zeros((len(qpos), 1)), qpos, qvel], axis=1)  # MuJoCo's: time, qpos, qvel
        after, feet = np.empty_like(state), np.empty((len(qpos), 3 * len(specs.LEGS)))
        lost = np.zeros(len(qpos), bool)
        sum_torque, sum_power = np.zeros_like(torque), np.zeros_like(torque)
        for ages in AGES:
            q, qd = state[:, 1 + MOTOR_QPOS], state[:, 1 + NQ + MOTOR_QVEL]
            now = robots, in_force(ages, robot.latency)
            torque = joint_torque(
                motors, torque, q, qd, history.position[now], history.velocity[now], specs.PHYSICS_STEP
            )
            # Written so that NaN is lost, too.
            lost |= ~(np.all(np.abs(state) <= FASTEST, axis=1) & np.all(np.isfinite(qacc), axis=1))
            lost |= ~np.all(np.isfinite(torque), axis=1)
            state[lost], torque[lost], qacc[lost] = self._rest, 0.0, 0.0
            sum_torque += torque
            sum_power += torque * qd
            if resistance is not None:
                force = losses.generalized(losses.loss(resistance, state[:, 1 : 1 + NQ], state[:, 1 + NQ :], torque))
            else:
                force = np.zeros_like(qacc)
            force[:, MOTOR_QVEL] += np.clip(torque, -self._peak, self._peak)
            pool.rollout(
                models,
                scratch,
                state,
                force[:, None],
                control_spec=int(mujoco.mjtState.mjSTATE_QFRC_APPLIED),
                skip_checks=True,
                nstep=1,
                initial_warmstart=qacc,
                state=after[:, None],
                sensordata=feet[:, None],
            )
            # The solver's first guess for the next step; it need not be exact.
            qacc = (after[:, 1 + NQ :] - state[:, 1 + NQ :]) / specs.PHYSICS_STEP
            state, after = after, state
        state[lost] = np.nan
        touching = feet.reshape(-1, len(specs.LEGS), 3)[..., 2] <= specs.FOOT_RADIUS
        mean = 1.0 / specs.SUBSTEPS
        return state[:, 1 : 1 + NQ], state[:, 1 + NQ :], qacc, torque, mean * sum_torque, mean * sum_power, touching


class _Models:
    """A compiled model for every robot of the last batches; most robots are in the next one, too, in the same place."""

    def __init__(self, nominal: mujoco.MjModel):
        self._nominal = nominal
        self._trunk = int(nominal.body("trunk").id)
        self._most = 2 * jax.local_device_count()
        self._known: deque[_Batch] = deque(maxlen=self._most)

    def of(self, robots: Randomization) -> list[mujoco.MjModel]:
        """The robots' models, good until the next call."""
        draws = np.concatenate([robots.friction[:, None], robots.mass, robots.com_offset], axis=1)
        batch = self._most_alike(draws)
        for row in np.flatnonzero(np.any(batch.draws != draws, axis=1)):
            robot = jax.tree.map(lambda field, row=row: field[row], robots)
            randomize_c_model(batch.models[row], self._nominal, robot, self._trunk)
        batch.draws[:] = draws
        return batch.models

    def _most_alike(self, draws: Float[np.ndarray, "n draws"]) -> "_Batch":
        """The batch known of which most robots are the same; each device has its own."""

        def alike(batch: _Batch) -> int:
            return int(np.sum(np.all(batch.draws == draws, axis=1)))

        known = [batch for batch in self._known if batch.draws.shape == draws.shape]
        best = max(known, key=alike, default=None)
        if best is None or (alike(best) == 0 and len(known) < self._most):
            best = _Batch(np.full_like(draws, np.nan), [copy.copy(self._nominal) for _ in draws])
            self._known.append(best)
        return best


class _Batch(NamedTuple):
    """Models, and of which robots they are."""

    draws: Float[np.ndarray, "n draws"]
    models: list[mujoco.MjModel]


def _randomization(arguments: Sequence[Any]) -> Randomization:
    """That of the robots, among the arguments of `_Host`."""
    return Randomization(*arguments[6:])  # pyright: ignore[reportCallIssue]


_hosts: dict[str, _Host] = {}
