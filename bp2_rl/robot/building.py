"""From an `Anatomy` to an editable MuJoCo model: BP2's scene with another robot in
BP2's place.

Ground, solver, contact settings and materials are those of `assets/bp2_mjcf`, and every
part has the name that the corresponding part of BP2 has there. What a `HardwareSpec`
says of motors, springs and contacts `robot.model` applies.
"""

import functools
import itertools
import math
from collections.abc import Sequence

import mujoco
import numpy as np

from bp2_rl.base.assets import asset_path
from bp2_rl.robot import bp2
from bp2_rl.robot.anatomy import Anatomy, Leg, Link, Vector, possible_moments
from bp2_rl.robot.conventions import GRAVITY, JOINTS, LEGS, MOTOR_NAMES

LENGTH = bp2.THIGH_LENGTH + bp2.SHANK_LENGTH + bp2.SPRING_REST_LENGTH + bp2.TOE_LENGTH
"""m, of BP2's straight leg, for which the cameras and the looks are drawn."""
TUBES = bp2.SHANK_REACH / bp2.THIGH_LENGTH
RODS = bp2.RODS_BELOW_KNEE / bp2.THIGH_LENGTH
"""Where a sprung leg's shank ends and its toe begins, over the length of the lower leg:
as BP2's."""

_Geom = mujoco.mjtGeom
_Sensor = mujoco.mjtSensor
Body = mujoco.MjsBody


def build_spec(
    anatomy: Anatomy, *, spring_stiffness: float = bp2.SPRING_STIFFNESS
) -> mujoco.MjSpec:
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


def _set_link(body: Body, link: Link) -> None:
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


def _add_trunk(spec: mujoco.MjSpec, trunk: Body, anatomy: Anatomy) -> None:
    """Add two capsules for contacts, a shell for looks, the IMU, two cameras and a
    light to the trunk."""
    x, y, z = anatomy.trunk_size
    radius, reach, lateral = anatomy.beams
    trunk.add_site(name="imu", size=(0.005, 0.0, 0.0), group=5)
    far = max(reach, 1e-3)
    for name, beside in (("trunk_right", -lateral), ("trunk_left", lateral)):
        ends = (far, beside, 0.0), (-far, beside, 0.0)
        _add_capsule(spec, trunk, name, "trunk", radius, *ends)
    for material, half, up in (
        ("shell", (0.96 * x, 0.9 * y, 0.5 * z), 0.35 * z),
        ("carbon", (0.9 * x, 0.8 * y, 0.8 * z), 0.0),
    ):
        _add_look(spec, trunk, _Geom.mjGEOM_BOX, material, half, pos=(0.0, 0.0, up))
    spine = (0.8 * x, 0.0, 0.85 * z), (-0.8 * x, 0.0, 0.85 * z)
    glow = (0.97 * x, 0.5 * y, 0.4 * z), (0.97 * x, -0.5 * y, 0.4 * z)
    _add_rod(spec, trunk, "accent", 0.08 * y, *spine)
    _add_rod(spec, trunk, "glow", 0.06 * z, *glow)
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


