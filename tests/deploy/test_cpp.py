"""The controller in C++ answers as the one in Python, tick by tick and fault by fault."""

import json
import os
import re
import shutil
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from compiler import CPP, build
from refusals import python

HERE = Path(__file__).parent
PAGE = Path(__file__).parents[2] / "docs" / "deploy.md"
SANE = "-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"
DT = 0.005
# rad, rad/s: the network's float32 sums in another order, and the way to a stand is 15
# times as fast, 1/s, as it is long
CLOSE = 1e-5
PARTS = slice(0, 12), slice(12, 24), slice(24, 27), slice(27, 30)
TICK = np.dtype("f8, f8, 30f8, f8, 3f8")  # what is told, now, values, stamp, command
ANSWER = np.dtype(
    [
        ("targets", "f8", (2, 12)),
        *((name, "f8") for name in ("cpu", "news")),
        *((name, "S16") for name in ("fault", "joint")),
    ]
)
MEASURED, COMMANDED, RESET = 1, 2, 4


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return build(tmp_path_factory.mktemp("drive"), HERE / "drive.cpp", "-O3")


@pytest.fixture(scope="module")
def sane(tmp_path_factory):
    """Build the same with sanitizers of addresses and undefined behaviour."""
    return build(tmp_path_factory.mktemp("sane"), HERE / "drive.cpp", *SANE)


@pytest.fixture(scope="module")
def flipped(another, tmp_path_factory):
    """Return Go1's bundle with signs and zeros of its joints edited, and sealed."""
    folder = tmp_path_factory.mktemp("flipped") / "go1"
    shutil.copytree(another("go1")[1], folder)
    file, rng = folder / "deploy.json", np.random.default_rng(0)
    settings = json.loads(file.read_text())
    for joint in settings["model_joints"]:
        joint["name"] = joint["name"].lower()
        joint["sign"], joint["offset"] = int(rng.choice((-1, 1))), rng.normal()
    settings["watchdog"]["target_step"] = 0.4  # an impatient limit
    file.write_text(json.dumps(settings))
    status, said, error = python(folder, "-m", "onboard.seal")
    assert (status, error) == (0, "")
    assert said.endswith("changed: deploy.json, cpp/controller.bin\n")
    return folder


class Recorder:
    """Steps a Python controller, and records what it is told and what it answers."""

    def __init__(self, controller):
        self.controller, self.ticks, self.expected = controller, [], []

    def reset(self):
        self.controller.reset()
        self.told = RESET

    def step(self, given, command, now):
        targets = self.controller.step(given, command, now)
        self.ticks.append(tick(self.told, given, command, now))
        self.expected.append((np.stack(targets), self.controller.fault))
        self.told = 0
        return targets

    def compare(self, program, folder, convention="bundle"):
        """Require the same targets and the same faults at the same ticks; return the
        faults' names and the answers."""
        ticks = np.array(self.ticks, TICK)
        command = program, folder / "cpp" / "controller.bin", convention
        done = subprocess.run(
            command, input=ticks.tobytes(), capture_output=True, check=False
        )
        assert (done.returncode, done.stderr) == (0, b"")
        found = np.frombuffer(done.stdout, ANSWER)
        targets, faults = zip(*self.expected, strict=True)
        np.testing.assert_allclose(found["targets"], targets, rtol=CLOSE, atol=CLOSE)
        for fault, name, joint in zip(
            faults, found["fault"].astype(str), found["joint"].astype(str), strict=True
        ):
            assert fault.partition(":")[0] == name
            assert fault.startswith(f"{name}: {joint}" if name else "")
        assert not found["news"].any()
        return {fault.partition(":")[0] for fault in faults}, found


def tick(told, given, command, now):
    told += MEASURED * (given is not None) + COMMANDED * (command is not None)
    values = np.zeros(30) if given is None else np.concatenate(given[:4])
    asked = np.zeros(3) if command is None else command
    return told, now, values, 0.0 if given is None else given[4], asked


# --- Recorded runs --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "robot", "speed", "hold"),
    [("built", "built", 10.74, 5.5), ("go1", "own", 0.8, 10.0)],
)
def test_recorded_ticks_have_the_same_targets(
    onboard, bundle, another, rehearse, drive, name, robot, speed, hold
):
    """From a stand to speed and on, with 5 % of the datagrams lost and targets that come
    5 ms late; then the operator falls silent, then the sensors."""
    folder = bundle if name == "built" else another(name)[1]
    recorder = Recorder(onboard.controller.OnboardController(folder))
    plan = onboard.robot.RehearsalPlan(speed, hold=hold)
    world = onboard.robot.RehearsalWorld(folder, robot, plan)
    *_, (measurement, command, _) = rehearse(world, recorder)
    assert len(recorder.ticks) >= 1990
    outcome = world.outcome()
    assert outcome["lost"] > 100
    if name == "built":  # which holds its speed
        assert outcome["fell_at"] is None
        assert outcome["mean_speed"] == pytest.approx(10.74, abs=0.1)
    now = world.milliseconds * 0.001
    for k in range(300):
        given = measurement._replace(time=now + DT * k) if k < 100 else None
        asked = command if k < 10 else (None, (np.nan, 0.0, 0.0))[k % 2]
        recorder.step(given, asked, now + DT * k)
    faults, found = recorder.compare(drive, folder)
    assert len(faults) == 2
    # s; of five batches the best, as others may share the core
    batches = np.percentile(found["cpu"][:2000].reshape(5, 400), (50, 99.9), axis=1)
    assert batches.min(axis=1)[0] <= 80e-6
    assert batches.min(axis=1)[1] <= 200e-6
    assert np.ptp(found["targets"][:, 0], axis=0).max() > 0.2  # it moves


