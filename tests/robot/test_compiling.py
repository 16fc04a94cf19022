"""A robot's model is compiled apart: it comes back bit for bit, and one that asks for
everything ends in one line."""

import os
import time

import mujoco
import numpy as np
import pytest

from bp2_rl.base.assets import asset_path
from bp2_rl.cli import robot as command
from bp2_rl.robot import compiling
from bp2_rl.robot.compiling import ReadingError, compiled_apart, load_mjcf


def packed(model: mujoco.MjModel) -> bytes:
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content.tobytes()


def test_a_model_comes_back_bit_for_bit():
    path = asset_path("bp2_mjcf/bp2.xml")
    here, notes = compiling.compile_file(path, ())
    assert packed(load_mjcf(path)) == packed(here)
    assert notes == []


def test_what_is_wrong_with_a_model_is_said_as_if_it_was_compiled_here(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(
        "<mujoco><worldbody><body><joint type='knee'/></body></worldbody></mujoco>"
    )
    with pytest.raises(
        ReadingError,
        match="not an MJCF that MuJoCo can read: XML Error: invalid keyword: 'knee'",
    ):
        load_mjcf(path)


GEOM = '<geom size=".1"/>'
THOUSAND = '<replicate count="1000">'
LONG = {
    "replicas": f"<worldbody>{3 * THOUSAND}{GEOM}{3 * '</replicate>'}</worldbody>",
    "bodies": f"<worldbody>{400_000 * ('<body>' + GEOM + '</body>')}</worldbody>",
    "a pipe": '<include file="pipe.xml"/>',
    "a pipe attached": '<asset><model name="m" file="pipe.xml"/></asset><worldbody><attach model="m" prefix="m"/>'
    "</worldbody>",
}
LARGE = {
    "a flex": '<worldbody><flexcomp name="f" type="grid" count="2000 2000 2000" spacing=".1 .1 .1" radius=".01" dim="3"'
    ' mass="1"/></worldbody>',
    "a cable": '<worldbody><composite type="cable" curve="s" count="100000000 1 1" size="1"><geom type="capsule" '
    'size=".01"/></composite></worldbody>',
    "numbers of a user": '<size nuser_body="1000000000"/><worldbody><body/></worldbody>',
}


def refusal(tmp_path, capsys, text):
    """Give a model to the command; return its error and how long it takes, s."""
    os.mkfifo(tmp_path / "pipe.xml")
    path = tmp_path / "robot.xml"
    path.write_text(f"<mujoco>{text}</mujoco>")
    began = time.monotonic()
    status = command.main(["new", str(path), "--out", str(tmp_path / "robot.toml")])
    error = capsys.readouterr().err
    assert (status, error.count("\n")) == (2, 1), error
    assert error.startswith(f"error: {path}: ")
    assert not (tmp_path / "robot.toml").exists()
    return error, time.monotonic() - began


@pytest.mark.parametrize("text", LONG.values(), ids=LONG)
def test_a_model_that_takes_too_long_is_given_up(tmp_path, capsys, monkeypatch, text):
    monkeypatch.setattr(compiling, "LONGEST", 2)
    error, seconds = refusal(tmp_path, capsys, text)
    assert error.endswith(
        ": MuJoCo has not compiled it after 2 s: leave only the robot\n"
    )
    # with the start and the end of the process, on a busy machine
    assert seconds < 10.0


@pytest.mark.parametrize("text", LARGE.values(), ids=LARGE)
def test_a_model_that_takes_too_much_memory_is_given_up(
    tmp_path, capsys, monkeypatch, text
):
    # s: a busy machine may take longer to fill the memory
    monkeypatch.setattr(compiling, "LONGEST", 120)
    error, _ = refusal(tmp_path, capsys, text)
    assert error.endswith(
        ": it crashes MuJoCo or takes over 2 GB: leave only the robot\n"
    )


@pytest.mark.attack
def test_the_line_comes_after_at_most_twenty_seconds(tmp_path, capsys):
    _, seconds = refusal(tmp_path, capsys, LONG["replicas"])
    assert seconds < 20.0


def test_a_compiled_model_that_is_no_robot_is_not_read(tmp_path, capsys):
    limbs = 4000 * f"<body><joint/>{GEOM}</body>"
    error, _ = refusal(
        tmp_path,
        capsys,
        f"<worldbody><body><freejoint/>{GEOM}{limbs}</body></worldbody>",
    )
    assert ": its compiled model has " in error
    assert error.endswith(" bytes, 4,194,304 at most are read: leave only the robot\n")


def test_a_name_with_a_terminals_escapes_is_not_read(tmp_path, capsys):
    error, _ = refusal(
        tmp_path,
        capsys,
        f'<worldbody><body name="&#27;[31m"><freejoint/>{GEOM}</body></worldbody>',
    )
    assert error.endswith(
        ": it holds the name '\\x1b[31m', which no terminal can show: choose another\n"
    )


def crash() -> tuple[mujoco.MjModel, list[str]]:
    os._exit(1)


def test_a_crash_of_mujoco_is_a_line():
    with pytest.raises(
        ReadingError,
        match=r"^it crashes MuJoCo or takes over 2 GB: leave only the robot$",
    ):
        compiled_apart(crash)
