"""Write a policy as a bundle for a robot's computer: network, reference motion,
settings and controller code.

manifest.json      the SHA-256 of every file that follows
policy.onnx        the network: obs (1, n) -> actions (1, 12)
reference.npz      the reference motion as plain arrays
deploy.json        observation layout, units, joint order, gains, limits, rates
onboard/           the controller, with the laws that it shares with bp2_rl: NumPy and onnxruntime alone
robots/NAME.xml    robots to rehearse on, in C MuJoCo
cpp/               the controller in C++ with its numbers in one file, and an example
requirements.txt   what to install, with versions that were tried together
"""

import contextlib
import dataclasses
import importlib.metadata
import json
import math
import re
from collections.abc import Collection, Generator
from pathlib import Path

import numpy as np

from bp2_rl.base import arrays, bounds, errors, files
from bp2_rl.base.errors import UserError
from bp2_rl.base.files import require_name, write_bytes, write_npz, write_text
from bp2_rl.base.folders import new_folder
from bp2_rl.deploy import onboard
from bp2_rl.deploy.network import to_onnx, to_records
from bp2_rl.deploy.onboard.binary import BINARY, pack
from bp2_rl.deploy.onboard.contents import (
    CODE,
    CPP,
    FORMAT,
    NEEDS,
    NETWORK,
    REFERENCE,
    ROBOT_FOLDER,
    SETTINGS,
    Settings,
    WatchdogLimits,
    seal,
)
from bp2_rl.deploy.onboard.robot import RehearsalPlan
from bp2_rl.deploy.reference import Playback, playback
from bp2_rl.env.controller import motors_of
from bp2_rl.evaluation.benchmarks.conditions import cruising_speed
from bp2_rl.learning.policy import Policy
from bp2_rl.reference import stepping, trot_law
from bp2_rl.robot import (
    actuator,
    anatomy,
    bp2,
    bp2_body,
    conventions,
    coordinates,
    hardware,
    height,
    losses,
    observation,
    operator,
)
from bp2_rl.robot.hardware import ROBOTS, HardwareSpec, robot_name
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import model_xml
from bp2_rl.robot.observation import OBSERVATION_TERMS
from bp2_rl.robot.operator import (
    COMMAND_ACCELERATION,
    COMMAND_LIMITS,
    HEADING_HOLD,
)
from bp2_rl.settings.env import EnvConfig
from bp2_rl.settings.task import TaskSources, onboard_source
from bp2_rl.simulation.simulator import RobotSetup, settled
from bp2_rl.simulation.world import LEVEL, World

MOTORS = (
    "peak_torque",
    "corner_speed",
    "no_load_speed",
    "braking_speed",
    "current_lag",
    "torque_rate",
)
OF_POLICY = ("stage", "created", "weights_sha256", "library_sha256", "config_hash")
OF_CONTROL = ("action_scale", "action_limit", "feedforward", "clock_at_rest")
UNITS = "SI: m, s, rad, Nm; x forward, y left, z up; angular_velocity and up in the body frame"
PACKAGES = ("numpy", "onnxruntime", "mujoco")  # mujoco for the rehearsal alone
LAWS = [
    str(module.__file__)
    for module in (
        *(arrays, bounds, errors, files),
        *(
            actuator,
            anatomy,
            bp2,
            bp2_body,
            conventions,
            coordinates,
            hardware,
            height,
            losses,
            observation,
            operator,
            stepping,
            trot_law,
        ),
    )
]
"""Modules of bp2_rl that the onboard code imports; a bundle holds copies of them."""
FROM_PACKAGE = re.compile(
    r"^from bp2_rl\.(?:base|reference|robot)(?: (?=import)|\.)", re.MULTILINE
)
"""Start of the import lines that a bundle's copies replace with relative imports."""


