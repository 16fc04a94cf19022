"""Compile a robot's MuJoCo model: its MJCF, written by hand for BP2, with a
`HardwareSpec` applied.

`robot.coordinates` says what is in `qpos` and `qvel`. `ctrl` is the 12 joint torques in
the order of `MOTOR_NAMES`.
"""

import functools
import itertools
from collections.abc import Callable

import mujoco
import numpy as np
from jaxtyping import Float, Int

from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError, one_line
from bp2_rl.robot import bp2, building, conventions
from bp2_rl.robot.anatomy import Anatomy
from bp2_rl.robot.bp2_body import BP2Body
from bp2_rl.robot.conventions import LEGS, PHYSICS_STEP
from bp2_rl.robot.hardware import IDEAL, HardwareSpec

NQ, NV, NU = 23, 22, 12
SPRING_QPOS = np.array([10, 14, 18, 22])
MOTOR_QPOS = np.setdiff1d(np.arange(7, NQ), SPRING_QPOS)
SPRING_QVEL = SPRING_QPOS - 1
MOTOR_QVEL = MOTOR_QPOS - 1

TRUNK_GEOMS = ("trunk_right", "trunk_left")
FOOT_GEOMS = tuple(f"{leg}_foot" for leg in LEGS)
SOLID_PARTS = ("thigh", "shank", "toe")
SOLE_SITES = tuple(f"{leg}_sole" for leg in LEGS)
VISIBLE = 2  # the last group of geoms that is shown; collision shapes are in later ones
FAR = 1e3
"""Length beyond any spring's end, m."""


class ModelError(UserError):
    """Raised for a model that MuJoCo cannot compile."""


def load_model(
    hardware: HardwareSpec = IDEAL,
    *,
    timestep: float = PHYSICS_STEP,
    visual: bool = True,
    feet_only: bool = False,
    weighed: bool = False,
    scene: Callable[[mujoco.MjSpec], None] | None = None,
) -> mujoco.MjModel:
    """Return a compiled model of a robot on flat ground.

    Args:
        hardware: the robot's parameters.
        timestep: s.
        visual: False leaves out what physics does not need (looks, sensors, lights,
            cameras); MJX is faster without.
        feet_only: leave out the collision of trunk and floor and, if legs are solid, of
            legs with each other and with the trunk. The feet's contacts stay as they
            are; MJX is faster.
        weighed: replace all sensors by four that report the forces on the feet, for
            `foot_forces`.
        scene: changes the ground, last of all.

    Raises:
        ModelError: MuJoCo cannot compile a model with these parameters.
    """
    spec = _scene(hardware, timestep, visual, feet_only, weighed).copy()
    if scene is not None:
        scene(spec)
    try:
        return spec.compile()
    except ValueError as error:
        raise ModelError(
            f"the model of {hardware.anatomy.name} does not compile: {one_line(str(error))}"
        ) from error


def model_xml(
    hardware: HardwareSpec,
    scene: Callable[[mujoco.MjSpec], None],
    *,
    weighed: bool = False,
) -> str:
    """Write the model that `load_model` compiles as one text of MJCF, with numbers to
    six digits."""
    spec = _scene(hardware, weighed=weighed).copy()
    scene(spec)
    spec.compile()
    return spec.to_xml()


@functools.lru_cache(maxsize=8)
def _scene(
    hardware: HardwareSpec,
    timestep: float = PHYSICS_STEP,
    visual: bool = True,
    feet_only: bool = False,
    weighed: bool = False,
) -> mujoco.MjSpec:
    """Return the scene of `load_model` on flat ground; copies take other ground."""
    spec = load_spec(hardware)
    spec.option.timestep = timestep
    if hardware.solid_legs and not feet_only:
        _make_legs_solid(spec)
    if not visual:
        _drop_visuals(spec)
    if feet_only:
        for name in TRUNK_GEOMS:
            spec.geom(name).conaffinity = 0
    if weighed:
        _weigh(spec)
    return spec


def let_converge(
    model: mujoco.MjModel,
    *,
    iterations: int = 100,
    line_search: int = 50,
    tolerance: float | None = None,
) -> None:
    """Let C MuJoCo's solver run until it has converged, and switch off its reset of
    diverged states.

    Args:
        model: to be changed.
        iterations: of the solver in a step, at most; with the usual tolerance mostly
            two do.
        line_search: line-search steps in an iteration, at most.
        tolerance: scaled residual at which it is done; None for that of the model.
    """
    model.opt.iterations, model.opt.ls_iterations = iterations, line_search
    if tolerance is not None:
        model.opt.tolerance = tolerance
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET


