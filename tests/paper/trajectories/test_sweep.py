import dataclasses

import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import save_config
from bp2_rl.optimiser.problem import Problem
from bp2_rl.paper.trajectories.sweep import Attempt, best_of, sweep

PROBLEM = Problem(intervals=4)


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """Two cold starts at a possible speed, two at an impossible one."""
    folder = tmp_path_factory.mktemp("sweep")
    return list(sweep(PROBLEM.on_mesh(2), [12.0, 40.0], 2, folder)), folder


def test_every_attempt_is_reported(swept):
    attempts, _ = swept
    assert sorted((attempt.speed, attempt.start) for attempt in attempts) == [
        (12, 0),
        (12, 1),
        (40, 0),
        (40, 1),
    ]
    for attempt in attempts:
        assert attempt.seconds > 0.0
        assert attempt.solved == (attempt.speed == 12.0)
        if attempt.solved:
            assert attempt.violation <= 1e-6
        else:
            assert "no trajectory at 40 m/s" in attempt.why


def test_only_what_was_solved_is_kept_and_the_cheapest_is_the_best(swept):
    attempts, folder = swept
    (best,) = best_of(folder)
    assert best.problem.speed == 12.0
    assert best.cost == min(attempt.cost for attempt in attempts if attempt.solved)
    assert "energy_residual" in best.checks
    assert not list(folder.glob("speed-40*.npz"))


def test_nothing_is_solved_twice(swept):
    attempts, folder = swept
    before = {path: path.stat().st_mtime_ns for path in folder.glob("speed-*")}
    again = list(sweep(PROBLEM.on_mesh(2), [12.0, 40.0], 2, folder))
    assert {path: path.stat().st_mtime_ns for path in folder.glob("speed-*")} == before
    assert sorted(a.seconds for a in again) == sorted(a.seconds for a in attempts)


def test_a_folder_of_another_sweep_is_left_alone(swept):
    with pytest.raises(UserError, match="holds a sweep with another clearance"):
        list(
            sweep(
                dataclasses.replace(PROBLEM.on_mesh(2), clearance=0.1),
                [12.0],
                1,
                swept[1],
            )
        )


def test_a_record_of_another_speed_is_refused_by_its_name(swept, tmp_path):
    save_config(tmp_path / "sweep.json", PROBLEM)
    save_config(
        tmp_path / "speed-12.00-start-0.attempt.json", Attempt(12.003, 0, False, 1.0)
    )
    with pytest.raises(
        UserError, match=r"speed-12.00-start-0.* is about start 0 at 12.003 m/s"
    ):
        list(sweep(PROBLEM, [12.0], 1, tmp_path))


def test_an_empty_folder_is_said_to_be_empty(tmp_path):
    with pytest.raises(
        UserError, match="holds no solved sweep: run `bp2 paper trajectories sweep"
    ):
        best_of(tmp_path)
