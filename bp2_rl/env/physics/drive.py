"""Motor torque and resistance in a physics step, shared by all physics engines."""

from typing import NamedTuple

from jaxtyping import Array, Float

from bp2_rl.env import randomization
from bp2_rl.env.controller import Targets
from bp2_rl.env.randomization import Randomization
from bp2_rl.robot import conventions, losses
from bp2_rl.robot.actuator import Actuator, joint_torque
from bp2_rl.robot.coordinates import joint_positions, joint_velocities
from bp2_rl.robot.losses import Resistance


class Drive(NamedTuple):
    """A robot's motors, and the resistance to its motion, if it has any."""

    motors: Actuator
    resistance: Resistance | None

    def randomized(self, robot: Randomization) -> "Drive":
        """Return the drive of a robot with random parameters."""
        motors = randomization.randomize_actuator(self.motors, robot)
        resistance = self.resistance
        if resistance is not None:
            resistance = randomization.randomize_resistance(resistance, robot)
        return Drive(motors, resistance)

    def forces(
        self,
        last: Float[Array, "... 12"],
        qpos: Float[Array, "... nq"],
        qvel: Float[Array, "... nv"],
        issued: Targets,
    ) -> tuple[
        Float[Array, "... 12"], Float[Array, "... 12"], Float[Array, "... nv"] | None
    ]:
        """Return the motors' torque (Nm) and power (W) in a physics step that follows
        the targets `issued`, and the generalized forces of resistance, if the robot has
        any.

        `last` is the torque (Nm) of the physics step before.
        """
        q, qd = joint_positions(qpos), joint_velocities(qvel)
        torque = joint_torque(
            self.motors,
            last,
            q,
            qd,
            issued.position,
            issued.velocity,
            conventions.PHYSICS_STEP,
        )
        if self.resistance is None:
            return torque, torque * qd, None
        loss = losses.loss(self.resistance, qpos, qvel, torque)
        return torque, torque * qd, losses.generalized(loss, qvel)
