"""Poincare sections of pendulums, against what must hold of all their points."""

import numpy as np
import pytest

from bp2_rl.paper.pendulum.sections import Section, sections

A = np.pi / 3.0


@pytest.fixture(scope="module")
def beams() -> list[Section]:
    return sections(A, [5.0, 25.0], 60.0)


def test_when_the_beam_turns_it_has_no_speed_and_no_energy(beams):
    for section in beams:
        cos = np.cos(section.theta)
        # No momentum, and none of it the beam's; a cubic between samples is right to
        # 1e-6.
        np.testing.assert_allclose(np.sum(cos * section.rate, axis=-1), 0.0, atol=1e-6)
        np.testing.assert_allclose(
            np.sum(section.rate**2 / 2.0 + 1.0 - cos, axis=-1),
            1.0 - np.cos(A),
            atol=1e-6,
        )
        # It turns from left to right: what hangs pulls it to the right.
        assert np.all(
            np.sum(np.sin(section.theta) * (section.rate**2 + cos), axis=-1) > 0.0
        )


def test_pendulums_that_exchange_share_a_path_and_trapped_ones_do_not(beams):
    shared, apart = (section.path for section in beams)
    assert shared.apart < 0.15  # gaps between some sixty points
    assert apart.apart > 1.0
    np.testing.assert_allclose(shared.angles[0], shared.angles[1], atol=0.02)
    assert apart.angles[0][0] > apart.angles[1][1]
