"""Write a policy as a folder that any file server serves, and that simulates and shows
the robot in a browser.

index.html       the page, with *.js and page.css
mujoco.js        MuJoCo's official build for browsers, with mujoco.wasm.gz and its licence
page.wasm        the controller in C++, motors and operator
policy/          page.json, controller.bin.gz, and NAME.bin and NAME.xml of each robot;
                 such folders of other pages may lie beside it: index.html#policy=FOLDER
"""

import dataclasses
import gzip
import importlib.metadata
import itertools
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bp2_rl.base.files import require_name, write_bytes
from bp2_rl.deploy.bundle import describe_policy, replaced, require_terms, robots_of
from bp2_rl.deploy.network import to_records
from bp2_rl.deploy.onboard.binary import assemble, pack
from bp2_rl.deploy.onboard.contents import Settings, with_infinity
from bp2_rl.deploy.page.mujoco_wasm import VERSION, mujoco_files
from bp2_rl.evaluation.races import BOLT_SPLITS, PAPER_BP2, TIMES, TRACK
from bp2_rl.evaluation.report import player
from bp2_rl.evaluation.report.player.content import describe_robot
from bp2_rl.learning.policy import Policy
from bp2_rl.robot.conventions import GRAVITY, NUM_MOTORS
from bp2_rl.robot.model import model_xml
from bp2_rl.robot.observation import OBSERVATION_TERMS
from bp2_rl.robot.operator import wish_rates
from bp2_rl.simulation.laws import JOINT_LOSSES, NO_BUS, NO_RESISTANCE
from bp2_rl.simulation.metrics import RIPPLE
from bp2_rl.simulation.policy_runner import control_steps_behind
from bp2_rl.simulation.simulator import RobotSetup
from bp2_rl.simulation.world import LEVEL, World

Vector = tuple[float, float, float]
HERE, POLICY, INDEX = Path(__file__).parent, "policy", "index.html"
"""This module's folder; a policy's folder in a page's; the page."""
SCRIPTS = ("linear.js", "shapes.js", "motion.js", "camera.js", "scene.js")
FROM_PLAYER = [Path(player.__file__).parent / name for name in SCRIPTS]
OWN = [HERE / name for name in ("robot.js", "page.js", "page.css", "page.wasm")]
LICENSE = importlib.metadata.distribution("mujoco").read_text("licenses/LICENSE") or ""
"""MuJoCo's, which goes where MuJoCo goes; npm's package is without."""
SIDEWAYS = "max_lateral", "max_forward", "max_turn", "max_yaw_rate"
RIVALS = {"Bolt": BOLT_SPLITS, "paper's BP2": [TIMES[PAPER_BP2]]}
"""Times over equal parts of 100 m, s."""
WHITE, BLACK, SIGNAL = (0.95, 0.95, 0.93), (0.08, 0.08, 0.09), (0.84, 0.37, 0.0)
BESIDE = 3.3  # m, from the track's middle to the posts beside it
SHOWN = 130.0  # m, of uneven ground ahead of the start
SOLVER = "iterations", "ls_iterations", "tolerance", "disableflags"


def write_page(
    directory: Path, policy: Policy, world: World = LEVEL, package: Path | None = None
) -> None:
    """Write a policy's page to `directory`, in the place of an older page; a failed
    write leaves nothing partial.

    Args:
        directory: the page's folder.
        policy: runs the robot.
        world: its ground.
        package: the file of MuJoCo's package, for machines without a network.

    Raises:
        UserError: the controller in C++ cannot run this policy, MuJoCo's package is not
            the pinned one, or the place cannot be written.
    """
    require_name(directory)
    require_terms(
        policy,
        [term.name for term in OBSERVATION_TERMS],
        "Python code of its task computes and a page cannot; --format onnx writes a bundle that can",
    )
    script, code = mujoco_files(package)
    settings, arrays = describe_policy(policy, world)
    env, robots = policy.card.env, {}
    files = {file.name: file.read_bytes() for file in (*FROM_PLAYER, *OWN)}
    files |= {
        INDEX: (HERE / "page.html").read_bytes().replace(b"VERSION", VERSION.encode()),
        "mujoco.js": script,
        "mujoco.LICENSE": LICENSE.encode(),
        "mujoco.wasm.gz": gzip.compress(code, mtime=0),
        f"{POLICY}/controller.bin.gz": gzip.compress(
            pack(settings, arrays, to_records(policy)), mtime=0
        ),
    }
    for name, hardware in robots_of(env).items():
        setup = RobotSetup(dataclasses.replace(env, hardware=hardware), world)
        robot = settings["robots"][name]
        files |= {
            f"{POLICY}/{name}.bin": robot_numbers(setup, settings, robot),
            f"{POLICY}/{name}.xml": model_xml(
                hardware, world.lay, weighed=True
            ).encode(),
        }
        robots[name] = _describe(setup, robot)
    page = {
        "name": env.hardware.anatomy.name,
        "command": settings["command"],
        "speed": settings["rehearsal"]["speed"],
        "fall": dataclasses.asdict(env.termination),
        "ripple": RIPPLE,
        "track": TRACK,
        "rivals": RIVALS,
        "robots": robots,
    }
    files[f"{POLICY}/page.json"] = json.dumps(page, allow_nan=False).encode()
    with replaced(directory, "page", INDEX) as fresh:
        (fresh / POLICY).mkdir()
        for name, content in files.items():
            write_bytes(fresh / name, content)


