"""`bp2 play` as a user meets it: what it refuses, and how it ends."""

import importlib.util
import re

import pytest

from bp2_rl.cli import play as command

NEEDED = 'needs the package viser: pip install -c constraints.txt -e ".[play]"'


@pytest.fixture(autouse=True)
def nowhere(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "")  # the command takes it away


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--port", "0"], "--port must be from 1 to 65535, got 0"),
        (["--seconds", "-1"], "--seconds must be"),
        (["--speed", "inf"], "--speed must be from -100 to 100"),
        (["nowhere"], "no policy"),
        (
            ["--speed", "16"],
            "--speed must be from 0 to 15.5, what this policy was trained for, got 16",
        ),
    ],
)
def test_a_mistake_is_one_line_and_status_2(flags, said, capsys):
    pytest.importorskip("viser", reason=NEEDED)
    assert command.main(flags) == 2
    out, err = capsys.readouterr()
    assert re.fullmatch(f"error: {re.escape(said)}.*\n", err)
    assert "http" not in out  # no page was served


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
