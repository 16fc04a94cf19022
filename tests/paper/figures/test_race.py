import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import quad

from bp2_rl.evaluation import races
from bp2_rl.evaluation.benchmarks.run import measure_splits
from bp2_rl.paper.figures.race import (
    RaceNumbers,
    Racer,
    check_paper,
    describe_race,
    fading,
    fit_profile,
    follow_run,
    paper_profile,
    race,
)
from bp2_rl.paper.figures.settings import RaceFigureSettings
from bp2_rl.paper.published import Athlete


def find(numbers: RaceNumbers, name: str) -> Racer:
    return next(racer for racer in numbers.racers if racer.name == name)


@pytest.fixture(scope="module")
def drawn():
    return race(RaceFigureSettings())


@pytest.fixture
def run(make_run):
    """Return a run at 3 m/s2 to 12 m/s, which covers 100 m after 10.3 s."""
    return make_run(duration=11.0, speed=12.0, acceleration=3.0)


# --- The paper's race -----------------------------------------------------------------


def test_the_papers_race_covers_100_m_in_its_time_at_its_speed():
    """v = 10.74 (1 - exp(-t / T)); T by hand is 2.9 s."""
    profile = paper_profile()
    assert profile.time[-1] == 12.2
    T = -1.0 / math.log(1.0 - profile.speed[1000] / 10.74)  # after a second
    assert pytest.approx(2.9, abs=0.05) == T
    covered = quad(lambda t: 10.74 * (1.0 - math.exp(-t / T)), 0.0, 12.2)[0]
    assert profile.distance[-1] == pytest.approx(covered, abs=1e-6)
    assert covered == pytest.approx(100.0, abs=1e-6)


def test_read_as_constant_the_papers_accelerations_make_no_second_of_deficit():
    paper = check_paper()
    times = [
        paper.constant_times[name]
        for name in (races.PAPER_BP2, races.TRAINED, races.UNTRAINED)
    ]
    assert times == pytest.approx([2.05, 1.44, 1.89], abs=0.005)
    assert paper.deficit == pytest.approx(0.61, abs=0.005)
    assert paper.finish_gap == pytest.approx(1.0)


@pytest.mark.parametrize("shape", np.linspace(0.05, 20.0, 30))
def test_no_start_of_one_shape_makes_more_of_the_deficit_than_a_constant_one(shape):
    def time_at_5m(read, said):
        """Of a start (1 - exp(-shape t / t5)), scaled so that its reading is what is
        said."""
        # With x = t/t5: distance = v t5 f, speed at 5 m = v g
        g, f = -math.expm1(-shape), 1.0 + math.expm1(-shape) / shape
        if read == "over_time":  # v g / t5 = said, v t5 f = 5
            return math.sqrt(5.0 * g / (f * said))
        return 5.0 * g / f / math.sqrt(10.0 * said)  # (v g)^2 / 10 = said

    for read in ("over_time", "over_distance"):
        deficit = time_at_5m(read, 2.38) - time_at_5m(read, 4.8)
        assert 0.0 < deficit < check_paper().deficit


# --- Fading, curves -------------------------------------------------------------------


def test_the_curve_goes_through_the_splits_from_a_stand():
    # A cubic that stands at 0 and has no curvature at its end is found as it is.
    times = np.array((2.0, 4.0, 7.0, 10.0))
    distances = 1.5 * times**2 - 0.05 * times**3
    athlete = Athlete("cubic", 10.2, 0.2, tuple(distances), tuple(times + 0.2))
    profile = fit_profile(athlete)
    np.testing.assert_allclose(
        profile.distance, 1.5 * profile.time**2 - 0.05 * profile.time**3, atol=1e-9
    )
    np.testing.assert_allclose(
        profile.speed, 3.0 * profile.time - 0.15 * profile.time**2, atol=1e-9
    )


def test_fading_is_the_slope_of_the_last_40_m():
    distances = np.arange(0.0, 101.0, 10.0)
    means = 12.0 - 0.01 * (distances[1:] - 5.0)
    means[:6] = 3.0  # what was before does not count
    assert fading(distances, means) == pytest.approx(-0.4)
    assert fading(np.array((0.0, 60.0, 100.0)), np.array((9.0, 10.0))) is None


def test_bolt_fades_and_exceeds_12(drawn):
    bolt = find(drawn.results, races.BOLT)
    assert max(bolt.means) == pytest.approx(10.0 / 0.81)  # from 60 to 70 m
    assert bolt.fade is not None
    assert -0.5 < bolt.fade < -0.3  # 12.35, 12.20, 12.05, 12.05 m/s: -0.0105 a m


# --- Runs -----------------------------------------------------------------------------


def test_a_run_has_the_splits_of_its_report(run):
    racer = describe_race(follow_run("ours", run)[0])
    assert racer.splits == tuple(split.time for split in measure_splits(run))
    # 4 s and 24 m, 76 m: 10.33 s
    assert racer.time == pytest.approx(2.0 + 100.0 / 12.0, abs=1e-3)
    assert racer.fade == pytest.approx(0.0, abs=1e-9)


def test_a_run_that_ends_early_is_shown_as_far_as_it_came(run, leave_report):
    fallen = dataclasses.replace(run.between(0.0, 1.0), fell_at=1.0)
    numbers = race(RaceFigureSettings(runs=(leave_report(fallen, "sprint"),)))
    (racer,) = numbers.results.runs
    assert (racer.time, racer.splits, racer.male_level) == (None, (), None)


# --- The figure -----------------------------------------------------------------------


def test_a_users_splits_complete_an_athlete(tmp_path):
    path = tmp_path / "splits.csv"
    rows = [
        f'"{races.LYLES}",{d},{t},0.178'
        for d, t in ((30, 3.9), (60, 6.45), (80, 8.09), (100, 9.784))
    ]
    path.write_text("\n".join(("athlete,distance [m],time [s],reaction [s]", *rows)))
    numbers = race(RaceFigureSettings(athletes=path)).results
    assert [racer.name for racer in numbers.racers].count(races.LYLES) == 1
    assert find(numbers, races.LYLES).means[2] == pytest.approx(20.0 / 1.64)
