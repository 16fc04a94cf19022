import dataclasses

import pytest

from bp2_rl.evaluation.benchmarks import losses as module
from bp2_rl.evaluation.benchmarks.losses import (
    Tried,
    greatest_speeds,
    losses,
    price,
    ramp_to_losses,
)
from bp2_rl.evaluation.benchmarks.options import BenchmarkOptions
from bp2_rl.robot.bp2_body import BP2Body
from bp2_rl.robot.hardware import (
    BUILT,
    IDEAL,
    PARTS,
    HardwareSpec,
    Losses,
    differing,
    with_parts,
)


def test_all_parts_together_make_the_other_robot():
    assert with_parts(IDEAL, BUILT, PARTS) == BUILT
    assert with_parts(BUILT, IDEAL, PARTS) == IDEAL
    assert differing(IDEAL, IDEAL) == ()
    assert set(differing(IDEAL, BUILT)) == set(PARTS) - {"braking limit"}
    # a part brings its own fields, and leaves the rest of the body
    own = BUILT.changed(leg_length=0.4, thigh_mass=3.0)
    assert with_parts(own, IDEAL, PARTS) == IDEAL.changed(
        leg_length=0.4, thigh_mass=3.0
    )


def test_every_loss_belongs_to_one_part():
    names = [name for part in PARTS.values() for name in part]
    assert len(set(names)) == len(names)
    losses, *others = (
        {field.name for field in dataclasses.fields(kind)}
        for kind in (Losses, HardwareSpec, BP2Body)
    )
    assert losses <= set(names) <= losses.union(*others)


def test_a_loss_of_a_robot_that_falls_costs_all_its_speed():
    assert price(Tried(15.0, None), Tried(14.2, None)) == pytest.approx(0.8)
    assert price(Tried(15.0, None), Tried(14.2, 3.0)) == 15.0


def test_the_optimiser_was_asked_for_the_same_parts():
    found = greatest_speeds()
    assert {name.partition(" + ")[2] for name in found if "+" in name} <= set(PARTS)
    assert found["built"] < found["ideal"] + 1e-9


def test_each_loss_is_tried_alone_left_out_and_added(
    make_policy, make_run, simulated, assert_fits
):
    """A robot that loses a tenth of a m/s for every part in which it is not ideal."""
    asked = []

    def run(one):
        asked.append(one.hardware)
        slower = len(differing(IDEAL, one.hardware)) / 10
        return make_run(duration=12.0, speed=10.0 - slower, acceleration=5.0)

    simulated(module, run)
    policy, setup = make_policy(), BenchmarkOptions(speed=10.0)
    evaluation = losses(policy, ramp_to_losses(policy, setup), setup)
    metrics, parts = evaluation.metrics, differing(IDEAL, BUILT)
    # With all but the last is as added up to it, the first added is alone, and the last
    # added is the built robot.
    assert len(asked) == len(set(asked)) == 3 * len(parts) - 1
    assert [loss.name for loss in metrics.losses] == list(parts)
    ideal, built = metrics.ideal.speed, metrics.built.speed
    assert ideal - built == pytest.approx(len(parts) / 10, abs=0.01)
    for i, loss in enumerate(metrics.losses, 1):
        assert ideal - loss.alone.speed == pytest.approx(0.1, abs=0.01)
        assert loss.without.speed - built == pytest.approx(0.1, abs=0.01)
        assert ideal - loss.added.speed == pytest.approx(i / 10, abs=0.02)
    assert metrics.losses[0].cost == price(metrics.ideal, metrics.losses[0].alone)
    # BP2 ran 13.2 m/s on a treadmill, 10.74 m/s outdoors
    still = metrics.losses[0].without.speed
    assert metrics.over_treadmill == pytest.approx(still - 13.2)
    assert metrics.over_outdoors == pytest.approx(built - 10.74)
    assert metrics.losses[0].optimiser == greatest_speeds()["ideal + air"]
    assert evaluation.good
    assert_fits(evaluation)
