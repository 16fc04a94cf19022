"""The optimiser on robots that are not BP2: models against C MuJoCo, a rigid problem, a
library and who may use it."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.cli.trajopt import load_family, save_family
from bp2_rl.deploy.onboard.motion import load_motion
from bp2_rl.deploy.reference import playback
from bp2_rl.env.controller import motion_of
from bp2_rl.optimiser import sagittal
from bp2_rl.optimiser.family import FamilyConfig, build_family
from bp2_rl.optimiser.figure import trajectory_figure
from bp2_rl.optimiser.planar import PlanarModel
from bp2_rl.optimiser.verify import failures
from bp2_rl.paper.trajectories.comparison import summarise_gait
from bp2_rl.paper.trajectories.coupling import account_coupling
from bp2_rl.paper.trajectories.decomposition import decompose
from bp2_rl.reference.library.trot import CollocationGait
from bp2_rl.robot import kinematics
from bp2_rl.robot.conventions import LEGS
from bp2_rl.robot.hardware import IDEAL, HardwareSpec
from bp2_rl.robot.model import load_model
from bp2_rl.robot.named import find_robot
from bp2_rl.settings.env import EnvConfig
from bp2_rl.settings.presets.robots import on_robot


def odd(hardware: HardwareSpec) -> HardwareSpec:
    """Return a robot whose hind legs are longer, hang lower, bend forwards and are as
    heavy in front as behind."""
    anatomy = hardware.anatomy

    def leg(leg):
        return dataclasses.replace(
            leg,
            hip=(0.03, leg.hip[1], -0.02),
            anchor=(leg.anchor[0], leg.anchor[1], 0.04),
            knee=(0.0, leg.knee[1], 1.2 * leg.knee[2]),
            thigh=dataclasses.replace(
                leg.thigh, com=(0.03, 0.01, -0.06), mass=1.3 * leg.thigh.mass
            ),
            bend=1,
            ranges=(leg.ranges[0], leg.ranges[1], (0.1, 2.6)),
        )

    fr, fl, rr, rl = anatomy.legs
    trunk = dataclasses.replace(anatomy.trunk, com=(0.05, 0.0, 0.03))
    body = dataclasses.replace(
        anatomy, name="odd", trunk=trunk, legs=(fr, fl, leg(rr), leg(rl))
    )
    return dataclasses.replace(hardware, body=body, gear_ratio=body.gear_ratio)


ROBOTS = {
    "go1": find_robot("go1"),
    "mini_cheetah": find_robot("mini_cheetah"),
    "odd and rigid": odd(find_robot("go1")),
    "odd and sprung": odd(
        dataclasses.replace(IDEAL, spring_stop_stiffness=0.0, rebound_stiffness=0.0)
    ),
}


def random_state(rng: np.random.Generator, each: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw a posture in the plane, clear of the floor, and rates of running speed."""
    leg = rng.uniform((-1.4, -2.6, 0.02), (2.4, 2.6, 0.10), size=(4, 3))[:, :each]
    q = np.concatenate([rng.uniform((-1.0, 1.3, -0.5), (1.0, 1.8, 0.5)), leg.ravel()])
    return q, rng.normal(scale=10.0, size=q.size)


