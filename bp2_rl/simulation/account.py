"""Account for the energy and the ground contact of a run, by evaluating C MuJoCo's
forward dynamics at every recorded sample.

For a run in steps of 1 ms. Powers are means over a millisecond: a force
times the mean of the velocities at its ends, which for MuJoCo's Euler integrator is the
exact change of the kinetic energy. What the battery gives is what is lost, by cause,
plus what is stored:

    bus = copper + gears + joints + slides + dampers + air + ground + stops + legs +
    stored

`stored` is the change of kinetic energy (rotors included), of height and of the
springs, stops included. Every term is computed by itself, the left side from the motors
alone, so that a loss that was not applied, or applied twice, shows.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from bp2_rl.robot import losses
from bp2_rl.robot.actuator import Actuator, bus_voltage, torque_limits, winding_heat
from bp2_rl.robot.coordinates import compression_rates, joint_velocities
from bp2_rl.robot.losses import Resistance
from bp2_rl.robot.model import foot_geom_ids, load_model
from bp2_rl.simulation.gait import contacts, touchdowns
from bp2_rl.simulation.laws import NO_RESISTANCE
from bp2_rl.simulation.metrics import (
    BURST,
    HARD,
    PLATE,
    Account,
    GroundMetrics,
    PowerMetrics,
)
from bp2_rl.simulation.simulator import CONVERGED
from bp2_rl.simulation.trajectory import Trajectory, window_means
from bp2_rl.simulation.world import World


class Ledger(NamedTuple):
    """The terms of a run's power balance in every millisecond, W."""

    bus: Float[np.ndarray, " N"]
    lost: dict[str, Float[np.ndarray, " N"]]
    stored: Float[np.ndarray, " N"]
    # J, kinetic, of height and of springs, at the start
    energy: Float[np.ndarray, " N"]
    # mechanical, of each motor before its gear; below 0 it brakes
    motors: Float[np.ndarray, "N 12"]
    copper: Float[np.ndarray, "N 12"]  # that each winding turns into heat
    # that each spring with its stops gives its leg; below 0 it is pressed
    springs: Float[np.ndarray, "N 4"]

    @property
    def error(self) -> Float[np.ndarray, " N"]:
        """Bus power minus losses and the change of stored energy, W."""
        return self.bus - sum(self.lost.values()) - self.stored

    @property
    def closure(self) -> float:
        """Greatest error in any millisecond, over the greatest term of that
        millisecond."""
        terms = np.abs(np.stack([self.bus, self.stored, *self.lost.values()]))
        return float(np.max(np.abs(self.error) / np.max(terms, axis=0)))


class SoleAccount(NamedTuple):
    """Depth in the ground and velocity of every foot's lowest point, at every
    sample."""

    depth: Float[np.ndarray, "N 4"]  # m, 0 in the air
    velocity: Float[np.ndarray, "N 4 3"]  # m/s, world frame


def account(run: Trajectory) -> Account:
    """Compute the power and ground metrics of a run, or of a part of a run."""
    ledger, soles = replay(run)
    return Account(_power(run, ledger), _ground(run, soles))


def replay(run: Trajectory) -> tuple[Ledger, SoleAccount]:
    """Put every sample but the last through MuJoCo's forward dynamics; return the run's
    powers and the motion of its soles."""
    resistance = Resistance.from_hardware(run.hardware) or NO_RESISTANCE
    against = losses.loss(resistance, run.qpos, run.qvel, run.torque)
    applied = losses.generalized(against, run.qvel)
    model = load_model(run.hardware, visual=False, scene=World(run.terrain).lay)
    CONVERGED.apply(model)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    force, energy, soles = _forces_at_samples(model, run, applied)
    return _balance(run, force, energy, against), soles


