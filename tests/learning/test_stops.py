"""Training processes that are killed, asked to stop or run out of disk: nothing that
was kept is lost or changed."""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time

import aim_run
import numpy as np
import pytest
from aim_run import begin, metrics

from bp2_rl.learning.checkpoint import latest_step, saved_steps
from bp2_rl.learning.judged import own_policy
from bp2_rl.learning.policy import load_policy

PER_STEP = 16 * 4  # control steps


@contextlib.contextmanager
def running(*arguments, pause=0.0):
    """Start a training process, and kill it at the end: a failed test must not wait
    until it has trained."""
    with begin(*arguments, pause=pause) as process:
        try:
            yield process
        finally:
            process.kill()


def finish(*arguments):
    with running(*arguments) as process:
        _, error = process.communicate(timeout=180)
    assert process.returncode == 0, error


def wait_for(condition, process):
    deadline = time.monotonic() + 120
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.002)


@pytest.fixture(scope="module")
def total(pytestconfig):
    """Return the number of train steps of a run that is to be killed; a kill costs less
    than 20."""
    return 20 * pytestconfig.getoption("--kills")


@pytest.fixture(scope="module")
def new(total):
    """Return arguments of a run that saves every 5 train steps and writes a line of
    metrics every 7."""
    sizes = {"steps": total * PER_STEP, "checkpoints": total // 5, "logs": total // 7}
    return [
        *aim_run.SMALL,
        *(
            word
            for name, size in sizes.items()
            for word in (f"--run.{name}", str(size))
        ),
    ]


@pytest.fixture(scope="module")
def uninterrupted(new, tmp_path_factory):
    run = tmp_path_factory.mktemp("uninterrupted") / "run"
    finish(*new, "--out", run)
    return run


def arrays(run):
    with np.load(run / "checkpoints" / str(latest_step(run)) / "state.npz") as file:
        return {
            name: (file[name].dtype, file[name].shape, file[name].tobytes())
            for name in file.files
        }


def assert_same_run(run, other):
    """Require that two runs have the same arrays, metrics and policy bit for bit, but
    for clocks."""
    assert arrays(run) == arrays(other)
    assert metrics(run) == metrics(other)
    ours, theirs = own_policy(run), own_policy(other)
    assert ours is not None
    assert theirs is not None
    weights = "weights.npz"
    assert (ours / weights).read_bytes() == (theirs / weights).read_bytes()


def test_a_run_killed_at_any_moment_resumes_to_the_uninterrupted_one(
    uninterrupted, new, total, tmp_path, pytestconfig
):
    """SIGKILL at any time between two saves, and, every other time, within one: writing
    takes more than 0.12 s."""
    moments, run, within_saves = random.Random(0), tmp_path / "run", 0
    arguments, kills = [*new, "--out", run], pytestconfig.getoption("--kills")
    for kill in range(kills):
        saved = latest_step(run) or 0
        with running(*arguments, pause=0.04) as process:
            wait_for(lambda before=saved: (latest_step(run) or 0) > before, process)
            if kill % 2:
                time.sleep(moments.uniform(0.0, 0.3))
            else:
                wait_for(lambda: any((run / "checkpoints").glob(".*.new")), process)
                time.sleep(moments.uniform(0.0, 0.1))
            process.kill()
            process.communicate()
        assert process.returncode == -signal.SIGKILL
        within_saves += any((run / "checkpoints").glob(".*.new"))
        arguments = ["--resume", run]
    print(f"{within_saves} of {kills} kills left a save half-written")
    assert (latest_step(run) or 0) < total
    finish(*arguments)
    assert_same_run(run, uninterrupted)


@pytest.mark.parametrize(
    ("number", "line"),
    [(signal.SIGTERM, "stopped by SIGTERM\n"), (signal.SIGINT, "interrupted\n")],
)
def test_a_run_stopped_before_its_first_checkpoint_leaves_nothing(
    number, line, new, tmp_path
):
    run = tmp_path / "runs" / "run"
    with running(*new, "--out", run, pause=2.0) as process:
        wait_for((run / "config.json").exists, process)
        process.send_signal(number)
        _, error = process.communicate(timeout=180)
    assert (process.returncode, error) == (128 + number, line)
    assert list(tmp_path.rglob("*")) == [tmp_path / "runs"]


def test_a_run_asked_to_stop_saves_says_so_and_resumes_to_the_uninterrupted_one(
    uninterrupted, new, total, tmp_path
):
    run = tmp_path / "run"
    arguments, saved = [*new, "--out", run], 0
    for number, status in ((signal.SIGTERM, 143), (signal.SIGINT, 130)):
        with running(*arguments, pause=0.04) as process:
            wait_for(lambda before=saved: (latest_step(run) or 0) > before, process)
            process.send_signal(number)
            _, error = process.communicate(timeout=180)
        assert process.returncode == status
        saved = latest_step(run) or 0
        assert (
            error
            == f"stopped by {number.name}, kept step {saved} of {total}: python train.py --resume {run}\n"
        )
        assert error.strip() in (run / "log.txt").read_text()
        assert load_policy(run).card.physics_steps == saved * PER_STEP * 5
        arguments = ["--resume", run]
    finish(*arguments)
    assert_same_run(run, uninterrupted)


@pytest.mark.parametrize("heeded", [True, False], ids=["heeded", "nohup"])
def test_a_run_whose_terminal_is_closed_saves_and_stops_unless_it_is_told_not_to(
    heeded, uninterrupted, new, total, tmp_path
):
    """The terminal is a pseudo-terminal's other end; the kernel sends SIGHUP, and what
    is printed then fails."""
    run = tmp_path / "run"
    ours, terminal = os.openpty()
    # the process inherits that
    here = signal.signal(signal.SIGHUP, signal.SIG_DFL if heeded else signal.SIG_IGN)
    take = [
        sys.executable,
        "-c",
        "import fcntl, os, sys, termios; os.setsid(); fcntl.ioctl(0, termios.TIOCSCTTY, 0); "
        "os.execv(sys.argv[1], sys.argv[1:])",
    ]
    with subprocess.Popen(
        [*take, *aim_run.command(*new, "--out", run, pause=0.04)],
        env=aim_run.ENVIRONMENT,
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
    ) as process:
        signal.signal(signal.SIGHUP, here)
        os.close(terminal)
        reader = threading.Thread(target=read_all, args=(ours,), daemon=True)
        try:
            reader.start()
            wait_for(lambda: (latest_step(run) or 0) > 0, process)
            process.send_signal(signal.SIGSTOP)  # while its terminal goes
            os.close(ours)
            process.send_signal(signal.SIGCONT)
            assert process.wait(120) == (129 if heeded else 0)
        finally:
            process.kill()
    log = (run / "log.txt").read_text()
    saved = latest_step(run) or 0
    if heeded:
        assert (
            f"stopped by SIGHUP, kept step {saved} of {total}: python train.py --resume {run}\n"
            in log
        )
        assert 0 < saved < total
        assert load_policy(run).card.physics_steps == saved * PER_STEP * 5
    else:
        assert_same_run(run, uninterrupted)


def read_all(terminal):
    """Read what a process prints, or it would wait for ever."""
    with contextlib.suppress(OSError):
        while os.read(terminal, 1000):
            pass


def test_a_second_ctrl_c_quits_at_once(new, tmp_path):
    run = tmp_path / "run"
    with running(*new, "--out", run, pause=60) as process:
        wait_for(
            lambda: (
                (run / "log.txt").exists()
                and "command" in (run / "log.txt").read_text()
            ),
            process,
        )
        time.sleep(1)  # into the first train step
        for _ in range(2):
            process.send_signal(signal.SIGINT)
            time.sleep(0.5)
        output, _ = process.communicate(timeout=10)
    assert process.returncode == 130
    assert "SIGINT: stopping after this train step; Ctrl-C now quits at once" in output
    assert latest_step(run) == 0


def test_of_two_processes_that_resume_a_run_one_does_and_the_other_says_why_not(
    uninterrupted, total, tmp_path
):
    run = tmp_path / "run"
    shutil.copytree(uninterrupted, run)
    for step in sorted(saved_steps(run))[1:]:
        shutil.rmtree(run / "checkpoints" / str(step))
    assert (latest_step(run) or 0) < total
    both = [begin("--resume", run, pause=0.1) for _ in range(2)]
    errors = [process.communicate(timeout=180)[1] for process in both]
    assert sorted(process.returncode for process in both) == [0, 2]
    assert f"another process trains in {run}" in "".join(errors)
    assert "".join(errors).count("\n") == 1
    assert_same_run(run, uninterrupted)


def test_a_run_whose_folder_is_deleted_ends_and_leaves_no_other(new, tmp_path):
    run = tmp_path / "run"
    with running(*new, "--out", run, pause=0.04) as process:
        wait_for(lambda: (latest_step(run) or 0) > 0, process)
        run.rename(tmp_path / "moved")
        _, error = process.communicate(timeout=180)
    assert process.returncode == 1
    assert (
        error
        == f"the run's folder {run} is gone, deleted or moved: nothing more can be kept in it\n"
    )
    assert not run.exists()
