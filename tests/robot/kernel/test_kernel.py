"""The kernel's step beside C MuJoCo's, which shares no code with it."""

import functools
import importlib
import importlib.util
import types

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from landing import converged, random_states

from bp2_rl.base.errors import UserError
from bp2_rl.env.physics.kernel import randomize_design
from bp2_rl.env.randomization import Randomization, draw
from bp2_rl.robot.ground import Ground, Stairs
from bp2_rl.robot.hardware import BUILT, IDEAL, HardwareSpec
from bp2_rl.robot.kernel import constraints, fusion_barriers, mosaic
from bp2_rl.robot.kernel import step as step_module
from bp2_rl.robot.kernel.design import Design, Masses, Robots
from bp2_rl.robot.kernel.step import MuJoCoState, step
from bp2_rl.robot.kernel.vectors import cos_sin
from bp2_rl.robot.model import MOTOR_QVEL, NV, foot_geom_ids, load_model
from bp2_rl.settings.env import RandomizationConfig

ROBOTS = 200
OTHER = IDEAL.changed(
    leg_length=0.4,
    fore_track=0.42,
    hind_track=0.3,
    spring_stiffness=8e3,
    spring_travel=0.1,
    mass_scale=1.2,
    thigh_mass=2.9,
    toe_mass=0.8,
    trunk_inertia=0.6,
)
DESIGNED = RandomizationConfig()
VARIED = RandomizationConfig(
    armature=(0.5, 2.0), spring_stiffness=(0.5, 1.5), spring_damping=(0.0, 20.0)
)
STAIRS = Stairs(0.1, 0.3, 7.0)  # frozen: `stepped` keeps its program


@pytest.fixture(scope="module")
def states() -> list[np.ndarray]:
    """Return states (qpos, qvel, torque) with zero to four feet on the ground and
    joints beyond their limits."""
    return [
        x.astype(np.float32)
        for x in random_states(np.random.default_rng(0), ROBOTS, thrown=0.0)
    ]


@functools.cache
def drawn(hardware: HardwareSpec, ranges: RandomizationConfig):
    """Draw robots around this one, each different in masses, trunk and friction, and in
    springs and rotors where the ranges say so."""
    keys = jax.random.split(jax.random.PRNGKey(1), ROBOTS)
    bodies = load_model(hardware).nbody
    return jax.vmap(lambda key: draw(key, ranges, bodies, hardware))(keys)


@functools.cache
def stepped(
    hardware: HardwareSpec,
    ranges: RandomizationConfig = DESIGNED,
    ground: Ground | None = None,
):
    """(qpos, qvel, torque), a robot a row -> (qpos, qvel, acceleration, heights of
    feet) after, from no first guess."""
    nominal = Design.of(load_model(hardware, visual=False, feet_only=True))
    robots = drawn(hardware, ranges)

    @jax.jit
    def run(qpos, qvel, torque):
        design = randomize_design(nominal, robots)
        masses = Masses.of(design, robots.mass.T, robots.com_offset.T)
        force = jnp.zeros((NV, len(qpos))).at[MOTOR_QVEL].set(torque.T)
        before = MuJoCoState(qpos.T, qvel.T, jnp.zeros((NV, len(qpos))))
        after, heights = step(
            Robots(design, masses, robots.friction),
            before,
            force,
            jax.tree.map(lambda x: jnp.full(len(qpos), x), ground),
        )
        return after.qpos.T, after.qvel.T, after.qacc_warmstart.T, heights.T

    return run


def randomize(
    model: mujoco.MjModel, nominal: mujoco.MjModel, robot: Randomization
) -> None:
    """Give a C MuJoCo model this draw; what MuJoCo's compiler derives from the masses
    stays nominal, as in training."""
    trunk = int(model.body("trunk").id)
    model.body_mass[:] = nominal.body_mass * robot.mass
    model.body_inertia[:] = nominal.body_inertia * robot.mass[:, None]
    model.body_ipos[trunk] = nominal.body_ipos[trunk] + robot.com_offset
    # else C MuJoCo does not look at body_ipos
    model.body_sameframe[trunk] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    model.geom_friction[:, 0] = robot.friction
    if robot.armature is not None:
        springs = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
        sliding = np.flatnonzero(springs) + NV - model.njnt
        stiffness, damping = map(
            np.asarray, (robot.spring_stiffness, robot.spring_damping)
        )
        model.dof_armature[:] = nominal.dof_armature * np.asarray(robot.armature)
        model.jnt_stiffness[springs] = nominal.jnt_stiffness[springs] * stiffness
        model.dof_damping[sliding] = nominal.dof_damping[sliding] * damping


