import dataclasses

import numpy as np
import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.base.serialization import to_json
from bp2_rl.cli.trajopt import load_family, save_family
from bp2_rl.optimiser.family import (
    FamilyConfig,
    arrays_of,
    build_family,
    provenance_of,
    steps_of,
)
from bp2_rl.optimiser.problem import Problem
from bp2_rl.optimiser.solution import save_solution, speed_name
from bp2_rl.reference.library.file import MotionLibrary, load_library, save_library

SETTINGS = FamilyConfig(
    slowest=9.6,
    fastest=10.4,
    step=0.4,
    starts=1,
    coarse=5,
    problem=Problem(intervals=6),
)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A family of three speeds and the folder of its solutions."""
    folder = tmp_path_factory.mktemp("family")
    told = []
    return (
        build_family(
            SETTINGS, folder, report=lambda done, total: told.append((done, total))
        ),
        folder,
        told,
    )


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
    motion = dataclasses.replace(
        slower.motion, durations=1.1 * slower.motion.durations, q=slower.motion.q.copy()
    )
    motion.q[..., 4] += 0.2  # one knee
    (step,) = steps_of([slower, dataclasses.replace(slower, motion=motion)])
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
    with pytest.raises(UserError, match="holds a family with another step"):
        build_family(dataclasses.replace(SETTINGS, step=0.2), built[1])


def test_a_library_survives_the_disk(built, tmp_path):
    """Broken ones are the business of `reference.library`."""
    path = tmp_path / "deep" / "library.npz"
    save_family(path, built[0], SETTINGS)
    for solution, again in zip(built[0], load_family(path), strict=True):
        assert again.problem == solution.problem
        assert again.checks == solution.checks
        for name, array in solution.motion.arrays.items():
            assert np.array_equal(again.motion.arrays[name], array)
    library = load_library(path)
    assert library.speeds == pytest.approx([9.6, 10.0, 10.4])
    assert library.q.shape == (3, 2, 13, 15)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda old: {"made": "by a test"}, "made: unknown key"),
        (
            lambda old: old | {"solutions": old["solutions"][:1]},
            "3 speeds, and statistics of 1",
        ),
        (
            lambda old: old | {"solutions": [None] * 3},
            r"solutions\[0\] takes an object",
        ),
        (lambda old: old | {"versions": None}, "versions takes an object"),
        (
            lambda old: old | {"settings": old["settings"] | {"step": "far"}},
            "settings.step takes a number",
        ),
        (
            lambda old: old | {"settings": to_json(FamilyConfig())},
            "q is .* at each speed, its settings say",
        ),
    ],
)
def test_a_provenance_that_is_not_the_arrays_is_refused(
    built, tmp_path, change, message
):
    library = MotionLibrary(
        **arrays_of(built[0]), provenance=change(provenance_of(built[0], SETTINGS))
    )
    save_library(tmp_path / "library.npz", library)
    with pytest.raises(UserError, match=f"{message}.*bp2 trajopt library build"):
        load_family(tmp_path / "library.npz")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slowest": 11.0}, "must be in this order"),
        ({"slowest": 0.0}, "slowest must be from 0.01 to 100, got 0"),
        ({"fastest": float("inf")}, "fastest must be from 0.01 to 100, got inf"),
        ({"step": 0.0}, "step must be positive and at most 100, got 0"),
        ({"step": float("nan")}, "step must be positive and at most 100, got nan"),
        ({"step": 1e-9}, "step .* makes more than 1000 speeds"),
        ({"starts": 0}, "starts must be from 1 to 1000, got 0"),
        ({"starts": -1}, "starts must be from 1 to 1000, got -1"),
        ({"coarse": -5}, "coarse must be from 2 to 500, got -5"),
        ({"proximity": float("nan")}, "proximity must be from 0 to 1e"),
        ({"problem": Problem(gait="two-leg")}, "the library is of trots"),
    ],
)
def test_impossible_families_are_refused(change, message):
    with pytest.raises(UserError, match=message):
        dataclasses.replace(FamilyConfig(), **change)


def test_the_walks_meet_both_ends_whatever_the_step():
    family = FamilyConfig(slowest=0.7, fastest=12.25, step=0.5)
    down, up = map(family.walk, family.ends)
    assert down[0] == up[0] == 10.0
    assert (down[-1], up[-1]) == (0.7, 12.25)
    for walk in (down, up):
        assert np.abs(np.diff(walk)).min() > 0.0
        assert np.abs(np.diff(walk)).max() <= 0.5 + 1e-9
    assert len(FamilyConfig().speeds) == 30
    assert FamilyConfig(slowest=10.0, fastest=10.0).speeds == [10.0]


def test_every_speed_has_a_file_of_its_own():
    """Steps of 3 mm/s once shared 21 names among 69 speeds."""
    family = FamilyConfig(slowest=9.9, fastest=10.1, step=0.003)
    names = [speed_name(speed) for speed in family.speeds]
    assert len(set(names)) == len(family.speeds) == 69
    assert names == sorted(names)
    assert [float(name.removeprefix("speed-")) for name in names] == family.speeds


@pytest.mark.parametrize(
    ("speed", "name"),
    [
        (8.5, "speed-08.50"),
        (10.0, "speed-10.00"),
        (10.003, "speed-10.003"),
        (1e-5, "speed-00.00001"),
    ],
)
def test_files_are_called_by_their_speed(speed, name):
    assert speed_name(speed) == name


def test_a_file_of_another_speed_is_refused_by_its_name(built, tmp_path):
    """As folders made with rounded names have them."""
    settings = dataclasses.replace(SETTINGS, step=0.2)
    for speed in settings.speeds:
        save_solution(tmp_path / speed_name(speed), built[0][1])
    with pytest.raises(
        UserError,
        match=r"speed-09\.80 holds the solution of another problem, at 10 m/s",
    ):
        build_family(settings, tmp_path)
