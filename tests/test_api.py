"""The public names of the package."""

import dataclasses
import importlib
import inspect
import os
import re
import subprocess
import sys
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest

import bp2_rl
from bp2_rl.base.assets import asset_path
from bp2_rl.base.errors import UserError
from bp2_rl.base.processes import use_one_xla_thread
from bp2_rl.base.serialization import save_config
from bp2_rl.env import observations
from bp2_rl.learning.policy import SHIPPED
from bp2_rl.robot.hardware import IDEAL
from bp2_rl.settings import training


@pytest.mark.parametrize("name", bp2_rl.HOMES)
def test_a_public_name_is_what_its_home_defines(name):
    home = importlib.import_module(f"bp2_rl.{bp2_rl.HOMES[name]}")
    assert getattr(bp2_rl, name) is getattr(home, name)
    assert getattr(bp2_rl, name).__name__ == name
    assert getattr(bp2_rl, name).__module__ == home.__name__
    assert name in dir(bp2_rl)


def test_the_reference_describes_every_public_name():
    page = (Path(__file__).parents[1] / "docs/reference/python.md").read_text(
        encoding="utf-8"
    )
    assert sorted(re.findall(r"^::: bp2_rl\.(\w+)$", page, re.MULTILINE)) == sorted(
        bp2_rl.HOMES
    )


def test_a_wrong_name_is_answered_with_the_right_ones():
    with pytest.raises(
        AttributeError,
        match=r"bp2_rl has no sprint; its public names are load_policy, Policy, rollout",
    ):
        bp2_rl.sprint  # noqa: B018


def test_importing_the_package_imports_neither_jax_nor_mujoco():
    code = "import sys, bp2_rl; print(sorted({'jax', 'mujoco', 'brax'} & set(sys.modules)))"
    assert in_a_process(code).stdout.strip() == "[]"


def in_a_process(code, **variables):
    """Run code in a process of its own, with NPROC unset unless these variables set
    it."""
    environment = {
        name: value for name, value in os.environ.items() if name != "NPROC"
    } | variables
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
    )


def test_importing_public_names_prints_nothing_and_sets_one_xla_thread_on_cpus():
    """MJX says on import that Warp is missing; XLA waits for ever where MJX's batched
    kernels have several threads."""
    used = "bp2_rl.make, bp2_rl.rollout, bp2_rl.train, bp2_rl.BP2Env"
    code = f"import os, bp2_rl; {used}; print(os.environ['NPROC'])"
    done = in_a_process(code, JAX_PLATFORMS="cpu")
    assert (done.stdout, done.stderr) == ("1\n", "")


def test_a_users_number_of_xla_threads_is_kept(monkeypatch):
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    monkeypatch.setenv("NPROC", "3")
    use_one_xla_thread()
    assert os.environ["NPROC"] == "3"


def test_importing_the_package_sets_nothing_and_takes_a_tenth_of_a_second():
    code = """
import os, time
before, since = dict(os.environ), time.process_time()
import bp2_rl
print(time.process_time() - since, dict(os.environ) == before)
"""
    seconds, unchanged = in_a_process(code).stdout.split()
    assert unchanged == "True"
    # of processor time, so that a busy machine does not count
    assert float(seconds) <= 0.1


def test_a_shipped_policy_is_found_by_its_name():
    shipped = asset_path("policies")
    assert sorted(SHIPPED) == sorted(
        entry.name for entry in shipped.iterdir() if entry.is_dir()
    )
    assert (
        bp2_rl.load_policy("built").card == bp2_rl.load_policy(shipped / "built").card
    )


def test_a_folder_of_that_name_goes_before_the_shipped_policy(tmp_path, monkeypatch):
    (tmp_path / "built").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match="built"):
        bp2_rl.load_policy("built")