def test_the_example_talks_to_the_rehearsal_over_udp(onboard, bundle, tmp_path):
    """A second of it, as compiled by the bundle's own CMakeLists.txt where there is
    CMake."""
    program = build(tmp_path, bundle / "cpp" / "main.cpp", "-O3")
    plan = onboard.robot.RehearsalPlan(speed=0.2, acceleration=2.0, hold=1.0)
    result = onboard.rehearse.in_real_time(bundle, "ideal", plan, None, program)
    assert result["ticks"] > 50
    assert result["lost"] > 0
    assert result["wall_ms"] == sorted(result["wall_ms"])
    assert "p50 / p99 / max" in onboard.rehearse.show(result, plan)
    assert onboard.rehearse.main([str(bundle), "--program", str(bundle)]) == 2


def test_a_program_that_says_nothing_does_not_hang_the_rehearsal(
    onboard, bundle, tmp_path, monkeypatch, capsys
):
    silent = tmp_path / "silent"
    silent.write_text("#!/bin/sh\nexec sleep 60\n")
    silent.chmod(0o755)
    monkeypatch.setattr(onboard.rehearse, "PATIENCE", 0.5)
    assert onboard.rehearse.main([str(bundle), "--program", str(silent)]) == 2
    assert "printed no port" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("script", "told"),
    [
        ("exit 3", "printed no port, and ended"),
        ("echo 9; sleep 0.5; exit 3", "ended during the rehearsal, with exit status 3"),
    ],
)
def test_a_program_that_ends_by_itself_is_told_of(
    onboard, bundle, tmp_path, capsys, script, told
):
    ended = tmp_path / "ended"
    ended.write_text(f"#!/bin/sh\n{script}\n")
    ended.chmod(0o755)
    words = [str(bundle), "--program", str(ended), "--speed", "0.2", "--hold", "1"]
    assert onboard.rehearse.main(words) == 2
    assert told in capsys.readouterr().err


# --- Wrong sensors --------------------------------------------------------------------


def wrongs(rng, then):
    """Return functions that make values, stamp and time wrong from a tick on, k ticks
    later."""
    part, place = PARTS[rng.integers(4)], rng.integers(30)
    joint = rng.choice((1, 2, 4, 5, 7, 8, 10, 11))  # hips and knees
    factor = rng.choice((-1.0, 0.0, 0.1, 0.5, 2.0, 9.81, 57.3))
    value = rng.choice((np.nan, np.inf, -np.inf, 1e300, -1e9, 3.0))
    size, ahead = 10.0 ** rng.uniform(-3.0, 3.0), rng.choice((-1.0, -0.03, 0.2, np.nan))

    def times(v, stamp, now, k):
        v[part] *= factor

    def becomes(v, stamp, now, k):
        v[place] = value

    def repeats(v, stamp, now, k):
        v[part] = then[part]

    def noise(v, stamp, now, k):
        v[part] += size * rng.normal(size=len(v[part]))

    def deaf(v, stamp, now, k):
        v[joint] = then[joint] + 0.003 * rng.normal()
        v[12 + joint] = 0.1 * rng.normal()

    def backward(v, stamp, now, k):
        v[[joint, 12 + joint]] *= -1.0

    def mirrored(v, stamp, now, k):
        v[:12], v[12:24] = 2.0 * then[:12] - v[:12], -v[12:24]

    def turned(v, stamp, now, k):
        v[1:12:3] += 0.9

    def fast(v, stamp, now, k):
        v[12 + joint] = 300.0

    def over(v, stamp, now, k):
        v[24:27] *= -1.0

    return (
        *(times, becomes, repeats, noise, deaf, backward, mirrored, turned, over, fast),
        lambda v, stamp, now, k: (stamp + ahead, now),
        lambda v, stamp, now, k: (stamp, now + ahead * (k > 5)),
        lambda v, stamp, now, k: (None, now),
        lambda v, stamp, now, k: (stamp - DT * k + 1e-6 * k,) * 2,
        lambda v, stamp, now, k: (now - 1e-9, now) if rng.random() < 0.9 else None,
    )


