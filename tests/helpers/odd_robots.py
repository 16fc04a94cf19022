"""Quadrupeds whose MJCF have odd conventions, and how their dynamics compare with those
of the model built of them."""

import importlib.util
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from bp2_rl.robot.anatomy import Anatomy
from bp2_rl.robot.building import build_spec
from bp2_rl.robot.conventions import LEGS, MOTOR_NAMES
from bp2_rl.robot.reading import RobotReading, read_mjcf


def anymal_like() -> str:
    """Return the MJCF of a robot with knee offsets, hind knees bent the other way, axes
    with either sign, welded feet, turned frames, degrees."""
    legs = ""
    for name, x, y, bend in (
        ("LF", 1, 1, 1),
        ("RF", 1, -1, 1),
        ("LH", -1, 1, -1),
        ("RH", -1, -1, -1),
    ):
        flip = -1 if (x, y) in ((1, -1), (-1, 1)) else 1
        legs += f"""
    <body name="{name}_HIP" pos="{0.3 * x} {0.1 * y} 0.02" euler="{20 * y} 0 0">
      <inertial pos="{0.05 * x} {-0.003 * y} 0.01" mass="1.4" fullinertia="0.002 0.003 0.0025 0.0001 0.0002 -0.0003"/>
      <joint name="{name}_HAA" axis="{flip} 0 0" range="-100 90" armature="0.02" damping="0.3" frictionloss="0.1"/>
      <body name="{name}_THIGH" pos="{0.06 * x} {0.08 * y} 0" euler="{-20 * y} {25 * bend} 90">
        <inertial pos="0.01 {0.02 * y} -0.1" mass="1.6" fullinertia="0.02 0.021 0.003 0.001 -0.002 0.0004"/>
        <joint name="{name}_HFE" axis="{flip} 0 0" range="-110 100" ref="12"/>
        <body name="{name}_SHANK" pos="{0.07 * y} {0.04 * bend} -0.28" euler="0 0 -90">
          <joint name="{name}_KFE" axis="0 {-flip} 0"/>
          <inertial pos="0.01 {0.02 * y} -0.1" mass="0.35" fullinertia="0.0048 0.005 0.001 0.0003 -0.0004 0.0002"/>
          <geom type="capsule" size="0.02" fromto="0 0 0 {0.05 * bend} 0 -0.28"/>
          <body name="{name}_FOOT" pos="{0.06 * bend} {0.01 * y} -0.3" euler="10 20 30">
            <inertial pos="0.001 0 0.01" mass="0.14" diaginertia="1e-4 2e-4 1.5e-4"/>
            <geom type="sphere" size="0.03" pos="0 0 0.005" friction="0.7"/>
            <geom type="sphere" size="0.035" contype="0" conaffinity="0" mass="0"/>
          </body>
        </body>
      </body>
    </body>"""
    motors = "".join(
        f'<position joint="{leg}_{joint}" kp="80" kv="2" forcerange="-80 80"/>'
        for leg in ("LF", "RF", "LH", "RH")
        for joint in ("HAA", "HFE", "KFE")
    )
    return f"""
<mujoco model="anymal-like">
  <compiler angle="degree" eulerseq="XYZ"/>
  <asset><mesh name="shell" file="missing.obj"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="base" pos="1 2 0.6" euler="0 0 30">
      <freejoint/>
      <inertial pos="0.01 0.002 0.03" mass="18" fullinertia="0.3 0.8 0.9 0.01 0.02 -0.03"/>
      <geom type="mesh" mesh="shell"/>
      <geom type="box" size="0.28 0.1 0.08" pos="0 0 0.02" mass="0"/>
      <body name="lidar" pos="0.1 0 0.15" euler="0 45 0">
        <inertial pos="0 0 0.02" mass="1.2" diaginertia="0.001 0.002 0.003"/>
      </body>{legs}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>"""


