"""The simulator with Drake's multibody dynamics and contact instead of MuJoCo's, for
comparison.

Motors, losses, latencies and controller are those of `simulation.simulator`, and so is
the law of springs and stops. Drake takes over what MuJoCo has computed: equations of
motion, contact, friction and joint limits. The plant is built from the numbers of the
compiled MuJoCo model, link by link; no code of dynamics is shared.

    normal     f = k x (1 + d x')+                                Hunt and Crossley, at depth x
    friction   |f_t| <= mu f, regularised below the speed v_s     `STICTION`

The step is semi-implicit Euler, as MuJoCo's, with velocities and contact forces solved
for at the step's end. A joint's limit is as stiff as the step allows.
"""

import itertools
import logging
from collections.abc import Sequence
from typing import Any, ClassVar

import mujoco
import numpy as np
from jaxtyping import Float, Int

from bp2_rl.base.errors import UserError, not_installed
from bp2_rl.robot.coordinates import POSE, TWIST, motor_indices
from bp2_rl.robot.model import foot_geom_ids
from bp2_rl.simulation.backend import Backend
from bp2_rl.simulation.simulator import STATE, RobotBatch, RobotSetup, Simulator

try:
    from pydrake import geometry
    from pydrake.math import RigidTransform, RotationMatrix
    from pydrake.multibody import plant as multibody
    from pydrake.multibody import tree
    from pydrake.systems.framework import DiagramBuilder
except ModuleNotFoundError as missing:
    raise not_installed("--backend drake", "drake", "drake") from missing

# Drake warns about ground in models without deformable bodies.
logging.getLogger("drake").setLevel(logging.ERROR)

SHARE = 0.075
"""Share of the robot's mass from which, with its `contact_time`, the ground's stiffness
follows: 300 kN/m for BP2 at 3 ms"""
DISSIPATION = 0.5
"""Hunt and Crossley's d, s/m: a foot leaves the ground at no more than the reciprocal."""
STICTION = 1e-3
"""m/s: slip that friction needs to reach its limit"""
_Geom, _Joint = mujoco.mjtGeom, mujoco.mjtJoint


class DrakeSimulator(Simulator):
    """N robots whose dynamics and contact Drake computes; all else is as in
    `Simulator`.

    Raises:
        UserError: a robot stands on rough ground, which this simulator lacks.
    """

    backend: ClassVar[Backend] = "drake"

    def __init__(
        self,
        robots: Sequence[RobotSetup],
        models: Sequence[mujoco.MjModel] | None = None,
    ):
        super().__init__(robots, models)
        if any(robot.world.ground for robot in robots):
            raise UserError(
                "Drake has flat ground and slopes alone; use --backend mujoco"
            )
        self._plants = [
            DrakeRobot(model, robot.config.hardware.contact_time)
            for model, robot in zip(self.models, robots, strict=True)
        ]
        self._computed = [mujoco.MjData(model) for model in self.models]

    def _advance(
        self,
        batch: RobotBatch,
        at: Int[np.ndarray, " K"],
        robots: Int[np.ndarray, " K"],
    ) -> Float[np.ndarray, "K _"]:
        forces = np.empty((len(at), batch.sensed.shape[1]))
        for robot, place, force in zip(
            robots.tolist(), at.tolist(), forces, strict=True
        ):
            data, model = self._computed[robot], self.models[robot]
            mujoco.mj_setState(model, data, batch.state[place], STATE)
            for _ in range(batch.steps):
                self._plants[robot].step(data)
            mujoco.mj_getState(model, data, batch.state[place], STATE)
            force[:] = data.sensordata
        return forces

    def _mobilities(
        self,
        batch: RobotBatch,
        at: Int[np.ndarray, " K"],
        robots: Int[np.ndarray, " K"],
    ) -> Float[np.ndarray, "K 12"]:
        masses = [self._plants[robot].mass_matrix() for robot in robots.tolist()]
        inverse = np.diagonal(np.linalg.inv(np.stack(masses)), axis1=1, axis2=2)
        return inverse[:, motor_indices(inverse.shape[1])]


