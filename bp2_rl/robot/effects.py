"""Measure armature, stiffness, damping and peak torque of a compiled model's joints,
whichever attributes declare them.

Armature and damping may be declared at joints, at actuators with gears, or at tendons;
gains at several actuators.
"""

import copy
import dataclasses

import mujoco
import numpy as np
from jaxtyping import Float

STEP, SLOW = 2.0**-10, 2.0**-40
"""Steps of finite differences: rad or rad/s; and rad/s at which only linear damping
counts. Powers of two make quotients exact."""
FAST = 10.0
"""Joint speed, rad/s, at which nonlinear damping shows."""
EXTREME_COMMAND = 1e9
"""An actuator's command beyond every limit."""
ENDLESS = 1e6
"""Torque, Nm, above which an actuator counts as unlimited."""

ONE_COORDINATE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
"""MuJoCo's types of joints with one coordinate."""
Dofs = Float[np.ndarray, " nv"]


@dataclasses.dataclass(frozen=True)
class Effects:
    """Armature, stiffness, damping and torque limits on the velocity coordinates of a
    model."""

    armature: Float[np.ndarray, "nv nv"]  # kg m2, of the mass matrix without bodies
    spring: Dofs  # Nm/rad, passive
    damping: Dofs  # Nm s/rad, passive, near rest
    nonlinear_damping: Dofs  # Nm at `FAST`, total damping minus its linear part
    stiffness: Dofs  # Nm/rad, of actuators at the command 0
    actuator_damping: Dofs  # Nm s/rad, of actuators at the command 0
    # Nm s/rad, further damping of actuators at the command 1
    commanded_damping: Dofs
    peak_torque: Dofs  # Nm, of the weakest actuator; inf: without a limit
    # Nm, the largest passive force apart from springs and dampers: of fluids, and
    # gravity compensation
    other_forces: float


def effects_of(model: mujoco.MjModel) -> Effects:
    """Measure armature, stiffness, damping and peak torque of a model's joints and
    actuators."""
    free, weightless = copy.copy(model), copy.copy(model)
    weightless.body_mass[:] = weightless.body_inertia[:] = 0.0
    for limited in (
        free.actuator_forcelimited,
        free.actuator_ctrllimited,
        free.jnt_actfrclimited,
    ):
        limited[:] = False
    rest, moved = _after(free), _after(free, position=STEP)
    fast = _after(free, FAST)
    commanded = _after(free, command=1.0)
    commanded_and_moving = _after(free, STEP, command=1.0)
    damping = 0.0 - _after(free, SLOW).qfrc_damper / SLOW
    actuator_damping = (rest.qfrc_actuator - _after(free, STEP).qfrc_actuator) / STEP
    damping_at_command = (
        commanded.qfrc_actuator - commanded_and_moving.qfrc_actuator
    ) / STEP
    return Effects(
        armature=mass_matrix(weightless, rest),
        spring=(rest.qfrc_spring - moved.qfrc_spring) / STEP,
        damping=damping,
        nonlinear_damping=-fast.qfrc_damper - FAST * damping,
        stiffness=(rest.qfrc_actuator - moved.qfrc_actuator) / STEP,
        actuator_damping=actuator_damping,
        commanded_damping=damping_at_command - actuator_damping,
        peak_torque=_peak_torque(model),
        other_forces=float(
            np.max(
                np.abs(fast.qfrc_passive - fast.qfrc_spring - fast.qfrc_damper),
                initial=0.0,
            )
        ),
    )


def mass_matrix(
    model: mujoco.MjModel, data: mujoco.MjData
) -> Float[np.ndarray, "nv nv"]:
    """Return the mass matrix in a state, with armature and all else that MuJoCo adds to
    the bodies' inertia."""
    matrix = np.zeros((model.nv, model.nv))
    for stage in (
        mujoco.mj_kinematics,
        mujoco.mj_comPos,
        mujoco.mj_tendon,
        mujoco.mj_transmission,
        mujoco.mj_makeM,
    ):
        stage(model, data)
    mujoco.mj_fullM(model, data, matrix)
    return matrix


def _after(
    model: mujoco.MjModel,
    speed: float = 0.0,
    *,
    position: float = 0.0,
    command: float = 0.0,
) -> mujoco.MjData:
    """Return the state with all forces, with every hinge and slide moved from its drawn
    pose and every actuator commanded."""
    data, moved = mujoco.MjData(model), np.isin(model.jnt_type, ONE_COORDINATE)
    data.qpos[model.jnt_qposadr[moved]] += position
    data.qvel[model.jnt_dofadr[moved]] = speed
    data.ctrl[:] = data.act[:] = command
    for stage in (mujoco.mj_fwdPosition, mujoco.mj_fwdVelocity, mujoco.mj_fwdActuation):
        stage(model, data)
    return data


def _peak_torque(model: mujoco.MjModel) -> Dofs:
    """Return the peak torque on each velocity coordinate, Nm, that the actuators' and
    joints' limits allow either way."""
    servo = (model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE) | (
        model.actuator_gaintype == mujoco.mjtGain.mjGAIN_PID
    )
    strained = copy.copy(model)
    # its commands are positions and speeds, not torques
    for actuator in np.flatnonzero(servo):
        first = model.actuator_ctrladr[actuator]
        strained.actuator_ctrllimited[
            first : first + model.actuator_ctrlnum[actuator]
        ] = False
    peak = np.full(model.nv, np.inf)
    for command in (-EXTREME_COMMAND, EXTREME_COMMAND):
        data = _after(strained, command=command)
        moments = np.zeros((len(data.moment_rownnz), model.nv))
        mujoco.mju_sparse2dense(
            moments,
            data.actuator_moment.ravel(),
            data.moment_rownnz,
            data.moment_rowadr,
            data.moment_colind.ravel(),
        )
        torques = np.abs(moments * data.actuator_force[:, None])
        # the actuator does not act on this coordinate, or has no limit
        torques[(torques == 0.0) | (torques > ENDLESS)] = np.inf
        peak = np.minimum(peak, np.min(torques, axis=0, initial=np.inf))
    for j in np.flatnonzero(model.jnt_actfrclimited):
        limit = np.min(np.abs(model.jnt_actfrcrange[j]))
        peak[model.jnt_dofadr[j]] = min(
            peak[model.jnt_dofadr[j]], limit if limit > 0.0 else np.inf
        )
    return peak
