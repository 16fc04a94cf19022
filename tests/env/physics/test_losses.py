"""Losses in every engine: MJX, the kernel and C MuJoCo, against closed forms and each
other."""

import dataclasses
import math
from functools import cache
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bp2_rl.env import randomization
from bp2_rl.env.bp2_env import BP2Env
from bp2_rl.env.controller import Targets
from bp2_rl.robot.hardware import BUILT, HardwareSpec, Losses
from bp2_rl.robot.model import MOTOR_QPOS, MOTOR_QVEL
from bp2_rl.settings.env import EnvConfig, Impl
from bp2_rl.simulation.simulator import RobotSetup, Simulator

Engine = Impl | Literal["mujoco"]
ENGINES: list[Engine] = ["mujoco", "jax", "kernel"]
# kg m2 at the motor, 7.2 at the joint: beside it a leg weighs little
HEAVY_ROTORS = 0.1
LEG_INERTIA = 0.14  # kg m2, of a bent leg about its hip
IN_THE_AIR = HardwareSpec(losses=Losses(drag_area=2.0, headwind=5.0))
PROMPT = BUILT.changed(latency=0.0)
AS_DESIGNED = {
    "braking": 0.0,
    "no_load_speed": 1.0,
    "armature": 1.0,
    "spring_stiffness": 1.0,
    "spring_damping": 1.0,
}
"""What training may draw, at the numbers of the design."""


@cache
def compiled(hardware: HardwareSpec, impl: Impl):
    env = BP2Env(EnvConfig(hardware=hardware), impl=impl)

    def control_step(physics, robot):
        q = physics.qpos[MOTOR_QPOS]
        after, *_ = env.engine(physics, Targets(q, jnp.zeros(12)), robot)
        return after

    nominal = randomization.nominal(env.mj_model.nbody, hardware)
    return env, jax.jit(control_step), nominal


def fly(
    engine: str,
    hardware: HardwareSpec,
    qvel: np.ndarray,
    control_steps: int,
    *,
    strength: float = 1.0,
    **drawn: float,
) -> np.ndarray:
    """Return velocities after each control step of a robot that starts 10 m up, its
    targets where its joints are.

    With a `strength` of 0 its motors give nothing; `drawn` is some of `AS_DESIGNED`,
    drawn otherwise.
    """
    if engine != "mujoco":
        env, control_step, robot = compiled(hardware, engine)
        numbers = AS_DESIGNED | drawn if drawn else {}
        robot = robot.replace(
            strength=strength * jnp.ones(12),
            **{name: jnp.array(value) for name, value in numbers.items()},
        )
        rest = env.starts.at_rest()
        physics = rest.replace(
            qpos=rest.qpos.at[2].set(10.0), qvel=jnp.asarray(qvel, jnp.float32)
        )
        found = []
        for _ in range(control_steps):
            physics = control_step(physics, robot)
            found.append(np.asarray(physics.qvel, np.float64))
        return np.array(found)
    simulator = Simulator(
        [
            RobotSetup(
                EnvConfig(hardware=dataclasses.replace(hardware, envelope="start"))
            )
        ]
    )
    simulator.set_motors(0, dataclasses.replace(simulator.motors[0], strength=strength))
    simulator.data[0].qpos[2] = 10.0
    simulator.data[0].qvel[:] = qvel
    simulator.read(0)
    found = []
    for _ in range(control_steps):
        q = simulator.qpos[:, MOTOR_QPOS].copy()
        for _ in range(5):
            simulator.millisecond(q, np.zeros((1, 12)))
        found.append(simulator.qvel[0].copy())
    return np.array(found)


def test_brakes_that_training_draws_weaker_are_those_of_such_motors_in_c_mujoco():
    """Joints at up to 21 rad/s, where brakes as drives have hardly any torque left;
    beyond, the back EMF brakes."""
    qvel = np.zeros(22)
    qvel[MOTOR_QVEL] = np.linspace(-21.0, 21.0, 12)
    weaker = PROMPT.changed(braking_speed=21.4)
    drawn = fly("kernel", PROMPT, qvel, 1, braking=1.0)[:, MOTOR_QVEL]
    weak, strong = (
        fly("mujoco", one, qvel, 1)[:, MOTOR_QVEL] for one in (weaker, PROMPT)
    )
    assert np.max(np.abs(drawn - weak)) < 0.01
    assert np.max(np.abs(strong - weak)) > 1.0


@pytest.mark.parametrize("engine", ENGINES)
def test_the_air_takes_a_flying_robots_speed_through_it(engine):
    """u = u0 / (1 + k u0 t / m) through the air, whose headwind blows it back. Drag
    acts on the trunk, whose legs lag a little behind."""
    qvel = np.zeros(22)
    qvel[0] = 15.0
    found = fly(engine, IN_THE_AIR, qvel, 60)[-1, 0]
    through_the_air = 20.0 / (1.0 + 0.5 * 1.2 * 2.0 * 20.0 * 0.3 / 35.8)
    assert through_the_air < 17.0
    assert found == pytest.approx(through_the_air - 5.0, rel=0.015)


