"""Every number that says what BP2 is: once, with its unit and its source.

Numbers come from the paper ("Breaking speed scaling in quadrupedal robots via Huygens'
coupled-pendulum dynamics"), from arithmetic on it (DERIVED), or, where the paper is silent, from us
(ASSUMED, with the reason). `PROVENANCE` lists them all in reading order; everything assumed that can
matter is a field of `HardwareSpec` or `Motor` and so can be changed from the command line.

Conventions of the whole package: SI units; world z up, x forward, y left; quaternions w-x-y-z; legs in the
order FR, FL, RR, RL; joints of a leg in the order abad, hip, knee (then the passive spring).
"""

import dataclasses
from typing import Annotated, Literal, NamedTuple

from bp2_rl.base.bounds import Within, check_bounds
from bp2_rl.base.errors import UserError

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
AIR_DENSITY = _number("rho", 1.2, "kg/m3", "standard, rounded: 20 C at sea level")

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
ENDURANCE_TIME = _number("-", 86.0, "s", "paper, Results; above 10 m/s on the treadmill")
HEATING_RATE = _number("-", 1.8, "K/s", "paper, Results; of a rear hip's motor, over those 86 s, nearly linear")
HIND_PEAK_POWERS = tuple(
    _number("P", power, "W", "paper, Results; peak of a hind leg's motor (Fig. 5E)") for power in (1620.0, 1765.0)
)

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
FORE_TRACK = _number("-", 0.39, "m", "ASSUMED: between the fore legs' planes; 0.44 m over all with their covers")
HIND_TRACK = _number("-", 0.32, "m", "ASSUMED: track of the hind feet, narrower than the front, as the paper says")
THIGH_LATERAL = _number("-", 0.080, "m", "ASSUMED: abduction axis to the leg's plane, outwards")
THIGH_TWIST_INERTIA = _number("-", 0.003, "kg m2", "ASSUMED: about its length, 2.2 kg of motors 0.05 m in radius")
SHANK_TWIST_INERTIA = _number("-", 5e-6, "kg m2", "ASSUMED: about its length, a 0.1 kg rod of 0.01 m radius")
FOOT_RADIUS = _number("-", 0.02, "m", "ASSUMED: sphere whose lowest point is the sole")
THIGH_RADIUS = _number("-", 0.018, "m", "ASSUMED: of a solid leg's capsule from hip to knee, half the shell's width")
LOWER_LEG_RADIUS = _number("-", 0.0145, "m", "ASSUMED: radius from knee to foot, that of the spring's coils")
SHANK_REACH = _number("-", 0.17, "m", "ASSUMED: knee to the end of the tubes that guide the spring")
RODS_BELOW_KNEE = _number(
    "-", 0.15, "m", "ASSUMED: knee to the upper end of the toe's rods, spring at rest: the longest that clear the knee"
)
LEG_FRICTION = _number("-", 0.3, "-", "ASSUMED: of a solid leg on anything, aluminium on carbon fibre, dry")
LEG_CONTACT_TIME = _number("-", 0.005, "s", "ASSUMED: MuJoCo's time constant of a solid leg, that of the foot")
TRUNK_RADIUS = _number("-", 0.07, "m", "ASSUMED: of the two capsules that stand for the trunk's box")
TRUNK_REACH = _number("-", 0.33, "m", "ASSUMED: trunk's centre to the ends of their axes; 0.80 m over all")
TRUNK_LATERAL = _number("-", 0.04, "m", "ASSUMED: trunk's mid-plane to their axes; 0.22 m wide over all")
CONTACT_TIME = _number("-", 0.005, "s", "ASSUMED: MuJoCo's time constant of foot on ground; 15 mm under 6 body weights")
FOOT_FRICTION = _number("mu", 0.9, "-", "ASSUMED: cleats on track or concrete")
TRUNK_ROLL_INERTIA = _number("-", 0.20, "kg m2", "ASSUMED: 20 kg box of 0.20 m x 0.16 m, plus battery and covers")
TRUNK_YAW_INERTIA = _number("-", 1.70, "kg m2", "ASSUMED: as pitch, plus what the width adds")
AMBIENT = _number("T_a", 25.0, "C", "ASSUMED: where 86 s at 1.8 K/s end at the limit of class H")
WINDING_LIMIT = _number("-", 180.0, "C", "standard: insulation class H of IEC 60085")
WINDING_CAPACITY = _number("C_w", 96.25, "J/K", "ASSUMED: 0.25 kg of copper at 385 J/kg/K")
CASE_CAPACITY = _number("C_c", 350.0, "J/K", "ASSUMED: 0.75 kg of stator iron, magnets and housing at 470 J/kg/K")
CASE_TO_AIR = _number("R_ca", 1.0, "K/W", "ASSUMED: 0.03 m2 in a wind of 10 m/s, 35 W/m2/K")
COPPER_GROWTH = _number("a", 3.9e-3, "1/K", "standard, rounded: annealed copper at 20 C, IEC 60028")
MAGNET_LOSS = _number("b", 1.1e-3, "1/K", "ASSUMED: NdFeB, remanence's reversible loss")
LEAST_TRUNK = _number("-", 7.2, "kg", "ASSUMED: twice its abduction links; what the heaviest legs leave it")
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
class Losses:
    """What a machine loses between its battery and the road, and how late its motors are.

    The laws are in `robot.losses` and, for the bus, in `robot.actuator`.
    """

    drag_area: Annotated[float, Within(0.0, 10.0)] = 0.0  # m2, drag coefficient x frontal area
    headwind: Annotated[float, Within(-50.0, 50.0)] = 0.0  # m/s, of air that blows towards -x
    gear_efficiency: Annotated[float, Within(0.1, 1.0)] = 1.0  # of the torque, driving and braking alike
    joint_friction: Annotated[float, Within(0.0, 1000.0)] = 0.0  # Nm, Coulomb's, at the joint
    joint_viscosity: Annotated[float, Within(0.0, 10.0)] = 0.0  # Nm s/rad, at the joint
    spring_friction: Annotated[float, Within(0.0, 1e4)] = 0.0  # N, Coulomb's, of the slide that guides the spring
    current_lag: Annotated[float, Within(0.0, 1.0)] = 0.0  # s, time constant of the torque behind its command
    latency: Annotated[float, Within(0.0, 0.020)] = 0.0
    """s, from an observation to the joint target it leads to; training draws `randomization.latency` in its place"""
    bus_power_out: Annotated[float, Within(1.0, 1e9, infinite=True)] = float("inf")  # W, from battery to motors
    bus_power_in: Annotated[float, Within(0.0, 1e9, infinite=True)] = float("inf")  # W, from motors to battery
    bus_sag: Annotated[float, Within(0.0, 1.0)] = 0.0  # share of the voltage that is lost per kW out