def load_spec(hardware: HardwareSpec = IDEAL) -> mujoco.MjSpec:
    """Return the robot's scene as an editable MjSpec with `hardware` applied."""
    body = hardware.body
    if isinstance(body, BP2Body):
        spec = _packaged().copy()
        _apply_body(spec, body)
    else:
        spec = _built(body, hardware.spring_stiffness).copy()
    for link in spec.bodies[1:]:
        link.mass *= hardware.mass_scale
        link.inertia = np.asarray(link.inertia) * hardware.mass_scale
    if hardware.anatomy.sprung:
        _apply_springs(spec, hardware)
    _apply_motors(spec, hardware)
    _apply_contacts(spec, hardware)
    return spec


def foot_geom_ids(model: mujoco.MjModel) -> np.ndarray:
    """Ids of the four foot spheres, in the order of the legs."""
    return np.array([model.geom(name).id for name in FOOT_GEOMS])


def visible_geoms(model: mujoco.MjModel) -> list[tuple[int, Float[np.ndarray, "3"]]]:
    """Return the geoms by which the robot is seen, each with its red, green and blue, 0
    to 1."""
    visible = np.flatnonzero(
        (model.geom_bodyid > 0) & (model.geom_group <= VISIBLE)
    ).tolist()
    painted = {geom: int(model.geom_matid[geom]) for geom in visible}
    return [
        (geom, (model.mat_rgba[m] if m >= 0 else model.geom_rgba[geom])[:3])
        for geom, m in painted.items()
    ]


def ground_geoms(model: mujoco.MjModel) -> list[int]:
    """Return the geoms of ground that is not flat."""
    raised = model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE
    return np.flatnonzero(
        raised & (model.geom_bodyid == 0) & (model.geom_group == 0)
    ).tolist()


def field_of(
    model: mujoco.MjModel,
) -> tuple[
    Float[np.ndarray, " columns"],
    Float[np.ndarray, " rows"],
    Float[np.ndarray, "rows columns"],
]:
    """Return the points along x and along y of a scene's only field of heights, and the
    heights there, m, in the frame of its geom."""
    length, breadth, most, _ = model.hfield_size[0]
    heights = most * model.hfield_data.reshape(model.hfield_nrow[0], -1)
    rows, columns = heights.shape
    x, y = np.linspace(-length, length, columns), np.linspace(-breadth, breadth, rows)
    return x, y, heights