@pytest.mark.parametrize(
    ("engine", "others"),
    [("mujoco", None), *((engine, (5.0, 1.0)) for engine in ENGINES)],
)
def test_a_spinning_joint_decays_by_coulomb_and_viscosity_and_stays_at_rest(
    engine, others
):
    """I w' = -c - b w: w = (w0 + c / b) exp(-b t / I) - c / b, with 2 % of I from the
    leg that hangs on it.

    That leg's own springs shake it by some hundredths of a rad/s. A hip does not care
    for the `others`' numbers.
    """
    losses = Losses(joint_friction=60.0, joint_viscosity=10.0)
    if others is not None:
        friction, viscosity = others
        losses = Losses(
            joint_friction=(friction, 60.0, 40.0),
            joint_viscosity=(viscosity, 10.0, 8.0),
        )
    hardware = HardwareSpec(rotor_inertia=HEAVY_ROTORS, losses=losses)
    qvel = np.zeros(22)
    qvel[MOTOR_QVEL[[1, 10]]] = 2.0, -2.0  # a fore and a hind hip
    found = fly(engine, hardware, qvel, 60, strength=0.0)[:, MOTOR_QVEL[[1, 10]]]
    inertia, time = hardware.reflected_inertia + LEG_INERTIA, 0.005 * np.arange(1, 61)
    expected = (2.0 + 6.0) * np.exp(-10.0 * time / inertia) - 6.0
    moving = expected > 0.05
    assert 20 < np.sum(moving) < 55
    np.testing.assert_allclose(found[moving, 0], expected[moving], atol=0.03)
    np.testing.assert_allclose(found[moving, 1], -expected[moving], atol=0.03)
    # still, but for what the swinging legs shake
    assert np.all(np.abs(found[-1]) < 0.05)


@pytest.mark.parametrize("engine", ["jax", "kernel"])
def test_a_built_robot_is_the_same_in_every_engine_as_in_the_judge(engine):
    """Ten control steps of a tumbling robot with all losses, bus and lag; float32
    rounds 10 rad/s by 1e-6."""
    rng = np.random.default_rng(3)
    qvel = rng.normal(0.0, 3.0, 22)
    qvel[MOTOR_QVEL] = rng.uniform(-15.0, 15.0, 12)
    ours, judged = (fly(one, PROMPT, qvel, 10) for one in (engine, "mujoco"))
    np.testing.assert_allclose(ours, judged, rtol=0, atol=5e-3)
    lossless = fly("mujoco", HardwareSpec(), qvel, 10)
    assert np.max(np.abs(judged - lossless)) > 1.0  # they matter


@pytest.mark.parametrize(
    ("name", "factor", "built_so", "tolerance"),
    [
        ("no_load_speed", 0.7, ("no_load_speed", "corner_speed"), 5e-3),
        ("armature", 0.6, ("rotor_inertia",), 5e-3),
        ("armature", 1.8, ("rotor_inertia",), 2e-2),
        ("spring_stiffness", 1.3, ("spring_stiffness",), 5e-3),
        ("spring_damping", 8.0, ("spring_damping",), 5e-3),
    ],
)
@pytest.mark.parametrize("engine", ["jax", "kernel"])
def test_a_robot_with_another_number_of_the_design_is_as_one_built_so_in_c_mujoco(
    engine, name, factor, built_so, tolerance
):
    """Four control steps of a tumbling robot, whose joints are about as fast as its
    motors.

    Near rest, friction holds a heavier rotor no more firmly than the designed one.
    """
    rng = np.random.default_rng(3)
    qvel = rng.normal(0.0, 3.0, 22)
    qvel[MOTOR_QVEL] = rng.uniform(-20.0, 20.0, 12)
    other = PROMPT.changed(**{n: factor * PROMPT.parameter(n) for n in built_so})
    drawn = fly(engine, PROMPT, qvel, 4, **{name: factor})
    built, designed = (fly("mujoco", one, qvel, 4) for one in (other, PROMPT))
    np.testing.assert_allclose(drawn, built, rtol=0, atol=tolerance)
    assert np.max(np.abs(built - designed)) > 0.1


@pytest.mark.parametrize("engine", ["jax", "kernel"])
def test_a_robot_drawn_with_twice_the_losses_has_twice_the_losses(engine):
    env, control_step, robot = compiled(IN_THE_AIR, engine)
    rest = env.starts.at_rest()
    start = rest.replace(qpos=rest.qpos.at[2].set(10.0), qvel=rest.qvel.at[0].set(5.0))
    lost = [
        5.0
        - float(
            control_step(
                start, robot.replace(losses=robot.losses.at[0].set(factor))
            ).qvel[0]
        )
        for factor in (0.0, 1.0, 2.0)
    ]
    # what the springs do to the trunk as they give
    assert lost[0] == pytest.approx(0.0, abs=5e-3)
    assert lost[2] - lost[0] == pytest.approx(2.0 * (lost[1] - lost[0]), rel=0.02)
    trunk_and_legs = (
        math.inf if lost[1] == 0.0 else 0.005 * 0.5 * 1.2 * 2.0 * 100.0 / lost[1]
    )
    assert 20.0 < trunk_and_legs < 36.0  # kg: the trunk is braked before its legs
