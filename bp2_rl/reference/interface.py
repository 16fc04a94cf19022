"""The interface of a reference motion: a function from command and phase to the motion
of the whole body."""

from typing import Protocol, runtime_checkable

from flax import struct
from jaxtyping import Array, Float

from bp2_rl.robot.hardware import HardwareSpec


class Reference(struct.PyTreeNode):
    """State of a reference motion at one command and phase. All leaves share the
    leading batch axes.

    Legs are in the order FR, FL, RR, RL, joints of a leg in the order abad, hip, knee.
    The heading frame has its x axis along the trunk's yaw and its z axis up.
    """

    joint_position: Float[Array, "... 12"]  # rad
    # rad/s, the exact time derivative of joint_position
    joint_velocity: Float[Array, "... 12"]
    spring_compression: Float[Array, "... 4"]  # m
    spring_velocity: Float[Array, "... 4"]  # m/s
    height: Float[Array, "..."]  # m, trunk centre above the ground
    height_velocity: Float[Array, "..."]  # m/s
    up: Float[Array, "... 3"]  # the trunk's vertical axis in the heading frame
    pitch: Float[Array, "..."]  # rad, about +y: nose down is positive
    pitch_rate: Float[Array, "..."]  # rad/s
    velocity: Float[Array, "... 3"]  # m/s, of the trunk's centre in the heading frame
    contact: Float[Array, "... 4"]  # 1 in stance, 0 in swing
    torque: Float[Array, "... 12"]  # Nm, feed-forward


@runtime_checkable
class ReferenceMotion(Protocol):
    """A family of periodic motions indexed by the command (vx, vy in m/s, yaw rate in
    rad/s)."""

    @property
    def hardware(self) -> HardwareSpec:
        """The robot whose motion this is."""
        ...

    @property
    def height(self) -> float:
        """Mean height of the trunk's centre above the ground, m; the least where it
        depends on the command."""
        ...

    def phase_rate(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Return the frequency of the gait at a command, cycles per second."""
        ...

    def stepping(self, command: Float[Array, "... 3"]) -> Float[Array, "..."]:
        """Return the size of the steps at a command, as a share of full steps: 0 when
        standing, 1 in a full trot."""
        ...

    def __call__(
        self, command: Float[Array, "... 3"], phase: Float[Array, "..."]
    ) -> Reference:
        """Return the reference at a command and a phase; the phase is in cycles, any
        real number, periodic with period 1."""
        ...
