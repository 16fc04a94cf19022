"""From an `Anatomy` to an editable MuJoCo model: BP2's scene with another robot in
BP2's place.

Ground, solver, contact settings and materials are those of `assets/bp2_mjcf`, and every
part has the name that the corresponding part of BP2 has there. What a `HardwareSpec`
says of motors, springs and contacts `robot.model` applies.
"""

import functools
import math
from typing import Any

import mujoco
import numpy as np

from bp2_rl.base.assets import asset_path
from bp2_rl.robot import bp2, conventions
from bp2_rl.robot.anatomy import Anatomy, Leg, Link, Vector, possible_moments
from bp2_rl.robot.conventions import GRAVITY, LEGS, MOTOR_NAMES

LENGTH = bp2.THIGH_LENGTH + bp2.SHANK_LENGTH + bp2.SPRING_REST_LENGTH + bp2.TOE_LENGTH
"""m, of BP2's straight leg, for which the cameras and the looks are drawn."""
TUBES = bp2.SHANK_REACH / bp2.THIGH_LENGTH
RODS = bp2.RODS_BELOW_KNEE / bp2.THIGH_LENGTH
"""Where a sprung leg's shank ends and its toe begins, over the length of the lower leg:
as BP2's."""

_Geom = mujoco.mjtGeom
_Sensor = mujoco.mjtSensor


def build_spec(
    anatomy: Anatomy, *, spring_stiffness: float = bp2.SPRING_STIFFNESS
) -> Any:
    """Return the robot on BP2's ground as an `MjSpec`.

    Args:
        anatomy: the robot's body, which names the model.
        spring_stiffness: N/m, with which the springs sag in the keyframe `stand`.
    """
    spec = _ground().copy()
    spec.modelname = anatomy.name
    trunk = spec.worldbody.add_body(name="trunk")
    trunk.add_freejoint(name="root")
    _set_link(trunk, anatomy.trunk)
    _add_trunk(spec, trunk, anatomy)
    for name, leg in zip(LEGS, anatomy.legs, strict=True):
        _add_leg(spec, trunk, name, leg, anatomy)
    _add_motors_and_sensors(spec, anatomy)
    qpos = standing(anatomy, spring_stiffness)
    trunk.pos = qpos[:3]
    spec.add_key(name="stand", qpos=qpos.tolist())
    return spec


def standing(
    anatomy: Anatomy, spring_stiffness: float = bp2.SPRING_STIFFNESS
) -> np.ndarray:
    """Return `qpos` with the trunk level, in the standing pose, the lowest sole on the
    ground and the springs loaded.

    A spring carries its share of what is above it, along the lower leg.
    """
    qpos = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    heights: list[float] = []
    for i, leg in enumerate(anatomy.legs):
        abad, hip, knee = anatomy.stand[3 * i : 3 * i + 3]
        sag = 0.0
        if leg.toe is not None:
            load = GRAVITY * (anatomy.mass / len(LEGS) - leg.toe.mass)
            sag = load * math.cos(abad) * math.cos(hip + knee) / spring_stiffness
        qpos += [abad, hip, knee, *([sag] if anatomy.sprung else [])]
        below_hip = (
            leg.thigh_length * math.cos(hip)
            - (leg.foot[2] + sag) * math.cos(hip + knee)
            - leg.hip[2]
        )
        heights.append(
            leg.foot_radius
            + below_hip * math.cos(abad)
            - leg.lateral * math.sin(abad)
            - leg.anchor[2]
        )
    qpos[2] = max(heights)
    return np.array(qpos)


@functools.cache
def _ground() -> mujoco.MjSpec:
    """Return the scene of BP2 without BP2."""
    spec = mujoco.MjSpec.from_file(str(asset_path("bp2_mjcf/scene_flat.xml")))
    for kind in ("keys", "sensors", "actuators", "tendons"):
        for element in list(getattr(spec, kind)):
            spec.delete(element)
    spec.delete(spec.body("trunk"))
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    return spec


def _set_link(body: Any, link: Link) -> None:
    """Give a body its mass, with the inertia along principal axes, which a uniform
    scale of the mass keeps."""
    body.explicitinertial, body.mass, body.ipos = True, link.mass, link.com
    if not any(link.inertia[3:]):
        body.inertia = possible_moments(link.inertia[:3])
        return
    principal, axes = np.linalg.eigh(link.inertia_matrix)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, axes.flatten())
    body.inertia, body.iquat = possible_moments(principal), quaternion


