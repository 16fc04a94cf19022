"""Every number that says what BP2 is: once, with its unit and its source.

Numbers come from the paper ("Breaking speed scaling in quadrupedal robots via Huygens'
coupled-pendulum dynamics"), from arithmetic on it (DERIVED), or, where the paper is silent, from us
(ASSUMED, with the reason). `PROVENANCE` lists them all in reading order; everything assumed that can
matter is a field of `HardwareSpec` or `Motor` and so can be changed from the command line.

Conventions of the whole package: SI units; world z up, x forward, y left; quaternions w-x-y-z; legs in the
order FR, FL, RR, RL; joints of a leg in the order abad, hip, knee (then the passive spring).
"""

import dataclasses
from typing import Annotated, NamedTuple

from bp2_rl.bounds import Within, check_bounds
from bp2_rl.errors import UserError

LEGS = ("FR", "FL", "RR", "RL")
JOINTS = ("abad", "hip", "knee")
MOTOR_NAMES = tuple(f"{leg}_{joint}" for leg in LEGS for joint in JOINTS)
NUM_MOTORS = len(MOTOR_NAMES)


class Provenance(NamedTuple):
    """Where a number comes from."""

    symbol: str
    value: float
    unit: str
    source: str


PROVENANCE: list[Provenance] = []


def _number(symbol: str, value: float, unit: str, source: str) -> float:
    PROVENANCE.append(Provenance(symbol, value, unit, source))
    return value


# --- The quarter robot of Table S3: a quarter of the trunk, one thigh, shank and toe -------------------------
TRUNK_QUARTER_MASS = _number("m_0", 6.15, "kg", "paper, Table S3")
THIGH_MASS = _number("m_1", 2.2, "kg", "paper, Table S3")
SHANK_MASS = _number("m_2", 0.1, "kg", "paper, Table S3")
TOE_MASS = _number("m_3", 0.5, "kg", "paper, Table S3")
TRUNK_QUARTER_INERTIA = _number("I_0", 0.10, "kg m2", "paper, Table S3; about its own centre of mass")
THIGH_INERTIA = _number("I_1", 0.014, "kg m2", "paper, Table S3")
SHANK_INERTIA = _number("I_2", 2e-5, "kg m2", "paper, Table S3")
TOE_INERTIA = _number("I_3", 1e-5, "kg m2", "paper, Table S3")
HIP_FORE_AFT = _number("L_0", 0.35, "m", "paper, Table S3; trunk centre to hip axis")
THIGH_LENGTH = _number("L_1", 0.35, "m", "paper, Table S3")
SHANK_LENGTH = _number("L_2", 0.10, "m", "paper, Table S3; knee to spring seat")
TOE_LENGTH = _number("L_3", 0.05, "m", "paper, Table S3; spring end to sole")
TRUNK_QUARTER_COM = _number("l_0", -0.10, "m", "paper, Table S3; from the hip, towards the trunk's centre")
THIGH_COM = _number("l_1", 0.024, "m", "paper, Table S3; from the hip, down the thigh")
SHANK_COM = _number("l_2", -0.05, "m", "paper, Table S3; from the spring seat, up towards the knee")
TOE_COM = _number("l_3", -0.02, "m", "paper, Table S3; from the sole, up the toe")
GEAR_RATIO = _number("r_1 = r_2", 8.5, "-", "paper, Table S3")
SPRING_STIFFNESS = _number("k_p", 6000.0, "N/m", "paper, Table S3; two springs of 3000 N/m in parallel")
SPRING_DAMPING = _number("k_d", 10.0, "N s/m", "paper, Table S3")

# --- The whole robot -----------------------------------------------------------------------------------------
TOTAL_MASS = _number("m", 36.0, "kg", "paper, Fig. 2; with battery (Table S3 adds up to 35.8)")
STANDING_HEIGHT = _number("h", 0.55, "m", "paper, Fig. 2")
BODY_LENGTH = _number("-", 0.80, "m", "paper, Fig. 2")
BODY_WIDTH = _number("-", 0.44, "m", "paper, Fig. 2")
GRAVITY = _number("g", 9.81, "m/s2", "standard, rounded")

