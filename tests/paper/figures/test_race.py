import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import quad

from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import save_config, to_json
from bp2_rl.evaluation import races
from bp2_rl.evaluation.benchmarks.run import measure_first_metres, measure_splits
from bp2_rl.evaluation.report.folder import TRAJECTORY, Report
from bp2_rl.paper.figures.race import race
from bp2_rl.paper.figures.race_numbers import (
    Profile,
    check_paper,
    compare,
    exponential,
    fading,
    fit,
    follow,
    judge,
    measure_start,
)
from bp2_rl.paper.figures.settings import RaceSettings
from bp2_rl.paper.published_races import Athlete


@pytest.fixture(scope="module")
def drawn():
    return race(RaceSettings())


@pytest.fixture
def run(make_run):
    """12 m/s at 3 m/s2: 100 m after 10.3 s."""
    return make_run(duration=11.0, speed=12.0, acceleration=3.0)


@pytest.fixture
def leave_report(tmp_path):
    def leave(run, benchmark="sprint"):
        save_config(
            tmp_path / "metrics.json",
            Report(benchmark, {"robot": "ideal: no losses"}, {}),
        )
        run.save(tmp_path / TRAJECTORY)
        return tmp_path

    return leave


# --- The paper's race -----------------------------------------------------------------


def test_the_papers_speed_and_time_need_three_seconds_to_rise():
    paper = check_paper()
    covered = quad(
        lambda t: 10.74 * (1.0 - math.exp(-t / paper.time_constant)), 0.0, 12.2
    )[0]
    assert covered == pytest.approx(100.0, abs=1e-9)
    assert paper.time_constant == pytest.approx(2.9, abs=0.05)
    assert paper.first_acceleration == pytest.approx(3.7, abs=0.05)


def test_at_its_own_acceleration_the_papers_race_would_be_shorter():
    paper = check_paper()
    # 2.38 m/s2 for 4.513 s and 24.23 m, then 75.77 m at 10.74 m/s
    assert paper.time_at_said == pytest.approx(4.5126 + 75.767 / 10.74, abs=1e-3)
    reached = 10.74 / paper.constant_needed
    assert reached + (100.0 - 0.5 * 10.74 * reached) / 10.74 == pytest.approx(
        12.2, abs=1e-9
    )


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


# --- Starts, fading, curves -----------------------------------------------------------


def test_every_reading_of_a_constant_acceleration_is_that():
    time = np.arange(0.0, 4.0, 1e-3)
    start = measure_start(Profile(time, 0.5 * 2.38 * time**2, 2.38 * time))
    assert start is not None
    # interpolated within a ms: a dt^2 / 8 v
    assert start.time == pytest.approx(math.sqrt(10.0 / 2.38), abs=1e-6)
    readings = start.over_time, start.over_distance, start.constant, start.best
    assert readings == pytest.approx([2.38] * 4, rel=1e-6)


def test_the_readings_of_an_exponential_rise_are_apart():
    start = measure_start(exponential(2.0, 10.0, 5.0))
    assert start is not None
    assert 10.0 * (
        start.time - 2.0 * (1.0 - math.exp(-start.time / 2.0))
    ) == pytest.approx(5.0, abs=1e-5)
    assert start.speed == pytest.approx(
        10.0 * (1.0 - math.exp(-start.time / 2.0)), abs=1e-5
    )
    # the first half second
    assert start.best == pytest.approx(10.0 * (1.0 - math.exp(-0.25)) / 0.5, abs=1e-9)
    assert start.constant > start.over_time > start.over_distance


def test_a_profile_that_ends_early_has_no_start():
    assert measure_start(exponential(2.0, 10.0, 1.0)) is None


def test_the_curve_goes_through_the_splits_from_a_stand():
    # A cubic that stands at 0 and has no curvature at its end is found as it is.
    times = np.array((2.0, 4.0, 7.0, 10.0))
    distances = 1.5 * times**2 - 0.05 * times**3
    athlete = Athlete("cubic", 10.2, 0.2, tuple(distances), tuple(times + 0.2))
    profile = fit(athlete)
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
    bolt = drawn.results.find(races.BOLT)
    assert max(bolt.means) == pytest.approx(10.0 / 0.81)  # from 60 to 70 m
    assert bolt.fade is not None
    assert -0.5 < bolt.fade < -0.3  # 12.35, 12.20, 12.05, 12.05 m/s: -0.0105 a m
    assert bolt.moving_time == pytest.approx(9.434)