def _add_trunk(spec: Any, trunk: Any, anatomy: Anatomy) -> None:
    """Two capsules for contacts, a shell for looks, the IMU, two cameras and a
    light."""
    x, y, z = anatomy.trunk_size
    radius, reach, lateral = anatomy.beams
    trunk.add_site(name="imu", size=(0.005, 0.0, 0.0), group=5)
    for side, name in ((-1.0, "trunk_right"), (1.0, "trunk_left")):
        far, beside = max(reach, 1e-3), side * lateral
        _capsule(
            spec, trunk, name, "trunk", radius, (far, beside, 0.0), (-far, beside, 0.0)
        )
    shell = _look(spec, trunk, _Geom.mjGEOM_BOX, "shell", (0.96 * x, 0.9 * y, 0.5 * z))
    shell.pos = (0.0, 0.0, 0.35 * z)
    _look(spec, trunk, _Geom.mjGEOM_BOX, "carbon", (0.9 * x, 0.8 * y, 0.8 * z))
    spine = _look(spec, trunk, _Geom.mjGEOM_CAPSULE, "accent", (0.08 * y, 0.0, 0.0))
    spine.fromto = (0.8 * x, 0.0, 0.85 * z, -0.8 * x, 0.0, 0.85 * z)
    glow = _look(spec, trunk, _Geom.mjGEOM_CAPSULE, "glow", (0.06 * z, 0.0, 0.0))
    glow.fromto = (0.97 * x, 0.5 * y, 0.4 * z, 0.97 * x, -0.5 * y, 0.4 * z)
    scale = max(2.0 * anatomy.leg_length / LENGTH, 0.4)
    follow = mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM
    for name, at, axes in (
        ("track", (0.5, -2.0, 0.35), (0.98, 0.2, 0.0, -0.05, 0.25, 1.0)),
        ("front", (1.6, -1.2, 0.35), (0.6, 0.8, 0.0, -0.24, 0.18, 1.0)),
    ):
        trunk.add_camera(
            name=name, mode=follow, pos=scale * np.array(at), xyaxes=axes, fovy=40.0
        )
    trunk.add_light(
        name="sun",
        mode=follow,
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=(-1.0, -1.5, 3.0),
        dir=(0.3, 0.45, -1.0),
        diffuse=(0.6, 0.6, 0.57),
    )


def _add_leg(spec: Any, trunk: Any, name: str, leg: Leg, anatomy: Anatomy) -> None:
    side = math.copysign(1.0, leg.lateral)
    thick, lower_radius = anatomy.thigh_radius, anatomy.lower_radius
    abad = _add_body(spec, trunk, f"{name}_abad", leg.anchor, leg.abad)
    _add_joint(spec, abad, f"{name}_abad", "abad", leg.ranges[0])
    motor = 0.16 * leg.thigh_length
    _cylinder(
        spec, abad, "metal", motor * 0.8, motor * 0.8, axis=0, at=(leg.hip[0], 0.0, 0.0)
    )
    _cylinder(
        spec,
        abad,
        "carbon",
        motor * 0.65,
        motor * 0.9,
        axis=0,
        at=(leg.hip[0], 0.0, 0.0),
    )

    thigh = _add_body(spec, abad, f"{name}_thigh", leg.hip, leg.thigh)
    _add_joint(spec, thigh, f"{name}_hip", "hip", leg.ranges[1])
    _capsule(
        spec,
        thigh,
        f"{name}_solid_thigh",
        "solid_thigh",
        thick,
        (0.0, leg.knee[1], 0.0),
        leg.knee,
    )
    seen = max(thick, 0.05 * leg.thigh_length)
    _cylinder(
        spec,
        thigh,
        "metal",
        motor,
        1.2 * seen,
        axis=1,
        at=(0.0, leg.knee[1] - 0.5 * side * seen, 0.0),
    )
    _cylinder(
        spec,
        thigh,
        "accent",
        0.8 * motor,
        1.3 * seen,
        axis=1,
        at=(0.0, leg.knee[1], 0.0),
    )
    _cylinder(
        spec,
        thigh,
        "carbon",
        0.65 * motor,
        1.4 * seen,
        axis=1,
        at=(0.0, leg.knee[1], 0.0),
    )
    beam = _look(spec, thigh, _Geom.mjGEOM_CAPSULE, "shell", (seen, 0.0, 0.0))
    beam.fromto = (0.0, leg.knee[1], 0.0, *leg.knee)
    _cylinder(spec, thigh, "metal", 1.2 * seen, 1.05 * seen, axis=1, at=leg.knee)

    shank = _add_body(spec, thigh, f"{name}_shank", leg.knee, leg.shank)
    _add_joint(spec, shank, f"{name}_knee", "knee", leg.ranges[2])
    shin = (0.0, leg.foot[1], 0.0)
    if leg.toe is None:
        _capsule(
            spec,
            shank,
            f"{name}_solid_shank",
            "solid_shank",
            lower_radius,
            shin,
            leg.foot,
        )
        rod = _look(
            spec, shank, _Geom.mjGEOM_CAPSULE, "carbon", (lower_radius, 0.0, 0.0)
        )
        rod.fromto = (*shin, *leg.foot)
        _add_foot(spec, shank, name, leg, leg.foot)
        return
    down = (0.0, leg.foot[1], -TUBES * leg.lower_length)
    _capsule(
        spec, shank, f"{name}_solid_shank", "solid_shank", lower_radius, shin, down
    )
    tube = _look(spec, shank, _Geom.mjGEOM_CAPSULE, "carbon", (lower_radius, 0.0, 0.0))
    tube.fromto = (*shin, *down)
    toe = _add_body(spec, shank, f"{name}_toe", leg.seat, leg.toe)
    toe.add_joint(spec.find_default("spring"), name=f"{name}_spring")
    sole = tuple(np.subtract(leg.foot, leg.seat))
    top = (sole[0], sole[1], -RODS * leg.lower_length - leg.seat[2])
    _capsule(spec, toe, f"{name}_solid_toe", "solid_toe", lower_radius, sole, top)
    coil = _look(
        spec, toe, _Geom.mjGEOM_CAPSULE, "accent", (0.8 * lower_radius, 0.0, 0.0)
    )
    coil.fromto = (*sole, *top)
    _add_foot(spec, toe, name, leg, sole)
    stop = spec.add_tendon(spec.find_default("stop"), name=f"{name}_stop")
    stop.wrap_joint(f"{name}_spring", 1.0)


