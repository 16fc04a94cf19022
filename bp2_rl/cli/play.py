"""`bp2 play`: steer a policy's robot in real time, in a browser."""

import contextlib
import dataclasses
import importlib.util
import sys
from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.base.assets import asset_path
from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.base.errors import UserError, not_installed
from bp2_rl.base.processes import without_gl_library
from bp2_rl.cli.app import Command
from bp2_rl.cli.eval import DEFAULT_POLICY
from bp2_rl.learning.policy import find_policy
from bp2_rl.settings.terrain import Terrain, TerrainFlag
from bp2_rl.settings.training import RobotFlag, TaskFlag

WEB = ("viser", "trimesh")  # packages that a page needs


@dataclasses.dataclass(frozen=True)
class PlayConfig(Bounded, path="--"):
    """Run a policy in C MuJoCo in real time, and steer the robot in a browser: speed,
    turn, pushes, friction.

    Ctrl-C ends the command.

    For example: bp2 play runs/RUN --robot ideal
    """

    run: Annotated[
        Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_OR_POLICY")
    ] = None
    """Name of a shipped policy, or folder of a policy or a training run; by default the
    policy built."""
    robot: RobotFlag = None
    """built: BP2 with losses and solid legs; ideal: without both; by default the
    policy's own robot, but built for a policy trained on ideal"""
    task: TaskFlag = None
    """the policy's task, if the task adds observations; its code is run"""
    terrain: TerrainFlag = "flat"
    host: str = "127.0.0.1"
    """Network address at which the page is served; 0.0.0.0 serves every machine that
    can reach this one."""
    port: Annotated[int, Within(1, 65535)] = 8080
    """Port of the page; if it is in use, the next free one."""
    speed: Annotated[float, Within(-100.0, 100.0)] = 0.0
    """Commanded speed at the start, m/s."""
    seconds: Annotated[float, Within(0.0, 1e9, open_below=True, infinite=True)] = float(
        "inf"
    )
    """Ends after this time, s."""


def play(config: PlayConfig) -> None:
    """Load the policy and serve the page on which it is steered; check all inputs
    before the simulation."""
    path = config.run or asset_path(DEFAULT_POLICY)
    find_policy(path)
    ground = Terrain.of(config.terrain)
    for name in WEB:
        if importlib.util.find_spec(name) is None:
            raise not_installed("bp2 play", name, "play")
    print(f"{path}: loading it and the simulator", flush=True)
    # Imported here so that --help and a mistyped flag are answered at once; the page
    # draws in the browser and needs no GL library.
    with without_gl_library():
        import mujoco  # noqa: F401
    from bp2_rl.base.processes import keep_compiled
    from bp2_rl.env.observations import layout_of
    from bp2_rl.evaluation.benchmarks.conditions import robot_of, title_of
    from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
    from bp2_rl.learning.policy import load_policy
    from bp2_rl.play.gate import OWN_NAMES
    from bp2_rl.play.pace import Pace, play_on
    from bp2_rl.play.session import Session, Wish, wish_limits
    from bp2_rl.play.web import Page
    from bp2_rl.simulation.parallel import compute_here
    from bp2_rl.simulation.world import World

    compute_here()
    # s: else the page's thread may keep the robot waiting for a control step
    sys.setswitchinterval(1e-3)
    keep_compiled()
    policy = load_policy(path, layout_of=layout_of, task=config.task)
    robot = robot_of(policy, BenchmarkOptions(robot=config.robot))
    least, most = wish_limits(policy.card.env.commands)
    if not least.speed <= config.speed <= most.speed:
        raise UserError(
            f"--speed must be from {least.speed:g} to {most.speed:g}, what this policy was trained "
            f"for, got {config.speed:g}"
        )
    session = Session(policy, robot, World(ground))
    session.wish = Wish(config.speed)
    page = Page(session, host=config.host, port=config.port)
    if config.host not in OWN_NAMES:
        print(
            f"--host {config.host}: anyone on the network who can reach this machine can steer the robot"
        )
    with contextlib.closing(page):
        print(
            f"{path} on the {title_of(robot)}, {ground}: open {page.url}; Ctrl-C ends it",
            flush=True,
        )
        pace = Pace()
        with contextlib.suppress(KeyboardInterrupt):
            play_on(session.tick, page.watched, page.show, pace, seconds=config.seconds)
        print(f"{pace} in {pace.elapsed:.1f} s", flush=True)


main = Command("bp2 play", PlayConfig, play)