def play(recorder, rng, number, ticks=320):
    """Play to a controller a robot that hangs and swings, whose joints follow their
    targets, and whose sensors go wrong."""
    recorder.reset()
    controller, begins, wrong = recorder.controller, ticks, None
    q, command, pause = controller._stand.copy(), np.zeros(3), rng.random() < 0.3
    for k in range(ticks):
        way = 0.3 * (controller._targets.position - q)
        q, angle, rate = q + way, 0.3 * np.sin(4.0 * DT * k), 1.2 * np.cos(4.0 * DT * k)
        joints = controller._frame.outward(np.stack((q, way / DT))).ravel()
        trunk = 0.0, np.sin(angle), np.cos(angle), rate, 0.0, 0.0
        values = np.array([*joints, *trunk]) + 1e-4 * rng.normal(size=30)
        stamp = now = DT * k
        if k == 60:
            begins, wrong = k, wrongs(rng, values.copy())[number % 15]
        if wrong is not None:
            stamp, now = wrong(values, stamp, now, k - begins) or (stamp, now)
        if k % 80 == 0:
            command = rng.uniform((0.0, -0.5, -1.0), (9.0, 0.5, 1.0))
            command = (command, command, None, command * np.nan)[rng.integers(4)]
        lost = stamp is None or (pause and rng.random() < 0.2)
        given = None if lost else (*(values[part] for part in PARTS), stamp)
        recorder.step(given, command, now)


@pytest.mark.parametrize("seed", range(int(os.environ.get("BP2_STREAMS", "1"))))
def test_random_streams_end_in_the_same_faults(
    onboard, bundle, another, flipped, drive, sane, seed
):
    """BP2, Go1, and a robot with flipped signs, under sanitizers as well: with
    BP2_STREAMS=24 a million measurements."""
    found, cases = set(), ((bundle, "bundle"), (another("go1")[1], "bundle"))
    for folder, convention in (*cases, (flipped, "model")):
        controller = onboard.controller.OnboardController(folder, convention=convention)
        recorder, rng = Recorder(controller), np.random.default_rng([seed, len(found)])
        for number in range(45):
            play(recorder, rng, number)
        for program in (drive, sane):
            found |= recorder.compare(program, folder, convention)[0]
    header = (CPP / "bp2_controller.hpp").read_text()
    names = re.findall(r'"([a-z ]*)"', header.split("kFaultNames")[1].split("}")[0])
    table = re.findall(r"^\| `([a-z ]+)` \|", PAGE.read_text(), re.MULTILINE)
    # types take the place of `form`, and a sound network has no fault
    assert {*names} == {"", *table} - {"form"}
    assert {*names} - found == {"network"} or seed > 0


# --- Damaged files --------------------------------------------------------------------


def damaged(content, rng):
    """Return a damaged file, whose checksum is right in every second case."""
    data = bytearray(content)
    for _ in range(rng.integers(1, 4)):
        place, kind = int(rng.integers(len(data) - 8)), rng.integers(4)
        if kind == 0:
            data[place] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            place = place // 8 * 8
            value = rng.choice((np.nan, np.inf, -1.0, 0.0, 1e300, 5e-324))
            data[place : place + 8] = np.float64(value).tobytes()
        elif kind == 2:
            del data[place : place + int(rng.integers(1, 64))]
        else:
            data = data[: max(place, 32)]
    sealed = rng.random() < 0.5
    if sealed:
        data[-8:] = np.uint64(zlib.crc32(data[:-8])).tobytes()
    return bytes(data), sealed


def test_damaged_files_are_refused(another, sane, tmp_path):
    original = another("go1")[1] / "cpp" / "controller.bin"
    rng, content, files = np.random.default_rng(0), original.read_bytes(), []
    for k in range(2000):
        data, sealed = damaged(content, rng)
        files.append((tmp_path / f"{k}{'sealed' * sealed}", data))
        files[-1][0].write_bytes(data)
    done = subprocess.run(
        [sane, "load", original, *(path for path, _ in files)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    whole, *said = done.stdout.splitlines()
    assert whole == "loaded"
    for (path, data), words in zip(files, said, strict=True):
        ours = data == content or path.name.endswith("sealed")
        assert words.startswith(f"{path}: ") or (words == "loaded" and ours)
    assert len({words.partition(": ")[2][:20] for words in said}) > 10


@pytest.mark.parametrize(
    ("name", "words"),
    [("nowhere", "nowhere: cannot be read; export the bundle anew"), ("", "")],
)
def test_fast_math_and_a_missing_file_are_refused(drive, tmp_path, name, words):
    if name:
        done = subprocess.run([drive, name, "model"], capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (1, f"{words}\n")
        return
    with pytest.raises(AssertionError, match="compile it without -ffast-math"):
        build(tmp_path, HERE / "drive.cpp", "-ffast-math")


def test_what_python_code_of_a_task_adds_is_refused_by_name(another, drive, tmp_path):
    content = (another("go1")[1] / "cpp" / "controller.bin").read_bytes()
    data = bytearray(content.replace(b"command\nphase", b"command\nsmell"))
    data[-8:] = np.uint64(zlib.crc32(data[:-8])).tobytes()
    (tmp_path / "it").write_bytes(data)
    done = subprocess.run([drive, "load", tmp_path / "it"], capture_output=True)
    assert b"the policy sees smell, which Python code of its task" in done.stdout
