"""One policy on many robots, each drawn as in training, all under the same command
schedule."""

import dataclasses
import math

import numpy as np
from jaxtyping import Float

from bp2_rl.learning.policy import Policy
from bp2_rl.robot import conventions
from bp2_rl.settings.env import RandomizationConfig
from bp2_rl.simulation.backend import Backend
from bp2_rl.simulation.gait import leg_room
from bp2_rl.simulation.parallel import simulate_all
from bp2_rl.simulation.rollout import RunRequest, sampled_commands
from bp2_rl.simulation.trajectory import Trajectory
from bp2_rl.simulation.world import Draw

# the milliseconds at which control steps begin
EACH = slice(None, None, conventions.SUBSTEPS)


@dataclasses.dataclass(frozen=True)
class FleetRun:
    """The motion of N robots at the start of T control steps; 0 after a fall."""

    time: Float[np.ndarray, " T"]  # s
    command: Float[np.ndarray, " T"]  # m/s, scheduled forward speed
    speed: Float[np.ndarray, "T N"]  # m/s, forward in the heading frame
    offset: Float[np.ndarray, "T N"]  # m, to the left of the line through the start
    fell_at: Float[np.ndarray, " N"]  # s; inf for robots that did not fall
    # m, least between legs or of a leg and the trunk, before a fall
    leg_room: Float[np.ndarray, " N"]
    # what was drawn: friction, latency (s), mass (kg), strength
    robots: dict[str, Float[np.ndarray, " N"]]
    steady_from: float  # s, from when the command is held


def run_fleet(
    policy: Policy,
    request: RunRequest,
    ranges: RandomizationConfig,
    robots: int,
    seed: int = 0,
    backend: Backend = "mujoco",
) -> FleetRun:
    """Run many robots from a standing start, each with its own draw.

    Args:
        policy: what all run by; `ranges` take the place of what it was trained with.
        request: the run of the robot around which they are drawn; its own pushes and
            noise are not used.
        ranges: from what they are drawn.
        robots: how many.
        seed: of everything that is drawn.
        backend: the simulator.
    """
    schedule, hardware = request.schedule, request.hardware or policy.card.env.hardware
    draws = [Draw(ranges, seed, number) for number in range(robots)]
    worlds = [
        dataclasses.replace(request.world, pushes=draw.pushes(schedule.duration))
        for draw in draws
    ]
    requests = [
        dataclasses.replace(
            request, world=world, noise_seed=draw.noise_seed, drawn=draw
        )
        for world, draw in zip(worlds, draws, strict=True)
    ]
    card = policy.card
    noisy = dataclasses.replace(
        card, env=dataclasses.replace(card.env, randomization=ranges)
    )
    speeds, offsets, falls, rooms, masses = zip(
        *simulate_all(
            _robot_run, dataclasses.replace(policy, card=noisy), requests, backend
        ),
        strict=True,
    )
    commands = sampled_commands(schedule)[:-1, 0]
    speed, offset = np.zeros((2, len(commands), robots))
    for number in range(robots):
        lasted = len(speeds[number])
        speed[:lasted, number] = speeds[number]
        offset[:lasted, number] = offsets[number]
    drawn = [draw.values(hardware) for draw in draws]
    return FleetRun(
        time=conventions.CONTROL_STEP * np.arange(len(commands)),
        command=commands,
        speed=speed,
        offset=offset,
        fell_at=np.array(falls),
        leg_room=np.array(rooms),
        robots={
            "friction": np.array([float(one.friction) for one in drawn]),
            "latency": np.array([float(one.latency) for one in drawn]),
            "mass": np.array(masses),
            "strength": np.array([float(np.min(one.strength)) for one in drawn]),
        },
        steady_from=schedule.steady_from,
    )


def _robot_run(
    _: RunRequest, run: Trajectory
) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, " K"], float, float, float]:
    """Return a robot's speeds, offsets, time of fall, least leg room and mass."""
    return (
        run.ground_velocity[EACH, 0],
        run.qpos[EACH, 1],
        math.inf if run.fell_at is None else run.fell_at,
        float(np.min(leg_room(run, EACH).least)),
        run.mass,
    )