def _add_leg(
    spec: mujoco.MjSpec, trunk: Body, name: str, leg: Leg, anatomy: Anatomy
) -> None:
    """Add a leg's links with their joints, capsules for contacts, and looks."""
    abad = _add_link(spec, trunk, f"{name}_abad", leg.anchor, leg.abad)
    thigh = _add_link(spec, abad, f"{name}_thigh", leg.hip, leg.thigh)
    shank = _add_link(spec, thigh, f"{name}_shank", leg.knee, leg.shank)
    for body, joint, ends in zip((abad, thigh, shank), JOINTS, leg.ranges, strict=True):
        body.add_joint(spec.find_default(joint), name=f"{name}_{joint}", range=ends)

    top, motor = (0.0, leg.knee[1], 0.0), 0.16 * leg.thigh_length
    thick, lower_radius = anatomy.thigh_radius, anatomy.lower_radius
    seen = max(thick, 0.05 * leg.thigh_length)
    beside = (0.0, leg.knee[1] - 0.5 * math.copysign(1.0, leg.lateral) * seen, 0.0)
    for axis, material, radius, half, at in (
        (0, "metal", 0.8 * motor, 0.8 * motor, (leg.hip[0], 0.0, 0.0)),
        (0, "carbon", 0.65 * motor, 0.9 * motor, (leg.hip[0], 0.0, 0.0)),
    ):
        _add_cylinder(spec, abad, material, radius, half, axis, at)
    ends = top, leg.knee
    _add_capsule(spec, thigh, f"{name}_solid_thigh", "solid_thigh", thick, *ends)
    for material, radius, half, at in (
        ("metal", motor, 1.2 * seen, beside),
        ("accent", 0.8 * motor, 1.3 * seen, top),
        ("carbon", 0.65 * motor, 1.4 * seen, top),
    ):
        _add_cylinder(spec, thigh, material, radius, half, 1, at)
    _add_rod(spec, thigh, "shell", seen, *ends)
    _add_cylinder(spec, thigh, "metal", 1.2 * seen, 1.05 * seen, 1, leg.knee)

    shin, foot = (0.0, leg.foot[1], 0.0), leg.foot
    end = foot if leg.toe is None else (*shin[:2], -TUBES * leg.lower_length)
    ends, last = (shin, end), shank
    _add_capsule(spec, shank, f"{name}_solid_shank", "solid_shank", lower_radius, *ends)
    _add_rod(spec, shank, "carbon", lower_radius, *ends)
    if leg.toe is not None:
        last = _add_link(spec, shank, f"{name}_toe", leg.seat, leg.toe)
        last.add_joint(spec.find_default("spring"), name=f"{name}_spring")
        foot = tuple(np.subtract(leg.foot, leg.seat).tolist())
        ends = foot, (*foot[:2], -RODS * leg.lower_length - leg.seat[2])
        _add_capsule(spec, last, f"{name}_solid_toe", "solid_toe", lower_radius, *ends)
        _add_rod(spec, last, "accent", 0.8 * lower_radius, *ends)
        stop = spec.add_tendon(spec.find_default("stop"), name=f"{name}_stop")
        stop.wrap_joint(f"{name}_spring", 1.0)
    last.add_geom(
        spec.find_default("foot"),
        name=f"{name}_foot",
        size=(leg.foot_radius, 0.0, 0.0),
        pos=foot,
    )
    below = np.subtract(foot, (0.0, 0.0, leg.foot_radius))
    last.add_site(name=f"{name}_sole", pos=below, size=(0.005, 0.0, 0.0), group=5)


def _add_link(
    spec: mujoco.MjSpec, parent: Body, name: str, at: Vector, link: Link
) -> Body:
    body = parent.add_body(name=name, pos=at)
    _set_link(body, link)
    return body


def _add_capsule(
    spec: mujoco.MjSpec,
    body: Body,
    name: str,
    style: str,
    radius: float,
    begin: Vector,
    end: Vector,
) -> None:
    """Add a geom for contacts."""
    body.add_geom(
        spec.find_default(style),
        name=name,
        size=(radius, 0.0, 0.0),
        fromto=(*begin, *end),
    )


def _add_look(
    spec: mujoco.MjSpec,
    body: Body,
    kind: mujoco.mjtGeom,
    material: str,
    size: Vector,
    **place: Sequence[float],
) -> None:
    """Add a geom that is seen and touches nothing."""
    style = spec.find_default("visual")
    body.add_geom(style, type=kind, material=material, size=size, **place)


def _add_rod(
    spec: mujoco.MjSpec,
    body: Body,
    material: str,
    radius: float,
    begin: Vector,
    end: Vector,
) -> None:
    size, ends = (radius, 0.0, 0.0), (*begin, *end)
    _add_look(spec, body, _Geom.mjGEOM_CAPSULE, material, size, fromto=ends)


def _add_cylinder(
    spec: mujoco.MjSpec,
    body: Body,
    material: str,
    radius: float,
    half: float,
    axis: int,
    at: Vector,
) -> None:
    size, reach = (radius, half, 0.0), half * np.eye(3)[axis]
    ends = (*np.subtract(at, reach), *np.add(at, reach))
    _add_look(spec, body, _Geom.mjGEOM_CYLINDER, material, size, fromto=ends)


def _add_motors_and_sensors(spec: mujoco.MjSpec, anatomy: Anatomy) -> None:
    joint = mujoco.mjtTrn.mjTRN_JOINT
    for name in MOTOR_NAMES:
        spec.add_actuator(
            spec.find_default("bp2"), name=name, target=name, trntype=joint
        ).set_to_motor()
    imu = {"objtype": mujoco.mjtObj.mjOBJ_SITE, "objname": "imu"}
    for name, kind in (
        ("imu_gyro", _Sensor.mjSENS_GYRO),
        ("imu_accelerometer", _Sensor.mjSENS_ACCELEROMETER),
        ("imu_quat", _Sensor.mjSENS_FRAMEQUAT),
    ):
        spec.add_sensor(name=name, type=kind, **imu)
    for leg, joint in itertools.product(LEGS, (*JOINTS, *["spring"] * anatomy.sprung)):
        spec.add_sensor(
            name=f"{leg}_{joint}_pos",
            type=_Sensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=f"{leg}_{joint}",
        )