# --- Runs -----------------------------------------------------------------------------


def test_a_run_has_the_splits_and_the_start_of_its_report(run):
    racer = judge(*follow("ours", run))
    launch = measure_first_metres(run)
    assert racer.start is not None
    assert racer.splits == tuple(split.time for split in measure_splits(run))
    readings = racer.start.time, racer.start.over_time, racer.start.constant
    expected = launch.time, launch.mean_acceleration, launch.equivalent_acceleration
    # the last digits depend on the order of the arithmetic
    assert readings == pytest.approx(expected, rel=1e-9)
    # 4 s and 24 m, 76 m: 10.33 s
    assert racer.time == pytest.approx(2.0 + 100.0 / 12.0, abs=1e-3)
    assert racer.fade == pytest.approx(0.0, abs=1e-9)


def test_a_run_that_ends_early_is_shown_as_far_as_it_came(run, leave_report):
    fallen = dataclasses.replace(run.between(0.0, 1.0), fell_at=1.0)
    numbers = race(RaceSettings(runs=(leave_report(fallen),)))
    (racer,) = numbers.results.runs
    assert (racer.time, racer.start, racer.splits, racer.male_level) == (
        None,
        None,
        (),
        None,
    )
    assert "did not arrive" in numbers.comparisons[-1].ours


def test_a_report_of_something_else_is_refused(run, leave_report):
    with pytest.raises(UserError, match="--benchmark sprint"):
        race(RaceSettings(runs=(leave_report(run, benchmark="topspeed"),)))


# --- The figure -----------------------------------------------------------------------


def test_level_two_is_missed(drawn):
    level = next(
        said for said in compare(drawn.results) if "National Level II" in said.paper
    )
    assert level.verdict == "differs"
    assert "level 3 of men, 1 of women" in level.ours


def test_every_statement_that_differs_says_why(drawn):
    assert all(said.because for said in drawn.comparisons if said.verdict != "same")


def test_a_users_splits_complete_an_athlete(tmp_path):
    path = tmp_path / "splits.csv"
    rows = [
        f'"{races.LYLES}",{d},{t},0.178'
        for d, t in ((30, 3.9), (60, 6.45), (80, 8.09), (100, 9.784))
    ]
    path.write_text("\n".join(("athlete,distance [m],time [s],reaction [s]", *rows)))
    numbers = race(RaceSettings(athletes=path)).results
    assert [racer.name for racer in numbers.racers].count(races.LYLES) == 1
    lyles = numbers.find(races.LYLES)
    assert lyles.means[2] == pytest.approx(20.0 / 1.64)
    assert lyles.start is not None


def test_the_picture_shows_the_numbers_of_the_file(run, leave_report):
    whole = race(RaceSettings(runs=(leave_report(run),)))
    data = to_json(whole.results)
    panels = whole.pictures["race"].axes
    dots = [
        np.asarray(line.get_xdata())
        for line in panels[4].get_lines()
        if line.get_marker() == "o"
    ]
    shown = {round(float(x), 9) for (x,) in dots}
    timed = [
        racer for racer in (*data["racers"], *data["runs"]) if racer["time"] is not None
    ]
    assert shown >= {round(racer["time"], 9) for racer in timed}
    assert shown >= {
        round(racer["time"] - racer["reaction"], 9)
        for racer in timed
        if racer["reaction"]
    }
    bolt = next(
        line for line in panels[0].get_lines() if line.get_label() == races.BOLT
    )
    reached = np.asarray(bolt.get_ydata())[-1]
    # the curve's end beside the last mean
    assert reached == pytest.approx(data["racers"][0]["means"][-1], abs=0.1)
    legend = panels[3].get_legend()
    assert legend is not None
    (label,) = [
        text.get_text()
        for text in legend.get_texts()
        if races.TRAINED in text.get_text()
    ]
    assert f"{data['paper']['constant_times'][races.TRAINED]:.2f} s" in label