# --- The motors, at the joint (behind the gear) --------------------------------------------------------------
PEAK_TORQUE = _number("tau_max", 120.0, "Nm", "paper, Table S1; the text's '250 Nm is 2.5 x peak' implies 100")
NO_LOAD_SPEED = _number("omega_0", 21.4, "rad/s", "paper, Table S1")
CORNER_SPEED = _number(
    "omega_c", 14.7, "rad/s", "DERIVED: a hind motor's 1765 W peak (Fig. 5E) over 120 Nm is the least corner"
)

# --- Control -------------------------------------------------------------------------------------------------
POLICY_RATE = _number("-", 200.0, "Hz", "paper, Experimental Platform")
FORCE_LOOP_RATE = _number("-", 1000.0, "Hz", "paper, Experimental Platform")
PHYSICS_STEP = 1.0 / FORCE_LOOP_RATE
CONTROL_STEP = 1.0 / POLICY_RATE
SUBSTEPS = round(FORCE_LOOP_RATE / POLICY_RATE)

# --- Published results, to compare with ----------------------------------------------------------------------
OUTDOOR_TOP_SPEED = _number("v", 10.74, "m/s", "paper, Abstract")
TREADMILL_TOP_SPEED = _number("v", 13.2, "m/s", "paper, Results")
SPRINT_100M_TIME = _number("t_100", 12.2, "s", "paper, Abstract")
LAUNCH_ACCELERATION = _number("a", 2.38, "m/s2", "paper, Results; mean over the first 5 m")

# --- What the paper does not say -----------------------------------------------------------------------------
SPRING_REST_LENGTH = _number(
    "-", 0.20, "m", "ASSUMED: lower leg = thigh = 0.35 m, the equal-length leg that stands at 0.55 m"
)
ROTOR_INERTIA = _number(
    "I_m", 2e-4, "kg m2", "ASSUMED: motor side, a frameless motor of this class; x gear^2 at the joint"
)
SPRING_STOP_STIFFNESS = _number("-", 30e3, "N/m", "ASSUMED: rubber buffer, 5 x the spring, one-sided")
SPRING_TRAVEL = _number("-", 0.13, "m", "ASSUMED: 65 % of the rest length; 0.11 m are used at 10 m/s")
ABAD_MASS = _number("-", 0.9, "kg", "ASSUMED: abduction link with the hip motor's stator; taken from the trunk")
ABAD_INERTIA = _number("-", 0.0015, "kg m2", "ASSUMED: a 0.9 kg cylinder of 0.05 m radius")
ABAD_COM_FORE_AFT = _number("-", -0.05, "m", "ASSUMED: from the hip, towards the trunk's centre")
FRONT_HIP_LATERAL = _number("-", 0.115, "m", "ASSUMED: trunk's mid-plane to the front abduction axis")
HIND_HIP_LATERAL = _number("-", 0.080, "m", "ASSUMED: narrower than the front, as the paper says")
THIGH_LATERAL = _number("-", 0.080, "m", "ASSUMED: abduction axis to the leg's plane, outwards")
THIGH_TWIST_INERTIA = _number("-", 0.003, "kg m2", "ASSUMED: about its length, 2.2 kg of motors 0.05 m in radius")
SHANK_TWIST_INERTIA = _number("-", 5e-6, "kg m2", "ASSUMED: about its length, a 0.1 kg rod of 0.01 m radius")
FOOT_RADIUS = _number("-", 0.02, "m", "ASSUMED: sphere whose lowest point is the sole")
FOOT_FRICTION = _number("mu", 0.9, "-", "ASSUMED: cleats on track or concrete")
TRUNK_ROLL_INERTIA = _number("-", 0.20, "kg m2", "ASSUMED: 20 kg box of 0.20 m x 0.16 m, plus battery and covers")
TRUNK_YAW_INERTIA = _number("-", 1.70, "kg m2", "ASSUMED: as pitch, plus what the width adds")
ABAD_RANGE = (-0.7, 0.7)  # rad, ASSUMED: clears the opposite leg
HIP_RANGE = (-1.4, 2.4)  # rad, ASSUMED: positive swings the foot back
KNEE_RANGE = (-2.6, -0.1)  # rad, ASSUMED: never straight, never folded flat

