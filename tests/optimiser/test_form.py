"""Limits on the form of a stride, each as MuJoCo and SciPy measure it, and the slow end
of a family that sets them."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import simpson

from bp2_rl.base.errors import UserError
from bp2_rl.optimiser.collocation import solve
from bp2_rl.optimiser.family import FamilyConfig, Limits, SlowEnd
from bp2_rl.optimiser.planar import PlanarModel
from bp2_rl.optimiser.problem import Form, Problem

STANDING = (1, 2)  # FL and RR, of the legs in their order
SWINGING = (0, 3)
SLOW = FamilyConfig().slow


def least_duty(solution):
    stance, flight = solution.motion.durations
    return float(stance / (2.0 * (stance + flight)))


def longest_period(solution):
    return float(2.0 * solution.motion.durations.sum())


def highest_trunk(solution):
    return float(solution.motion.q[..., 1].max())


def highest_step(solution):
    model, motion = PlanarModel.of(solution.problem), solution.motion
    heights = np.array(
        [
            [model.terms(q, 0.0 * q).contact[1::2] for q in segment]
            for segment in motion.q
        ]
    )
    return float(max(np.max(heights[0][:, SWINGING]), np.max(heights[1])))


def hardest_landing(solution):
    motion, order = solution.motion, solution.problem.stride.next_coordinates
    before = PlanarModel.of(solution.problem).terms(
        motion.q[-1, -1, order], motion.v[-1, -1, order]
    )
    return float(
        np.max(
            np.abs(before.jacobian @ motion.v[-1, -1, order]).reshape(4, 2)[
                list(STANDING)
            ]
        )
    )


def fastest_release(solution):
    springs = solution.motion.v[0, -1, 3:].reshape(4, 3)[list(STANDING), 2]
    return -float(np.min(springs))


def greatest_share(solution):
    loads = np.asarray(simpson(solution.motion.force[0, :, 1::2], axis=0))
    return float(np.max(loads) / np.sum(loads))


LIMITS = [
    (least_duty, 1.05),
    (longest_period, 0.98),
    (highest_trunk, 0.99),
    (highest_step, 0.95),
    (hardest_landing, 0.9),
    (fastest_release, 0.97),
    (greatest_share, 0.99),
]
"""Measures of a trot, each with the factor that makes its limit a little tighter than
the cheapest trot."""


@pytest.fixture(scope="module")
def formed(trot):
    """Return a trot within all `LIMITS` at once."""
    form = Form(
        **{measure.__name__: change * measure(trot) for measure, change in LIMITS}
    )
    return solve(dataclasses.replace(trot.problem, form=form), trot.motion)


@pytest.mark.parametrize(("measure", "change"), LIMITS)
def test_a_limit_on_form_is_kept(trot, formed, measure, change):
    """To 1e-6, the program's tolerance."""
    limit, found = change * measure(trot), measure(formed)
    assert found >= limit - 1e-6 if change > 1.0 else found <= limit + 1e-6


def test_a_fast_trot_is_asked_for_no_form():
    for speed in (5.0, 10.0, 15.0):
        assert FamilyConfig().at(speed) == FamilyConfig().problem.at(speed)
    assert FamilyConfig().problem.form == Form()


def test_limits_go_along_a_line_and_stay_as_they_are_below_it():
    duties = [
        FamilyConfig().at(speed).form.least_duty
        for speed in (0.5, 1.0, 2.0, 3.0, 4.0, 4.999)
    ]
    assert duties == pytest.approx([0.48, 0.48, 0.425, 0.37, 0.315, 0.26], abs=1e-4)
    assert FamilyConfig().at(3.0).torque_rate == pytest.approx(3500.0)


def test_lengths_are_those_of_the_leg_and_tighter_limits_stay():
    # six fifths
    problem = Problem(speed=0.5, pitch_limit=0.01, torque_rate=500.0).on(
        leg_length=0.42
    )
    limited = SLOW.limit(problem)
    assert limited.form.highest_trunk == pytest.approx(1.2 * 0.57)
    assert limited.form.highest_step == pytest.approx(1.2 * 0.10)
    assert (limited.form.least_duty, limited.form.longest_period) == (0.48, 0.44)
    assert (limited.pitch_limit, limited.torque_rate, limited.speed_margin) == (
        0.01,
        500.0,
        0.5,
    )


@pytest.mark.parametrize(
    "open_end",
    [{"lower": Limits()}, {"upper": Limits()}, {"lower": Limits(), "upper": Limits()}],
)
def test_between_a_limit_and_none_there_is_none(open_end):
    for speed in (1.5, 3.0, 4.9):
        form = dataclasses.replace(SLOW, **open_end).limit(Problem(speed=speed)).form
        assert (
            form.longest_period == form.highest_step == form.hardest_landing == math.inf
        )


def test_a_slow_end_that_ends_where_it_begins_is_a_step():
    slow = SlowEnd(speeds=(2.0, 2.0))
    assert slow.limit(Problem(speed=2.0)).form == Form()
    assert slow.limit(Problem(speed=1.99)).form.least_duty == 0.48


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (
            lambda: Form(least_duty=0.5),
            "form.least_duty must be at least 0 and below 0.5, got 0.5",
        ),
        (
            lambda: Form(greatest_share=0.4),
            "form.greatest_share must be from 0.5 to 1, got 0.4",
        ),
        (
            lambda: Form(longest_period=math.nan),
            "form.longest_period must be from 0.01 to 10 or inf, got nan",
        ),
        (lambda: Limits(torque_rate=0.0), "torque_rate must be from 1 to"),
        (
            lambda: SlowEnd(speeds=(5.0, 1.0)),
            r"slow.speeds must be a range \(low, high\)",
        ),
        (lambda: SlowEnd(proximity=-1.0), "slow.proximity must be from 0 to"),
    ],
)
def test_impossible_forms_are_refused(build, message):
    with pytest.raises(UserError, match=message):
        build()
