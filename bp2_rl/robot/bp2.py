"""Every parameter of BP2 (masses, lengths, motors, limits), once, with its unit and
source.

Numbers come from the paper ("Breaking speed scaling in quadrupedal robots via Huygens'
coupled-pendulum dynamics"), from arithmetic on it (DERIVED), or, where the paper is
silent, from us (ASSUMED, with the reason). `PROVENANCE` lists them all in reading
order; everything assumed that can matter is a field of `BP2Body` or `HardwareSpec` and
so can be changed from the command line.
"""

from bp2_rl.robot.conventions import LEGS, number

# --- The quarter robot of Table S3: a quarter of the trunk, one thigh, shank and toe --
TRUNK_QUARTER_MASS = number("m_0", 6.15, "kg", "paper, Table S3")
THIGH_MASS = number("m_1", 2.2, "kg", "paper, Table S3")
SHANK_MASS = number("m_2", 0.1, "kg", "paper, Table S3")
TOE_MASS = number("m_3", 0.5, "kg", "paper, Table S3")
TRUNK_QUARTER_INERTIA = number(
    "I_0", 0.10, "kg m2", "paper, Table S3; about its own centre of mass"
)
THIGH_INERTIA = number("I_1", 0.014, "kg m2", "paper, Table S3")
SHANK_INERTIA = number("I_2", 2e-5, "kg m2", "paper, Table S3")
TOE_INERTIA = number("I_3", 1e-5, "kg m2", "paper, Table S3")
HIP_FORE_AFT = number("L_0", 0.35, "m", "paper, Table S3; trunk centre to hip axis")
THIGH_LENGTH = number("L_1", 0.35, "m", "paper, Table S3")
SHANK_LENGTH = number("L_2", 0.10, "m", "paper, Table S3; knee to spring seat")
TOE_LENGTH = number("L_3", 0.05, "m", "paper, Table S3; spring end to sole")
TRUNK_QUARTER_COM = number(
    "l_0", -0.10, "m", "paper, Table S3; from the hip, towards the trunk's centre"
)
THIGH_COM = number("l_1", 0.024, "m", "paper, Table S3; from the hip, down the thigh")
SHANK_COM = number(
    "l_2", -0.05, "m", "paper, Table S3; from the spring seat, up towards the knee"
)
TOE_COM = number("l_3", -0.02, "m", "paper, Table S3; from the sole, up the toe")
GEAR_RATIO = number("r_1 = r_2", 8.5, "-", "paper, Table S3")
SPRING_STIFFNESS = number(
    "k_p", 6000.0, "N/m", "paper, Table S3; two springs of 3000 N/m in parallel"
)
SPRING_DAMPING = number("k_d", 10.0, "N s/m", "paper, Table S3")

# --- The whole robot ------------------------------------------------------------------
TOTAL_MASS = number(
    "m", 36.0, "kg", "paper, Fig. 2; with battery (Table S3 adds up to 35.8)"
)
STANDING_HEIGHT = number("h", 0.55, "m", "paper, Fig. 2")
BODY_LENGTH = number("-", 0.80, "m", "paper, Fig. 2")
BODY_WIDTH = number("-", 0.44, "m", "paper, Fig. 2")

# --- The motors, at the joint (behind the gear) ---------------------------------------
PEAK_TORQUE = number(
    "tau_max",
    120.0,
    "Nm",
    "paper, Table S1; the text's '250 Nm is 2.5 x peak' implies 100",
)
NO_LOAD_SPEED = number("omega_0", 21.4, "rad/s", "paper, Table S1")
CORNER_SPEED = number(
    "omega_c",
    14.7,
    "rad/s",
    "DERIVED: a hind motor's 1765 W peak (Fig. 5E) over 120 Nm is the least corner",
)

# --- Published results, to compare with -----------------------------------------------
OUTDOOR_TOP_SPEED = number("v", 10.74, "m/s", "paper, Abstract")
TREADMILL_TOP_SPEED = number("v", 13.2, "m/s", "paper, Results")
SPRINT_100M_TIME = number("t_100", 12.2, "s", "paper, Abstract")
LAUNCH_ACCELERATION = number(
    "a", 2.38, "m/s2", "paper, Results; mean over the first 5 m"
)
ENDURANCE_TIME = number("-", 86.0, "s", "paper, Results; above 10 m/s on the treadmill")
HEATING_RATE = number(
    "-",
    1.8,
    "K/s",
    "paper, Results; of a rear hip's motor, over those 86 s, nearly linear",
)
HIND_PEAK_POWERS = tuple(
    number("P", power, "W", "paper, Results; peak of a hind leg's motor (Fig. 5E)")
    for power in (1620.0, 1765.0)
)

