"""The figures of the paper's main text, panel by panel: what is ours, and when it is the same."""

from bp2_rl.paper.index.item import Check, Item, unprinted

FORCES = "trajopt/decomposition.png"
SWING = "simulate:results/mass_ratios/mass_ratio"
PATHS = "sections:results/mass_ratios/mass_ratio"
TEN = "trajopt:by_speed/speed=10.0"
SLOW, FAST = "trajopt:means/0", "trajopt:means/-1"
BOLT = "race:results/racers/name=Bolt, Berlin 2009"
ROBOTS = "scaling:results/robots/name"

TOE = (
    "the toe on its spring rings at 17 Hz; filtered or in other coordinates the torque is another (coupling.png, G, H)"
)

FIGURE_1 = (
    Item(
        "Fig. 1",
        "Greatest speed over body mass, with the law of 171 mammals; robots are well below it",
        "scaling/scaling.png",
        ours="of the law's speed BP2 has {scaling:results/robots/name=BP2/share|.2f} outdoors and "
        "{scaling:results/treadmill/share|.2f} on the treadmill, WildCat "
        "{scaling:results/robots/name=WildCat/share|.2f}; simulated {scaling:results/simulated/0/share|.2f} and "
        "{scaling:results/simulated/1/share|.2f} (built, ideal)",
        checks=(Check(f"{ROBOTS}=BP2/share", 0.0, 1.0), Check(f"{ROBOTS}=WildCat/share", 0.0, 1.0)),
        because="the mammals' table has no clear licence: --mammals reads yours",
    ),
    Item(
        "Fig. 1, inset",
        "Ratio m g v / (peak torque x greatest motor speed): BP2 1.475, others typically 0.6 to 0.8",
        "scaling/scaling.png",
        ours="BP2 {scaling:results/robots/name=BP2/demand_as_printed|.3f}; half of the others lie from "
        "{scaling:results/spread/quartiles/0|.2f} to {scaling:results/spread/quartiles/1|.2f}",
        checks=(
            Check(f"{ROBOTS}=BP2/demand_as_printed", 1.4745, 1.4755),
            Check("scaling:results/spread/quartiles/0", 0.595, 0.7),
            Check("scaling:results/spread/quartiles/1", 0.7, 0.805),
        ),
        because="BP2's ratio is the paper's; the band is not what Table S1 holds",
    ),
)

FIGURE_2 = (
    Item(
        "Fig. 2",
        "The robot: 55 cm high, 80 cm long, 44 cm wide, 36 kg",
        "robot/robot.png",
        ours="standing height {robot:results/standing_height|.3f} m, trunk {robot:results/length|.2f} x "
        "{robot:results/width|.2f} m, {robot:results/mass|.1f} kg: measured on the compiled model",
        checks=(
            Check("robot:results/standing_height", 0.535, 0.565),
            Check("robot:results/length", 0.795, 0.805),
            Check("robot:results/width", 0.435, 0.445),
            Check("robot:results/mass", 35.5, 36.5),
        ),
        because="Table S3 adds up to 35.8 kg; the shank's assembly is not published",
    ),
)

FIGURE_3 = (
    Item("Fig. 3 A", "Huygens' pendulums, the experiment", stated="needs hardware", because="a photograph"),
    Item(
        "Fig. 3 B",
        "The simplified model: two pendulums on a beam that slides",
        "simulate",
        command="pytest tests/paper/pendulum/test_beam.py",
        ours=f"energy kept to {{{SWING}=1.0/energy_drift|.0e}}, momentum to {{{SWING}=1.0/momentum_drift|.0e}} over "
        "40 periods",
        checks=(Check(f"{SWING}=1.0/energy_drift", most=1e-9), Check(f"{SWING}=1.0/momentum_drift", most=1e-9)),
        because="the same equations as C MuJoCo solves, to 1e-6",
    ),
    Item(
        "Fig. 3 C",
        "Let go at 60 deg: mean energies go from (0.5, 0) to about 0.25 each within some six periods",
        "simulate/simulate.png",
        ours=f"R = 2: {{{SWING}=2.0/mean/0|.3f}} and {{{SWING}=2.0/mean/1|.3f}}, even after "
        f"{{{SWING}=2.0/even_after|.1f}} periods; R = 1: {{{SWING}=1.0/mean/0|.3f}}; R = 5: "
        f"{{{SWING}=5.0/mean/0|.3f}}, even after {{{SWING}=5.0/even_after|.1f}}",
        checks=(
            Check(f"{SWING}=2.0/mean/0", 0.225, 0.275),
            Check(f"{SWING}=2.0/mean/1", 0.225, 0.275),
            Check(f"{SWING}=2.0/even_after", most=7.0),
        ),
        because="R, window and whose energy are not given: R of 2 to 3, seen from the ground, fits",
    ),
    Item(
        "Fig. 3 D",
        "Sections contract from two orbits to one path as R falls",
        "sections/sections.png",
        ours=f"paths are {{{PATHS}=100.0/apart|.2f}} rad apart at R = 100 and {{{PATHS}=1.0/apart|.2f}} at R = 1",
        checks=(Check(f"{PATHS}=100.0/apart", 0.5), Check(f"{PATHS}=1.0/apart", most=0.2)),
        because="the same picture, but nothing contracts: energy is kept, and a wide swing is trapped (`bp2 pendulum "
        "trapping`)",
    ),
    Item(
        "Fig. 3 E",
        "Torques at R = 1, A = 1 rad, 5 Hz, phase pi/4: coupling significantly reduces the peak",
        "torque/torque.png",
        ours="peak with a free beam over that with a fixed one {torque:results/lengths/length=1.0/peak/0|.3f} at 1 "
        "m, {torque:results/lengths/length=0.35/peak/0|.3f} at 0.35 m",
        checks=(
            Check("torque:results/lengths/length=1.0/peak/0", most=0.9),
            Check("torque:results/lengths/length=0.35/peak/0", most=0.9),
        ),
        because="the length is not given, and hardly matters; the phase is no trot's (`bp2 paper pendulum gaits`)",
    ),
)