@pytest.mark.parametrize("hardware", ROBOTS.values(), ids=ROBOTS)
def test_accelerations_are_those_of_the_robot_in_space(hardware):
    """C MuJoCo's whole robot with abduction, roll and yaw held: 1e-6 of the largest
    acceleration, 50 states.

    Springs are without stops, whose corners the plane rounds.
    """
    robot, casadi = load_model(hardware), sagittal.build_model(LEGS, hardware)
    each = 3 if hardware.anatomy.sprung else 2
    data, rng, n = mujoco.MjData(robot), np.random.default_rng(1), 3 + 4 * each
    roles = ("hip", "knee", "spring")[:each]
    joints = [robot.joint(f"{leg}_{role}") for leg in LEGS for role in roles]
    columns = [0, 2, 4, *(joint.dofadr[0] for joint in joints)]
    motors = [
        columns.index(robot.joint(f"{leg}_{role}").dofadr[0])
        for leg in LEGS
        for role in ("hip", "knee")
    ]
    for _ in range(50):
        q, v = random_state(rng, each)
        tau, p = rng.normal(scale=20.0, size=8), sagittal.design_vector(hardware)
        data.qpos[:], data.qvel[:] = 0.0, 0.0
        data.qpos[[0, 2]], data.qpos[[3, 5]] = (
            q[:2],
            (np.cos(q[2] / 2.0), np.sin(q[2] / 2.0)),
        )
        for joint, angle in zip(joints, q[3:], strict=True):
            data.qpos[joint.qposadr[0]] = angle
        data.qvel[columns] = v
        mujoco.mj_forward(robot, data)
        mass = np.zeros((robot.nv, robot.nv))
        mujoco.mj_fullM(robot, data, mass)
        push = (data.qfrc_passive - data.qfrc_bias)[columns]
        push[motors] += tau - np.array(casadi.resistance(v, tau, p)).ravel()
        expected = np.linalg.solve(mass[np.ix_(columns, columns)], push)
        residual = np.array(
            casadi.residual(q, v, expected, tau, np.zeros(8), p)
        ).ravel()
        found = expected - np.linalg.solve(np.array(casadi.mass(q, p)), residual)
        assert np.max(np.abs(found - expected)) <= 1e-6 * np.max(np.abs(expected))
        judged, _ = PlanarModel(LEGS, hardware).accelerate(q, v, tau, [])
        assert np.max(np.abs(judged - found)) <= 1e-9 * np.max(np.abs(expected))
        assert n == q.size


