"""The mechanism benchmark on forces that are known: metrics, sentences and figures."""

import numpy as np
import pytest
from known_strides import STRIDES, known_forces

from bp2_rl.paper.benchmarks.mechanism.forces import (
    COORDINATES,
    closure,
    measure_forces,
)
from bp2_rl.paper.benchmarks.speeds import whole_strides
from bp2_rl.paper.trajectories.sources import SPATIAL_TERMS

HIP = slice(0, None, 2)


def test_shares_are_those_at_the_peaks_by_source():
    found = measure_forces(known_forces(), STRIDES, 1e-3)
    assert found.closure < 1e-12
    assert found.frequency == pytest.approx(10.0)
    assert found.peaks == 4 * 2 * STRIDES
    assert found.covered == pytest.approx(0.72)
    assert found.own == pytest.approx(0.7)
    assert found.legs == pytest.approx(0.02)
    assert found.within["spring"] == pytest.approx(0.4)
    # u is 0.28 of the main torque; without the trunk's help it would be 0.30.
    assert found.torques["hip, u"] == pytest.approx(28.0)
    assert found.torques["hip, ũ"] == pytest.approx(30.0)
    assert found.saved_at_hips == pytest.approx(1 - 28 / 30)


def test_closure_tells_a_term_that_lacks():
    forces = known_forces()
    forces.terms[SPATIAL_TERMS.index("active"), 7, COORDINATES.motors[0]] += 1.0
    assert np.argmax(closure(forces)) == 7
    assert measure_forces(forces, STRIDES, 1e-3).closure == pytest.approx(1.0 / 350.0)


def test_whole_strides_go_from_touchdown_to_touchdown(make_run):
    run = make_run(duration=6.0)
    found = whole_strides(run, most=3)
    assert found is not None
    part, strides = found
    assert strides == 3
    touching = run.foot_force[:, 2, 2] > 0.0
    period = np.diff(np.flatnonzero(touching[1:] & ~touching[:-1])).mean()
    assert len(part) == pytest.approx(3 * period, abs=3)
    assert whole_strides(run.between(1.0, 1.05)) is None