class DrakeRobot:
    """A compiled MuJoCo model rebuilt as a Drake plant, which advances the state in
    MuJoCo's data by one physics step.

    Drake's coordinates are MuJoCo's in another order, with the trunk's angular velocity
    in the world's frame.

    Args:
        model: free trunk, hinges, slides; springs at joints and one-sided ones at
            tendons of one joint.
        contact_time: s, of the robot; with its mass it gives the ground's stiffness.
    """

    def __init__(self, model: mujoco.MjModel, contact_time: float):
        stiffness = SHARE * float(np.sum(model.body_mass)) / contact_time**2
        builder = DiagramBuilder()
        self._plant, scene = multibody.AddMultibodyPlantSceneGraph(
            builder, model.opt.timestep
        )
        plant = self._plant
        # in the others slip lifts a foot
        plant.set_discrete_contact_approximation(
            multibody.DiscreteContactApproximation.kLagged
        )
        plant.set_contact_model(multibody.ContactModel.kPoint)
        plant.set_stiction_tolerance(STICTION)
        # contact forces are asked for before the step that they act in
        plant.SetUseSampledOutputPorts(False)
        plant.mutable_gravity_field().set_gravity_vector(model.opt.gravity)
        bodies = _add_bodies(plant, model)
        joints = _add_joints(plant, model, bodies)
        ids = _add_contacts(plant, model, bodies, stiffness)
        _exclude_collisions(scene, model, ids)
        plant.Finalize()
        self._diagram = builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self._context = plant.GetMyMutableContextFromRoot(self._root)
        self._applied = plant.get_applied_generalized_force_input_port()
        self._results = plant.get_contact_results_output_port()
        self._floor = ids[model.geom("floor").id]
        self._feet = {
            ids[foot]: leg for leg, foot in enumerate(foot_geom_ids(model).tolist())
        }
        # Where MuJoCo's coordinates are in Drake's, which has a rotation before a
        # translation.
        trunk, *legs = joints
        q, v = trunk.position_start(), trunk.velocity_start()
        self._q = np.r_[
            q + 4 : q + 7, q : q + 4, [joint.position_start() for joint in legs]
        ]
        self._v = np.r_[
            v + 3 : v + 6, v : v + 3, [joint.velocity_start() for joint in legs]
        ]
        self._model = model
        # from MuJoCo's velocities to Drake's, but for their order
        self._turn = np.eye(model.nv)

    def mass_matrix(self) -> Float[np.ndarray, "nv nv"]:
        """Return the mass matrix of the state last set, in MuJoCo's coordinates."""
        matrix = self._plant.CalcMassMatrix(self._context)[np.ix_(self._v, self._v)]
        return self._turn.T @ matrix @ self._turn

    def set_state(
        self, qpos: Float[np.ndarray, " nq"], qvel: Float[np.ndarray, " nv"]
    ) -> None:
        """Set the plant's state from positions and velocities in MuJoCo's
        coordinates."""
        self._turn[3:TWIST, 3:TWIST] = _rotation(qpos[3:POSE])
        q, v = np.empty_like(qpos), np.empty_like(qvel)
        q[self._q], v[self._v] = qpos, self._turn @ qvel
        self._plant.SetPositionsAndVelocities(self._context, np.concatenate([q, v]))

    def step(self, data: mujoco.MjData) -> None:
        """Advance `data` by one physics step under its `ctrl` and `qfrc_applied`, and
        write the foot forces to `sensordata`."""
        self.set_state(data.qpos, data.qvel)
        mujoco.mj_tendon(self._model, data)
        mujoco.mj_passive(self._model, data)  # springs, and the stops of their tendons
        forces = data.qfrc_applied + data.qfrc_spring
        forces[motor_indices(len(forces))] += data.ctrl
        generalized = np.empty_like(forces)
        generalized[self._v] = self._turn @ forces
        self._applied.FixValue(self._context, generalized)
        data.sensordata[:] = self._ground_forces().ravel()
        after = (
            self._plant.EvalUniquePeriodicDiscreteUpdate(self._context)
            .get_vector(0)
            .value()
        )
        q, v = np.split(after, [len(data.qpos)])
        data.qpos[:], data.qvel[:] = q[self._q], v[self._v]
        mujoco.mju_normalize4(data.qpos[3:POSE])
        data.qvel[3:TWIST] = _rotation(data.qpos[3:POSE]).T @ data.qvel[3:TWIST]
        data.time += self._model.opt.timestep

    def _ground_forces(self) -> Float[np.ndarray, "4 3"]:
        """Return the ground's force on each foot in the step that begins in the state
        last set, N, world frame."""
        forces = np.zeros((4, 3))
        results = self._results.Eval(self._context)
        for i in range(results.num_point_pair_contacts()):
            contact = results.point_pair_contact_info(i)
            pair, force = contact.point_pair(), contact.contact_force()
            pushed, pushing = pair.id_B, pair.id_A
            if pushing == self._floor and pushed in self._feet:
                forces[self._feet[pushed]] += force
            elif pushed == self._floor and pushing in self._feet:
                forces[self._feet[pushing]] -= force
        return forces