WRONG = [
    (
        'make("walker")',
        "there is no environment 'walker': choose one of bp2, bp2_ideal, bp2_kinematic",
    ),
    (
        'make("walker", bp2.EnvConfig())',
        "there is no environment 'walker': choose one of",
    ),
    (
        'preset("imitation", "big")',
        "there is no preset 'big': choose one of smoke, first, cpu, gpu",
    ),
    (
        'preset("walk", "cpu")',
        "there is no stage 'walk': choose one of imitation, relaxed",
    ),
    (
        'make("bp2", impl="mjx")',
        "there is no physics 'mjx': did you mean jax? choose one of jax, kernel",
    ),
    (
        'make("bp2", "cpu")',
        'make takes settings, such as preset("imitation", "cpu").env, got \'cpu\'',
    ),
    (
        "Course().to(5.0, 1.0)",
        "a course leads to three numbers (forward, left, yaw rate); got 5.0",
    ),
    (
        'rollout(bp2.load_policy("built"), 10.0)',
        "rollout takes a schedule that lasts, such as Ramp(10.0), got 10",
    ),
    (
        'rollout(bp2.load_policy("built"), bp2.Course())',
        "rollout takes a schedule that lasts",
    ),
    (
        'rollout(bp2.load_policy("built"), bp2.Ramp(3.0), backend="bullet")',
        "there is no backend 'bullet'",
    ),
    (
        'train("imitation", "run")',
        'train takes settings, such as preset("imitation", "cpu") gives, got \'imit',
    ),
    (
        'rollout(bp2.load_policy("built"), bp2.Ramp(3.0), hardware=3)',
        "hardware takes a HardwareSpec, got 3",
    ),
    (
        'rollout(bp2.load_policy("built"), bp2.Ramp(3.0), world=0.1)',
        "world takes a World, got 0.1",
    ),
    (
        'simulate(bp2.load_policy("built"), bp2.RunRequest(bp2.Ramp(3.0)))',
        "simulate takes several requests, such as",
    ),
    (
        'simulate(bp2.load_policy("built"), [bp2.Ramp(3.0)])',
        "each request takes a RunRequest, such as",
    ),
    (
        'rollout(bp2.load_policy("built"), bp2.Ramp(3.0), config=3)',
        "config takes settings, such as preset",
    ),
    (
        'rollout(bp2.load_policy("built"), bp2.Ramp(3.0), operator=3)',
        "operator takes a HeadingHold, got 3",
    ),
    ("Course(3)", "course.legs takes a tuple of entries, each a CourseLeg, got 3"),
    (
        "Course().to((1.0, 2.0, 'x'), 1.0)",
        "leg.command takes a number, got 'x'",
    ),
    ("World(pushes=3)", "world.pushes takes a tuple of entries, each a Push, got 3"),
    (
        "World(pushes=(bp2.Push(1.0, 0.0, 1.0), 3))",
        "world.pushes takes a Push, got 3",
    ),
    (
        'make("bp2", task=3)',
        "task takes a file or a Task, got 3",
    ),
    (
        "resume(None)",
        "the name of a file or folder takes a text or a Path, such as 'runs/first', got None",
    ),
    (
        'train(bp2.preset("imitation", "cpu"), None)',
        "the name of a file or folder takes a text or a Path, such as",
    ),
    ("TrainConfig(env=3)", "env takes an EnvConfig, got 3"),
    ("EnvConfig(hardware=3)", "hardware takes a HardwareSpec, got 3"),
    ("Ramp(10.0, hold=True)", "ramp.hold takes a number, got True"),
    (
        'EnvConfig(reference="foo")',
        "reference takes 'collocation' or 'kinematic' or 'none', got 'foo'",
    ),
    ('EnvConfig(hardware="built")', "hardware takes a HardwareSpec, got 'built'"),
    ('Ramp(10.0, hold="5")', "ramp.hold takes a number, got '5'"),
    ("load_policy(3)", "load_policy takes a folder or a policy's name (built, "),
    ('make("bp2", num_robots=0)', "num_robots must be at least 1, got 0"),
    (
        'train(bp2.preset("imitation", "cpu"), "run", tracker="tensorboard")',
        "there is no tracker 'tensorboard'",
    ),
    (
        "train(bp2.EnvConfig(), 'run')",
        'train takes settings, such as preset("imitation", "cpu") gives, got a EnvC',
    ),
    (
        'preset("imitation", "cpu", robot=5)',
        "robot takes a robot's name, a robot file's path or a HardwareSpec, g",
    ),
    (
        'preset("relaxed", "cpu", robot="dog")',
        "there is no robot 'dog': choose one of ideal, built",
    ),
]  # ask, how the answer begins


@pytest.fixture(scope="module")
def answers():
    """Return the answers to all wrong calls of the API, from a process of its own, as
    types are checked first in this one."""
    code = f"""
import bp2_rl as bp2
for ask in {[ask for ask, _ in WRONG]}:
    try:
        print(eval("bp2." + ask))
    except bp2.UserError as error:
        print(error)
"""
    return in_a_process(code).stdout.splitlines()


@pytest.mark.parametrize("number", range(len(WRONG)))
def test_a_wrong_choice_is_answered_with_what_is_right(number, answers):
    assert answers[number].startswith(WRONG[number][1])


def paths_of_the_api():
    """Return the parameters of public functions and methods that can be a path."""
    found = set()
    for name in bp2_rl.HOMES:
        public = getattr(bp2_rl, name)
        own = [public]
        if inspect.isclass(public):
            methods = [
                value
                for key, value in vars(public).items()
                if not key.startswith("_") or key == "__init__"
            ]
            own = [getattr(method, "__func__", method) for method in methods]
        for function in filter(inspect.isfunction, own):
            # a task's settings name types that they do not import
            for parameter, kind in typing.get_type_hints(
                function, None, vars(observations) | vars(training)
            ).items():
                if parameter != "return" and Path in (kind, *typing.get_args(kind)):
                    assert str in typing.get_args(kind), (
                        f"{function.__qualname__} takes no text as {parameter}"
                    )
                    found.add((function.__qualname__, parameter))
    return found