def drawn_crouching() -> str:
    """Return the MJCF of a robot with legs drawn as they stand, hips listed hind first,
    a keyframe, geoms that make the masses, motors with gears."""
    legs = ""
    for name, x, y in (
        ("leg1", -1, 1),
        ("leg2", 1, -1),
        ("leg3", -1, -1),
        ("leg4", 1, 1),
    ):
        legs += f"""
    <body pos="{0.2 * x} {0.06 * y} -0.01">
      <joint name="{name}a" axis="1 0 0" range="-0.8 0.8"/>
      <geom type="cylinder" size="0.04 0.03" euler="0 1.5708 0" density="2000" contype="0" conaffinity="0"/>
      <body pos="0 {0.07 * y} -0.02">
        <joint name="{name}b" axis="0 -1 0" range="-2 2"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 -0.12 0 -0.18" density="1500"/>
        <body pos="-0.12 0 -0.18">
          <joint name="{name}c" axis="0 -1 0" range="-1.4 1.3" pos="0.002 0 0.001"/>
          <geom type="capsule" size="0.015" fromto="0 0 0 0.11 0 -0.17" density="1500"/>
        </body>
      </body>
    </body>"""
    motors = "".join(
        f'<motor joint="leg{leg}{joint}" gear="-6" ctrlrange="-4 4"/>'
        for leg in (1, 2, 3, 4)
        for joint in "abc"
    )
    return f"""
<mujoco model="drawn crouching">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="torso" pos="0 0 0.4">
      <freejoint/>
      <geom type="box" size="0.25 0.08 0.05" mass="6"/>{legs}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
  <keyframe>
    <key name="home" qpos="0 0 0.4 1 0 0 0  0 0.1 0  0 0.1 0  0 0.1 0  0 0.1 0"/>
  </keyframe>
</mujoco>"""


def sprung() -> str:
    """Return the MJCF of a robot with springs whose coordinate grows downwards and is
    not zero at rest, on a turned shank, and boxes for feet."""
    legs = ""
    for name, x, y in (("fr", 1, -1), ("fl", 1, 1), ("rr", -1, -1), ("rl", -1, 1)):
        legs += f"""
    <body pos="{0.2 * x} {0.06 * y} 0">
      <inertial pos="0 0 0" mass="0.5" diaginertia="0.001 0.001 0.001"/>
      <joint name="{name}_x" axis="1 0 0" range="-0.8 0.8"/>
      <body pos="0 {0.07 * y} 0">
        <inertial pos="0 0 -0.05" mass="1" diaginertia="0.005 0.005 0.001"/>
        <joint name="{name}_y" axis="0 1 0" range="-2 2"/>
        <body pos="0 0 -0.2" euler="0 -0.3 0">
          <inertial pos="0.01 0 -0.03" mass="0.1" fullinertia="0.0005 0.0006 0.0001 0 0.0001 0"/>
          <joint name="{name}_k" axis="0 1 0" range="-2 -0.1"/>
          <body pos="0 0 -0.15">
            <inertial pos="0.002 {0.001 * y} -0.02" mass="0.2" diaginertia="0.0001 0.0001 0.0001"/>
            <joint name="{name}_s" type="slide" axis="0 0 -1" springref="0.02" stiffness="4000" damping="8"
              range="-0.06 0.02"/>
            <geom name="{name}_pad" type="box" size="0.02 0.01 0.01" pos="0 0 -0.06"/>
            <site name="{name}_tip" pos="0 0 -0.06"/>
          </body>
        </body>
      </body>
    </body>"""
    return f"""
<mujoco model="sprung">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="torso" pos="0 0 0.4">
      <freejoint/>
      <inertial pos="0 0 0" mass="8" diaginertia="0.1 0.2 0.2"/>{legs}
    </body>
  </worldbody>
</mujoco>"""


PLAIN_JOINTS = tuple(
    f"{leg}_{joint}" for leg in LEGS for joint in ("abad", "hip", "knee")
)
"""The joints of `plain`, in the order of `MOTOR_NAMES`."""


