"""Summary of a robot as text and picture: sizes, joints, motors, and a standing
trial."""

import dataclasses
import math
from typing import cast

import mujoco
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from bp2_rl.base.plotting import FAINT, LEG_COLORS, QUIET, WIDTH, styled
from bp2_rl.robot import bp2
from bp2_rl.robot.actuator import Actuator, joint_torque
from bp2_rl.robot.conventions import GRAVITY, JOINTS, LEGS, MOTOR_NAMES, PHYSICS_STEP
from bp2_rl.robot.coordinates import joint_positions, joint_velocities
from bp2_rl.robot.hardware import AtJoints, HardwareSpec, at_joints
from bp2_rl.robot.model import FOOT_GEOMS, load_model
from bp2_rl.robot.reading import RobotReading
from bp2_rl.robot.robot_file import RobotFile, mirrored, row

STAND_TIME = 5.0
"""Duration of the standing trial, s."""
FALLEN = 0.7
"""A robot has fallen below this share of its standing height, or below this cosine of
the trunk's tilt."""
LIKE = 0.1
"""Relative difference up to which the gains of two position loops count as equal."""
DRAG = 0.2
"""A joint's resistance at the motor's no-load speed above this share of the peak torque
is warned about."""
STRETCH = 0.75
"""A greatest reach of a leg below this share of the straight leg's length is warned
about."""
STROKE = 0.1
"""A difference of greatest and least reach below this share of the straight leg's
length is warned about."""
SAME = 1e-3
"""Relative difference up to which left and right legs count as mirror images."""


@dataclasses.dataclass(frozen=True)
class StandingTrial:
    """Result of a robot's standing trial on its position loop in C MuJoCo."""

    fallen_after: float | None  # s; None: it stands after `STAND_TIME`
    height: float  # m, of the trunk at the end
    torque: Float[np.ndarray, "12"]  # Nm, that the motors hold at the end
    feet_down: int
    touching: tuple[str, ...]  # what but feet touches something, at the end


def stand(robot: RobotFile) -> StandingTrial:
    """Simulate a robot that holds its standing pose under its gains, and return how it
    stood."""
    hardware = robot.hardware
    model = load_model(hardware)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    stiffness, damping = gains(robot)
    motors = Actuator.from_hardware(hardware, stiffness=stiffness, damping=damping)
    target, torque = np.array(robot.anatomy.stand), np.zeros(12)
    begin, fallen = float(data.qpos[2]), None
    for step in range(round(STAND_TIME / PHYSICS_STEP)):
        q, qd = joint_positions(data.qpos), joint_velocities(data.qvel)
        torque = data.ctrl[:] = joint_torque(
            motors, torque, q, qd, target, np.zeros(12), PHYSICS_STEP
        )
        mujoco.mj_step(model, data)
        upright = 1.0 - 2.0 * float(data.qpos[4] ** 2 + data.qpos[5] ** 2)
        if (
            data.qpos[2] < FALLEN * begin
            or upright < FALLEN
            or not np.all(np.isfinite(data.qpos))
        ):
            fallen = (step + 1) * PHYSICS_STEP
            break
    pairs = [
        {model.geom(contact.geom1).name, model.geom(contact.geom2).name}
        for contact in data.contact[: data.ncon]
    ]
    down = {name for pair in pairs if "floor" in pair for name in pair} & {*FOOT_GEOMS}
    touching = {name for pair in pairs for name in pair} - {"floor", *FOOT_GEOMS}
    return StandingTrial(
        fallen_after=fallen,
        height=float(data.qpos[2]),
        torque=np.array(torque),
        feet_down=len(down),
        touching=tuple(sorted(touching)),
    )


def trained_gains(robot: RobotFile) -> tuple[float, float]:
    """Return stiffness (Nm/rad) and damping (Nm s/rad) of the joints' position loop in
    training."""
    size = robot.hardware.size
    stiffness, damping = bp2.LOOP_STIFFNESS, bp2.LOOP_DAMPING
    return size.torque * stiffness, size.torque * size.time * damping


def gains(robot: RobotFile) -> tuple[AtJoints, AtJoints]:
    """Return stiffness (Nm/rad) and damping (Nm s/rad) of the joints' position loop:
    the file's, or else training's."""
    if robot.gains is None:
        return trained_gains(robot)
    return at_joints(robot.gains.stiffness), at_joints(robot.gains.damping)


def sheet(robot: RobotFile, stood: StandingTrial) -> str:
    """Return the summary of a robot as text; lines that begin with "!" are warnings to
    its user."""
    notes = robot.reading.notes if robot.reading else ()
    lines = [
        *_body_lines(robot),
        "",
        *_joint_lines(robot, robot.reading),
        "",
        *_motor_lines(robot),
        "",
        *_stand_lines(robot, stood),
        *_symmetry_lines(robot),
        *(f"! {note}" for note in notes),
        *(f"assumed: {what}" for what in robot.assumed),
    ]
    return "\n".join(lines)


