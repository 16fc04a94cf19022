"""The five physics steps of a control step in C MuJoCo, on all of the host's processors.

For people without a GPU: on a processor C MuJoCo is several times as fast as MJX, in float64 and with its solver run
to convergence. XLA hands the whole batch to the host; the very same motors run there on NumPy arrays.

The host keeps threads, scratch memory and compiled models, but nothing that a result depends on: equal arguments give
equal bits, in whatever order they come and on however many threads.
"""

import copy
import hashlib
import threading
from collections import OrderedDict
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from mujoco import rollout

from bp2_rl.env.controller import Targets
from bp2_rl.env.physics import host_call
from bp2_rl.env.physics.interface import AGES, Effort, Physics, in_force, target_history
from bp2_rl.env.randomization import Randomization, randomize_actuator, randomize_c_model, randomize_resistance
from bp2_rl.errors import UserError
from bp2_rl.robot import losses, specs
from bp2_rl.robot.actuator import Actuator, joint_torque
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import MOTOR_QPOS, MOTOR_QVEL, NQ, NV, let_converge, load_model
from bp2_rl.robot.specs import HardwareSpec
from bp2_rl.workers import processors

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
        self._model, self._motors = load_model(hardware, visual=False, feet_only=True, foot_sensors=True), motors
        let_converge(self._model)
        self._models = _Models(self._model)
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
        arrays: list[Any] = [x.reshape(-1, *x.shape[batch:]).astype(np.float64) for x in arguments]
        with self._lock, np.errstate(over="ignore", invalid="ignore"):
            done = self._control_step(*arrays[:4], Targets(*arrays[4:6]), Randomization(*arrays[6:]))  # pyright: ignore[reportCallIssue]
            for array, result in zip(results, done, strict=True):
                array[...] = result.reshape(array.shape)

    def _control_step(
        self,
        qpos: Float[np.ndarray, "n 23"],
        qvel: Float[np.ndarray, "n 22"],
        qacc: Float[np.ndarray, "n 22"],
        torque: Float[np.ndarray, "n 12"],
        history: Targets,
        robot: Randomization,
    ) -> tuple[np.ndarray, ...]:
        """(qpos, qvel, qacc, torque, mean torque, mean power, feet); NaN for robots that are no physics any more."""
        robots = np.arange(len(qpos))
        motors, models = randomize_actuator(self._motors, robot), self._models.of(robot)
        resistance = randomize_resistance(self._resistance, robot) if self._resistance is not None else None
        pool, scratch = self._threads
        state = np.concatenate([np.zeros((len(qpos), 1)), qpos, qvel], axis=1)  # MuJoCo's: time, qpos, qvel
        after, feet = np.empty((len(qpos), 1, 1 + NQ + NV)), np.empty((len(qpos), 1, 3 * len(specs.LEGS)))
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
            control, what = torque, mujoco.mjtState.mjSTATE_CTRL
            if resistance is not None:
                against = losses.loss(resistance, state[:, 1 : 1 + NQ], state[:, 1 + NQ :], torque)
                control = np.concatenate([torque, losses.generalized(against)], axis=1)
                what |= mujoco.mjtState.mjSTATE_QFRC_APPLIED
            pool.rollout(
                models,
                scratch,
                state,
                control[:, None],
                control_spec=int(what),
                skip_checks=True,
                nstep=1,
                initial_warmstart=qacc,
                state=after,
                sensordata=feet,
            )
            # The solver's first guess for the next step; it need not be exact.
            qacc = (after[:, 0, 1 + NQ :] - state[:, 1 + NQ :]) / specs.PHYSICS_STEP
            state = after[:, 0].copy()
        state[lost] = np.nan
        touching = feet.reshape(-1, len(specs.LEGS), 3)[..., 2] <= specs.FOOT_RADIUS
        mean = 1.0 / specs.SUBSTEPS
        return state[:, 1 : 1 + NQ], state[:, 1 + NQ :], qacc, torque, mean * sum_torque, mean * sum_power, touching


class _Models:
    """A compiled model for every robot of the last batches; most robots are in the next batch, too."""

    def __init__(self, nominal: mujoco.MjModel):
        self._nominal = nominal
        self._trunk = int(nominal.body("trunk").id)
        self._devices = jax.local_device_count()
        self._known: OrderedDict[bytes, mujoco.MjModel] = OrderedDict()

    def of(self, robots: Randomization) -> list[mujoco.MjModel]:
        """The robots' models, good until the next call."""
        draws = np.concatenate([robots.friction[:, None], robots.mass, robots.com_offset], axis=1)
        capacity = 2 * self._devices * len(draws)
        models = []
        for row, draw in enumerate(draws):
            key = draw.tobytes()
            if key not in self._known:
                # The model used longest ago is not of this batch, which at most half of them are.
                full = len(self._known) >= capacity
                model = self._known.popitem(last=False)[1] if full else copy.copy(self._nominal)
                robot = jax.tree.map(lambda field, row=row: field[row], robots)
                randomize_c_model(model, self._nominal, robot, self._trunk)
                self._known[key] = model
            self._known.move_to_end(key)
            models.append(self._known[key])
        return models


_hosts: dict[str, _Host] = {}