def plain(
    *,
    knee_range: str = "-2.6 -0.3",
    joints: Sequence[str] = ("", "", ""),
    actuator: str = '<motor joint="{joint}" ctrlrange="-30 30"/>',
    foot: str = '<geom name="{leg}_foot" type="sphere" size="0.02" pos="0 0 -0.21" mass="0"/>',
    trunk: str = '<freejoint/><geom type="box" size="0.2 0.09 0.05" mass="6"/>',
    extra: str = "",
) -> str:
    """Return the MJCF of a quadruped of 13.2 kg without any oddity, but for the
    arguments.

    Args:
        knee_range: rad.
        joints: attributes that abad, hip and knee have besides.
        actuator: of every joint; {joint} stands for its name.
        foot: below each knee; {leg} stands for the leg's name and {side} for 1 on the
            left and -1 on the right.
        trunk: the trunk's joint and mass.
        extra: what the model has besides, such as a keyframe.
    """
    legs = ""
    for leg, x, y in zip(LEGS, (1, 1, -1, -1), (-1, 1, -1, 1), strict=True):
        legs += f"""
    <body name="{leg}_hip_link" pos="{0.2 * x} {0.05 * y} 0">
      <inertial pos="0 0 0" mass="0.6" diaginertia="5e-4 7e-4 5e-4"/>
      <joint name="{leg}_abad" axis="1 0 0" range="-0.8 0.8" {joints[0]}/>
      <body name="{leg}_thigh" pos="0 {0.08 * y} 0">
        <inertial pos="0 0 -0.03" mass="1" diaginertia="5e-3 5e-3 1e-3"/>
        <joint name="{leg}_hip" axis="0 1 0" range="-1.5 2.5" {joints[1]}/>
        <body name="{leg}_shank" pos="0 0 -0.21">
          <inertial pos="0 0 -0.1" mass="0.2" diaginertia="1.5e-3 1.5e-3 5e-5"/>
          <joint name="{leg}_knee" axis="0 1 0" range="{knee_range}" {joints[2]}/>
          {foot.format(leg=leg, side=y)}
        </body>
      </body>
    </body>"""
    return f"""
<mujoco model="plain">
  <compiler angle="radian"/>
  <worldbody>
    <geom type="plane" size="5 5 0.1"/>
    <body name="trunk" pos="0 0 0.4">{trunk}{legs}
    </body>
  </worldbody>
  <actuator>{"".join(actuator.format(joint=joint) for joint in PLAIN_JOINTS)}</actuator>
  {extra}
</mujoco>"""


def without_a_base() -> str:
    """Return the MJCF of the robot `plain` with its legs fixed to the world, as MuJoCo
    writes a URDF whose base it has fused."""
    return re.sub('<body name="trunk".*', "", plain()).replace(
        "</body>\n  </worldbody>", "</worldbody>"
    )