@dataclasses.dataclass(frozen=True)
class HardwareSpec:
    """The parameters of BP2's body that a designer may change.

    The motor itself stays: a gear ratio g gives g/8.5 times the joint torque at 8.5/g times the speed. The bounds are
    those of what can be computed, not of what can be built.
    """

    gear_ratio: Annotated[float, Within(0.1, 1000.0)] = GEAR_RATIO
    leg_length: Annotated[float, Within(0.0, 10.0)] = THIGH_LENGTH
    """m, of the thigh and of the uncompressed lower leg alike"""
    fore_track: Annotated[float, Within(2.0 * THIGH_LATERAL, 10.0)] = FORE_TRACK  # m, between the fore legs' planes
    hind_track: Annotated[float, Within(2.0 * THIGH_LATERAL, 10.0)] = HIND_TRACK  # m, between the hind feet
    solid_legs: bool = False
    """legs collide with each other and with the trunk in C MuJoCo; in training they end the episode instead"""
    spring_stiffness: Annotated[float, Within(100.0, 1e7)] = SPRING_STIFFNESS  # N/m
    spring_damping: Annotated[float, Within(0.0, 1e5)] = SPRING_DAMPING  # N s/m
    spring_travel: Annotated[float, Within(0.0, 10.0)] = SPRING_TRAVEL  # m, at which the stop begins to push
    spring_stop_stiffness: Annotated[float, Within(0.0, 1e8)] = SPRING_STOP_STIFFNESS  # N/m, on top of the spring's
    rebound_stiffness: Annotated[float, Within(0.0, 1e8)] = SPRING_STOP_STIFFNESS
    """N/m, of the stop at no compression that keeps the toe from flying off, on top of the spring's"""
    rebound_damping: Annotated[float, Within(0.0, 300.0)] = 0.0  # N s/m, of that stop; more is no stable step
    joint_stop_time: Annotated[float, Within(0.002, 1.0)] = 0.02
    """s, in which a joint limit takes up an excess: MuJoCo's time constant, critically damped"""
    rotor_inertia: Annotated[float, Within(0.0, 0.1)] = ROTOR_INERTIA  # kg m2, motor side
    peak_torque: Annotated[float, Within(0.1, 1e5)] = PEAK_TORQUE  # Nm, at the joint with the gear of 8.5
    corner_speed: Annotated[float, Within(0.0, 1e4)] = CORNER_SPEED  # rad/s, with that gear; 0: a straight line
    no_load_speed: Annotated[float, Within(0.1, 1e4)] = NO_LOAD_SPEED  # rad/s, with that gear
    braking_speed: Annotated[float, Within(0.1, 1e4, infinite=True)] = float("inf")
    """rad/s, at which no braking torque is left, on a line as the driving one's; inf: the peak at any speed"""
    envelope: Literal["start", "throughout"] = "start"
    """when in a millisecond torque keeps to the envelope: at its start only, or, in C MuJoCo, all the time"""
    mass_scale: Annotated[float, Within(0.01, 100.0)] = 1.0  # of every body, inertias alike
    thigh_mass: Annotated[float, Within(0.1, 10.0)] = THIGH_MASS
    """kg, before that scale: what legs gain the trunk loses, and inertias go with the masses"""
    toe_mass: Annotated[float, Within(0.05, 10.0)] = TOE_MASS  # kg, of one
    trunk_inertia: Annotated[float, Within(0.1, 1e4)] = 1.0
    """of the trunk's inertia, times what its mass makes of it; a large one guides the trunk, which then cannot pitch"""
    friction: Annotated[float, Within(0.01, 10.0)] = FOOT_FRICTION
    contact_time: Annotated[float, Within(0.002, 1.0)] = CONTACT_TIME
    """s, in which the ground takes up a foot's depth: MuJoCo's time constant"""
    contact_damping: Annotated[float, Within(0.01, 100.0)] = 1.0  # MuJoCo's damping ratio of that
    losses: Losses = Losses()

    def __post_init__(self) -> None:
        """Refuse what cannot be built."""
        check_bounds(self, "hardware.")
        for name in ("no_load_speed", "braking_speed"):
            if self.corner_speed >= getattr(self, name):
                raise UserError(
                    f"hardware.corner_speed ({self.corner_speed}) must be below {name} ({getattr(self, name)})"
                )
        most = QUARTER_MASS - SHANK_MASS - LEAST_TRUNK / 4.0
        if self.thigh_mass + self.toe_mass > most:
            raise UserError(
                f"hardware.thigh_mass ({self.thigh_mass:g}) and toe_mass ({self.toe_mass:g}) must leave the trunk "
                f"{LEAST_TRUNK:g} kg: together at most {most:g} kg"
            )
        shortest = SHANK_LENGTH + TOE_LENGTH + self.spring_travel
        if self.leg_length <= shortest:
            raise UserError(
                f"hardware.leg_length ({self.leg_length}) must exceed shank + toe + spring travel = {shortest:.3f} m"
            )

    @property
    def thigh_inertia(self) -> float:
        """Return a thigh's inertia about its centre of mass, across its length, kg m2, before masses are scaled."""
        return self.thigh_mass / THIGH_MASS * THIGH_INERTIA

    @property
    def toe_inertia(self) -> float:
        """Return a toe's inertia about its centre of mass, across its length, kg m2, before masses are scaled."""
        return self.toe_mass / TOE_MASS * TOE_INERTIA

    @property
    def trunk_quarter_mass(self) -> float:
        """What the legs leave the trunk's quarter, its abduction link included, kg."""
        return TRUNK_QUARTER_MASS + (THIGH_MASS - self.thigh_mass) + (TOE_MASS - self.toe_mass)

    @property
    def trunk_inertia_share(self) -> float:
        """Inertia of the trunk without its abduction links, over BP2's."""
        return self.trunk_inertia * (self.trunk_quarter_mass - ABAD_MASS) / (TRUNK_QUARTER_MASS - ABAD_MASS)

    @property
    def trunk_pitch_inertia(self) -> float:
        """Return the pitch inertia, kg m2, of the trunk with its abduction links about its centre."""
        links = 4.0 * (ABAD_INERTIA + ABAD_MASS * (HIP_FORE_AFT + ABAD_COM_FORE_AFT) ** 2)
        return TRUNK_PITCH_INERTIA + (self.trunk_inertia_share - 1.0) * (TRUNK_PITCH_INERTIA - links)

    @property
    def hip_laterals(self) -> tuple[float, float, float, float]:
        """How far left of the trunk's mid-plane each leg's abduction axis is, m, in the order of `LEGS`."""
        fore, hind = (round(track / 2 - THIGH_LATERAL, 12) for track in (self.fore_track, self.hind_track))
        return -fore, fore, -hind, hind

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

    @property
    def joint_braking_speed(self) -> float:
        """Speed at which no braking torque is left, at the joint, rad/s."""
        return self.braking_speed * GEAR_RATIO / self.gear_ratio


