"""What a robot file makes of a robot, on one sheet: sizes, joints, motors against the
load of standing, and a stand."""

import dataclasses
import itertools
import math
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from bp2_rl.robot.actuator import GAINS, Actuator, joint_torque
from bp2_rl.robot.conventions import GRAVITY, LEGS, MOTOR_NAMES, PHYSICS_STEP
from bp2_rl.robot.coordinates import joint_positions, joint_velocities
from bp2_rl.robot.hardware import HardwareSpec, at_joints
from bp2_rl.robot.model import foot_geom_ids, load_model
from bp2_rl.robot.reading import RobotReading
from bp2_rl.robot.robot_file import RobotFile, mirrored, row

STAND_TIME = 5.0
"""s, for which a robot must stand."""
FALLEN = 0.7
"""Share of the standing height below which it has fallen; and cosine of the trunk's
tilt."""
LIKE = 0.1
"""Relative difference up to which two loops count as one."""
DRAG = 0.2
"""Share of the peak torque above which a joint's resistance at the motor's no-load
speed is doubted."""
STRETCH = 0.75
"""Share of the straight leg's length below which the greatest reach is doubted."""
STROKE = 0.1
"""Share of the straight leg's length below which the difference of greatest and least
reach is doubted."""
SAME = 1e-3
"""Relative difference up to which left and right legs are mirror images."""


@dataclasses.dataclass(frozen=True)
class StandingTrial:
    """How a robot stands on its position loop in C MuJoCo."""

    fallen_after: float | None  # s; None: it stands after `STAND_TIME`
    height: float  # m, of the trunk at the end
    torque: Float[np.ndarray, "12"]  # Nm, that the motors hold at the end
    feet_down: int
    touching: tuple[str, ...]  # what but feet touches something, at the end


def stand(robot: RobotFile) -> StandingTrial:
    """Let a robot stand at its standing pose under its gains."""
    hardware = robot.hardware
    model = load_model(hardware)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    target, torque, begin = (
        np.array(robot.anatomy.stand),
        np.zeros(12),
        float(data.qpos[2]),
    )
    motors, fallen = _motors(robot), None
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
    feet = set(foot_geom_ids(model).tolist())
    pairs = [
        (int(contact.geom1), int(contact.geom2))
        for contact in data.contact[: data.ncon]
    ]
    down = {
        geom
        for pair in pairs
        for geom in pair
        if geom in feet and model.geom("floor").id in pair
    }
    others = {model.geom(geom).name for geom in itertools.chain(*pairs)} - {"floor"}
    return StandingTrial(
        fallen_after=fallen,
        height=float(data.qpos[2]),
        torque=np.array(torque),
        feet_down=len(down),
        touching=tuple(sorted(others - {f"{leg}_foot" for leg in LEGS})),
    )


def trained_gains(robot: RobotFile) -> tuple[float, float]:
    """Return stiffness (Nm/rad) and damping (Nm s/rad) of the position loop in
    training."""
    size = robot.hardware.size
    return size.torque * GAINS[0], size.torque * size.time * GAINS[1]


def gains(robot: RobotFile) -> tuple[Any, Any]:
    """Return stiffness and damping of the position loop, each a number or one for each
    motor: those of training where the file gives none."""
    otherwise = trained_gains(robot)

    def of_motors(given: Any, default: float) -> Any:
        return (
            np.tile(given, len(LEGS))
            if isinstance(given, tuple)
            else default
            if given is None
            else given
        )

    return of_motors(robot.stiffness, otherwise[0]), of_motors(
        robot.damping, otherwise[1]
    )


def _motors(robot: RobotFile) -> Actuator:
    stiffness, damping = gains(robot)
    return Actuator.from_hardware(robot.hardware, stiffness=stiffness, damping=damping)