def _add_bodies(
    plant: multibody.MultibodyPlant, model: mujoco.MjModel
) -> list[tree.RigidBody]:
    """Add the model's links to the plant; return the plant's body for each MuJoCo
    body."""
    bodies = [plant.world_body()]
    for i in range(1, model.nbody):
        axes = _rotation(model.body_iquat[i])
        inertia = axes @ np.diag(model.body_inertia[i]) @ axes.T
        central = tree.RotationalInertia(
            *np.diag(inertia).tolist(), *inertia[np.triu_indices(3, 1)].tolist()
        )
        spatial = tree.SpatialInertia.MakeFromCentralInertia(
            model.body_mass[i], model.body_ipos[i], central
        )
        bodies.append(plant.AddRigidBody(model.body(i).name, spatial))
    return bodies


def _add_joints(
    plant: multibody.MultibodyPlant,
    model: mujoco.MjModel,
    bodies: Sequence[tree.RigidBody],
) -> list[tree.Joint]:
    """Add the model's joints with dampers, limits and rotor inertias; return them in
    MuJoCo's order, the free joint first."""
    joints = []
    for i in range(model.njnt):
        body = int(model.jnt_bodyid[i])
        name = model.joint(i).name
        dof = int(model.jnt_dofadr[i])
        parent, child = bodies[model.body_parentid[body]], bodies[body]
        if model.jnt_type[i] == _Joint.mjJNT_FREE:
            joints.append(
                plant.AddJoint(
                    tree.QuaternionFloatingJoint(
                        name, parent.body_frame(), child.body_frame()
                    )
                )
            )
            continue
        at = _pose(model.body_pos[body], model.body_quat[body])
        frame = plant.AddFrame(
            tree.FixedOffsetFrame(f"{name}_seat", parent.body_frame(), at)
        )
        kind = (
            tree.RevoluteJoint
            if model.jnt_type[i] == _Joint.mjJNT_HINGE
            else tree.PrismaticJoint
        )
        ends = model.jnt_range[i] if model.jnt_limited[i] else (-np.inf, np.inf)
        joint = plant.AddJoint(
            kind(
                name,
                frame,
                child.body_frame(),
                model.jnt_axis[i],
                *ends,
                damping=float(model.dof_damping[dof]),
            )
        )
        rotor = plant.AddJointActuator(f"{name}_rotor", joint)
        rotor.set_default_rotor_inertia(model.dof_armature[dof])
        joints.append(joint)
    return joints


def _add_contacts(
    plant: multibody.MultibodyPlant,
    model: mujoco.MjModel,
    bodies: Sequence[tree.RigidBody],
    stiffness: float,
) -> dict[int, geometry.GeometryId]:
    """Add the colliding geoms to the plant, on ground of a stiffness (N/m); return
    Drake's geometry id for each MuJoCo geom."""
    feet = foot_geom_ids(model)
    ids = {}
    for geom in np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist():
        ground = model.geom_type[geom] == _Geom.mjGEOM_PLANE
        size = model.geom_size[geom]
        properties = geometry.ProximityProperties()
        friction = multibody.CoulombFriction(
            *2 * [model.geom_friction[feet[0] if ground else geom, 0]]
        )
        # Two that touch are springs in series.
        geometry.AddContactMaterial(DISSIPATION, 2.0 * stiffness, friction, properties)
        pose = _pose(model.geom_pos[geom], model.geom_quat[geom])
        ids[geom] = plant.RegisterCollisionGeometry(
            bodies[model.geom_bodyid[geom]],
            pose,
            _shape(int(model.geom_type[geom]), size),
            model.geom(geom).name,
            properties,
        )
    return ids


def _exclude_collisions(
    scene: geometry.SceneGraph,
    model: mujoco.MjModel,
    ids: dict[int, geometry.GeometryId],
) -> None:
    """Exclude from Drake's contact the pairs of geoms that pass through each other in
    MuJoCo."""
    body = model.geom_bodyid
    parent = model.body_parentid
    for one, other in itertools.combinations(ids, 2):
        meant = model.geom_contype[[one, other]] & model.geom_conaffinity[[other, one]]
        of, on = body[one], body[other]
        adjacent = (
            of == on or (of > 0 and of == parent[on]) or (on > 0 and on == parent[of])
        )
        if adjacent or not meant.any():
            pair = geometry.GeometrySet(ids[one]), geometry.GeometrySet(ids[other])
            scene.collision_filter_manager().Apply(
                geometry.CollisionFilterDeclaration().ExcludeBetween(*pair)
            )


def _shape(kind: int, size: Float[np.ndarray, "3"]) -> geometry.Shape:
    if kind == _Geom.mjGEOM_PLANE:
        return geometry.HalfSpace()
    return (
        geometry.Sphere(size[0])
        if kind == _Geom.mjGEOM_SPHERE
        else geometry.Capsule(size[0], 2.0 * size[1])
    )


def _rotation(quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _pose(at: Any, quaternion: Float[np.ndarray, "4"]) -> RigidTransform:
    return RigidTransform(RotationMatrix(_rotation(quaternion)), at)