def urdf(
    *,
    effort: float = 30,
    velocity: float | str = 20,
    root: str = "",
    rooted: str = "",
    foot: str = "",
) -> str:
    """Return the URDF of the robot `plain`.

    Args:
        effort: Nm, of every joint.
        velocity: rad/s, of every joint.
        root: name of a link to which the base is fixed.
        rooted: what that link has; without, it has no mass.
        foot: in place of the balls, what a link of 0.05 kg in each foot has.
    """

    def link(
        name: str, mass: float, com: str, inertia: str, collision: str = ""
    ) -> str:
        xx, yy, zz = inertia.split()
        moments = f'ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"'
        body = f'<origin xyz="{com}"/><mass value="{mass}"/><inertia {moments}/>'
        return f'<link name="{name}"><inertial>{body}</inertial>{collision}</link>'

    def joint(
        name: str, parent: str, child: str, at: str, axis: str, low: float, high: float
    ) -> str:
        limit = f'<limit lower="{low}" upper="{high}" effort="{effort}" velocity="{velocity}"/>'
        ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/>'
        return f'<joint name="{name}" type="revolute">{ends}<axis xyz="{axis}"/>{limit}</joint>'

    box = '<collision><geometry><box size="0.4 0.18 0.1"/></geometry></collision>'
    ball = '<collision><origin xyz="0 0 -0.21"/><geometry><sphere radius="0.02"/></geometry></collision>'
    moments = " ".join(
        str(6.0 / 3.0 * (a * a + b * b))
        for a, b in ((0.09, 0.05), (0.2, 0.05), (0.2, 0.09))
    )
    parts = [link("trunk", 6, "0 0 0", moments, box)]
    if root:
        fixed = f'<joint name="fixed" type="fixed"><parent link="{root}"/><child link="trunk"/></joint>'
        parts += [f'<link name="{root}">{rooted}</link>', fixed]
    for leg, x, y in zip(LEGS, (1, 1, -1, -1), (-1, 1, -1, 1), strict=True):
        abad, hip, knee = (f"{leg}_{name}" for name in ("abad", "hip", "knee"))
        if foot:
            ends = f'<parent link="{leg}_shank"/><child link="{leg}_foot"/><origin xyz="0 0 -0.21"/>'
            parts += [link(f"{leg}_foot", 0.05, "0 0 0", "1e-5 1e-5 1e-5", foot)]
            parts += [f'<joint name="{leg}_ankle" type="fixed">{ends}</joint>']
        parts += [
            link(f"{leg}_hip_link", 0.6, "0 0 0", "5e-4 7e-4 5e-4"),
            link(f"{leg}_thigh", 1, "0 0 -0.03", "5e-3 5e-3 1e-3"),
            link(
                f"{leg}_shank",
                0.2,
                "0 0 -0.1",
                "1.5e-3 1.5e-3 5e-5",
                "" if foot else ball,
            ),
            joint(
                abad,
                "trunk",
                f"{leg}_hip_link",
                f"{0.2 * x} {0.05 * y} 0",
                "1 0 0",
                -0.8,
                0.8,
            ),
            joint(
                hip,
                f"{leg}_hip_link",
                f"{leg}_thigh",
                f"0 {0.08 * y} 0",
                "0 1 0",
                -1.5,
                2.5,
            ),
            joint(
                knee, f"{leg}_thigh", f"{leg}_shank", "0 0 -0.21", "0 1 0", -2.6, -0.3
            ),
        ]
    return f'<robot name="plain">{"".join(parts)}</robot>'