@pytest.mark.parametrize(
    ("hardware", "ranges"),
    [(OTHER, DESIGNED), (BUILT, VARIED)],
    ids=["other", "varied"],
)
def test_one_step_of_randomised_robots_is_that_of_c_mujoco(states, hardware, ranges):
    """Accelerations to 1e-4 of each state's largest, C MuJoCo's solver converged in
    float64; then the step itself."""
    positions, velocities, accelerations, heights = map(
        np.asarray, stepped(hardware, ranges)(*states)
    )
    nominal = load_model(hardware, visual=False, feet_only=True)
    model, robots = (
        converged(load_model(hardware, visual=False, feet_only=True)),
        drawn(hardware, ranges),
    )
    data, feet, limits, worst = mujoco.MjData(model), [], [], []
    for i, (qpos, qvel, torque) in enumerate(zip(*states, strict=True)):
        randomize(model, nominal, jax.tree.map(lambda x, i=i: np.asarray(x[i]), robots))
        mujoco.mj_resetData(model, data)
        data.qpos, data.qvel = qpos, qvel
        data.qfrc_applied[MOTOR_QVEL] = torque
        mujoco.mj_step(model, data)
        feet.append(data.ncon)
        limits.append(np.sum(data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT))
        largest = abs(data.qacc).max()
        worst.append(abs(accelerations[i] - data.qacc).max() / largest)
        np.testing.assert_allclose(
            velocities[i], data.qvel, rtol=0, atol=1e-4 * largest * 1e-3 + 1e-5
        )
        np.testing.assert_allclose(positions[i], data.qpos, rtol=0, atol=1e-6)
        np.testing.assert_allclose(
            heights[i], data.geom_xpos[foot_geom_ids(model), 2], rtol=0, atol=1e-6
        )
    assert max(worst) < 1e-4
    # its legs reach further down
    assert all(np.bincount(feet, minlength=5) >= (0 if hardware is OTHER else 6))
    assert np.sum(limits) > 20


def test_full_newton_steps_end_at_the_minimum(monkeypatch):
    """5000 states, feet thrown into the ground among them: twice as many steps end at
    the same accelerations.

    Where full steps circled between sets of rows, another number of steps would end
    elsewhere.
    """
    states = [
        x.astype(np.float32)
        for x in random_states(np.random.default_rng(7), 5000, thrown=3.0)
    ]
    design = Design.of(load_model(BUILT, visual=False, feet_only=True))
    robots = Robots(
        design,
        Masses.of(design, jnp.ones((18, 5000)), jnp.zeros((3, 5000))),
        0.8 * jnp.ones(5000),
    )

    def accelerations(steps):
        monkeypatch.setattr(constraints, "MOST_STEPS", steps)

        @jax.jit
        def run(qpos, qvel, torque):
            force = jnp.zeros((NV, 5000)).at[MOTOR_QVEL].set(torque.T)
            return step(
                robots, MuJoCoState(qpos.T, qvel.T, jnp.zeros((NV, 5000))), force
            )[0].qacc_warmstart

        return np.asarray(run(*states))

    once, twice = (
        accelerations(constraints.MOST_STEPS),
        accelerations(2 * constraints.MOST_STEPS + 1),
    )
    assert np.isfinite(once).all()
    np.testing.assert_array_equal(once, twice)


def as_on_a_gpu(monkeypatch, kernel):
    monkeypatch.setattr(
        fusion_barriers.FusionBarriers,
        "of",
        lambda friction: fusion_barriers.FusionBarriers(None),
    )
    monkeypatch.setattr(step_module, "in_one_kernel", kernel)


