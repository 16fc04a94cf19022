"""The conditions of a benchmark: the commanded speed, the robot, and their description
for reports."""

import importlib.metadata
import math

import mujoco

from bp2_rl.base.errors import UserError, shown
from bp2_rl.base.serialization import config_hash
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.learning.policy import Policy
from bp2_rl.robot import bp2
from bp2_rl.robot.hardware import BUILT, IDEAL, ByJoint, HardwareSpec, robot_name
from bp2_rl.robot.named import find_robot
from bp2_rl.robot.operator import EASE, HeadingHold
from bp2_rl.settings.env import ControlConfig, RandomizationConfig
from bp2_rl.simulation.backend import Backend
from bp2_rl.simulation.schedule import Ramp

BEYOND = 0.25, 0.7
"""Bounds on top speed over the fastest trained command; between them the command is the
policy's own top speed, else the fastest command."""
LARGEST_RESULT = 1000.0
"""Largest number that a result on a policy's card may have, SI units."""
CRUISE = 0.6
"""Cruising speed over top speed, for robots other than BP2."""


def speed_to_command(policy: Policy, benchmark: str = "topspeed") -> float:
    """Return the command for a benchmark, m/s: the command of the result on the
    policy's card.

    A robot may run slower than its command.

    A card without a result of this benchmark gives the command of its `topspeed`
    result. A card without both gives the judge's fastest command, or the speed that the
    judge measured if the robot fell under that command or ran far slower.
    """
    for result in ("commanded_speed", "best_speed"):
        speed = on_card(policy, benchmark, result)
        if speed is not None:
            return speed
    fastest = _fastest_command(policy)
    own = top_speed(policy)
    fell = own < fastest and on_card(policy, "judged", "speed") is None
    return round(own, 2) if fell or BEYOND[0] <= own / fastest < BEYOND[1] else fastest


def top_speed(policy: Policy) -> float:
    """Return a policy's own top speed, m/s: the `topspeed` result on its card, else the
    judge's measurement.

    If the policy fell under the judge's fastest command, its top speed is the speed
    held under a slower command. A policy without measurements, or one that always fell,
    gives the fastest command of the judge or of its training.
    """
    results = (("topspeed", "best_speed"), ("judged", "speed"), ("judged", "held"))
    speeds = (on_card(policy, *result) for result in results)
    return next(filter(None, speeds), None) or _fastest_command(policy)


def _fastest_command(policy: Policy) -> float:
    """Return the fastest command that the judge gave a policy, m/s, else the fastest of
    its training."""
    judged = on_card(policy, "judged", "told")
    return round(judged, 2) if judged else policy.card.env.commands.max_forward


def cruising_speed(policy: Policy) -> float:
    """Return a policy's cruising speed, m/s, at which the robot should run without
    falls.

    Fleets, stops, pushes and rehearsals run at this speed.

    BP2's is that of its outdoor run; any other robot's is `CRUISE` of its policy's own
    top speed.
    """
    if policy.card.env.hardware.is_bp2:
        return bp2.OUTDOOR_TOP_SPEED
    return round(CRUISE * top_speed(policy), 2)


def on_card(policy: Policy, benchmark: str, result: str) -> float | None:
    """Return a benchmark's positive result from the policy's card; None without one.

    Results are stored by the benchmark's name. A result that the card lacks for this
    benchmark is taken from `topspeed`.

    Raises:
        UserError: the value on the card is not a number in the allowed range.
    """
    for name in (benchmark, "topspeed"):
        group = policy.card.results.get(name, {})
        value = (group.get(result) or 0.0) if isinstance(group, dict) else group
        if (
            not isinstance(group, dict)
            or type(value) not in (int, float)
            or not 0.0 <= value <= LARGEST_RESULT
        ):
            raise UserError(
                f"the policy's card is not as we write it: {result} of {name} is {shown(value)}"
            )
        if value:
            return float(value)
    return None


def robot_of(policy: Policy, setup: BenchmarkOptions) -> HardwareSpec:
    """Return the robot that a benchmark simulates: the one asked for, else the built
    one in place of the ideal one, else the card's own."""
    own = policy.card.env.hardware
    if setup.robot is None:
        return BUILT if own == IDEAL else own
    chosen = find_robot(setup.robot)
    if chosen.anatomy.name != own.anatomy.name:
        raise UserError(
            f"--robot {setup.robot}: the policy was trained for {own.anatomy.name}, another robot"
        )
    return chosen


def conditions(
    policy: Policy, setup: BenchmarkOptions, schedule: str, simulator: str | None = None
) -> dict[str, str]:
    """Return the conditions under which an evaluation can be repeated, in words, by
    name; the simulator is by default the one of `setup`."""
    robot = robot_of(policy, setup)
    return {
        "robot": describe_robot(robot),
        **({} if setup.terrain == "flat" else {"ground": str(setup.ground)}),
        "schedule": schedule,
        "policy": describe_policy(policy),
        "trained on": describe_robot(policy.card.env.hardware),
        "weights_sha256": policy.card.weights_sha256,
        "simulator": simulator or describe_simulator(setup.backend, robot),
        "sensors": describe_sensors(policy.card.env.randomization, setup.noise_seed),
        "operator": describe_operator(setup.operator),
        "controller": describe_easing(policy.card.env.control),
    }


def describe_policy(policy: Policy) -> str:
    """Describe a policy's training in one line."""
    card = policy.card
    return (
        f"{card.stage} stage, {card.physics_steps / 1e6:.3g} M physics steps, seed {card.seed}, {card.created}, "
        f"config {card.config_hash}"
    )