SHORT = bp2_rl.Ramp(0.5, hold=0.05)
GO1 = asset_path("robots/go1.toml")
TASK = Path(__file__).parents[1] / "examples/reward_term.py"
UNJUDGED = bp2_rl.preset("imitation", "smoke")
UNJUDGED = dataclasses.replace(
    UNJUDGED, run=dataclasses.replace(UNJUDGED.run, judged=0)
)
BY_PATH: dict[tuple[str, str], Callable[[Path, Callable[[Path], Any]], Any]] = {
    ("load_policy", "path"): lambda _, of: (
        bp2_rl.load_policy(of(asset_path("policies/built"))).card
    ),
    ("preset", "robot"): lambda _, of: bp2_rl.preset(
        "imitation", "smoke", robot=of(GO1)
    ),
    ("preset", "task"): lambda _, of: bp2_rl.preset(
        "imitation", "smoke", task=of(TASK)
    ),
    ("make", "task"): lambda _, of: bp2_rl.make("bp2_kinematic", task=of(TASK)).config,
    ("load_policy", "task"): lambda _, of: refusal(
        lambda: bp2_rl.load_policy("ideal", task=of(TASK))
    ),
    ("rollout", "hardware"): lambda _, of: refusal(
        lambda: bp2_rl.rollout(
            bp2_rl.load_policy("ideal"), SHORT, hardware=of(Path("no robot.toml"))
        )
    ),
    ("Trajectory.save", "path"): lambda folder, of: (
        bp2_rl.rollout(bp2_rl.load_policy("ideal"), SHORT).save(of(folder / "x.npz")),
        bp2_rl.Trajectory.load(folder / "x.npz").metrics.mean_speed,
    ),
    ("Trajectory.load", "path"): lambda folder, of: (
        bp2_rl.rollout(bp2_rl.load_policy("ideal"), SHORT).save(folder / "x.npz"),
        bp2_rl.Trajectory.load(of(folder / "x.npz")).metrics.mean_speed,
    ),
    ("train", "run_dir"): lambda folder, of: bp2_rl.train(UNJUDGED, of(folder)),
    ("train", "parent"): lambda folder, of: bp2_rl.train(
        UNJUDGED, folder, parent=of(folder)
    ),
    ("resume", "run_dir"): lambda folder, of: bp2_rl.resume(of(folder)),
}
"""What each of them gives, of a folder, with a path made by a function."""


def refusal(call: Callable[[], object]) -> str:
    with pytest.raises(UserError) as told:
        call()
    return str(told.value)


def test_each_path_of_the_api_has_its_test():
    assert paths_of_the_api() == set(BY_PATH)


@pytest.mark.parametrize("name", BY_PATH, ids=".".join)
def test_a_path_may_be_a_text_or_a_path(name, tmp_path, monkeypatch):
    """The learner is a stand-in, which must be given paths alone."""
    given = []

    def told(*arguments, **named):
        given.append(
            [*arguments[-1:], *(named[one] for one in ("parent",) if one in named)]
        )
        return tmp_path

    monkeypatch.setattr("bp2_rl.learning.run.start", told)
    monkeypatch.setattr("bp2_rl.learning.run.resume", told)
    save_config(tmp_path / "config.json", UNJUDGED)
    by_text, by_path = (BY_PATH[name](tmp_path, of) for of in (str, Path))
    assert by_text == by_path
    assert given[:1] == given[1:]
    assert all(isinstance(path, Path | None) for paths in given for path in paths)


def test_what_a_reader_prints_is_a_line():
    policy = bp2_rl.load_policy("gentle")
    assert repr(policy).startswith("Policy(relaxed, BP2, ")
    run = bp2_rl.rollout(policy, bp2_rl.Ramp(0.5, hold=0.05), hardware="ideal")
    assert run.hardware == IDEAL
    assert repr(run) == f"Trajectory(policy, {run.time[-1]:.2f} s, upright)"


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda: bp2_rl.rollout(bp2_rl.load_policy("built"), cast(Any, bp2_rl.Ramp)),
            "a schedule that lasts",
        ),
        (
            lambda: bp2_rl.rollout(
                bp2_rl.load_policy("built"), bp2_rl.Ramp(1.0), hardware="go2"
            ),
            "there is no robot",
        ),
        (lambda: bp2_rl.make("go1"), 'go1 is a robot: make("bp2"'),
    ],
)
def test_a_name_in_the_wrong_place_is_told_where_it_belongs(call, said):
    with pytest.raises(UserError, match=re.escape(said)):
        call()