# --- What the paper does not say ------------------------------------------------------
SPRING_REST_LENGTH = number(
    "-",
    0.20,
    "m",
    "ASSUMED: lower leg = thigh = 0.35 m, the equal-length leg that stands at 0.55 m",
)
ROTOR_INERTIA = number(
    "I_m",
    2e-4,
    "kg m2",
    "ASSUMED: motor side, a frameless motor of this class; x gear^2 at the joint",
)
SPRING_STOP_STIFFNESS = number(
    "-", 30e3, "N/m", "ASSUMED: rubber buffer, 5 x the spring, one-sided"
)
SPRING_TRAVEL = number(
    "-", 0.13, "m", "ASSUMED: 65 % of the rest length; 0.11 m are used at 10 m/s"
)
ABAD_MASS = number(
    "-",
    0.9,
    "kg",
    "ASSUMED: abduction link with the hip motor's stator; taken from the trunk",
)
ABAD_INERTIA = number(
    "-", 0.0015, "kg m2", "ASSUMED: a 0.9 kg cylinder of 0.05 m radius"
)
ABAD_COM_FORE_AFT = number(
    "-", -0.05, "m", "ASSUMED: from the hip, towards the trunk's centre"
)
FORE_TRACK = number(
    "-",
    0.39,
    "m",
    "ASSUMED: between the fore legs' planes; 0.44 m over all with their covers",
)
HIND_TRACK = number(
    "-",
    0.32,
    "m",
    "ASSUMED: track of the hind feet, narrower than the front, as the paper says",
)
THIGH_LATERAL = number(
    "-", 0.080, "m", "ASSUMED: abduction axis to the leg's plane, outwards"
)
THIGH_TWIST_INERTIA = number(
    "-", 0.003, "kg m2", "ASSUMED: about its length, 2.2 kg of motors 0.05 m in radius"
)
SHANK_TWIST_INERTIA = number(
    "-", 5e-6, "kg m2", "ASSUMED: about its length, a 0.1 kg rod of 0.01 m radius"
)
FOOT_RADIUS = number("-", 0.02, "m", "ASSUMED: sphere whose lowest point is the sole")
THIGH_RADIUS = number(
    "-",
    0.018,
    "m",
    "ASSUMED: of a solid leg's capsule from hip to knee, half the shell's width",
)
LOWER_LEG_RADIUS = number(
    "-", 0.0145, "m", "ASSUMED: radius from knee to foot, that of the spring's coils"
)
SHANK_REACH = number(
    "-", 0.17, "m", "ASSUMED: knee to the end of the tubes that guide the spring"
)
RODS_BELOW_KNEE = number(
    "-",
    0.15,
    "m",
    "ASSUMED: knee to the upper end of the toe's rods, spring at rest: the longest that clear the knee",
)
LEG_FRICTION = number(
    "-", 0.3, "-", "ASSUMED: of a solid leg on anything, aluminium on carbon fibre, dry"
)
LEG_CONTACT_TIME = number(
    "-", 0.005, "s", "ASSUMED: MuJoCo's time constant of a solid leg, that of the foot"
)
TRUNK_RADIUS = number(
    "-", 0.07, "m", "ASSUMED: of the two capsules that stand for the trunk's box"
)
TRUNK_REACH = number(
    "-", 0.33, "m", "ASSUMED: trunk's centre to the ends of their axes; 0.80 m over all"
)
TRUNK_LATERAL = number(
    "-", 0.04, "m", "ASSUMED: trunk's mid-plane to their axes; 0.22 m wide over all"
)
CONTACT_TIME = number(
    "-",
    0.005,
    "s",
    "ASSUMED: MuJoCo's time constant of foot on ground; 15 mm under 6 body weights",
)
FOOT_FRICTION = number("mu", 0.9, "-", "ASSUMED: cleats on track or concrete")
TRUNK_ROLL_INERTIA = number(
    "-", 0.20, "kg m2", "ASSUMED: 20 kg box of 0.20 m x 0.16 m, plus battery and covers"
)
TRUNK_YAW_INERTIA = number(
    "-", 1.70, "kg m2", "ASSUMED: as pitch, plus what the width adds"
)
LEAST_TRUNK = number(
    "-",
    7.2,
    "kg",
    "ASSUMED: twice its abduction links; what the heaviest legs leave it",
)
LOOP_STIFFNESS = 250.0  # Nm/rad, ASSUMED: of the joints' position loop in training
LOOP_DAMPING = 3.0  # Nm s/rad, ASSUMED: of the same
ABAD_RANGE = (-0.7, 0.7)  # rad, ASSUMED: clears the opposite leg
HIP_RANGE = (-1.4, 2.4)  # rad, ASSUMED: positive swings the foot back
KNEE_RANGE = (-2.6, -0.1)  # rad, ASSUMED: never straight, never folded flat

STAND_HIP = number(
    "-",
    0.62,
    "rad",
    "DERIVED: settles at 0.55 m under joint PD (250 Nm/rad), foot below the hip",
)
STAND_KNEE = -2.0 * STAND_HIP
STAND_JOINTS = (0.0, STAND_HIP, STAND_KNEE) * len(LEGS)

QUARTER_MASS = TRUNK_QUARTER_MASS + THIGH_MASS + SHANK_MASS + TOE_MASS  # kg, DERIVED
TRUNK_PITCH_INERTIA = 4.0 * (
    TRUNK_QUARTER_INERTIA + TRUNK_QUARTER_MASS * (HIP_FORE_AFT + TRUNK_QUARTER_COM) ** 2
)  # kg m2, DERIVED: four quarters about the trunk's centre, abduction links included