def describe_subject(policy: Policy, setup: BenchmarkOptions) -> str:
    """Name the policy, the robot and the ground of a run, for titles.

    The commanded speed is left out: a reader would take it for the speed run.
    """
    noisy = ", noisy sensors" if setup.sensor_noise else ""
    ground = "" if setup.terrain == "flat" else f", ground {setup.terrain}"
    return f"{policy.card.stage} policy, {title_of(robot_of(policy, setup))}{ground}{noisy}"


def describe_robot(hardware: HardwareSpec) -> str:
    """Describe a robot in one line: name and losses, and a hash of its settings if it
    is not a known BP2."""
    losses = hardware.losses
    name = robot_name(hardware)
    if name == "ideal":
        return (
            "ideal: no air, no losses but the windings', a bus that gives and takes everything, legs that pass "
            "through each other"
        )
    parts = {
        f"CdA {losses.drag_area:g} m²": True,
        f"gears {losses.gear_efficiency:.0%}": True,
        f"joint friction {_by_joint(losses.joint_friction)} Nm + "
        f"{_by_joint(losses.joint_viscosity)} Nm s/rad": True,
        f"slides {losses.spring_friction:g} N": hardware.anatomy.sprung,
        f"bus {1e-3 * losses.bus_power_out:g} kW out and {1e-3 * losses.bus_power_in:g} kW in "
        f"with {losses.bus_sag:.2%} sag a kW": math.isfinite(losses.bus_power_out),
        f"torque lag {1e3 * losses.current_lag:g} ms": True,
        f"latency {1e3 * losses.latency:g} ms": True,
        f"friction {hardware.friction:g}": True,
        "solid legs": hardware.solid_legs,
        "legs that pass through each other": not hardware.solid_legs,
    }
    properties = ", ".join(part for part, holds in parts.items() if holds)
    if name is not None:
        return f"{name}: {properties}"
    return f"{title_of(hardware)}, {hardware.mass:.3g} kg: {properties}; config {config_hash(hardware)}"


def _by_joint(value: ByJoint) -> str:
    """Write a joint parameter: one number for all joints, or three for abad, hip and
    knee."""
    return " / ".join(
        f"{number:g}" for number in (value if isinstance(value, tuple) else (value,))
    )


def title_of(hardware: HardwareSpec) -> str:
    """Return a robot's name for the title of a figure or report."""
    if not hardware.is_bp2:
        return hardware.anatomy.name
    name = robot_name(hardware) or "unnamed"
    return "plausible robot real" if name == "real" else f"{name} robot"


def describe_limits(hardware: HardwareSpec) -> str:
    """Describe in one line at which times the motors' torque is kept within the
    envelope."""
    if hardware.envelope == "throughout":
        return "motor torques computed each ms, then held, and within the envelope from its start to its end"
    return "motor torques computed, and checked against the envelope, at the speed at the start of each ms, then held"


def describe_ramp(ramp: Ramp) -> str:
    """Describe a ramp of the command in one line: speed, rise and hold."""
    return f"from a stand to {ramp.target[0]:g} m/s {describe_rise(ramp)}, then hold for {ramp.hold:g} s"


def describe_rise(ramp: Ramp) -> str:
    """Describe in a few words how fast the command rises."""
    rise = f"at {ramp.acceleration:g} m/s²"
    if math.isfinite(ramp.launching):
        return f"{rise}, and at no more than {_launching(ramp)}"
    return rise


def describe_sensors(noise: RandomizationConfig, seed: int | None) -> str:
    """Describe the sensors' noise in one line."""
    if seed is None:
        return "without noise"
    return (
        f"with the noise of training, seed {seed}: joints {noise.joint_position_noise:g} rad and "
        f"{noise.joint_velocity_noise:g} rad/s, upright {noise.orientation_noise:g}, gyro "
        f"{noise.angular_velocity_noise:g} rad/s (standard deviations)"
    )


def describe_operator(operator: HeadingHold) -> str:
    """Describe the outer loop that steers the robot along its lane, in one line."""
    if operator.limit == 0:
        return "none: the yaw command is the schedule's"
    return (
        f"yaw-rate command = -{operator.heading_gain:g}/s x heading - {operator.lane_gain:g}/(m s) x offset to the "
        f"left, at most {operator.limit:g} rad/s, on straight commands; sees the true heading and offset, without "
        "noise or delay"
    )


def describe_easing(control: ControlConfig) -> str:
    """Describe how the controller limits the rise and fall of forward commands, in one
    line."""
    limits = {
        f"rises no faster than {_launching(control)}": math.isfinite(control.launching),
        f"falls no faster than {control.braking:g} m/s²": math.isfinite(
            control.braking
        ),
        f"falls no faster than (v + {EASE:g} m/s) / {control.stopping_time:g} s": bool(
            control.stopping_time
        ),
    }
    limits_in_force = ", and ".join(limit for limit, holds in limits.items() if holds)
    if not limits_in_force:
        return "the policy observes the command without limits on its rise and fall"
    return f"the forward command v that the policy observes {limits_in_force}"


def _launching(law: ControlConfig | Ramp) -> str:
    """Describe the fastest rise of a command v, as a formula."""
    rate = f"{law.launching:g} m/s²"
    if math.isfinite(law.launching_speed):
        return f"{rate} x (1 - v / {law.launching_speed:g} m/s)"
    return rate


def describe_simulator(backend: Backend, hardware: HardwareSpec) -> str:
    """Describe the simulator of a run and its numerics in one line."""
    engine = f"C MuJoCo {mujoco.__version__}, 1 kHz, float64, solver converged to 1e-10"
    if backend == "drake":
        engine = f"Drake {importlib.metadata.version('drake')}, 1 kHz, float64, point contact"
    return f"{engine}; {describe_limits(hardware)}; policy at 200 Hz"
