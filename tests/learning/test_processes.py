"""Two processes train as one does: they meet, save, stop and go on together, or end
with a line that says why."""

import contextlib
import shutil
import signal
import socket
import subprocess
import sys
import time

import aim_run
import numpy as np
import pytest
from aim_run import begin

from bp2_rl.learning.policy import load_policy

CHATTER = ("[Gloo]", "Failed to import")
STEPS = 20
NEW = [
    *aim_run.SMALL,
    "--run.steps",
    str(STEPS * 16 * 4),
    "--run.checkpoints",
    "2",
    "--run.logs",
    str(STEPS),
]


def membership(process, port, patience=60):
    return (
        "--cluster.coordinator",
        f"localhost:{port}",
        "--cluster.processes",
        2,
        "--cluster.process",
        process,
        "--cluster.patience",
        patience,
    )


def begin_two(*arguments, second=(), **options):
    """Start both processes of a cluster; the second has a clock of another time zone,
    and may have arguments of its own."""
    port = free_port()
    return [
        begin(*arguments, *membership(0, port), **options),
        begin(*arguments, *second, *membership(1, port), **options, TZ="XXX+5"),
    ]


def free_port():
    with socket.socket() as any_port:
        any_port.bind(("localhost", 0))
        return any_port.getsockname()[1]


def end(processes):
    """Wait for processes; return exit status, standard output and standard error of
    each, without libraries' messages."""
    with contextlib.ExitStack() as stack:
        for process in processes:
            stack.enter_context(process)
            stack.callback(process.kill)
        said = [process.communicate(timeout=120) for process in processes]
    return [
        (
            process.returncode,
            [line for line in out.splitlines() if not line.startswith(CHATTER)],
            error,
        )
        for process, (out, error) in zip(processes, said, strict=True)
    ]


def params(run, step=STEPS):
    with np.load(run / "checkpoints" / str(step) / "state.npz") as file:
        return np.concatenate(
            [file[name].ravel() for name in file.files if name.startswith("params/")]
        )


def steps(run):
    return sorted(int(path.name) for path in (run / "checkpoints").iterdir())


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Train once by one process and once by two; return the folder and what the two
    processes said."""
    folder = tmp_path_factory.mktemp("runs")
    alone = begin(*NEW, "--out", folder / "one")
    said = end(begin_two(*NEW, "--out", folder / "two"))
    assert end([alone])[0][0] == 0
    return folder, said


def test_two_processes_train_as_one_and_the_first_alone_speaks_and_writes(runs):
    folder, ((status, out, error), other) = runs
    assert (status, error) == (0, "")
    assert "imitation on 2 x cpu" in " ".join(out)
    assert other == (0, [], "")
    assert steps(folder / "two") == steps(folder / "one") == [0, 10, 20]
    assert load_policy(folder / "two")
    assert len(list((folder / "two").glob("events*"))) == 1
    assert len((folder / "two" / "metrics.jsonl").read_text().splitlines()) == STEPS
    # float32 sums in another order, 1e-7 here; a step of Adam is 3e-4.
    np.testing.assert_allclose(
        params(folder / "two"), params(folder / "one"), rtol=0, atol=1e-5
    )


def test_a_signal_to_one_stops_both_at_the_same_step_and_two_or_one_go_on(
    runs, tmp_path
):
    """The stopped run is in a folder of the default name, of the first process's
    clock."""
    folder, _ = runs
    both = begin_two(*NEW, pause=0.1, cwd=tmp_path)
    deadline = time.monotonic() + 60
    while not any(
        path.read_text().count("\n") >= 3
        for path in tmp_path.glob("runs/*/metrics.jsonl")
    ):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    both[1].send_signal(signal.SIGTERM)
    (status, _, line), (other_status, _, other_line) = end(both)
    assert status == other_status == 128 + signal.SIGTERM
    assert line == other_line
    (run,) = tmp_path.glob("runs/*")
    assert str(run.relative_to(tmp_path)) in line
    stopped = steps(run)[-1]
    assert 3 <= stopped < STEPS

    shutil.copytree(run, tmp_path / "by one")
    alone = begin("--resume", tmp_path / "by one")
    assert [status for status, _, _ in end([*begin_two("--resume", run), alone])] == [
        0,
        0,
        0,
    ]
    # Two processes are bit for bit what they were; one sums in another order.
    np.testing.assert_array_equal(params(run), params(folder / "two"))
    np.testing.assert_allclose(
        params(tmp_path / "by one"), params(folder / "two"), rtol=0, atol=1e-5
    )


@pytest.mark.parametrize(
    ("second", "taken", "why"),
    [
        ((), True, "holds other files"),
        (("--run.seed", 1), False, "differ in their settings"),
        (("--ppo.clipping", 0), False, "another process of the cluster failed"),
    ],
    ids=["taken folder", "other settings", "wrong flag"],
)
def test_what_stops_one_stops_the_other(tmp_path, second, taken, why):
    out = tmp_path / "out"
    if taken:
        out.mkdir()
        (out / "thesis.tex").touch()
    said = end(begin_two(*NEW, "--out", out, second=second))
    assert [status for status, _, _ in said] == [2, 2]
    assert why in said[0][2]
    assert all(
        error.startswith("error: ") and error.count("\n") == 1 for _, _, error in said
    )
    assert [path.name for path in tmp_path.glob("out/*")] == (
        ["thesis.tex"] if taken else []
    )


def test_each_process_has_the_model_on_a_device_of_its_own():
    """A compiled program cannot take in an array that lies on another process's
    device."""
    program = """
import sys
import jax
jax.distributed.initialize("localhost:" + sys.argv[1], 2, int(sys.argv[2]))
from bp2_rl.settings.env import EnvConfig
from bp2_rl.env.bp2_env import BP2Env
engine = BP2Env(EnvConfig()).engine
arrays = [x for x in jax.tree.leaves((engine.model, engine._template)) if isinstance(x, jax.Array)]
assert len(arrays) > 100 and all(x.is_fully_addressable for x in arrays)
"""
    port = free_port()
    both = [
        subprocess.Popen(
            [sys.executable, "-c", program, str(port), str(process)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=aim_run.ENVIRONMENT,
            text=True,
        )
        for process in (0, 1)
    ]
    assert [(status, error[-500:]) for status, _, error in end(both)] == [
        (0, ""),
        (0, ""),
    ]


def test_a_process_left_alone_gives_up_with_one_line(tmp_path):
    said = end(
        [
            begin(*NEW, *membership(process, free_port(), patience=2), cwd=tmp_path)
            for process in (0, 1)
        ]
    )
    assert [status for status, _, _ in said] == [2, 2]
    for _, _, error in said:
        assert error.startswith("error: not all processes have met at localhost:")
        assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())