def _body_lines(robot: RobotFile) -> list[str]:
    """Return lines on masses, lengths and springs, with warnings about knees that allow
    little reach."""
    anatomy, top_speed = robot.anatomy, robot.top_speed
    published = "" if top_speed is None else f", published top speed {top_speed:g} m/s"
    sizes = [
        f"{anatomy.name}: {anatomy.weighed_mass:.3g} kg (links {anatomy.mass:.4g} kg, trunk {anatomy.trunk.mass:.4g} kg)"
        f"{published}"
    ]
    doubts: list[str] = []
    for name, leg in (("fore", anatomy.legs[1]), ("hind", anatomy.legs[3])):
        (nearest, farthest), length = leg.reach(), leg.thigh_length + leg.lower_length
        sizes.append(
            f"{name} legs: thigh {leg.thigh_length:.3g} m, lower leg {leg.lower_length:.3g} m with a foot of "
            f"{leg.foot_radius:.3g} m, {leg.lateral:.3g} m beside the abduction axis, knee bent "
            f"{'backwards' if leg.bend < 0 else 'forwards'}, reach {nearest:.3g} to {farthest:.3g} m from the hip"
        )
        if farthest < STRETCH * length or farthest - nearest < STROKE * length:
            doubts.append(
                f"! {name} legs of {length:.3g} m reach from {nearest:.3g} to {farthest:.3g} m: correct the knee's range"
            )
    spring = f"spring: {robot.hardware.spring_stiffness:g} N/m"
    return [*sizes, spring if anatomy.sprung else "rigid shanks", *doubts]