IDEAL = HardwareSpec()
"""BP2 without losses, on legs that pass through each other: what the paper's numbers alone make of it."""

BUILT = HardwareSpec(
    hind_track=0.28,  # the widest at which fore and hind legs hardly ever meet
    solid_legs=True,
    rebound_stiffness=150e3,  # a polyurethane buffer 20 mm deep ...
    rebound_damping=100.0,  # ... that gives back half of a hit
    joint_stop_time=0.005,  # a hard stop
    envelope="throughout",  # a drive's current loop is ten times as fast as the force loop
    friction=0.8,  # rubber on a dry track
    contact_time=0.003,  # rubber sole and track in series, some 300 kN/m
    losses=Losses(
        drag_area=0.2,  # 0.44 m x 0.3 m and four legs, at a drag coefficient of about 1
        gear_efficiency=0.92,  # a planetary stage of 8.5:1
        joint_friction=2.0,  # seals, bearings and cogging behind the gear
        joint_viscosity=0.05,  # grease
        spring_friction=20.0,  # a bushing under a leg's side load
        current_lag=0.002,  # drive and bus
        latency=0.005,  # one control step
        bus_power_out=8e3,  # a pack of about 1 kWh for seconds
        bus_power_in=3e3,  # cells are charged at less than half of what they give
        bus_sag=0.0125,  # a tenth at full load
    ),
)
"""BP2 as a machine that one could build: all of it ASSUMED, with published values in docs/notes/reality.md."""


