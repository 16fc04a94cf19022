"""The paper's supplement, tables, equations and movies, and what it has no item for."""

import functools

from bp2_rl.paper.index.item import Check, Item, unprinted

STRIDE = "trajopt/trajectory.png"
BP2 = "scaling:results/robots/name=BP2"
SWING = "simulate:results/mass_ratios/mass_ratio=1.0"
beyond = functools.partial(Item, stated="not comparable", beyond=True)

FIGURE_S1 = (
    Item(
        "Fig. S1",
        "The sagittal model with a complete motor inertia model",
        "robot/robot.png",
        command="bp2 trajopt solve --rotor-coupling",
        ours="equations of motion close to {trajopt:shown/closure|.0e} N or Nm",
        checks=(Check("trajopt:shown/closure", most=1e-6),),
        because="rotors count by r^2 I_m; their cross terms r I_m, 2 % of what couples hip and knee, are a flag",
    ),
)

_S2 = (
    ("a", "Motion at 10 m/s", "period {trajopt:shown/period|.3f} s, duty {trajopt:shown/duty|.3f}"),
    ("b", "Horizontal velocity of the centre of mass", "it jumps at touchdown alone"),
    ("c", "Vertical velocity of the centre of mass", ""),
    ("d", "Hip velocity", ""),
    ("e", "Knee velocity", ""),
)
FIGURE_S2 = (
    *(unprinted(f"Fig. S2 {letter.upper()}", what, STRIDE, ours=ours) for letter, what, ours in _S2),
    Item(
        "Fig. S2 F",
        "Horizontal ground reaction: no net impulse over a cycle",
        STRIDE,
        ours="{trajopt:shown/horizontal_impulse|.0e} N s",
        checks=(Check("trajopt:shown/horizontal_impulse", -0.01, 0.01),),
        because="it is the momentum's balance",
    ),
    Item(
        "Fig. S2 G",
        "Vertical ground reaction: its impulse is gravity's",
        STRIDE,
        ours="{trajopt:shown/vertical_impulse|.6f} of gravity's; peak {trajopt:shown/peak_force|.0f} N a foot",
        checks=(Check("trajopt:shown/vertical_impulse", 0.9999, 1.0001),),
        because="it is the momentum's balance; the peak hangs on F bar, not given (`bp2 paper trajectories objective`)",
    ),
    *(
        Item(
            f"Fig. S2 {letter.upper()}",
            f"{joint} torque, within the motor's limits",
            STRIDE,
            ours="peak of all motors {trajopt:shown/peak_torque|.0f} Nm of 120 Nm",
            checks=(Check("trajopt:shown/peak_torque", most=120.0),),
            because="by construction: the limits are constraints",
        )
        for letter, joint in (("h", "Hip"), ("i", "Knee"))
    ),
)

TABLES = (
    Item(
        "Table S1",
        "Legged robots: mass, motor, speed",
        "scaling/scaling.png",
        ours=f"BP2: {{{BP2}/mass|g}} kg, {{{BP2}/top_speed|g}} m/s; all robots in assets/published/robots.csv",
        checks=(Check(f"{BP2}/mass", 36.0, 36.0), Check(f"{BP2}/top_speed", 10.74, 10.74)),
        because="copied, with the sources that the paper gives, and which run on wheels",
    ),
    Item(
        "Table S2",
        "China's 100 m standards; 12.2 s is said to meet level 2",
        "race/race.png",
        ours="12.2 s is level {race:results/racers/name=BP2, paper/male_level|d} of men and level "
        "{race:results/racers/name=BP2, paper/female_level|d} of women",
        checks=(Check("race:results/racers/name=BP2, paper/male_level", most=2),),
        because="level 2 of men is 11.74 s",
    ),
    Item(
        "Table S3",
        "Parameters of the sagittal model",
        "robot/robot.png",
        ours="four quarters make {robot:results/mass|.2f} kg in the compiled model",
        checks=(Check("robot:results/mass", 35.79, 35.81),),
        because="each number stands in bp2_rl/robot/specs.py (`pytest tests/robot/test_specs.py "
        "tests/robot/test_model.py`)",
    ),
    Item(
        "Table S4",
        "Reward terms, base coefficients imitation/relaxed, and the speed-dependent schedule",
        "rewards/rewards.png",
        ours="imitation stage, weight of tracking from rest to top speed: to the letter "
        "{rewards:results/literal/at_rest|.1f} to {rewards:results/literal/at_top|.1f}, by the text "
        "{rewards:results/text/at_rest|.1f} to {rewards:results/text/at_top|.1f}",
        checks=(Check("rewards:results/literal/at_top", 0.3),),
        because="to the letter tracking loses weight with speed, which the text contradicts; we go by the text",
    ),
    Item(
        "Table S4, symbols",
        "What the symbols of the rewards mean",
        command="pytest tests/env/test_rewards.py",
        stated="same",
        because="w, eta, beta, c_m and c_v are functions of bp2_rl/env/rewards.py; the maxima of commands are not "
        "given",
    ),
)

