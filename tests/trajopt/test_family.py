import dataclasses

import numpy as np
import pytest

from bp2_rl.errors import UserError
from bp2_rl.gait.collocation.library import load_library
from bp2_rl.trajopt.family import FamilyConfig, build_family, load_family, save_family, steps_of
from bp2_rl.trajopt.problem import Problem
from bp2_rl.trajopt.solution import Trajectory

SETTINGS = FamilyConfig(slowest=9.6, fastest=10.4, step=0.4, starts=1, coarse=5, problem=Problem(intervals=6))


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A family of three speeds and the folder of its solutions."""
    folder = tmp_path_factory.mktemp("family")
    told = []
    return build_family(SETTINGS, folder, report=lambda done, total: told.append((done, total))), folder, told


def test_the_family_has_the_speeds_asked_for(built):
    family, _, told = built
    assert [solution.problem.speed for solution in family] == [9.6, 10.0, 10.4]
    assert told[-1] == (3, 3)
    for solution in family:
        assert solution.violation <= 1e-6
        assert solution.checks["dynamics_residual"] < 1e-3


def test_neighbours_are_near(built):
    for step in steps_of(built[0]):
        assert abs(step.period) < 0.06
        assert 0.0 < step.joints < 0.15


def test_steps_measure_what_they_say(built):
    slower = built[0][0]
    trajectory = dataclasses.replace(
        slower.trajectory, durations=1.1 * slower.trajectory.durations, q=slower.trajectory.q.copy()
    )
    trajectory.q[..., 4] += 0.2  # one knee
    (step,) = steps_of([slower, dataclasses.replace(slower, trajectory=trajectory)])
    assert step.period == pytest.approx(0.1)
    assert step.joints == pytest.approx(0.2)


def test_an_interrupted_build_goes_on(built):
    family, folder, _ = built
    before = {path.name: path.stat().st_mtime_ns for path in folder.glob("speed-*")}
    for path in folder.glob("speed-10.40.*"):
        path.unlink()
    again = build_family(SETTINGS, folder)
    assert again[2].cost == pytest.approx(family[2].cost, rel=1e-6)
    for path in folder.glob("speed-*"):
        if "10.40" not in path.name:
            assert path.stat().st_mtime_ns == before[path.name]


def test_a_folder_of_another_family_is_left_alone(built):
    with pytest.raises(UserError, match="holds a family of other settings"):
        build_family(dataclasses.replace(SETTINGS, step=0.2), built[1])


def test_a_library_survives_the_disk(built, tmp_path):
    family = built[0]
    path = tmp_path / "deep" / "library.npz"
    save_family(path, family, SETTINGS)
    for solution, again in zip(family, load_family(path), strict=True):
        assert again.problem == solution.problem
        assert again.checks == solution.checks
        for field in dataclasses.fields(Trajectory):
            ours, theirs = (getattr(s.trajectory, field.name) for s in (solution, again))
            assert np.array_equal(ours, theirs)


def test_the_gait_reads_what_the_family_writes(built, tmp_path):
    save_family(tmp_path / "library.npz", built[0], SETTINGS)
    library = load_library(tmp_path / "library.npz")
    assert library.speeds == pytest.approx([9.6, 10.0, 10.4])
    assert library.q.shape == (3, 2, 13, 15)


def test_a_broken_library_is_refused(built, tmp_path):
    path = tmp_path / "library.npz"
    with pytest.raises(UserError, match="bp2 trajopt library build"):
        load_family(path)
    path.write_bytes(b"PK\x03\x04 not a library")
    with pytest.raises(UserError, match="cannot be read"):
        load_family(path)
    save_family(path, built[0], SETTINGS)
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **{**arrays, "format": np.asarray(7)})
    with pytest.raises(UserError, match="has format 7, this version reads 1"):
        load_family(path)
    np.savez(path, **{name: array for name, array in arrays.items() if name != "tau"})
    with pytest.raises(UserError, match="cannot be read"):
        load_family(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slowest": 11.0}, "must be in this order"),
        ({"slowest": 0.0}, "must be in this order"),
        ({"step": 0.0}, "step must be positive"),
        ({"step": float("nan")}, "step must be positive"),
        ({"problem": Problem(gait="two-leg")}, "the library is of trots"),
    ],
)
def test_impossible_families_are_refused(change, message):
    with pytest.raises(UserError, match=message):
        dataclasses.replace(FamilyConfig(), **change)


def test_the_walks_meet_both_ends_whatever_the_step():
    family = FamilyConfig(slowest=0.7, fastest=12.25, step=0.5)
    down, up = family.walks()
    assert down[0] == up[0] == 10.0
    assert (down[-1], up[-1]) == (0.7, 12.25)
    for walk in (down, up):
        assert np.abs(np.diff(walk)).min() > 0.0
        assert np.abs(np.diff(walk)).max() <= 0.5 + 1e-9
    assert len(FamilyConfig().speeds) == 30
    assert FamilyConfig(slowest=10.0, fastest=10.0).speeds == [10.0]
