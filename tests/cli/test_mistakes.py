"""A mistake on the command line is told with exit status 2, and leaves nothing
behind."""

from pathlib import Path

import aim_run
import pytest
from refusals import refused

from bp2_rl.cli.__main__ import main

TRAIN, BENCH = "train", "bench --preset smoke"
SOLVE, BUILD = "trajopt solve", "trajopt library build"
IN_TAKEN = f"train {' '.join(aim_run.SMALL)} --impl kernel --out taken/run"


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"{TRAIN} --velocity 3", ["--velocity"]),
        (f"{TRAIN} --preset huge", ["preset"]),
        (f"{TRAIN} --stage flying", ["stage"]),
        (
            f"{TRAIN} --env.commands.max-forward -3",
            ["max_forward", "from 0.001 to 1000"],
        ),
        (f"{TRAIN} --ppo.num-envs 0", ["num_envs"]),
        (
            f"{TRAIN} --ppo.num-envs 100 --ppo.num-minibatches 16",
            ["num_envs", "num_minibatches"],
        ),
        (f"{TRAIN} --env.hardware.spring-stiffness -1", ["spring_stiffness"]),
        (f"{TRAIN} --run.steps 0", ["steps"]),
        (f"{TRAIN} --stage relaxed", ["imitation", "--from"]),
        (
            f"{TRAIN} --stage relaxed --from nowhere",
            ["no training run at nowhere", "there is no such folder"],
        ),
        (
            f"{TRAIN} --resume nowhere",
            ["no training run at nowhere", "there is no such folder"],
        ),
        (f"{TRAIN} --resume nowhere --run.steps 5", ["leave out --run.steps"]),
        (f"{TRAIN} --replay nowhere --resume x", ["leave out --replay"]),
        (f"{TRAIN} --resume nowhere extra", ["extra"]),
        (f"{TRAIN} --impl warp", ["warp"]),
        (IN_TAKEN, ["taken/run", "cannot write"]),
        ("eval built --robot go1", ["--robot go1", "trained for BP2, another robot"]),
        (f"{BENCH} --robots 0", ["--robots"]),
        (f"{BENCH} --robots many", ["--robots"]),
        (f"{BENCH} --devices 64", ["--devices 64", "JAX sees"]),
        (f"{BENCH} --devices -1", ["--devices"]),
        (f"{BENCH} --seconds 0", ["--seconds"]),
        (f"{BENCH} --seconds nan", ["--seconds"]),
        (f"{BENCH} --parts brains", ["--parts", "physics"]),
        (f"{BENCH} --preset huge", ["--preset", "smoke"]),
        (f"{BENCH} --ppo.num-minibatches 3", ["num_minibatches"]),
        (f"{BENCH} --speed", ["--speed"]),
        ("trajopt leap", ["no command 'leap'; bp2 trajopt has: solve, verify"]),
        (f"{SOLVE} --speed 0", ["speed must be from 0.01 to 100, got 0"]),
        (
            f"{SOLVE} --speed 23",
            [
                "speed must be at most 22.5 m/s, as fast as hip and knee move a foot, got 23"
            ],
        ),
        (f"{SOLVE} --speed 1e308", ["speed must be from 0.01 to 100, got 1e+308"]),
        (f"{SOLVE} --gait amble", ["amble"]),
        (
            f"{SOLVE} --hardware.spring-stiffness -6000",
            ["spring_stiffness must be from 100 to"],
        ),
        (f"{SOLVE} --starts 0", ["starts must be from 1 to 1000, got 0"]),
        (f"{SOLVE} --refine 1", ["refine must be 0 or at least 2"]),
        (f"{SOLVE} --refine -3", ["refine must be from 0 to 500, got -3"]),
        (
            f"{SOLVE} --intervals {'9' * 400}",
            ["intervals must be from 2 to 500, got a huge integer"],
        ),
        (f"{SOLVE} --out /dev/null/here", ["cannot write to /dev/null/here"]),
        (
            f"{SOLVE} --robot built --hardware.losses.bus-sag 2",
            ["losses.bus_sag must be from 0 to 1, got 2"],
        ),
        (f"{BUILD} --workers 0", ["workers must be from 1 to 256, got 0"]),
        (f"{BUILD} --starts -1", ["starts must be from 1 to 1000, got -1"]),
        (f"{BUILD} --coarse -5", ["coarse must be from 2 to 500, got -5"]),
        (f"{BUILD} --proximity nan", ["proximity must be from 0 to 1e+06, got nan"]),
        (f"{BUILD} --step 1e-9", ["makes more than 1000 speeds"]),
        (f"{BUILD} --to library.json", ["a library is an .npz file"]),
        ("trajopt library burn", ["burn"]),
        (f"trajopt verify {'x' * 5000}", ["cannot be read: File name too long"]),
        ("trajopt verify nowhere.npz", ["nowhere.npz cannot be read"]),
        ("play --port 0", ["--port must be from 1 to 65535, got 0"]),
        ("play --seconds -1", ["--seconds must be"]),
        ("play --speed inf", ["--speed must be from -100 to 100"]),
        ("play nowhere", ["no policy"]),
    ],
)
def test_a_mistake_is_told(
    line: str,
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MUJOCO_GL", "")
    Path("taken").write_text("a file, not a folder")
    error = refused(capsys, main, *line.split())
    assert [word for word in words if word not in error] == []
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