def write_bundle(directory: Path, policy: Policy, world: World = LEVEL) -> None:
    """Write the policy's bundle to `directory`, in the place of an older bundle; a
    failed write leaves nothing partial. Its rehearsal is on the ground of `world`.

    Raises:
        UserError: the controller cannot run this policy, a package is missing, or the
            place cannot be written.
    """
    require_name(directory)
    network = to_onnx(policy)
    settings, arrays = describe_policy(policy, world)
    with replaced(directory, "bundle", SETTINGS) as fresh:
        write_bytes(fresh / NETWORK, network)
        write_npz(fresh / REFERENCE, arrays)
        write_text(
            fresh / SETTINGS, json.dumps(settings, indent=1, allow_nan=False) + "\n"
        )
        write_text(
            fresh / NEEDS,
            "".join(
                f"{name}=={importlib.metadata.version(name)}\n" for name in PACKAGES
            ),
        )
        for folder in (CODE, ROBOT_FOLDER, CPP):
            (fresh / folder).mkdir()
        for module in (
            *sorted(Path(onboard.__file__).parent.glob("*.py")),
            *map(Path, LAWS),
        ):
            write_text(
                fresh / CODE / module.name,
                FROM_PACKAGE.sub("from .", module.read_text()),
            )
        if isinstance(code := policy.card.env.task.code, TaskSources):
            own = onboard_source(code, policy.card.env.task.task)
            write_text(fresh / CODE / "task.py", FROM_PACKAGE.sub("from .", own))
        for source in sorted((Path(__file__).parent / CPP).iterdir()):
            write_text(fresh / CPP / source.name, source.read_text())
        write_bytes(fresh / BINARY, pack(settings, arrays, to_records(policy)))
        for name, hardware in robots_of(policy.card.env).items():
            write_text(
                fresh / ROBOT_FOLDER / f"{name}.xml", model_xml(hardware, world.lay)
            )
        seal(fresh)


@contextlib.contextmanager
def replaced(directory: Path, kind: str, mark: str) -> Generator[Path]:
    """Context manager that yields a new folder, which replaces `directory` when the
    block ends, whole or not at all.

    Args:
        directory: a folder that is not there, is empty, or holds the file `mark`.
        kind: what the folder is called in errors.
        mark: the file by which a folder of this kind is known.

    Raises:
        UserError: the folder is of another kind, or cannot be written.
    """
    try:
        place = Path(directory).resolve()
        if place.exists() and not (place / mark).is_file() and any(place.iterdir()):
            raise FileExistsError(
                0, f"the folder holds files that are no {kind}'s; choose another"
            )
        with new_folder(place) as fresh:
            yield fresh
    except OSError as error:
        raise UserError(
            f"cannot write {kind} {directory}: {error.strerror or error}"
        ) from error


def describe_policy(policy: Policy, world: World = LEVEL) -> Playback:
    """Return the content of a bundle's deploy.json and the arrays of its reference.npz
    for a policy, to be rehearsed on the ground of `world`.

    Raises:
        UserError: the controller of a bundle cannot run this policy.
    """
    card, env = policy.card, policy.card.env
    known = [term.name for term in OBSERVATION_TERMS]
    if isinstance(env.task.code, TaskSources):
        known += dict(env.task.observations)
    require_terms(
        policy,
        known,
        "the controller of a bundle does not make: it knows "
        f"{', '.join(known)}; a task's observations come with --task FILE",
    )
    reference, arrays = playback(env)
    control, commands = env.control, env.commands
    sideways = commands.max_lateral, commands.max_yaw_rate
    speed = cruising_speed(policy)
    # s, until 5 m before the ground ends
    room = (world.end - 5.0) / speed - 0.5 * speed / COMMAND_ACCELERATION
    settings = {
        "format": FORMAT,
        "policy": {
            **{name: getattr(card, name) for name in OF_POLICY},
            "bp2_rl": card.versions.get("bp2_rl", "unknown"),
        },
        "units": UNITS,
        # Hz
        "rates": {
            "policy": conventions.POLICY_RATE,
            "drives": conventions.FORCE_LOOP_RATE,
        },
        "joints": list(conventions.MOTOR_NAMES),
        "model_joints": [
            dataclasses.asdict(joint) for joint in env.hardware.anatomy.joints
        ],
        "joint_range": [
            list(ends) for leg in env.hardware.anatomy.legs for ends in leg.ranges
        ],
        "observation": [list(entry) for entry in card.observation_layout],
        "control": {
            "mode": control.mode,
            **_limits(
                {
                    name: getattr(control, name)
                    for name in (*OF_CONTROL, *COMMAND_LIMITS)
                }
            ),
            "stand": list(env.hardware.anatomy.stand),
        },
        "gains": {"stiffness": control.stiffness, "damping": control.damping},
        "command": {
            "least": [-commands.max_backward, *(-most for most in sideways)],
            "most": [commands.max_forward, *sideways],
        },
        "watchdog": dataclasses.asdict(watchdog_limits(env)),
        # m/s, s
        "rehearsal": {"speed": speed, "hold": min(RehearsalPlan.hold, room)},
        "ground": str(world.terrain),
        "reference": reference,
        "operator": dataclasses.asdict(HEADING_HOLD),
        "fall": {"height": env.termination.min_height, "up": env.termination.min_up},
        "robots": _describe_robots(env, world),
    }
    return settings, arrays


