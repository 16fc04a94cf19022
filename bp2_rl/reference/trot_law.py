"""The law of the kinematic trot (see `kinematic_trot`), for training and for a robot's
own computer alike.

Functions take arrays of NumPy or JAX and import neither JAX nor jaxtyping; a command is
("... 3"): m/s forward, m/s to the left, rad/s. Rates are derivatives by time; the
caller passes the function that differentiates, since NumPy has none.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from bp2_rl.base.arrays import Array
from bp2_rl.reference.stepping import TROT, ground, square_speed
from bp2_rl.robot.anatomy import LegGeometry
from bp2_rl.robot.conventions import GRAVITY

# of abad, hip, knee: draws the foot straight towards the hip
FLEXION = np.array([0.0, -0.5, 1.0])

Differentiate = Callable[
    [Callable[..., Array], tuple[Array, ...], tuple[Array, ...]], tuple[Array, Array]
]
"""A function such as `jax.jvp`: from a function, its arguments and their rates to its
values and their rates."""


@dataclasses.dataclass(frozen=True, eq=False)
class TrotLaw:
    """A robot's kinematic trot as plain numbers; `settings.reference.KinematicConfig`
    explains the fields that are settings."""

    legs: LegGeometry
    nominal: Array  # (4, 2), m, where the feet are set, seen from above
    # (4), m, height of a standing leg's sole: a foot's sphere touches the ground
    # elsewhere
    sole_clearance: Array
    circle: float  # m, distance of the outermost foot from the trunk's centre
    height: float  # m, of this robot's trunk
    sweep: float  # m, of this robot's feet
    slow_stance: float  # s
    swing_time: float  # s
    flexion: float  # rad
    follow_through: int
    landing: float
    stepping_speed: float  # m/s
    # m, compression of a spring that carries a quarter of the robot; 0 where shanks are
    # rigid
    sag: float
    spring_travel: float  # m

    def stance_time(self, command: Array) -> Array:
        """Return the duration of stance at a command, s: about the lesser of
        `slow_stance` and the time that the sweep takes."""
        xp = command.__array_namespace__()
        return self.slow_stance / xp.sqrt(
            1.0
            + square_speed(command, self.circle) * (self.slow_stance / self.sweep) ** 2
        )

    def phase_rate(self, command: Array) -> Array:
        """Return the frequency of the gait at a command, cycles per second."""
        return 1.0 / (self.stance_time(command) + self.swing_time)

    def stepping(self, command: Array) -> Array:
        """Return the size of the steps at a command: 0 when standing, close to 1 on the
        move."""
        s2 = square_speed(command, self.circle)
        return s2 / (s2 + self.stepping_speed**2)

    def at_rest(self, command: Array) -> Array:
        """Return the constant part of a spring's compression at a command, m: all of
        the compression when standing."""
        return (1.0 - self.stepping(command)) * self.sag

    def trunk_height(self, command: Array, tau: Array) -> Array:
        """Return the height of the trunk's centre above the ground, m, `tau` seconds
        after mid-stance of either pair of legs.

        Rise and fall are the first harmonic of the answer to the legs' force: of
        relative size 2 for short impulses and 2/3 for half sines that follow each other
        without a gap.
        """
        xp, period = tau.__array_namespace__(), 1.0 / self.phase_rate(command)
        harmonic = 2.0 - 4.0 / 3.0 * (2.0 * self.stance_time(command) / period) ** 2
        amplitude = (
            self.stepping(command) * harmonic * GRAVITY * (period / (4.0 * np.pi)) ** 2
        )
        return self.height - amplitude * xp.cos(4.0 * np.pi / period * tau)

    def in_stance(self, command: Array, phase: Array) -> tuple[Array, Array]:
        """Return which legs ("... 4") are in stance at a phase in [0, 1), and how long
        ago each touched down, s."""
        xp, stance_time = phase.__array_namespace__(), self.stance_time(command)
        period = stance_time + self.swing_time
        leg_phase = phase[..., None] + xp.asarray(TROT, dtype=phase.dtype)
        since_touchdown = (leg_phase - xp.floor(leg_phase)) * period[..., None]
        return since_touchdown < stance_time[..., None], since_touchdown

    def joints(
        self, command: Array, phase: Array, differentiate: Differentiate
    ) -> tuple[Array, Array, Array, Array]:
        """Joint angles (rad, "... 4 3") and speeds, and springs' compressions (m, "...
        4") and rates, at a phase.

        The phase is in [0, 1); `differentiate` takes the rates.
        """
        xp, stance_time = phase.__array_namespace__(), self.stance_time(command)
        in_stance, since_touchdown = self.in_stance(command, phase)
        # A foot's stance now, at lift-off and at touchdown in one batch, with rates.
        half = 0.0 * since_touchdown + stance_time[..., None] / 2.0
        tau = xp.stack(
            [xp.where(in_stance, since_touchdown - half, 0.0), half, -half], axis=-2
        )
        (q, spring), (qd, spring_rate) = differentiate(
            lambda t: self._stance(command, t), (tau,), (xp.ones_like(tau),)
        )
        s = xp.where(in_stance, 0.0, (since_touchdown - 2.0 * half) / self.swing_time)
        q_swing, qd_swing = self._swing(
            command,
            s,
            (q[..., 1, :, :], qd[..., 1, :, :]),
            (q[..., 2, :, :], qd[..., 2, :, :]),
        )
        stands = in_stance[..., None]
        return (
            xp.where(stands, q[..., 0, :, :], q_swing),
            xp.where(stands, qd[..., 0, :, :], qd_swing),
            xp.where(in_stance, spring[..., 0, :], self.at_rest(command)[..., None]),
            xp.where(in_stance, spring_rate[..., 0, :], 0.0),
        )

    def _stance(self, command: Array, tau: Array) -> tuple[Array, Array]:
        """Joint angles (rad) and spring compressions (m) of legs `tau` ("... k 4", s)
        from mid-stance."""
        xp = tau.__array_namespace__()
        command = command[..., None, :]
        stance_time = self.stance_time(command)
        mean = (
            self.stepping(command) * self.sag / (stance_time * self.phase_rate(command))
        )
        most = 1.2 * self.spring_travel  # beyond, the stop takes the force
        mean = mean * (1.0 + (1.5 * mean / most) ** 8) ** -0.125
        w = 1.0 - (2.0 * tau / stance_time[..., None]) ** 2
        pulse = (
            w
            * (self.landing + (1.0 - self.landing) * w)
            / (2.0 / 3.0 - 2.0 / 15.0 * (1.0 - self.landing))
        )
        spring = self.at_rest(command)[..., None] + mean[..., None] * pulse

        nominal = xp.asarray(self.nominal, dtype=tau.dtype)
        seen_from_above = ground(nominal, command[..., :2], command[..., 2:], tau)
        z = xp.asarray(self.sole_clearance, dtype=tau.dtype) - self.trunk_height(
            command[..., None, :], tau
        )
        feet = xp.concat([seen_from_above, z[..., None]], axis=-1)
        return self.legs.joint_angles(feet, spring), spring

    def _swing(
        self,
        command: Array,
        s: Array,
        lift_off: tuple[Array, Array],
        touchdown: tuple[Array, Array],
    ) -> tuple[Array, Array]:
        """Joint angles and speeds at the share `s` ("... 4") of a swing between two
        pairs (angles, speeds).

        Speed is out (1 - s)^n + back s^n + mean 30 s^2 (1 - s)^2, plus that of the
        flexion 16 s^2 (1 - s)^2, which leaves every knee in mid-swing bent by `flexion`
        beyond its mean at lift-off and touchdown.
        """
        xp = s.__array_namespace__()
        (start, out), (end, back) = lift_off, touchdown
        n, time = self.follow_through, self.swing_time
        mean = (end - start) / time - (out + back) / (n + 1)
        # what the follow-through leaves in mid-swing
        followed = time / (n + 1) * (out - back) / 2.0
        bend = self.legs.bend
        flexion = (self.stepping(command) * self.flexion)[..., None]
        flexion = flexion - xp.asarray(bend, dtype=s.dtype) * followed[..., 2]
        flexion = flexion[..., None] * xp.asarray(
            np.outer(bend, FLEXION), dtype=s.dtype
        )
        s = s[..., None]
        r = 1.0 - s
        q = start + time / (n + 1) * (out * (1.0 - r ** (n + 1)) + back * s ** (n + 1))
        q = (
            q
            + time * mean * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
            + flexion * 16.0 * (s * r) ** 2
        )
        qd = (
            out * r**n
            + back * s**n
            + mean * 30.0 * (s * r) ** 2
            + flexion / time * 32.0 * s * r * (r - s)
        )
        return q, qd