@dataclasses.dataclass(frozen=True)
class MotorHeat:
    """A motor as two lumps that heat, winding and case; all twelve alike. The laws are in `robot.thermal`."""

    winding_capacity: Annotated[float, Within(10.0, 1e6)] = WINDING_CAPACITY  # J/K
    winding_to_case: Annotated[float, Within(0.05, 1e6)] | None = None
    """K/W; by default such that a rear hip heats at the paper's 1.8 K/s over 86 s in the gait at 10.74 m/s"""
    case_capacity: Annotated[float, Within(10.0, 1e6)] = CASE_CAPACITY  # J/K
    case_to_air: Annotated[float, Within(0.1, 1e6)] = CASE_TO_AIR  # K/W
    air: Annotated[float, Within(-50.0, 100.0)] = AMBIENT  # C; the motors are as warm when the clock starts
    limit: Annotated[float, Within(0.0, 1000.0)] = WINDING_LIMIT  # C, at which the run ends for any winding
    copper_growth: Annotated[float, Within(0.0, 0.01)] = COPPER_GROWTH  # 1/K, of the windings' resistance
    magnet_loss: Annotated[float, Within(0.0, 0.002)] = MAGNET_LOSS  # 1/K, of the magnets' flux
    iron_loss: Annotated[float, Within(0.0, 1e4)] = 0.0  # W, in the case

    def __post_init__(self) -> None:
        """Refuse what does not heat like a motor."""
        check_bounds(self, "--heat.")
        if self.limit <= self.air:
            raise UserError(f"--heat.limit ({self.limit:g} C) must be above --heat.air ({self.air:g} C)")


RobotName = Literal["ideal", "built"]
ROBOTS: dict[RobotName, HardwareSpec] = {"ideal": IDEAL, "built": BUILT}