def disagreement(
    original: mujoco.MjModel, reading: RobotReading, *, seed: int = 0
) -> tuple[float, float, float]:
    """Return how far the model built from a reading is from the original in a random
    state.

    Relative differences of mass matrix and bias force; and the feet's greatest
    distance, m.
    """
    draws = np.random.default_rng(seed)
    built = build_spec(reading.anatomy).compile()
    ours, theirs = mujoco.MjData(built), mujoco.MjData(original)
    free = next(
        i
        for i in range(original.njnt)
        if original.jnt_type[i] == mujoco.mjtJoint.mjJNT_FREE
    )
    at, dof = original.jnt_qposadr[free], original.jnt_dofadr[free]
    ours.qpos[:7] = theirs.qpos[at : at + 7] = draws.normal(size=7)
    ours.qvel[:6] = theirs.qvel[dof : dof + 6] = draws.normal(size=6)
    order, sign = np.arange(built.nv) + dof, np.ones(built.nv)
    built.dof_armature[:] = 0.0
    for name, joint in zip(MOTOR_NAMES, reading.joints, strict=True):
        built.dof_armature[built.joint(name).dofadr] = joint.armature
    pairs = [
        (name, joint.name, joint.sign, joint.offset)
        for name, joint in zip(MOTOR_NAMES, reading.joints, strict=True)
    ]
    for leg, knee in (
        zip(LEGS, reading.joints[2::3], strict=True) if reading.spring else ()
    ):
        body = original.jnt_bodyid[original.joint(knee.name).id]
        slide = next(
            i
            for i in range(original.njnt)
            if original.body_parentid[original.jnt_bodyid[i]] == body
        )
        name, up = (
            original.joint(slide).name,
            -1 if original.jnt_axis[slide][2] < 0.0 else 1,
        )
        pairs.append(
            (
                f"{leg}_spring",
                name,
                up,
                -up * float(original.qpos_spring[original.jnt_qposadr[slide]]),
            )
        )
    for name, their_name, direction, offset in pairs:
        our, their = built.joint(name), original.joint(their_name)
        theirs.qpos[their.qposadr], theirs.qvel[their.dofadr] = angle, speed = (
            draws.normal(size=2)
        )
        ours.qpos[our.qposadr], ours.qvel[our.dofadr] = (
            direction * angle + offset,
            direction * speed,
        )
        order[our.dofadr], sign[our.dofadr] = their.dofadr[0], direction
    inertias: list[np.ndarray] = []
    for model, data in ((built, ours), (original, theirs)):
        mujoco.mj_normalizeQuat(model, data.qpos)
        mujoco.mj_forward(model, data)
        inertia = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        inertias.append(inertia)
    theirs_in_ours = inertias[1][np.ix_(order, order)] * np.outer(sign, sign)
    bias = theirs.qfrc_bias[order] * sign
    apart = [
        np.linalg.norm(ours.geom(f"{leg}_foot").xpos - _foot(theirs, original, name))
        for leg, name in zip(LEGS, reading.contacts, strict=True)
    ]
    return (
        float(
            np.max(np.abs(inertias[0] - theirs_in_ours))
            / np.max(np.abs(theirs_in_ours))
        ),
        float(np.max(np.abs(ours.qfrc_bias - bias)) / np.max(np.abs(bias))),
        float(np.max(apart)),
    )


def _foot(data: mujoco.MjData, model: mujoco.MjModel, name: str) -> np.ndarray:
    """Return where a foot's sphere is: a geom, a site, or of a capsule the lower end,
    the middle if it lies."""
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name) >= 0:
        return data.site(name).xpos
    geom = (
        int(name.removeprefix("geom "))
        if name.startswith("geom ")
        else model.geom(name).id
    )
    w, x, y, z = model.geom_quat[geom]
    lies = abs(w * w - x * x - y * y + z * z) < 0.1  # the vertical part of its axis
    half = (
        0.0
        if lies or model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_CAPSULE
        else model.geom_size[geom, 1]
    )
    return data.geom_xpos[geom] - half * data.geom_xmat[geom].reshape(3, 3)[:, 2]


def playground(path: str) -> Path:
    """Return the path of a robot's model in MuJoCo Playground."""
    spec = importlib.util.find_spec("mujoco_playground")
    assert spec is not None
    return Path((spec.submodule_search_locations or [])[0], "_src/locomotion", path)


def written(folder: Path, text: str) -> Path:
    """Write an MJCF or a URDF, and return its path."""
    path = folder / ("model.urdf" if text.startswith("<robot") else "model.xml")
    path.write_text(text)
    return path


def read(folder: Path, text: str, **named: Any) -> RobotReading:
    """Write an MJCF or a URDF, and read the robot in it."""
    return read_mjcf(written(folder, text), **named)


def leg_numbers(anatomy: Anatomy) -> list[list[float]]:
    """Return the places of each leg's joints and foot, and the joints' ranges."""
    legs = anatomy.legs
    return [
        list(np.concatenate([leg.anchor, leg.hip, leg.knee, leg.foot, *leg.ranges]))
        for leg in legs
    ]


def link_numbers(anatomy: Anatomy) -> list[list[float]]:
    """Return mass, centre of mass and inertia of the trunk and of each leg's links."""
    links = [anatomy.trunk, *(link for leg in anatomy.legs for link in leg.links)]
    return [[link.mass, *link.com, *link.inertia] for link in links]
