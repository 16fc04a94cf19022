"""`bp2 play` as a user meets it: what it refuses, and how it ends."""

import importlib.util

import pytest
from refusals import refused

from bp2_rl.cli import play as command

NEEDED = 'needs the package viser: pip install -c constraints.txt -e ".[play]"'


@pytest.fixture(autouse=True)
def nowhere(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MUJOCO_GL", "")  # the command takes it away


def test_a_speed_that_the_policy_was_not_trained_for_is_refused(capsys):
    pytest.importorskip("viser", reason=NEEDED)
    said = "--speed must be from 0 to 15.5, what this policy was trained for, got 16"
    assert said in refused(capsys, command.main, "--speed", 16)


def test_a_missing_package_is_one_line_that_says_what_to_install(monkeypatch, capsys):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util,
        "find_spec",
        lambda name, *rest: None if name == "viser" else found(name, *rest),
    )
    assert command.main([]) == 2
    assert capsys.readouterr().err == (
        'error: bp2 play needs the package viser: pip install -c constraints.txt -e ".[play]"\n'
    )


@pytest.mark.parametrize(
    ("host", "open_to_all"), [("0.0.0.0", True), ("localhost", False)]
)
def test_a_page_for_other_machines_says_who_can_steer_the_robot(
    host, open_to_all, monkeypatch, capsys
):
    pytest.importorskip("viser", reason=NEEDED)
    # s: it need not stand
    monkeypatch.setattr("bp2_rl.simulation.simulator.SETTLING_TIME", 0.1)
    monkeypatch.setattr("bp2_rl.simulation.parallel.compute_here", lambda: None)
    flags = ["--robot", "ideal", "--port", "18080", "--seconds", "0.1"]
    assert command.main([*flags, "--host", host]) == 0
    line = f"--host {host}: anyone on the network who can reach this machine can steer the robot\n"
    assert (line in capsys.readouterr().out) is open_to_all