def robot_numbers(setup: RobotSetup, settings: Settings, robot: Settings) -> bytes:
    """Return the file from which a page's C++ reads a robot's motors, losses and
    operator."""
    env, bus, losses = setup.config, robot["bus"], robot["losses"]
    losses = vars(NO_RESISTANCE) if losses is None else losses
    rise, fall = wish_rates(env.control, env.commands.turn_acceleration)
    parts = {
        "motors": _at_joints(settings["gains"] | robot["motors"]),
        "bus": vars(NO_BUS) if bus is None else bus,
        "losses": losses | _at_joints({name: losses[name] for name in JOINT_LOSSES}),
        "operator": settings["operator"],
        "wish": {"rise": rise, "fall": fall},
        "commands": {name: getattr(env.commands, name) for name in SIDEWAYS},
        "stand": robot["stand"] | {"target": settings["control"]["stand"]},
        "up": setup.model().opt.gravity / -GRAVITY,
        "behind": control_steps_behind(setup.latency),
    }
    return assemble(parts)


def _at_joints(values: Settings) -> dict[str, np.ndarray]:
    """Return parameters at all twelve joints, by name; None is infinity."""
    return {
        name: np.broadcast_to(x, NUM_MOTORS)
        for name, x in with_infinity(values).items()
    }


def _describe(setup: RobotSetup, robot: Settings) -> Settings:
    """Return a robot's settings for a page's JavaScript."""
    options, hardware = setup.model().opt, setup.config.hardware
    path = np.array([[0.0, 0.0], [SHOWN, 0.0]])
    scene = describe_robot(hardware, setup.world, path)
    scene["geoms"] += list(_course())
    return {
        "stand": robot["stand"]["qpos"],
        "solver": {name: getattr(options, name) for name in SOLVER},
        "throughout": hardware.envelope == "throughout",
        "scene": scene,
    }


def _course() -> Iterator[Settings]:
    """Yield what stands along 100 m for the eye alone: a start line, posts at every ten
    metres, and the finish."""
    yield _box((0.0, 0.0, 0.003), (0.05, 3.0, 0.003), WHITE)
    for side in (-BESIDE, BESIDE):
        yield _box((TRACK, side, 1.35), (0.07, 0.07, 1.35), BLACK)
        for x in np.arange(0.0, TRACK, 10.0).tolist():
            yield _box((x, side, 0.25), (0.035, 0.035, 0.25), WHITE)
            yield _box((x, side, 0.45), (0.037, 0.037, 0.06), SIGNAL)
    for row, column in itertools.product(range(2), range(22)):  # of checks
        color, y = (BLACK, WHITE)[(row + column) % 2], 0.3 * (column - 10.5)
        yield _box((TRACK + 0.3 * row, y, 0.003), (0.15, 0.15, 0.003), color)
        yield _box((TRACK, y, 2.35 + 0.3 * row), (0.05, 0.15, 0.15), color)


def _box(position: Vector, size: Vector, color: Vector) -> Settings:
    """Return a box of the scenery; half lengths in m."""
    shape = {"link": -1, "shape": "box", "quaternion": (1.0, 0.0, 0.0, 0.0)}
    return shape | {"position": position, "size": size, "color": color}