def _grows(kind: str, unit: str) -> str:
    """How the inertial terms' means grow over speed."""
    terms = ", ".join(
        f"{name} {{{SLOW}/average/{kind}/{term}|.0f}} to {{{FAST}/average/{kind}/{term}|.0f}} {unit}"
        for name, term in (("main inertial", "main inertial"), ("coupled", "coupled inertial"))
    )
    return f"{terms} from {{{SLOW}/speed|g}} to {{{FAST}/speed|g}} m/s"


def _means(letter: str, what: str, kind: str, unit: str) -> Item:
    """A panel of mean magnitudes that the paper prints no number of."""
    return unprinted(
        f"Fig. 4 {letter.upper()}",
        f"Mean magnitudes over speed, {what}: motion-dependent terms grow sharply",
        FORCES,
        ours=_grows(kind, unit),
    )


FIGURE_4 = (
    Item(
        "Fig. 4 A",
        "Vertical forces at 10 m/s: C alone reaches 1.19 m g at 3/4 T",
        FORCES,
        ours=f"{{{TEN}/velocity_force/peak|.2f}} m g, at {{{TEN}/velocity_force/instant|.2f}} T after touchdown; at "
        f"3/4 T {{{TEN}/velocity_force/at_three_quarters|.2f}}",
        checks=(
            Check(f"{TEN}/velocity_force/peak", 1.1, 1.3),
            Check(f"{TEN}/velocity_force/at_three_quarters", 1.1, 1.3),
        ),
        because="the value agrees, the instant does not",
    ),
    Item(
        "Fig. 4 B",
        "Hip at 10 m/s: a main inertial torque of 250 Nm at 0.21 T, where the thigh reverses; coupled inertia "
        "bridges the gap",
        FORCES,
        ours=f"largest {{{TEN}/largest_main/joints|.0f}} Nm, {{{TEN}/at_paper_instant/main inertial|.0f}} Nm at 0.21 "
        f"T; the hip reverses at {{{TEN}/reversal|.2f}} T; coupled covers {{{TEN}/covered|.0%}}, of which other legs "
        f"{{{TEN}/through/same pair|+.1%}} and {{{TEN}/through/other pair|+.1%}}",
        checks=(
            Check(f"{TEN}/largest_main/joints", 225.0, 275.0),
            Check(f"{TEN}/at_paper_instant/main inertial", 200.0),
        ),
        because=f"{TOE}; what covers it is the leg's own knee and spring",
    ),
    unprinted(
        "Fig. 4 C",
        "Knee at 10 m/s: a similar pattern",
        FORCES,
        ours=f"peak torque {{{TEN}/torques/hind knee/peak|.0f}} Nm, {{{TEN}/torques/hind knee/fixed_peak|.0f}} Nm on "
        "a trunk that is not accelerated (hind)",
    ),
    unprinted(
        "Fig. 4 D",
        "The optimised motion at 10 m/s",
        FORCES,
        ours="period {trajopt:shown/period|.3f} s, duty {trajopt:shown/duty|.3f}",
    ),
    _means("e", "horizontal", "x", "N"),
    Item(
        "Fig. 4 F",
        "Mean magnitudes over speed, vertical: gravity and ground reaction have one mean",
        FORCES,
        ours=f"ratio of the two {{trajopt:shown/gravity_to_ground|.4f}} at worst; {_grows('z', 'N')}",
        checks=(Check("trajopt:shown/gravity_to_ground", 0.999, 1.001),),
        because="it is the momentum's balance",
    ),
    _means("g", "hip", "hip", "Nm"),
    _means("h", "knee", "knee", "Nm"),
    unprinted(
        "Fig. 4 I",
        "Shares over speed, horizontal",
        FORCES,
        ours=f"main inertial {{{SLOW}/share/x/main inertial|.2f}} to {{{FAST}/share/x/main inertial|.2f}}",
    ),
    Item(
        "Fig. 4 J",
        "Shares over speed, vertical: inertial terms take over from gravity",
        FORCES,
        ours=f"gravity {{{SLOW}/share/z/gravity|.2f}} to {{{FAST}/share/z/gravity|.2f}}, coupled "
        f"{{{SLOW}/share/z/coupled inertial|.2f}} to {{{FAST}/share/z/coupled inertial|.2f}}",
        checks=(Check(f"{FAST}/share/z/gravity", most=0.25), Check(f"{FAST}/share/z/coupled inertial", 0.2)),
        because="the sum of means grows with speed, gravity does not",
    ),
    Item(
        "Fig. 4 K",
        "Shares over speed, hip: the active torque's falls, the coupled inertia's grows",
        FORCES,
        ours=f"active {{{SLOW}/share/hip/active|.2f}} to {{{FAST}/share/hip/active|.2f}}, coupled "
        f"{{{SLOW}/share/hip/coupled inertial|.2f}} to {{{FAST}/share/hip/coupled inertial|.2f}}",
        checks=(Check(f"{FAST}/share/hip/active", most=0.14), Check(f"{FAST}/share/hip/coupled inertial", 0.31)),
        because="the other way round, from a few m/s on",
    ),
    unprinted(
        "Fig. 4 L",
        "Shares over speed, knee",
        FORCES,
        ours=f"active {{{SLOW}/share/knee/active|.2f}} to {{{FAST}/share/knee/active|.2f}}",
    ),
)
