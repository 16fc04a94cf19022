"""How commands end: the exit status, and the one line on standard error."""

from pathlib import Path

import pytest

from bp2_rl.cli import app
from bp2_rl.errors import RunStopped, UserError


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
def test_what_is_expected_ends_with_its_own_status_and_line(error, status, line, capsys):
    assert app.run(raising(error)) == status
    assert capsys.readouterr().err == line


def test_a_failure_names_the_log_of_its_traceback(capsys):
    assert app.run(raising(ZeroDivisionError("by\nnought"))) == 1
    line = capsys.readouterr().err
    assert line.startswith("failed: ZeroDivisionError: by nought; log: ")
    log = Path(line.split("log: ")[1].strip())
    assert "in command" in log.read_text()
    log.unlink()


@pytest.mark.parametrize("there", [True, False])
def test_the_log_goes_into_the_runs_folder_where_there_is_one(there, tmp_path, capsys):
    run = tmp_path / "run"
    if there:
        run.mkdir()

    def command() -> None:
        with app.failures_into(run):
            raise ZeroDivisionError

    assert app.run(command) == 1
    log = Path(capsys.readouterr().err.split("log: ")[1].strip())
    assert (log.parent == run) == there
    assert log.read_text().startswith("Traceback")
    log.unlink()


def test_a_users_mistake_leaves_no_log(tmp_path):
    def command() -> None:
        with app.failures_into(tmp_path):
            raise UserError("wrong flag")

    assert app.run(command) == 2
    assert list(tmp_path.iterdir()) == []