def require_terms(policy: Policy, known: Collection[str], remedy: str) -> None:
    """Raise UserError if the policy sees other observation terms than these; the
    message ends in `remedy`."""
    seen = [name.partition("@")[0] for name, _ in policy.card.observation_layout]
    if unknown := sorted({*seen}.difference(known)):
        raise UserError(f"the policy sees {', '.join(unknown)}, which {remedy}")


def watchdog_limits(env: EnvConfig) -> WatchdogLimits:
    """Return the watchdog's limits for an environment's robot; docs/deploy.md compares
    each with normal running."""
    robot, control = env.hardware, env.control
    size = robot.size
    fastest = float(np.max(robot.joint_no_load_speed)) / bp2.NO_LOAD_SPEED
    return WatchdogLimits(
        silence=0.05,
        ahead=0.005,  # a tick: stamp and `now` may be read in either order
        rate=2.0,
        # longer, and a robot at a walk is on its side before its feet are under it
        stand_time=size.time * 0.1,
        braking=1.0,  # what policies brake at on bad ground
        joint_margin=0.3,  # joints bounce off their stops by .1
        joint_speed=fastest * 100.0,  # five times what the motors can do
        # What an action can swing from one tick to the next, and what the reference
        # motion may add to it.
        target_step=2.0 * control.action_scale * control.action_limit
        + fastest * 100.0 * conventions.CONTROL_STEP,
        turning=size.rate * 50.0,
        up_length=0.2,
        # training ends an episode at 37 deg: no policy knows what is beyond
        tilt=math.radians(60.0),
        frozen=0.1,  # slow drivers repeat a value for some 20 ms
        # 25 Nm at BP2's stiffness, as much of another robot's weight: it moves any
        # joint
        frozen_target=0.1,
        window=0.5,  # a stride and more
        mismatch=0.5,  # finds speeds half or twice as large, and wrong signs
        joint_noise=0.1,  # ten times an encoder's noise in training
        # 0.7 deg; what a gyro's noise in training adds up to is a quarter of it
        turned=0.012,
        # half or twice the gyro is 0.5, noise 1; runs with training's noise, and a real
        # one, have 0.18
        unlike=0.4,
        off_target=0.8,  # a hip with the wrong sign is off by 1.24 in BP2's stand
        opposed=0.5,
        swing=0.1,
        # an encoder's noise in training is a third of it, joints that work are at 0.35
        # and more
        still=0.15,
    )


def robots_of(env: EnvConfig) -> dict[str, HardwareSpec]:
    """Return the robots of a bundle's rehearsal, by name: `own`, if not a named BP2,
    and BP2's built and ideal."""
    if not env.hardware.is_bp2:
        return {"own": env.hardware}
    own = {} if robot_name(env.hardware) else {"own": env.hardware}
    return {**own, "built": ROBOTS["built"], "ideal": ROBOTS["ideal"]}


def _describe_robots(env: EnvConfig, world: World = LEVEL) -> dict[str, Settings]:
    """Return motors, bus, losses and settled stand for every robot of a bundle's
    rehearsal.

    `onboard.robot` reads them; None means no limit.
    """
    robots = {
        name: dataclasses.replace(env, hardware=hardware)
        for name, hardware in robots_of(env).items()
    }
    stands = settled([RobotSetup(robot, world) for robot in robots.values()])
    described: dict[str, Settings] = {}
    for i, (name, robot) in enumerate(robots.items()):
        motors, resistance = motors_of(robot), Resistance.from_hardware(robot.hardware)
        described[name] = {
            "motors": _limits({field: getattr(motors, field) for field in MOTORS}),
            "bus": None if motors.bus is None else vars(motors.bus),
            "losses": None if resistance is None else _limits(vars(resistance)),
            "stand": {
                "qpos": stands.qpos[i].tolist(),
                "torque": stands.torque[i].tolist(),
            },
        }
    return described


def _limits(values: Settings) -> Settings:
    """Return limits by name for JSON: numbers or lists of twelve, with None for
    infinity."""
    return {
        name: np.where(np.isfinite(value), value, np.array(None)).tolist()
        for name, value in values.items()
    }