def mesh_of(
    model: mujoco.MjModel, mesh: int
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """Return a mesh's vertices, m, in the frame of its geoms, and its faces."""
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    start, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    return model.mesh_vert[first : first + count], model.mesh_face[
        start : start + faces
    ]


def foot_forces(data: mujoco.MjData) -> Float[np.ndarray, "4 3"]:
    """Return the ground's force on each foot, N, at the last `mj_step` or `mj_forward`
    of a `weighed` model.

    In the world frame; the ground is all that is fixed to the world. It is a view,
    which the next step overwrites.
    """
    return data.sensordata.reshape(len(LEGS), 3)


def _apply_body(spec: mujoco.MjSpec, design: BP2Body) -> None:
    """Set the links' masses and the places of hips, knees and toes in a spec; links
    keep their mass at their upper ends."""
    trunk = spec.body("trunk")
    trunk.mass += len(LEGS) * (design.trunk_quarter_mass - bp2.TRUNK_QUARTER_MASS)
    trunk.inertia = np.asarray(trunk.inertia) * design.trunk_inertia_share
    for leg in LEGS:
        for link, share in (
            ("thigh", design.thigh_mass / bp2.THIGH_MASS),
            ("toe", design.toe_mass / bp2.TOE_MASS),
        ):
            body = spec.body(f"{leg}_{link}")
            body.mass = share * body.mass
            body.inertia = share * np.asarray(body.inertia)
    thigh, toe = design.leg_length, design.leg_length - bp2.TOE_LENGTH
    for leg, lateral in zip(LEGS, design.hip_laterals, strict=True):
        spec.body(f"{leg}_abad").pos[1] = lateral
        spec.body(f"{leg}_shank").pos = np.array((0.0, 0.0, -thigh))
        spec.body(f"{leg}_toe").pos = np.array((0.0, 0.0, -toe))
        spec.geom(f"{leg}_solid_thigh").fromto[5] = -thigh
        spec.geom(f"{leg}_solid_toe").fromto[5] = max(
            toe - bp2.RODS_BELOW_KNEE, bp2.LOWER_LEG_RADIUS
        )
    for key in spec.keys:
        qpos = np.array(key.qpos)
        qpos[2] += _leg_drop(qpos, design.leg_length) - _leg_drop(
            qpos, bp2.THIGH_LENGTH
        )
        key.qpos = qpos


def _apply_springs(spec: mujoco.MjSpec, hardware: HardwareSpec) -> None:
    for leg in LEGS:
        joint = spec.joint(f"{leg}_spring")
        joint.stiffness = np.array((hardware.spring_stiffness, 0.0, 0.0))
        joint.damping = np.array((hardware.spring_damping, 0.0, 0.0))
        stop = spec.tendon(f"{leg}_stop")
        stop.stiffness = np.array((hardware.spring_stop_stiffness, 0.0, 0.0))
        stop.springlength = np.array((0.0, hardware.spring_travel))
        if hardware.rebound_stiffness != hardware.spring_stop_stiffness:
            stop.springlength = np.array((-FAR, hardware.spring_travel))
            rebound = spec.add_tendon(
                name=f"{leg}_rebound",
                springlength=(0.0, FAR),
                stiffness=(hardware.rebound_stiffness, 0.0, 0.0),
            )
            rebound.wrap_joint(f"{leg}_spring", 1.0)


def _apply_motors(spec: mujoco.MjSpec, hardware: HardwareSpec) -> None:
    motors = [
        np.broadcast_to(x, NU).tolist()
        for x in (hardware.reflected_inertia, hardware.joint_peak_torque)
    ]
    for name, armature, peak in zip(conventions.MOTOR_NAMES, *motors, strict=True):
        joint = spec.joint(name)
        joint.armature = armature
        joint.solref_limit = np.array((hardware.joint_stop_time, 1.0))
        spec.actuator(name).forcerange = np.array((-peak, peak))


def _apply_contacts(spec: mujoco.MjSpec, hardware: HardwareSpec) -> None:
    for name in FOOT_GEOMS:
        foot = spec.geom(name)
        foot.friction = np.array((hardware.friction, *foot.friction[1:]))
        foot.solref = np.array((hardware.contact_time, hardware.contact_damping))


def _make_legs_solid(spec: mujoco.MjSpec) -> None:
    """Let legs collide with each other and with the trunk in a spec; only the feet
    still meet the floor."""
    bits = {leg: 2 << i for i, leg in enumerate(LEGS)}  # 1 is the floor's
    all_legs = sum(bits.values())
    for leg, bit in bits.items():
        # a rigid leg has no toe
        solid = [f"{leg}_solid_{part}" for part in SOLID_PARTS]
        parts = [spec.geom(name) for name in (f"{leg}_foot", *solid)]
        for geom in filter(None, parts):
            geom.contype, geom.conaffinity = bit, geom.conaffinity | all_legs - bit
    for name in TRUNK_GEOMS:
        spec.geom(name).conaffinity |= all_legs


def _weigh(spec: mujoco.MjSpec) -> None:
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    # net: of all its contacts, in the world frame
    force, net = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3
    for name in FOOT_GEOMS:
        sensor = spec.add_sensor(
            name=f"{name}_force",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            intprm=[force, net, 1],
        )
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_BODY, "world"
        sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_GEOM, name


def _drop_visuals(spec: mujoco.MjSpec) -> None:
    seen_only = [
        geom for geom in list(spec.geoms) if geom.contype == geom.conaffinity == 0
    ]
    for geom in list(spec.geoms):
        geom.material = ""
    pictures = itertools.chain(spec.meshes, spec.materials, spec.textures)
    unseen = itertools.chain(pictures, spec.sensors, spec.lights, spec.cameras)
    for element in (*seen_only, *unseen):
        spec.delete(element)


def _leg_drop(qpos: np.ndarray, leg_length: float) -> float:
    """Height of the hips above the lowest sole, trunk level and abduction zero, m."""
    hip, knee, compression = qpos[8::4], qpos[9::4], qpos[10::4]
    return float(
        np.max(
            leg_length * np.cos(hip) + (leg_length - compression) * np.cos(hip + knee)
        )
    )


@functools.cache
def _packaged() -> mujoco.MjSpec:
    """Return BP2's scene as it ships, read once: to read it takes a hundred times as
    long as to copy it."""
    return mujoco.MjSpec.from_file(str(asset_path("bp2_mjcf/scene_flat.xml")))


@functools.lru_cache(maxsize=8)
def _built(body: Anatomy, spring_stiffness: float) -> mujoco.MjSpec:
    return building.build_spec(body, spring_stiffness=spring_stiffness)
