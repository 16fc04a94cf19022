"""What the paper says of its race, and what the numbers say."""

from bp2_rl.evaluation.published import sprints
from bp2_rl.evaluation.published.sprints import read_standards
from bp2_rl.paper.figures.drawn import Comparison
from bp2_rl.paper.figures.race.numbers import RaceNumbers, Racer
from bp2_rl.robot import specs

FAST = 12.0  # m/s, which the paper has Bolt and Lyles exceed


def compare(numbers: RaceNumbers) -> tuple[Comparison, ...]:
    """What the paper says of the figure, and what the numbers say."""
    bolt, lyles, bp2 = (numbers.find(name) for name in (sprints.BOLT, sprints.LYLES, sprints.PAPER_BP2))
    paper = numbers.paper
    return (
        _greatest(bolt),
        _greatest(lyles),
        Comparison(
            "Bolt slows down measurably over the final 20 to 30 m",
            f"{bolt.means[-4]:.2f} m/s from 60 to 70 m, {bolt.means[-1]:.2f} from 90 to 100 m: "
            f"{bolt.means[-1] / bolt.means[-4] - 1.0:+.1%}",
            "same",
        ),
        Comparison(
            f"{specs.SPRINT_100M_TIME:g} s meets China's National Level II",
            f"Table S2's level 2 is {_standard('male', 2):g} s of men and {_standard('female', 2):g} s of women: "
            f"{specs.SPRINT_100M_TIME:g} s is {levels(bp2)}",
            "differs",
            "of men it misses level 2 by "
            f"{specs.SPRINT_100M_TIME - _standard('male', 2):.2f} s; of women it meets more than level 2",
        ),
        Comparison(
            "mean accelerations over 5 m: 2.38, trained 4.8, untrained 2.8 m/s²; so a deficit of nearly 1 s at 5 m",
            f"constant, they take {paper.constant_times[sprints.PAPER_BP2]:.2f}, "
            f"{paper.constant_times[sprints.TRAINED]:.2f} and {paper.constant_times[sprints.UNTRAINED]:.2f} s: "
            f"{paper.deficit:.2f} s behind the trained sprinter",
            "differs",
            "no definition is given; as v/t or v²/2d of two starts of one shape it is less still; "
            f"the gap at the finish is {paper.finish_gap:.1f} s",
        ),
        Comparison(
            "10.74 m/s, held to the end; 100 m in 12.2 s; 2.38 m/s² over the first 5 m",
            f"at a constant 2.38 to 10.74 m/s 100 m take {paper.time_at_said:.2f} s, and 12.2 s need "
            f"{paper.constant_needed:.2f} m/s²; an exponential rise needs T = {paper.time_constant:.2f} s, from "
            f"{paper.first_acceleration:.2f} m/s² on, and 5 m then take {paper.start.time:.2f} s: v/t "
            f"{paper.start.over_time:.2f}, 2d/t² {paper.start.constant:.2f}, v²/2d {paper.start.over_distance:.2f} "
            "m/s²",
            "not comparable",
            "the profile is not published; of the readings of this rise v²/2d, the mean over distance, is nearest",
        ),
        Comparison(
            "trained and untrained profiles (panels C and D)",
            "times, mean speeds and constant starts alone",
            "not comparable",
            "their splits are not published",
        ),
        *(_ours(run, bp2) for run in numbers.runs),
    )


def levels(racer: Racer) -> str:
    """The standards of Table S2 that a time meets."""
    men, women = (f"{level}" if level else "none" for level in (racer.male_level, racer.female_level))
    return f"level {men} of men, {women} of women".replace("level none", "no level")


def _greatest(racer: Racer) -> Comparison:
    said = f"{racer.name} exceeds {FAST:g} m/s"
    if not racer.means:
        return Comparison(said, "not known", "not comparable", "no citable splits ship here: see --athletes")
    fastest = max(racer.means)
    found = f"{fastest:.2f} m/s in the mean of the fastest split"
    if fastest > FAST:
        return Comparison(said, found, "same")
    return Comparison(said, found, "not comparable", "between splits the greatest speed is above their mean")


def _standard(category: str, level: int) -> float:
    return next(s.time for s in read_standards() if (s.category, s.level) == (category, level))


def _ours(run: Racer, bp2: Racer) -> Comparison:
    said = f"BP2: {bp2.time:g} s, {bp2.said_acceleration:g} m/s² over 5 m, minimal decay"
    if run.time is None or run.start is None or run.fade is None:
        return Comparison(said, f"{run.name}: did not arrive", "differs", "it fell, or was too slow")
    return Comparison(
        said,
        f"{run.name}: {run.time:.2f} s ({levels(run)}), 5 m in {run.start.time:.2f} s with v/t "
        f"{run.start.over_time:.2f} m/s², {run.fade:+.2f} m/s over the last 40 m",
        "differs",
        "it is simulated: what its robot leaves out is in the report of the run",
    )
