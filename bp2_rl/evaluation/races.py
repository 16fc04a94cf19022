"""Times of people and of the paper's robot over 100 m."""

from bp2_rl.robot import bp2

TRACK = 100.0  # m
LAUNCH_DISTANCE = 5.0  # m, as in the paper
MARKS = tuple(range(10, 101, 10))  # m, of the splits

BOLT_SPLITS = (1.89, 2.88, 3.78, 4.64, 5.47, 6.29, 7.10, 7.92, 8.75, 9.58)
"""Time of Usain Bolt at each of `MARKS`, s, reaction time of 0.146 s included: world
record, Berlin 2009 (Graubner and Nixdorf, Biomechanical analysis of the sprint and
hurdles events at the 2009 IAAF World Championships in Athletics, New Studies in
Athletics 26, 2011)."""
# s, paper, Results, Hundred-meter sprint benchmark
TRAINED_TIME, UNTRAINED_TIME = 11.2, 16.1

BOLT = "Bolt, Berlin 2009"
LYLES = "Lyles, Paris 2024"
TRAINED = "trained sprinter"
UNTRAINED = "untrained adults"
PAPER_BP2 = "BP2, paper"
TIMES = {  # s over 100 m
    BOLT: BOLT_SPLITS[-1],
    LYLES: 9.78,
    TRAINED: TRAINED_TIME,
    PAPER_BP2: bp2.SPRINT_100M_TIME,
    UNTRAINED: UNTRAINED_TIME,
}
