"""The kernel's step of the robots that ship, and of twenty drawn at random, beside C
MuJoCo's."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from random_robots import compiled, random_robot, states_of

from bp2_rl.robot import losses
from bp2_rl.robot.coordinates import motor_indices
from bp2_rl.robot.hardware import HardwareSpec
from bp2_rl.robot.kernel import constraints
from bp2_rl.robot.kernel.design import Design, Masses, Robots
from bp2_rl.robot.kernel.step import MuJoCoState, step
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import foot_geom_ids, let_converge
from bp2_rl.robot.named import find_robot, robot_names

STATES = 200
ROBOTS = {
    **{name: lambda name=name: find_robot(name) for name in robot_names()},
    **{f"random-{seed}": lambda seed=seed: random_robot(seed) for seed in range(20)},
}


def unknown(design: Design) -> Design:
    """Return the design with all numbers but its zeros unknown to the program, so that
    robots share one program."""
    numbers = (
        (field.name, getattr(design, field.name))
        for field in dataclasses.fields(design)
    )
    return Design(
        **{
            name: jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), x)
            for name, x in numbers
        }
    )


def advance(robots, qpos, qvel, force):
    after, heights = step(
        robots, MuJoCoState(qpos.T, qvel.T, jnp.zeros_like(qvel.T)), force.T
    )
    return after.qacc_warmstart.T, after.qvel.T, after.qpos.T, heights.T


run = jax.jit(advance)


def stepped(
    model: mujoco.MjModel, qpos, qvel, force, *, program=run
) -> list[np.ndarray]:
    """Return accelerations, velocities after, positions after, and heights of feet
    before a step of the kernel, a state a row, no first guess."""
    design, number = unknown(Design.of(model)), len(qpos)
    masses = Masses.of(design, jnp.ones((model.nbody, number)), jnp.zeros((3, number)))
    friction = jnp.full(
        number, model.geom_friction[foot_geom_ids(model)[0], 0], jnp.float32
    )
    return [
        np.asarray(x)
        for x in program(
            Robots(design, masses, friction), qpos, qvel, force.astype(np.float32)
        )
    ]


def in_c(
    model: mujoco.MjModel, qpos, qvel, force
) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Return the same as `stepped` by C MuJoCo, and each state's feet on the ground and
    joints in their stops."""
    data, rows, feet, stops = mujoco.MjData(model), [], [], []
    for state in zip(qpos, qvel, force, strict=True):
        mujoco.mj_resetData(model, data)
        data.qpos, data.qvel, data.qfrc_applied = state
        mujoco.mj_step(model, data)
        heights = data.geom_xpos[foot_geom_ids(model), 2]
        rows.append([x.copy() for x in (data.qacc, data.qvel, data.qpos, heights)])
        feet.append(data.ncon)
        stops.append(np.sum(data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT))
    return (
        [np.array(x) for x in zip(*rows, strict=True)],
        np.array(feet),
        np.array(stops),
    )


def forces(hardware: HardwareSpec, qpos, qvel, torque, nv: int) -> np.ndarray:
    """Return the forces of the motors, and the friction and viscosity of the joints, as
    both engines are given them."""
    force = np.zeros((len(qpos), nv))
    force[:, motor_indices(nv)] = torque
    if (resistance := Resistance.from_hardware(hardware)) is not None:
        force += losses.generalized(losses.loss(resistance, qpos, qvel, torque), qvel)
    return force


def apart(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Return each state's largest difference of accelerations, over its largest
    acceleration."""
    return abs(ours - theirs).max(axis=1) / abs(theirs).max(axis=1)


def case(name: str, stopped: float, number: int = STATES):
    hardware = ROBOTS[name]()
    model = compiled(hardware, damping=int(name.split("-")[1]) if "-" in name else None)
    qpos, qvel, torque = states_of(hardware, number, seed=5, stopped=stopped)
    return model, qpos, qvel, forces(hardware, qpos, qvel, torque, model.nv)


@pytest.mark.parametrize("stopped", [0.03, 0.3], ids=["few-stops", "many-stops"])
@pytest.mark.parametrize("name", ROBOTS)
def test_one_step_is_that_of_c_mujoco(name, stopped):
    """Accelerations to 1e-4 of each state's largest, in float32, of C MuJoCo's
    converged in float64; then the step."""
    model, *state = case(name, stopped)
    accelerations, velocities, positions, heights = stepped(model, *state)
    let_converge(model, tolerance=1e-14)
    (theirs, their_velocities, their_positions, their_heights), feet, stops = in_c(
        model, *state
    )
    assert apart(accelerations, theirs).max() < 1e-4
    largest = abs(theirs).max(axis=1, keepdims=True) * model.opt.timestep
    assert np.all(abs(velocities - their_velocities) <= 1e-4 * largest + 1e-5)
    # float32 of some rad
    np.testing.assert_allclose(positions, their_positions, rtol=0, atol=2e-6)
    np.testing.assert_allclose(heights, their_heights, rtol=0, atol=1e-6)
    assert len(set(feet)) >= 4
    assert np.mean(stops) > 10 * stopped


@pytest.mark.parametrize("name", ["go1", "random-1", "random-2"])
def test_newtons_steps_settle_before_the_last(name, monkeypatch):
    """In 2000 states with every third joint in its stop: twice as many steps at most
    change nothing."""
    model, *state = case(name, 0.33, 2000)
    parts = [[x[i : i + STATES] for x in state] for i in range(0, 2000, STATES)]
    accelerations = [stepped(model, *part)[0] for part in parts]
    monkeypatch.setattr(constraints, "MOST_STEPS", 2 * constraints.MOST_STEPS)
    traced_anew = jax.jit(lambda *state: advance(*state))
    np.testing.assert_array_equal(
        [stepped(model, *part, program=traced_anew)[0] for part in parts], accelerations
    )


def test_a_robots_step_does_not_depend_on_the_robots_beside_it():
    """Nor on their number, but for rounding: those that settle late are picked from
    all, some at a time."""
    model, *state = case("go1", 0.3)
    together = stepped(model, *state)[0]
    reordered = stepped(model, *(x[::-1] for x in state))[0][::-1]
    np.testing.assert_array_equal(together, reordered)
    for number in (1, 50):
        alone = stepped(model, *(x[:number] for x in state))[0]
        assert apart(alone, together[:number]).max() < 1e-5