def sheet(robot: RobotFile, stood: StandingTrial) -> str:
    """Return the sheet as text; lines that begin with "!" are what its user must look
    at."""
    anatomy, hardware = robot.anatomy, robot.hardware
    fore, hind = anatomy.legs[1], anatomy.legs[3]
    published = (
        ""
        if robot.top_speed is None
        else f", published top speed {robot.top_speed:g} m/s"
    )
    lines = [
        f"{robot.name}: {anatomy.weighed_mass:.3g} kg (links {anatomy.mass:.4g} kg, trunk {anatomy.trunk.mass:.4g} kg)"
        f"{published}",
        *(
            f"{name} legs: thigh {leg.thigh_length:.3g} m, lower leg {leg.lower_length:.3g} m with a foot of "
            f"{leg.foot_radius:.3g} m, {leg.lateral:.3g} m beside the abduction axis, knee bent "
            f"{'backwards' if leg.bend < 0 else 'forwards'}, reach "
            f"{' to '.join(f'{end:.3g}' for end in leg.reach())} m from the hip"
            for name, leg in (("fore", fore), ("hind", hind))
        ),
        f"spring: {hardware.spring_stiffness:g} N/m"
        if anatomy.sprung
        else "rigid shanks",
        *_reach_doubts(robot),
        "",
        *_joint_lines(robot, robot.reading),
        "",
        *_motor_lines(robot),
        "",
        *_stand_lines(robot, stood),
        *_symmetry(robot),
        *(
            []
            if robot.reading is None
            else [f"! {note}" for note in robot.reading.notes]
        ),
        *(f"assumed: {what}" for what in robot.assumed),
    ]
    return "\n".join(lines)


def _reach_doubts(robot: RobotFile) -> list[str]:
    """Doubt knees whose range keeps a leg bent, or of one length."""
    doubts: list[str] = []
    for name, leg in zip(("fore", "hind"), robot.anatomy.legs[1::2], strict=True):
        (nearest, farthest), length = leg.reach(), leg.thigh_length + leg.lower_length
        if farthest < STRETCH * length or farthest - nearest < STROKE * length:
            doubts.append(
                f"! {name} legs of {length:.3g} m reach from {nearest:.3g} to {farthest:.3g} m: mend the knee's range"
            )
    return doubts


def _joint_lines(robot: RobotFile, reading: RobotReading | None) -> list[str]:
    """One line a joint: what it is called in the model, and its range and stand."""
    lines = [f"{'joint':8} {'in the model':34} {'range, rad':>15} {'stand':>6}"]
    for i, name in enumerate(MOTOR_NAMES):
        theirs = ""
        if reading is not None:
            joint = reading.joints[i]
            theirs = f"{'-' if joint.sign < 0 else '+'}{joint.name} {joint.offset:+.3f}"
        low, high = robot.anatomy.legs[i // 3].ranges[i % 3]
        lines.append(
            f"{name:8} {theirs:34} {f'{low:.2f} to {high:.2f}':>15} {robot.anatomy.stand[i]:6.2f}"
        )
    return lines


def _motor_lines(robot: RobotFile) -> list[str]:
    """One line a number of the motors, with ASSUMED beside what the file lists as
    assumed, and a doubt."""
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
            "! no motor's rotor has an inertia of 0: give armature in [motors], rotor x gear ratio^2"
        )
    return lines


def _stand_lines(robot: RobotFile, stood: StandingTrial) -> list[str]:
    hardware = robot.hardware
    peak = np.broadcast_to(hardware.joint_peak_torque, 12)
    share = np.abs(stood.torque) / peak
    worst = int(np.argmax(share))
    stiffness, damping = (np.broadcast_to(x, 12)[:3] for x in gains(robot))
    whose = (
        "gains"
        if robot.stiffness is not None
        else "training's own loop, ASSUMED as the file has no [gains]:"
    )
    loop = f"{whose} {row(stiffness)} Nm/rad, {row(damping)} Nm s/rad"
    if stood.fallen_after is not None:
        lines = [
            f"! it falls after {stood.fallen_after:.2f} s ({loop}): a stiffer loop in [gains], another [stand], or "
            "stronger motors"
        ]
    else:
        lines = [
            f"stands {STAND_TIME:g} s at {stood.height:.3f} m, {stood.feet_down} feet down ({loop})"
        ]
        if stood.feet_down < len(LEGS):
            lines.append(
                "! not all feet are down: mend [stand], so that fore and hind legs are equally high"
            )
    lines += _note_of_gains(robot)
    lines += _resistance(robot)
    lines.append(
        f"static load: at most {share[worst]:.0%} of the peak torque, at {MOTOR_NAMES[worst]}; two legs that carry the "
        f"robot push {_push(robot):.2g} times its weight"
    )
    if stood.touching:
        lines.append(
            f"! it touches with {', '.join(stood.touching)}: mend [stand], or the radii of trunk and legs"
        )
    return lines


