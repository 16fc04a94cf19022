import pytest

from bp2_rl.base.errors import UserError
from bp2_rl.settings.env import CommandConfig, ControlConfig, EnvConfig
from bp2_rl.settings.training import ClusterConfig, RunConfig, TrainConfig


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"steps": 0}, "run.steps must be from 1 to"),
        ({"seed": -1}, "run.seed must be from 0 to 4294967295, got -1"),
        (
            {"seed": 2**63},
            "run.seed must be from 0 to 4294967295, got 9223372036854775808",
        ),
        (
            {"logs": 10**400},
            "run.logs must be from 1 to 1000000000, got a huge integer",
        ),
        ({"judged": -1}, "run.judged must be from 0 to 1000000, got -1"),
        ({"judged": 1, "until": 0.0}, "run.until must be from 0.1 to 100, got 0"),
        ({"until": 10.74}, "--until needs a judge: let --run.judged be 1 or more"),
    ],
)
def test_impossible_runs_are_refused_by_name(changes, line):
    with pytest.raises(UserError, match=f"^{line}"):
        RunConfig(**changes)


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        (
            {"patience": 0.0},
            "--cluster.patience must be positive and at most 1e.06, got 0",
        ),
        (
            {"coordinator": "host:1", "processes": 0, "process": 0},
            "--cluster.processes must be from 1 to 65536, got 0",
        ),
        (
            {"coordinator": "host:1", "processes": 2, "process": 2},
            "--cluster.process must be 0 to 1, got 2",
        ),
    ],
)
def test_impossible_clusters_are_refused_by_the_flag(changes, line):
    with pytest.raises(UserError, match=f"^{line}"):
        ClusterConfig(**changes)


def test_commands_that_no_controller_tells_are_refused():
    control = ControlConfig(launching=6.0, launching_speed=18.0)
    with pytest.raises(
        UserError,
        match=r"commands\.max_forward \(20\) must be below control\.launching_speed \(18\)",
    ):
        EnvConfig(control=control, commands=CommandConfig(max_forward=20.0))


def test_a_run_cannot_end_at_a_speed_beyond_its_fastest_command():
    env = EnvConfig(commands=CommandConfig(max_forward=2.0))
    TrainConfig(env=env, run=RunConfig(judged=1, until=2.0))
    with pytest.raises(UserError, match=r"--until 2.1 cannot be reached: .* is 2 m/s"):
        TrainConfig(env=env, run=RunConfig(judged=1, until=2.1))