def _forces_at_samples(
    model: mujoco.MjModel, run: Trajectory, applied: Float[np.ndarray, "_ nv"]
) -> tuple[dict[str, Float[np.ndarray, "N nv"]], Float[np.ndarray, " N"], SoleAccount]:
    """Return each sample's forces on the coordinates by their kind, its energy, and the
    feet's lowest points."""
    data = mujoco.MjData(model)
    feet = foot_geom_ids(model)
    count = len(run) - 1
    change = np.diff(run.qvel, axis=0)
    names = "momentum", "bias", "spring", "damper", "ground", "legs", "stops"
    force = {name: np.zeros((count, model.nv)) for name in names}
    energy = np.zeros(count)
    soles = SoleAccount(np.zeros((count, 4)), np.zeros((count, 4, 3)))
    for k in range(count):
        data.qpos[:] = run.qpos[k]
        data.qvel[:] = run.qvel[k]
        data.ctrl[:] = run.torque[k]
        data.qfrc_applied[:] = applied[k]
        mujoco.mj_forward(model, data)
        energy[k] = np.sum(data.energy)
        mujoco.mj_mulM(model, data, force["momentum"][k], change[k] / run.dt)
        force["bias"][k] = data.qfrc_bias
        force["spring"][k] = data.qfrc_spring
        # implicit, as the integrator has it
        force["damper"][k] = data.qfrc_damper - model.dof_damping * change[k]
        split_constraints(
            model, data, force["ground"][k], force["legs"][k], force["stops"][k]
        )
        depths = np.where(on_ground(model, data), -data.contact.dist, 0.0)
        soles.depth[k] = [
            np.max(depths, where=np.any(data.contact.geom == foot, axis=1), initial=0.0)
            for foot in feet
        ]
        soles.velocity[k] = [
            _sole_velocity(model, data, foot) for foot in feet.tolist()
        ]
    return force, energy, soles


def _sole_velocity(
    model: mujoco.MjModel, data: mujoco.MjData, foot: int
) -> Float[np.ndarray, "3"]:
    """Return the velocity of a foot's lowest point, m/s, world frame."""
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_GEOM, foot, velocity, 0)
    below = 0.0, 0.0, -model.geom_size[foot, 0]
    return velocity[3:] + np.cross(velocity[:3], below)


def _balance(
    run: Trajectory,
    force: dict[str, Float[np.ndarray, "N nv"]],
    energy: Float[np.ndarray, " N"],
    against: losses.Loss,
) -> Ledger:
    """Return the powers of the forces, and of the motors that the run has recorded."""
    mean = run.qvel[:-1] + 0.5 * np.diff(run.qvel, axis=0)
    qd = joint_velocities(mean)
    rate = compression_rates(mean)
    torque = run.torque[:-1]
    powers = {name: np.sum(value * mean, axis=-1) for name, value in force.items()}
    motors = torque * qd
    copper = winding_heat(Actuator.from_hardware(run.hardware), torque)

    def taken(force: np.ndarray, velocity: np.ndarray) -> Float[np.ndarray, " N"]:
        return 0.0 - np.sum(force[:-1] * velocity, axis=-1)

    lost = {
        "copper": np.sum(copper, axis=-1),
        "gears": taken(against.gear, qd),
        "joints": taken(against.joint, qd),
        "slides": taken(against.slide, rate),
        "dampers": taken(against.rebound, rate) - powers["damper"],
        "air": taken(against.air, mean[:, :3]),
        "ground": -powers["ground"],
        "stops": -powers["stops"],
        "legs": -powers["legs"],
    }
    return Ledger(
        bus=np.sum(motors, axis=-1) + lost["copper"],
        lost=lost,
        stored=powers["momentum"] + powers["bias"] - powers["spring"],
        energy=energy,
        motors=motors,
        copper=copper,
        springs=compression_rates(force["spring"] * mean),
    )


def split_constraints(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    ground: Float[np.ndarray, " nv"],
    legs: Float[np.ndarray, " nv"],
    stops: Float[np.ndarray, " nv"],
) -> None:
    """Split the generalised constraint force by cause, ground, legs and joint stops,
    into the three arrays."""
    if data.nefc == 0:
        return
    limits = data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT
    on_floor = np.zeros(data.nefc, bool)
    rows = np.flatnonzero(~limits)
    on_floor[rows] = on_ground(model, data)[data.efc_id[rows]]
    for chosen, out in (
        (on_floor, ground),
        (limits, stops),
        (~limits & ~on_floor, legs),
    ):
        if np.any(chosen):
            mujoco.mj_mulJacTVec(
                model, data, out, np.where(chosen, data.efc_force, 0.0)
            )


def on_ground(model: mujoco.MjModel, data: mujoco.MjData) -> Bool[np.ndarray, " C"]:
    """Return which contacts are with the ground: with geoms that are fixed to the
    world."""
    return np.any(model.geom_bodyid[data.contact.geom] == 0, axis=1)