def _add_body(spec: Any, parent: Any, name: str, at: Vector, link: Link) -> Any:
    body = parent.add_body(name=name, pos=at)
    _set_link(body, link)
    return body


def _add_joint(
    spec: Any, body: Any, name: str, role: str, ends: tuple[float, float]
) -> None:
    body.add_joint(spec.find_default(role), name=name, range=ends)


def _add_foot(spec: Any, body: Any, name: str, leg: Leg, at: Vector) -> None:
    body.add_geom(
        spec.find_default("foot"),
        name=f"{name}_foot",
        size=(leg.foot_radius, 0.0, 0.0),
        pos=at,
    )
    below = np.subtract(at, (0.0, 0.0, leg.foot_radius))
    body.add_site(name=f"{name}_sole", pos=below, size=(0.005, 0.0, 0.0), group=5)


def _capsule(
    spec: Any,
    body: Any,
    name: str,
    style: str,
    radius: float,
    begin: Vector,
    end: Vector,
) -> None:
    """Add a geom for contacts."""
    geom = body.add_geom(spec.find_default(style), name=name, size=(radius, 0.0, 0.0))
    geom.fromto = (*begin, *end)


def _look(spec: Any, body: Any, kind: Any, material: str, size: Vector) -> Any:
    return body.add_geom(
        spec.find_default("visual"), type=kind, material=material, size=size
    )


def _cylinder(
    spec: Any,
    body: Any,
    material: str,
    radius: float,
    half: float,
    *,
    axis: int,
    at: Vector,
) -> None:
    geom = _look(spec, body, _Geom.mjGEOM_CYLINDER, material, (radius, half, 0.0))
    reach = half * np.eye(3)[axis]
    geom.fromto = (*np.subtract(at, reach), *np.add(at, reach))


def _add_motors_and_sensors(spec: Any, anatomy: Anatomy) -> None:
    for name in MOTOR_NAMES:
        motor = spec.add_actuator(
            spec.find_default("bp2"),
            name=name,
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
        )
        motor.set_to_motor()
    site = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": "imu"}
    spec.add_sensor(name="imu_gyro", type=_Sensor.mjSENS_GYRO, **site)
    spec.add_sensor(name="imu_accelerometer", type=_Sensor.mjSENS_ACCELEROMETER, **site)
    spec.add_sensor(name="imu_quat", type=_Sensor.mjSENS_FRAMEQUAT, **site)
    coordinates = (
        (*conventions.JOINTS, "spring") if anatomy.sprung else conventions.JOINTS
    )
    joints = [f"{leg}_{coordinate}" for leg in LEGS for coordinate in coordinates]
    for name in joints:
        spec.add_sensor(
            name=f"{name}_pos",
            type=_Sensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=name,
        )