def _note_of_gains(robot: RobotFile) -> list[str]:
    """Say where training's position loop is another one than the file's, and how to
    train with the file's."""
    ours, theirs = trained_gains(robot), [float(np.mean(x)) for x in gains(robot)]
    if np.allclose(ours, theirs, rtol=LIKE):
        return []
    flags = (
        f"--env.control.stiffness {theirs[0]:.3g} --env.control.damping {theirs[1]:.3g}"
    )
    return [
        f"note: training's loop is one of its own, {ours[0]:.3g} Nm/rad and {ours[1]:.3g} Nm s/rad by the robot's "
        f"size; to train with [gains]: {flags}"
    ]


def _resistance(robot: RobotFile) -> list[str]:
    """Doubt joints that take much of what their motors give, as those of models do that
    damp for the loop's sake."""
    hardware, losses = robot.hardware, robot.hardware.losses
    drag = (
        at_joints(losses.joint_friction)
        + at_joints(losses.joint_viscosity) * hardware.joint_no_load_speed
    )
    share = float(np.max(drag / np.asarray(hardware.joint_peak_torque)))
    if share <= DRAG:
        return []
    return [
        f"! joints resist with up to {share:.0%} of the peak torque: mend joint_friction or joint_viscosity in [losses]"
    ]


def _push(robot: RobotFile) -> float:
    """Return two legs' vertical force in the standing pose at the knee's or hip's peak
    torque, over the weight."""
    anatomy, peak = robot.anatomy, np.broadcast_to(robot.hardware.joint_peak_torque, 12)
    forces: list[float] = []
    for i, leg in enumerate(anatomy.legs):
        hip, knee = anatomy.stand[3 * i + 1], anatomy.stand[3 * i + 2]
        levers = (
            abs(
                leg.thigh_length * math.sin(hip)
                + leg.lower_length * math.sin(hip + knee)
            ),
            abs(leg.lower_length * math.sin(hip + knee)),
        )
        forces.append(
            min(
                peak[3 * i + 1 + j] / max(lever, 1e-6) for j, lever in enumerate(levers)
            )
        )
    return 2.0 * min(forces) / (anatomy.weighed_mass * GRAVITY)


def _symmetry(robot: RobotFile) -> list[str]:
    """Say which numbers of the right legs are not those of the left ones mirrored."""
    different: list[str] = []
    for right, left, which in zip(
        robot.anatomy.legs[::2], robot.anatomy.legs[1::2], ("fore", "hind"), strict=True
    ):
        ours, theirs = dataclasses.asdict(mirrored(left)), dataclasses.asdict(right)
        for part, value in ours.items():
            a, b = np.array(_numbers(value)), np.array(_numbers(theirs[part]))
            share = np.abs(a - b).max(initial=0.0) / max(
                np.abs(a).max(initial=0.0), 1e-9
            )
            if share > SAME:
                different.append(f"{which} {part} by {share:.1%}")
    if not different:
        return ["left and right legs are mirror images"]
    return [
        f"! left and right legs differ: {', '.join(different)}; a policy that is mirrored sees them as equal"
    ]


def _numbers(value: Any) -> list[float]:
    if isinstance(value, dict):
        return [x for inner in value.values() for x in _numbers(inner)]
    if isinstance(value, list | tuple):
        return [x for inner in value for x in _numbers(inner)]
    return [] if value is None else [float(value)]
