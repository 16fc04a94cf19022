"""Commands end with the right exit status, and with one line on standard error."""

import dataclasses
import subprocess
import sys
import time
from pathlib import Path
from typing import Annotated, Literal

import pytest

from bp2_rl.base.bounds import Bounded, Within
from bp2_rl.base.errors import RunStopped, UserError
from bp2_rl.cli import app


def raising(error: BaseException):
    def command() -> None:
        raise error

    return command


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (UserError("wrong:\n flag"), 2, "error: wrong: flag\n"),
        (RunStopped("stopped by SIGTERM", 143), 143, "stopped by SIGTERM\n"),
        (KeyboardInterrupt(), 130, "interrupted\n"),
    ],
)
def test_what_is_expected_ends_with_its_own_status_and_line(
    error, status, line, capsys
):
    assert app.run(raising(error)) == status
    assert capsys.readouterr().err == line


def fail_into(folder: Path, error: Exception):
    def command() -> None:
        with app.failures_into(folder):
            raise error

    return command


@pytest.mark.parametrize("there", [True, False])
def test_the_log_goes_into_the_runs_folder_where_there_is_one(there, tmp_path, capsys):
    run = tmp_path if there else tmp_path / "gone"
    assert app.run(fail_into(run, ZeroDivisionError("by\nnought"))) == 1
    failed, log = capsys.readouterr().err.strip().split("; log: ")
    assert failed == "failed: ZeroDivisionError: by nought"
    assert (Path(log).parent == run) == there
    assert Path(log).read_text().startswith("Traceback")
    Path(log).unlink()


def test_a_users_mistake_leaves_no_log(tmp_path):
    assert app.run(fail_into(tmp_path, UserError("wrong flag"))) == 2
    assert list(tmp_path.iterdir()) == []


def test_work_goes_on_when_nobody_reads_its_output_any_more(tmp_path):
    program = f"""
import sys
import time
from pathlib import Path
from bp2_rl.cli import app

def command():
    print("first", flush=True)
    sys.stdin.readline()  # until the reader has left
    for _ in range(3):
        print("more", flush=True)
    Path({str(tmp_path / "done")!r}).touch()

sys.exit(app.run(command))
"""
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "first\n"
    process.stdout.close()
    _, said = process.communicate("\n", timeout=60)
    assert process.returncode == 0
    assert said == "standard output was closed; the command goes on without output\n"
    assert (tmp_path / "done").exists()


@dataclasses.dataclass(frozen=True)
class Nested(Bounded, path="nested."):
    depth: Annotated[int, Within(0)] = 1


@dataclasses.dataclass(frozen=True)
class Flags:
    speed: float | None = None
    kind: Literal["a", "b"] = "a"
    nested: Nested = Nested()


def test_flags_change_the_defaults():
    assert app.parse(Flags, [], "tool") == Flags()
    default = Flags(speed=2.0, nested=Nested(7))
    assert app.parse(Flags, ["--kind", "b"], "tool", default) == Flags(
        2.0, "b", Nested(7)
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--speed", "fast"], ("--speed", "fast")),
        (["--speed"], ("--speed",)),
        (["--kind", "c"], ("--kind", "'c'")),
        (["--spede", "3"], ("--spede", "Perhaps you meant", "--speed")),
        (["slow"], ("slow",)),
        (["--kind", "\udcff\x1b[2J"], ("--kind", "\\udcff\\x1b[2J")),
    ],
)
def test_what_tyro_cannot_read_is_told_in_its_words_with_status_2(
    arguments, words, capsys
):
    assert app.run(lambda: print(app.parse(Flags, arguments, "tool"))) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert all(word in err for word in words)
    assert "Traceback" not in err


def test_what_a_config_refuses_is_told_in_its_own_line():
    with pytest.raises(UserError, match=r"^nested\.depth must be at least 0, got -1$"):
        app.parse(Flags, ["--nested.depth", "-1"], "tool")


def test_flags_of_others_are_passed_over():
    words = ["--stage", "x", "--nested.depth", "3", "--help", "y"]
    assert app.parse_known(Flags, words, "tool") == Flags(nested=Nested(3))


@pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX's")
@pytest.mark.parametrize(
    ("number", "line"),
    # as POSIX numbers them
    [(15, "stopped by SIGTERM"), (2, "interrupted"), (1, "stopped by SIGHUP")],
)
def test_a_signal_ends_a_command_that_computes_for_minutes_outside_python(number, line):
    program = """
import hashlib, os, signal, sys
from bp2_rl.base.processes import spawned
from bp2_rl.cli import app
app.GRACE = 0.5
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests may run where it is ignored, in the background
signal.signal(signal.SIGHUP, signal.SIG_DFL)

def command():
    with spawned(1) as pool:  # its semaphores must not be leaked, which Python would say
        pool.submit(os.getpid).result()
        print("began", flush=True)
        hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)  # a quarter of an hour in C, in which Python runs no handler

sys.exit(app.run(command))
"""
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "began\n"
    time.sleep(0.2)  # until it is in there
    process.send_signal(number)
    try:
        _, said = process.communicate(timeout=30)
    finally:
        process.kill()
    assert (process.returncode, said) == (128 + number, f"{line}\n")