@pytest.mark.parametrize("hardware", ROBOTS.values(), ids=ROBOTS)
def test_contacts_are_those_of_the_judge(hardware):
    casadi, planar = sagittal.build_model(LEGS, hardware), PlanarModel(LEGS, hardware)
    rng, p = np.random.default_rng(2), sagittal.design_vector(hardware)
    for _ in range(10):
        q, v = random_state(rng, 3 if hardware.anatomy.sprung else 2)
        terms = planar.terms(q, v)
        np.testing.assert_allclose(
            np.array(casadi.contact(q, p)).ravel(), terms.contact, rtol=0, atol=1e-12
        )
        np.testing.assert_allclose(
            casadi.contact_jacobian(q, p), terms.jacobian, rtol=0, atol=1e-12
        )
        accelerated = np.array(casadi.contact_acceleration(q, v, 0.0 * v, p)).ravel()
        np.testing.assert_allclose(accelerated, terms.convective, rtol=1e-9, atol=1e-9)


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Solve the Go1's trots of three speeds on a coarse mesh; return the family and its
    file."""
    settings = FamilyConfig.on(find_robot("go1"))
    anchor, problem = settings.anchor, settings.problem.on_mesh(12)
    ends = {"slowest": anchor - 0.2, "fastest": anchor + 0.2, "step": 0.2}
    settings = dataclasses.replace(settings, **ends, starts=1, problem=problem)
    folder = tmp_path_factory.mktemp("go1")
    family = build_family(settings, folder / "solutions")
    save_family(folder / "go1_trot.npz", family, settings)
    return family, folder / "go1_trot.npz"


def test_a_rigid_robots_trots_are_sound(library):
    """Without a figure of the re-simulation, which a mesh as coarse as this leaves some
    millimetres off."""
    for solution in library[0]:
        assert solution.motion.q.shape[-1] == 11
        assert [
            line for line in failures(solution.checks) if "_error" not in line
        ] == []


def test_a_rigid_robots_trot_is_drawn_and_split_into_its_forces(library):
    """Motors' and contacts' forces are the inertial and other terms; what is split by
    springs is refused."""
    solution = library[0][0]
    trajectory_figure(solution)
    assert summarise_gait(solution).speed == solution.problem.speed
    terms = decompose(solution)
    assert terms.coordinates[-2:] == ("RL hip", "RL knee")
    assert terms.closure < 1e-6  # as BP2's, in test_decomposition.py
    with pytest.raises(UserError, match="rigid shanks"):
        account_coupling(solution)


def test_a_rigid_robots_library_survives_the_disk(library):
    family, path = library
    for solution, again in zip(family, load_family(path), strict=True):
        assert again.problem == solution.problem
        np.testing.assert_array_equal(again.motion.q, solution.motion.q)


def _go1(path, **changes) -> EnvConfig:
    env = on_robot(EnvConfig(), find_robot("go1"))
    library = dataclasses.replace(env.library, path=str(path))
    return dataclasses.replace(env, reference="collocation", library=library, **changes)


def test_a_training_follows_the_library(library):
    """At its points and speeds the reference has the solution's angles and rates;
    float32."""
    family, path = library
    gait = motion_of(_go1(path))
    solution = family[1]
    durations = solution.motion.durations
    command = jnp.array([solution.problem.speed, 0.0, 0.0])
    for point in (3, 10):
        share = (
            durations[0] * solution.problem.points[point] / (2.0 * np.sum(durations))
        )
        reference = gait(command, jnp.asarray(share))
        joints = np.asarray(reference.joint_position).reshape(4, 3)
        np.testing.assert_allclose(
            joints[:, 1:],
            solution.motion.q[0, point, 3:].reshape(4, 2),
            rtol=0,
            atol=1e-4,
        )
        np.testing.assert_allclose(joints[:, 0], 0.0, rtol=0, atol=1e-4)
        rates = np.asarray(reference.joint_velocity).reshape(4, 3)[:, 1:]
        np.testing.assert_allclose(
            rates, solution.motion.v[0, point, 3:].reshape(4, 2), rtol=0, atol=1e-2
        )
    np.testing.assert_array_equal(reference.spring_compression, 0.0)


def test_it_stands_on_its_feet_in_balance(library):
    robot = find_robot("go1")
    with jax.enable_x64(True):
        stand = CollocationGait(str(library[1]), hardware=robot)(
            jnp.zeros(3), jnp.zeros(())
        )
    joints = np.asarray(stand.joint_position).reshape(4, 3)
    np.testing.assert_allclose(
        joints, np.reshape(robot.anatomy.stand, (4, 3)), rtol=0, atol=1e-9
    )
    # The torque is minus the load's work per angle: a central difference of the feet's
    # height, exact to 1e-6.
    load, step = robot.mass * 9.81 / 4.0, 1e-5
    for joint in (1, 2):
        moved = (
            joints + step * (np.arange(3) == joint),
            joints - step * (np.arange(3) == joint),
        )
        up, down = (kinematics.foot_position(at, 0.023, robot)[:, 2] for at in moved)
        torque = np.asarray(stand.torque).reshape(4, 3)[:, joint]
        np.testing.assert_allclose(
            torque, -load * (up - down) / (2.0 * step), rtol=0, atol=1e-6
        )


def test_the_controller_on_board_plays_it(library):
    config = _go1(library[1])
    gait, motion = motion_of(config), load_motion(*playback(config))
    rng = np.random.default_rng(0)
    command, phase = (
        rng.uniform((-0.5, -0.3, -1.0), (4.0, 0.3, 1.0), (100, 3)),
        rng.uniform(0.0, 1.0, 100),
    )
    with jax.enable_x64(True):
        law = jax.jit(gait.__call__)(jnp.asarray(command), jnp.asarray(phase))
    played = [
        motion(at, moment)
        for at, moment in zip(command.tolist(), phase.tolist(), strict=True)
    ]
    for name, expected in (
        ("position", law.joint_position),
        ("velocity", law.joint_velocity),
        ("torque", law.torque),
    ):
        found = np.stack([getattr(pose, name) for pose in played])
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8, err_msg=name)


@pytest.mark.parametrize(
    ("other", "name"), [("mini_cheetah", "MIT Mini Cheetah"), ("built", "BP2")]
)
def test_another_robot_is_refused_in_one_line(library, other, name):
    with pytest.raises(
        UserError,
        match=rf"is of Unitree Go1, and the robot is {name}: make one with .*--robot",
    ):
        motion_of(dataclasses.replace(_go1(library[1]), hardware=find_robot(other)))


def test_bp2s_library_is_not_for_another_robot():
    with pytest.raises(UserError, match="is of BP2, and the robot is Unitree Go1"):
        motion_of(_go1("bp2_trot"))
