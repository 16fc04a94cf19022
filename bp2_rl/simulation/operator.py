"""The operator, who steers the robot along its line, because a policy knows neither its
place nor its heading."""

import dataclasses
from typing import Annotated

from bp2_rl.base.arrays import ArrayT, Number
from bp2_rl.base.bounds import Bounded, Within


@dataclasses.dataclass(frozen=True)
class HeadingHold(Bounded, path="--operator."):
    """Keeps a robot on the line through its start.

    yaw-rate command = -heading_gain x yaw - lane_gain x y, clipped; y is the distance
    to the left of the line. Added only to commands that ask for straight running (no
    lateral and no yaw part).
    """

    heading_gain: Annotated[float, Within(-1000.0, 1000.0)] = 4.0
    """yaw rate that a radian of wrong heading is answered with, 1/s"""
    lane_gain: Annotated[float, Within(-1000.0, 1000.0)] = 0.4
    """yaw rate for each metre beside the line, 1/(m s); heading_gain^2 / (4 v) is
    critical damping at a speed v"""
    limit: Annotated[float, Within(0.0, 1000.0)] = 0.5
    """largest yaw rate commanded, rad/s; 0: nobody steers"""

    def steer(self, command: ArrayT, y: Number, yaw: Number) -> ArrayT:
        """The command ("... 3") with the operator's yaw rate at a place and heading
        ("..."); numpy and jax alike."""
        xp = command.__array_namespace__()
        rate = xp.clip(
            -self.heading_gain * yaw - self.lane_gain * y, -self.limit, self.limit
        )
        straight = (command[..., 1] == 0.0) & (command[..., 2] == 0.0)
        return command + xp.where(straight, rate, 0.0)[..., None] * xp.asarray(
            [0.0, 0.0, 1.0], dtype=command.dtype
        )


HEADING_HOLD = HeadingHold()