def _power(run: Trajectory, ledger: Ledger) -> PowerMetrics:
    beyond = beyond_envelope(run)
    qd = run.joint_velocity
    seconds = (len(run) - 2) * run.dt
    stored = float(ledger.energy[-1] - ledger.energy[0]) / seconds
    means = [window_means(ledger.bus, round(span / run.dt)) for span in (BURST, 1.0)]
    return PowerMetrics(
        mean=float(np.mean(ledger.bus)),
        peak=float(np.max(ledger.bus)),
        burst=float(np.max(means[0])) if len(means[0]) else float(np.mean(ledger.bus)),
        second=float(np.max(means[1])) if len(means[1]) else None,
        recharge=max(-float(np.min(ledger.bus)), 0.0),
        motor_peak=float(np.max(run.torque[:-1] * 0.5 * (qd[:-1] + qd[1:]))),
        beyond=float(np.max(beyond)),
        beyond_share=float(np.mean(beyond > 1.0)),
        overspeed_share=float(np.mean(np.abs(qd) > run.hardware.joint_no_load_speed)),
        lost={cause: float(np.mean(power)) for cause, power in ledger.lost.items()},
        stored=stored,
        integration=float(np.mean(ledger.stored[:-1])) - stored,
        closure=ledger.closure,
    )


def beyond_envelope(run: Trajectory) -> Float[np.ndarray, "M 12"]:
    """Return how far each torque is outside the envelope within its millisecond, Nm.

    The start or the end of the millisecond counts, whichever is more.

    The voltage is that of the millisecond. The first sample, before which no torque is
    known, and the last are left out.
    """
    motors = Actuator.from_hardware(run.hardware)
    voltage = bus_voltage(motors, run.torque[:-2], run.joint_velocity[1:-1])
    torque = run.torque[1:-1]
    excess = np.zeros_like(run.torque[1:-1])
    for qd in (run.joint_velocity[1:-1], run.joint_velocity[2:]):
        lower, upper = torque_limits(motors, qd, voltage)
        excess = np.maximum(excess, np.maximum(torque - upper, lower - torque))
    return excess


def _ground(run: Trajectory, soles: SoleAccount) -> GroundMetrics:
    standing = contacts(run)[:-1]
    touching = run.foot_force[:-1, :, 2] > 0.0
    speed = np.linalg.norm(soles.velocity[..., :2], axis=-1)
    starts = [touchdowns(standing[:, leg]) for leg in range(4)]
    stances = sum(map(len, starts))
    landings = np.concatenate(
        [
            soles.velocity[before_contact(touching[:, leg], starts[leg]), leg]
            for leg in range(4)
        ]
    )
    broken = standing[1:] & standing[:-1] & touching[:-1] & ~touching[1:]
    compression = run.spring_compression[:-1]
    onto = (compression[1:] < 0.0) & (compression[:-1] >= 0.0)
    tops = -run.spring_velocity[1:-1][onto]
    limits = np.array([leg.ranges for leg in run.hardware.anatomy.legs]).reshape(-1, 2)
    over = np.maximum(
        run.joint_position - limits[:, 1], limits[:, 0] - run.joint_position
    )
    sliding = speed[standing & touching]
    plate = min(round(PLATE / run.dt), len(run))
    return GroundMetrics(
        depth=float(np.max(soles.depth)),
        slip=_quantile(sliding, 0.5),
        slip_95=_quantile(sliding, 0.95),
        slip_distance=float(np.sum(sliding) * run.dt / stances) if stances else None,
        breaks=int(np.sum(broken)) / stances if stances else None,
        plate_force=max(
            float(np.max(window_means(foot, plate)))
            for foot in run.foot_force[..., 2].T
        ),
        landing_down=_mean(-landings[:, 2]),
        landing_forward=_mean(landings[:, 0]),
        top_outs=len(tops) / (len(onto) * run.dt)
        if run.hardware.anatomy.sprung
        else None,
        hard_top_outs=float(np.sum(tops > HARD)) / (len(onto) * run.dt),
        top_out_mean=_mean(tops),
        top_out_speed=float(np.max(tops, initial=0.0)),
        limit_share=float(np.mean(np.any(over > 0.0, axis=-1))),
        limit_depth=max(float(np.max(over)), 0.0),
    )


def _mean(values: Float[np.ndarray, " K"]) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _quantile(values: Float[np.ndarray, " K"], share: float) -> float | None:
    return float(np.quantile(values, share)) if len(values) else None


def before_contact(touching: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Return the index of the last airborne sample of a foot before each of its
    stances."""
    return np.array(
        [start - int(np.argmax(~touching[start::-1])) for start in starts], int
    )