EQUATIONS = (
    Item(
        "Eq. 1",
        "Active torque with and without coupling, u = u~ + u^c",
        "torque",
        command="pytest tests/paper/pendulum/test_torque.py",
        ours="peak free over fixed {torque:results/lengths/length=1.0/peak/0|.3f}",
        stated="same",
        because="bp2_rl/paper/pendulum/beam.py, against C MuJoCo; for legs half a cycle apart u^c is nothing",
    ),
    Item(
        "Eq. 2",
        "Continuous dynamics",
        "trajopt",
        command="pytest tests/paper/trajectories/test_decomposition.py",
        ours="closes to {trajopt:shown/closure|.0e} N or Nm",
        checks=(Check("trajopt:shown/closure", most=1e-6),),
        because="bp2_rl/optimiser/sagittal.py, against C MuJoCo",
    ),
    *(
        Item(
            f"Eq. {number}",
            what,
            "trajopt/decomposition.png",
            command="pytest tests/paper/trajectories/test_decomposition.py",
            stated="same",
            because="paper/trajectories/decomposition.py; impulses of touchdowns count, else means would not balance",
        )
        for number, what in ((3, "Average force"), (4, "Force ratio"))
    ),
    *(
        Item(
            f"Eq. {number}",
            what,
            "simulate",
            command="pytest tests/paper/pendulum/test_beam.py",
            ours=f"energy kept to {{{SWING}/energy_drift|.0e}} over 40 periods",
            checks=(Check(f"{SWING}/energy_drift", most=1e-9),),
            because="bp2_rl/paper/pendulum/beam.py, against C MuJoCo",
        )
        for number, what in ((5, "Two pendulums on a beam"), (6, "The same without dimensions"))
    ),
    *(
        Item(
            f"Eq. {number}",
            what,
            "trajopt",
            command="bp2 trajopt verify",
            ours="horizontal impulse over a cycle {trajopt:shown/horizontal_impulse|.0e} N s",
            checks=(Check("trajopt:shown/horizontal_impulse", -0.01, 0.01),),
            because="bp2_rl/optimiser/program.py, judged by a second model in MuJoCo (bp2_rl/optimiser/verify.py)",
        )
        for number, what in ((7, "Momentum over an impact"), (8, "Impact map"), (9, "Hybrid dynamics"))
    ),
    Item(
        "Eq. 10",
        "The objective: a sum over nodes",
        command="pytest tests/optimiser/test_collocation.py",
        stated="differs",
        because="a sum over nodes drifts with the mesh, so ours has the scheme's quadrature "
        "(docs/notes/trajectories.md)",
    ),
    Item(
        "Eq. 11",
        "Running cost: power, loads, smoothness",
        command="bp2 paper trajectories objective",
        stated="not comparable",
        because="weights and F bar are not given; period, duty and force hang on F bar",
    ),
    Item(
        "Eq. S1",
        "Discretised dynamics",
        command="bp2 paper trajectories schemes",
        stated="differs",
        because="the paper's scheme is an option; it does not keep energy, so the library has Hermite-Simpson "
        "(docs/notes/trajectories.md)",
    ),
    Item(
        "Eq. S2",
        "Stance and swing",
        command="bp2 trajopt verify",
        stated="same",
        because="and no force at lift-off, which the paper leaves out",
    ),
    Item(
        "Eq. S3",
        "Periodicity, task, bounds, smoothness",
        command="bp2 trajopt verify",
        stated="differs",
        because="periodicity, task and bounds are the same; smoothness is a cost, not a bound: the bounds are not "
        "given",
    ),
)

MOVIES = (
    Item(
        "Movie S1",
        "Overview of the study",
        command="bp2 paper figures --all",
        stated="not comparable",
        because="this page is our overview",
    ),
    Item(
        "Movie S2",
        "The gait at top speed",
        "topspeed/run.mp4",
        ours="{topspeed:metrics/mean_speed|.2f} m/s, simulated (built robot)",
        stated="needs hardware",
        because="ours is a simulation",
    ),
    Item(
        "Movie S3",
        "The 100 m in 12.2 s",
        "sprint/run.mp4",
        ours="{sprint:metrics/time|.2f} s, simulated (built robot)",
        stated="needs hardware",
        because="ours is a simulation",
    ),
    Item(
        "Movie S4",
        "13.2 m/s on the treadmill",
        "topspeed/run.mp4",
        ours="best second {topspeed:metrics/best_speed|.2f} m/s, simulated (built robot)",
        stated="needs hardware",
        because="without air a constant belt and the ground are one frame of reference; the film is Movie S2's",
    ),
)