STAND_HIP = _number("-", 0.62, "rad", "DERIVED: settles at 0.55 m under joint PD (250 Nm/rad), foot below the hip")
STAND_KNEE = -2.0 * STAND_HIP
STAND_JOINTS = (0.0, STAND_HIP, STAND_KNEE) * len(LEGS)

QUARTER_MASS = TRUNK_QUARTER_MASS + THIGH_MASS + SHANK_MASS + TOE_MASS  # kg, DERIVED
TRUNK_PITCH_INERTIA = 4.0 * (
    TRUNK_QUARTER_INERTIA + TRUNK_QUARTER_MASS * (HIP_FORE_AFT + TRUNK_QUARTER_COM) ** 2
)  # kg m2, DERIVED: four quarters about the trunk's centre, abduction links included


@dataclasses.dataclass(frozen=True)
class HardwareSpec:
    """The parameters of BP2's body that a designer may change; the defaults are BP2.

    The motor itself stays: a gear ratio g gives g/8.5 times the joint torque at 8.5/g times the speed. The bounds are
    those of what can be computed, not of what can be built.
    """

    gear_ratio: Annotated[float, Within(0.1, 1000.0)] = GEAR_RATIO
    leg_length: Annotated[float, Within(0.0, 10.0)] = THIGH_LENGTH
    """m, of the thigh and of the uncompressed lower leg alike"""
    spring_stiffness: Annotated[float, Within(100.0, 1e7)] = SPRING_STIFFNESS  # N/m
    spring_damping: Annotated[float, Within(0.0, 1e5)] = SPRING_DAMPING  # N s/m
    spring_travel: Annotated[float, Within(0.0, 10.0)] = SPRING_TRAVEL  # m, at which the stop begins to push
    spring_stop_stiffness: Annotated[float, Within(0.0, 1e8)] = SPRING_STOP_STIFFNESS  # N/m, on top of the spring's
    rotor_inertia: Annotated[float, Within(0.0, 0.1)] = ROTOR_INERTIA  # kg m2, motor side
    peak_torque: Annotated[float, Within(0.1, 1e5)] = PEAK_TORQUE  # Nm, at the joint with the gear of 8.5
    corner_speed: Annotated[float, Within(0.0, 1e4)] = CORNER_SPEED  # rad/s likewise; 0 is the straight back-EMF line
    no_load_speed: Annotated[float, Within(0.1, 1e4)] = NO_LOAD_SPEED  # rad/s likewise
    mass_scale: Annotated[float, Within(0.01, 100.0)] = 1.0  # of every body, inertias alike
    friction: Annotated[float, Within(0.01, 10.0)] = FOOT_FRICTION

    def __post_init__(self) -> None:
        """Refuse what cannot be built."""
        check_bounds(self, "hardware.")
        if self.corner_speed >= self.no_load_speed:
            raise UserError(
                f"hardware.corner_speed ({self.corner_speed}) must be below no_load_speed ({self.no_load_speed})"
            )
        shortest = SHANK_LENGTH + TOE_LENGTH + self.spring_travel
        if self.leg_length <= shortest:
            raise UserError(
                f"hardware.leg_length ({self.leg_length}) must exceed shank + toe + spring travel = {shortest:.3f} m"
            )

    @property
    def reflected_inertia(self) -> float:
        """Rotor inertia at the joint, kg m2."""
        return self.rotor_inertia * self.gear_ratio**2

    @property
    def joint_peak_torque(self) -> float:
        """Peak torque at the joint behind this gear, Nm."""
        return self.peak_torque * self.gear_ratio / GEAR_RATIO

    @property
    def joint_corner_speed(self) -> float:
        """Speed up to which the peak torque is available, at the joint, rad/s."""
        return self.corner_speed * GEAR_RATIO / self.gear_ratio

    @property
    def joint_no_load_speed(self) -> float:
        """Speed at which no driving torque is left, at the joint, rad/s."""
        return self.no_load_speed * GEAR_RATIO / self.gear_ratio


BP2 = HardwareSpec()