def evaluated(function, *inputs):
    """Return function(*inputs) by the evaluation inside a kernel for Mosaic GPU."""
    leaves, structure = jax.tree.flatten(inputs)
    leaves = [jnp.atleast_1d(leaf) for leaf in leaves]
    program, shapes = mosaic.traced_flat(function, structure, leaves)
    given = [
        x[0] if x.shape == (1,) else jnp.broadcast_to(x, (*x.shape[:-1], ROBOTS))
        for x in leaves
    ]
    found = mosaic.BlockEvaluation(ROBOTS).results(program, given)
    return jax.tree.unflatten(jax.tree.structure(shapes), found)


def interpreted(function, *inputs):
    """Return function(*inputs) by a kernel for Mosaic GPU in which JAX plays the
    GPU."""
    mosaic_gpu = importlib.import_module("jax.experimental.pallas.mosaic_gpu")
    with mosaic_gpu.force_gpu_interpret_mode():
        return mosaic.mosaic(function, *inputs)


MOSAIC = pytest.mark.skipif(
    jax.__version_info__ < (0, 11), reason="the kernels for Mosaic GPU ask for JAX 0.11"
)


@pytest.mark.parametrize(
    ("kernel", "ground"),
    [
        (functools.partial(fusion_barriers._pallas, interpret=True), None),
        (evaluated, STAIRS),
        pytest.param(interpreted, STAIRS, marks=MOSAIC),
    ],
    ids=["triton", "evaluated", "mosaic"],
)
def test_in_programs_or_in_kernels_the_step_is_the_same(
    states, monkeypatch, kernel, ground
):
    """Only what the compiler fuses differs, and with it the rounding of float32."""
    in_programs = stepped(BUILT, VARIED, ground)(*states)
    as_on_a_gpu(monkeypatch, kernel)
    in_kernels = stepped.__wrapped__(BUILT, VARIED, ground)(*states)
    for ours, theirs in zip(in_programs, in_kernels, strict=True):
        scale = np.max(np.abs(theirs), axis=1, keepdims=True)
        np.testing.assert_allclose(ours / scale, theirs / scale, rtol=0, atol=1e-4)


def thought_of_gpu():
    """Return the context of a GPU that is not there, which JAX 0.11 needs before it
    lowers a kernel for a GPU."""
    device = jax.sharding.AbstractDevice("NVIDIA H100 80GB HBM3", None, "gpu")
    return jax.sharding.use_abstract_mesh(
        jax.sharding.AbstractMesh((), (), abstract_device=device)
    )


@pytest.mark.parametrize("ranges", [DESIGNED, VARIED], ids=["designed", "varied"])
@pytest.mark.parametrize(
    ("kernel", "call"),
    [
        (fusion_barriers._pallas, "xla.gpu.triton"),
        pytest.param(mosaic.mosaic, "@mosaic_gpu_v2", marks=MOSAIC),
    ],
    ids=["triton", "mosaic"],
)
def test_for_a_gpu_a_step_is_four_kernels(states, monkeypatch, ranges, kernel, call):
    """As far as that can be told without one: it is handed to Triton or Mosaic GPU, and
    little else is left around it."""
    as_on_a_gpu(monkeypatch, kernel)
    with thought_of_gpu():
        program = (
            stepped.__wrapped__(BUILT, ranges)
            .trace(*states)
            .lower(lowering_platforms=("cuda",))
            .as_text()
        )
    assert program.count(call) == 4
    assert program.count("stablehlo.multiply") < 50