def _joint_lines(robot: RobotFile, reading: RobotReading | None) -> list[str]:
    """Return a table of the joints: name in the model, range and standing angle."""
    lines = [f"{'joint':8} {'in the model':34} {'range, rad':>15} {'stand':>6}"]
    for i, name in enumerate(MOTOR_NAMES):
        in_model = ""
        if reading is not None:
            joint = reading.joints[i]
            in_model = (
                f"{'-' if joint.sign < 0 else '+'}{joint.name} {joint.offset:+.3f}"
            )
        low, high = robot.anatomy.legs[i // 3].ranges[i % 3]
        lines.append(
            f"{name:8} {in_model:34} {f'{low:.2f} to {high:.2f}':>15} {robot.anatomy.stand[i]:6.2f}"
        )
    return lines


def _motor_lines(robot: RobotFile) -> list[str]:
    """Return a table of the motors' numbers, with ASSUMED where the file says so, and a
    warning if a rotor has no inertia."""
    hardware: HardwareSpec = robot.hardware
    lines = [f"{'at the joint':22} {'abad':>8} {'hip':>8} {'knee':>8}"]
    for key, what, by_joint in (
        ("peak_torque", "peak torque, Nm", hardware.joint_peak_torque),
        ("corner_speed", "corner speed, rad/s", hardware.joint_corner_speed),
        ("no_load_speed", "no-load speed, rad/s", hardware.joint_no_load_speed),
        ("armature", "rotor inertia, kg m2", hardware.reflected_inertia),
        ("joint_friction", "friction, Nm", at_joints(hardware.losses.joint_friction)),
        (
            "joint_viscosity",
            "viscosity, Nm s/rad",
            at_joints(hardware.losses.joint_viscosity),
        ),
    ):
        abad, hip, knee = np.broadcast_to(by_joint, 12)[:3]
        assumed = "  ASSUMED" if any(key in entry for entry in robot.assumed) else ""
        lines.append(f"{what:22} {abad:8.4g} {hip:8.4g} {knee:8.4g}{assumed}")
    if np.min(hardware.reflected_inertia) == 0.0:
        lines.append(
            "! a motor has no rotor inertia: give armature in [motors], rotor inertia x gear ratio^2"
        )
    return lines


def _stand_lines(robot: RobotFile, stood: StandingTrial) -> list[str]:
    """Return lines on the standing trial: the position loop, and the motors' loads and
    limits."""
    hardware, losses = robot.hardware, robot.hardware.losses
    peak = np.broadcast_to(hardware.joint_peak_torque, 12)
    share = np.abs(stood.torque) / peak
    worst = int(np.argmax(share))
    stiffness, damping = (np.broadcast_to(x, 12) for x in gains(robot))
    whose = "gains"
    if robot.gains is None:
        whose = "training's own loop, ASSUMED as the file has no [gains]:"
    loop = f"{whose} {row(stiffness[:3])} Nm/rad, {row(damping[:3])} Nm s/rad"
    if stood.fallen_after is None:
        lines = [
            f"stands {STAND_TIME:g} s at {stood.height:.3f} m, {stood.feet_down} feet down ({loop})"
        ]
        if stood.feet_down < len(LEGS):
            lines.append(
                "! not all feet are down: correct [stand], so that fore and hind legs are equally high"
            )
    else:
        lines = [
            f"! it falls after {stood.fallen_after:.2f} s ({loop}): a stiffer loop in [gains], another [stand], or "
            "stronger motors"
        ]
    trained, from_file = trained_gains(robot), (np.mean(stiffness), np.mean(damping))
    if not np.allclose(trained, from_file, rtol=LIKE):
        lines.append(
            f"note: training's loop is one of its own, {trained[0]:.3g} Nm/rad and {trained[1]:.3g} Nm s/rad by the robot's "
            f"size; to train with [gains]: --env.control.stiffness {from_file[0]:.3g} --env.control.damping {from_file[1]:.3g}"
        )
    # models often put the damping of the position loop there
    drag = (
        at_joints(losses.joint_friction)
        + at_joints(losses.joint_viscosity) * hardware.joint_no_load_speed
    )
    if (resistance := float(np.max(drag / peak))) > DRAG:
        lines.append(
            f"! joints resist with up to {resistance:.0%} of the peak torque: correct joint_friction or joint_viscosity"
        )
    lines.append(
        f"static load: at most {share[worst]:.0%} of the peak torque, at {MOTOR_NAMES[worst]}; two legs that carry the "
        f"robot push {_push(robot):.2g} times its weight"
    )
    if stood.touching:
        lines.append(
            f"! it touches with {', '.join(stood.touching)}: correct [stand], or the radii of trunk and legs"
        )
    return lines


def _push(robot: RobotFile) -> float:
    """Return the greatest vertical force of two legs in the standing pose, over the
    robot's weight."""
    anatomy, peak = robot.anatomy, np.broadcast_to(robot.hardware.joint_peak_torque, 12)
    forces: list[float] = []
    for i, leg in enumerate(anatomy.legs):
        _, hip, knee = anatomy.stand[3 * i : 3 * i + 3]
        below_knee = leg.lower_length * math.sin(hip + knee)
        levers = leg.thigh_length * math.sin(hip) + below_knee, below_knee
        for torque, lever in zip(peak[3 * i + 1 : 3 * i + 3], levers, strict=True):
            forces.append(torque / max(abs(lever), 1e-6))
    return 2.0 * min(forces) / (anatomy.weighed_mass * GRAVITY)


def _symmetry_lines(robot: RobotFile) -> list[str]:
    """Return a line on the numbers by which right legs differ from mirrored left
    ones."""
    different: list[str] = []
    for right, left, which in zip(
        robot.anatomy.legs[::2], robot.anatomy.legs[1::2], ("fore", "hind"), strict=True
    ):
        for part, ours in vars(mirrored(left)).items():
            a, b = np.array(_numbers(ours)), np.array(_numbers(getattr(right, part)))
            largest = max(np.abs(a).max(initial=0.0), 1e-9)
            share = np.abs(a - b).max(initial=0.0) / largest
            if share > SAME:
                different.append(f"{which} {part} by {share:.1%}")
    if not different:
        return ["left and right legs are mirror images"]
    return [
        f"! left and right legs differ: {', '.join(different)}; a policy that is mirrored sees them as equal"
    ]


def _numbers(value: object) -> list[float]:
    """Return all numbers in nested dataclasses and tuples, in their order."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = dataclasses.astuple(value)
    if isinstance(value, tuple):
        return [x for inner in cast(tuple[object, ...], value) for x in _numbers(inner)]
    return [float(value)] if isinstance(value, int | float) else []


# --- The picture -----------------------------------------------------------------------


@styled
def draw_robot(hardware: HardwareSpec) -> Figure:
    """Draw the robot in its standing pose from the right and from behind, with a dot at
    each joint and foot; axes in metres."""
    model = load_model(hardware)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    mujoco.mj_forward(model, data)
    figure = Figure(figsize=(WIDTH, 0.5 * WIDTH), layout="constrained")
    views: list[Axes] = list(
        figure.subplots(1, 2, width_ratios=(1.6, 1.0), sharey=True)
    )
    for axes, across, title in zip(
        views, (0, 1), ("from the right, forward is right", "from behind"), strict=True
    ):
        shown = [across, 2]
        half = np.array(hardware.anatomy.trunk_size)[shown]
        corner = data.body("trunk").xpos[shown] - half
        axes.add_patch(
            Rectangle(tuple(corner), *(2.0 * half), facecolor=FAINT, edgecolor=QUIET)
        )
        for leg in reversed(LEGS):
            joints = [data.joint(f"{leg}_{joint}").xanchor for joint in JOINTS]
            points = np.array([*joints, data.geom(f"{leg}_foot").xpos])[:, shown]
            axes.plot(*points.T, "o-", color=LEG_COLORS[leg], label=leg)
        axes.axhline(0.0, color=QUIET)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("m")
        axes.set_title(title)
    views[1].invert_xaxis()  # y is to the left
    figure.legend(
        *views[1].get_legend_handles_labels(), loc="outside lower center", ncols=4
    )
    figure.suptitle(hardware.anatomy.name, x=0.01, ha="left", fontweight="bold")
    return figure
