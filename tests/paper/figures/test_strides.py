"""Three gait cycles of a run: which cycles are chosen, and which numbers are given."""

import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.paper.figures.runs import CYCLES, cycles
from bp2_rl.paper.figures.settings import StridesFigureSettings
from bp2_rl.paper.figures.strides import describe_cycles, strides


def test_the_cycles_are_whole_and_end_within_the_best_second(make_run):
    run = make_run(duration=8.0)
    part = cycles(run)
    landed = (
        np.flatnonzero(
            (run.foot_force[1:, 2, 2] > 0.0) & (run.foot_force[:-1, 2, 2] == 0.0)
        )
        + 1
    )
    period = np.diff(landed).mean()
    # contact begins above a few N
    assert len(part) == pytest.approx(CYCLES * period, abs=3)
    numbers = describe_cycles("a run", part)
    assert numbers.frequency == pytest.approx(1.0 / (period * run.dt), rel=0.02)
    assert numbers.speed == pytest.approx(5.0, abs=0.1)
    assert 0.0 <= numbers.aerial < 1.0


def test_a_run_without_three_cycles_is_refused(make_run):
    with pytest.raises(
        UserError, match=r"whole strides, 3 are drawn: name a longer one"
    ):
        cycles(make_run(duration=6.0).between(3.0, 3.3))


def test_one_report_is_drawn_and_no_other_number_of_them(make_run, leave_report):
    report = leave_report(make_run(duration=6.0))
    drawn = strides(StridesFigureSettings((report,)))
    assert list(drawn.pictures) == ["strides"]
    assert drawn.results.name == "simulated, ideal robot"
    for runs in ((), (report, report)):
        with pytest.raises(
            UserError,
            match=r"--runs takes one report that python eval\.py --benchmark topspeed leaves",
        ):
            strides(StridesFigureSettings(runs))