def test_cosine_and_sine_are_exact_to_float32():
    angles = np.concatenate(
        [np.linspace(-10.0, 10.0, 200_001), np.linspace(-100.0, 100.0, 20_001)]
    ).astype(np.float32)
    cos, sin = map(np.asarray, jax.jit(cos_sin)(angles))
    np.testing.assert_allclose(
        cos, np.cos(angles.astype(np.float64)), rtol=0, atol=2.4e-7
    )
    np.testing.assert_allclose(
        sin, np.sin(angles.astype(np.float64)), rtol=0, atol=2.4e-7
    )


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda m: m.body_parentid.__setitem__(3, 1), "the tree of its bodies"),
        (lambda m: m.body_quat.__setitem__((3, 1), 0.1), "turned bodies"),
        (lambda m: m.jnt_stiffness.__setitem__(3, 10.0), "springs parallel to joints"),
        (lambda m: m.jnt_limited.__setitem__(4, 1), "limited or preloaded springs"),
        (
            lambda m: m.tendon_damping.__setitem__(0, 1.0),
            "tendons but for springs' stops",
        ),
        (lambda m: m.jnt_margin.__setitem__(2, 0.01), "margins of joints"),
        (lambda m: m.dof_damping.__setitem__(0, 1.0), "a damped trunk"),
        (lambda m: m.geom_contype.__setitem__(-1, 1), "other contacts"),
        (lambda m: setattr(m.opt, "cone", 1), "other contacts"),
        (lambda m: m.jnt_axis.__setitem__((2, 0), 1.0), "the axes of its joints"),
        (lambda m: m.geom_solimp.__setitem__((-1, 4), 3.0), "unlike feet"),
        (lambda m: m.jnt_solref.__setitem__((2, 0), 0.01), "unlike joints"),
        (lambda m: m.dof_frictionloss.__setitem__(7, 1.0), "dry friction"),
        (
            lambda m: m.geom_bodyid.__setitem__(foot_geom_ids(m)[0], 2),
            "the tree of its bodies",
        ),
        (lambda m: m.jnt_bodyid.__setitem__(2, 4), "the tree of its bodies"),
        (
            lambda m: m.jnt_type.__setitem__(2, mujoco.mjtJoint.mjJNT_SLIDE),
            "the axes of its joints",
        ),
        (lambda m: m.jnt_pos.__setitem__((3, 2), 0.01), "turned bodies"),
        (lambda m: m.qpos_spring.__setitem__(10, 0.01), "limited or preloaded springs"),
        (
            lambda m: m.dof_dampingpoly.__setitem__((7, 0), 0.1),
            "stiffness or damping that is not linear",
        ),
        (lambda m: m.wrap_prm.__setitem__(0, 2.0), "tendons but for springs' stops"),
        (
            lambda m: m.wrap_objid.__setitem__(0, m.wrap_objid[1]),
            "tendons but for springs' stops",
        ),
        (
            lambda m: m.geom_solref.__setitem__((slice(None), 0), -100.0),
            "a constraint's solref or solimp",
        ),
        (
            lambda m: m.geom_solimp.__setitem__((slice(None), 3), 0.6),
            "a constraint's solref or solimp",
        ),
    ],
)
def test_a_robot_that_the_kernel_does_not_know_is_refused_by_name(change, what):
    model = load_model(visual=False, feet_only=True)
    change(model)
    with pytest.raises(UserError, match=what):
        Design.of(model)


def test_legs_with_unlike_stops_are_refused_by_name():
    model = load_model(BUILT, visual=False, feet_only=True)
    springs = model.wrap_objid.copy()
    model.wrap_objid[:] = np.where(
        np.arange(len(springs)) == np.flatnonzero(springs == springs[0])[-1],
        springs[1],
        springs,
    )
    with pytest.raises(UserError, match="unlike legs"):
        Design.of(model)


def test_equality_constraints_are_refused_by_name():
    def weld(spec: mujoco.MjSpec) -> None:
        spec.add_equality(
            type=mujoco.mjtEq.mjEQ_CONNECT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1="FR_toe",
            name2="FL_toe",
        )

    with pytest.raises(UserError, match="equality constraints"):
        Design.of(load_model(visual=False, feet_only=True, scene=weld))


@pytest.mark.parametrize(
    ("gpus", "jax_version", "by_mosaic"),
    [
        (["9.0"], (0, 11, 2), True),
        (["9.0", "9.0"], (0, 11, 2), True),
        (["9.0", "8.0"], (0, 11, 2), False),
        (["9.0"], (0, 10, 2), False),
        (["8.9"], (0, 11, 2), False),
        (["gfx942"], (0, 11, 2), False),
    ],
)
def test_mosaic_gpu_makes_the_kernels_where_it_was_tried(
    gpus, jax_version, by_mosaic, monkeypatch
):
    found = [types.SimpleNamespace(compute_capability=one) for one in gpus]
    monkeypatch.setattr(jax, "devices", lambda: found)
    monkeypatch.setattr(jax, "__version_info__", jax_version)
    assert fusion_barriers._has_mosaic() is by_mosaic
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert fusion_barriers._has_mosaic()