BEYOND = (
    Item(
        "Fig. 4 in 3-D",
        "Whose inertia balances whose in the gait that the policy really runs",
        "mechanism/sources.png",
        ours="at {mechanism:metrics/speeds/-1/speed|.1f} m/s the hips' main torque is covered to "
        "{mechanism:metrics/speeds/-1/forces/covered|.0%} at its peaks, by the leg across "
        "{mechanism:metrics/speeds/-1/forces/through/same pair|+.1%}, by the other pair "
        "{mechanism:metrics/speeds/-1/forces/through/other pair|+.1%}",
        checks=(
            Check("mechanism:metrics/speeds/-1/forces/through/same pair", 0.05),
            Check("mechanism:metrics/speeds/-1/forces/covered", 0.0),
        ),
        because="the paper has coupling between limbs; it is within the leg: its own joints and its spring",
        beyond=True,
    ),
    beyond(
        "Efficiency",
        "Motors within their high-efficiency regions; no cost of transport is printed",
        "efficiency/efficiency.png",
        ours="at {efficiency:metrics/speeds/-1/speed|.1f} m/s mechanical "
        "{efficiency:metrics/speeds/-1/energy/positive|.2f}, electrical "
        "{efficiency:metrics/speeds/-1/energy/electrical/everything|.2f} to "
        "{efficiency:metrics/speeds/-1/energy/electrical/nothing|.2f} by what becomes of braking; motors that drive "
        "make work of {efficiency:metrics/speeds/-1/energy/efficiency|.0%} of what their windings are given, hind "
        "hips of {efficiency:metrics/speeds/-1/energy/joints/name=hind hip/efficiency|.0%}",
        because="the paper prints no cost of transport and no efficiency; ours knows of copper's heat alone",
    ),
    beyond(
        "Fig. 3, where it helps",
        "Phase, frequency and amplitude at which a free beam lowers the peak torque",
        "map/map.png",
        ours="at R = 1 for W > {map:results/mass_ratios/mass_ratio=1.0/boundary|.3f}; measured "
        "{map:results/mass_ratios/mass_ratio=1.0/boundary_measured/0|.3f}",
        because="the paper shows one point of it",
    ),
    beyond(
        "Fig. 3, threshold",
        "From which R on a swing stays with its pendulum",
        "trapping/trapping.png",
        ours="at 0.5 rad from R = {trapping:results/thresholds/amplitude=0.5/traps|.0f}",
        because="the paper sweeps R and names no threshold",
    ),
    beyond(
        "Fig. 3, gaits",
        "What a trot's phases leave of the beam's help",
        "gaits/gaits.png",
        ours="peak free over fixed, trot {gaits:results/gaits/gait=trot/peak|.3f}, pronk "
        "{gaits:results/gaits/gait=pronk/peak|.3f}",
        because="the paper takes from the pendulums that legs take torque off each other; two in antiphase do not",
    ),
    beyond(
        "What is assumed",
        "Which of the numbers that had to be assumed the paper's own numbers pin down",
        "identifiability/identifiability.png",
        ours="{identifiability:results/pinned|d} combinations of {identifiability:results/assumptions|d} "
        "assumptions; left of the range of a rotor's inertia {identifiability:results/left/rotor inertia|.0%}, of "
        "the drag area's {identifiability:results/left/drag area|.0%}, of friction's "
        "{identifiability:results/left/friction|.0%}",
        because="the paper prints none of these",
    ),
    beyond(
        "Limits of speed",
        "Which limits hold the optimiser back, and how far the policy is from it on the same robot",
        "binding/binding.png",
        ours="greatest speed {binding:results/greatest/speed|.1f} m/s; for 1 % more of leg length, no-load speed, "
        "peak torque and friction {binding:results/greatest/prices/leg length|+.1f}, "
        "{binding:results/greatest/prices/no-load speed|+.1f}, {binding:results/greatest/prices/peak torque|+.1f} "
        "and {binding:results/greatest/prices/friction|+.1f} cm/s more; at {binding:results/gaps/0/policy/speed|.1f} "
        "m/s the policy works {binding:results/gaps/0/policy/positive|.2f} m g d, the optimiser "
        "{binding:results/gaps/0/optimiser/positive|.2f}",
        because="the paper has no bound to compare its speed with; ours is of the plane and without feedback",
    ),
)
