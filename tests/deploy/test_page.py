"""The page that `bp2 export --format page` writes: its laws in C++ are Python's, and a
browser runs the robot as C MuJoCo in Python does."""

import ctypes
import dataclasses
import functools
import hashlib
import http.server
import io
import json
import re
import shutil
import tarfile
import threading
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from browser import browsing, find_browser
from compiler import build

from bp2_rl.base.errors import UserError
from bp2_rl.deploy.bundle import _describe_robots
from bp2_rl.deploy.page import build as page_build
from bp2_rl.deploy.page import mujoco_wasm
from bp2_rl.deploy.page.folder import robot_numbers, write_page
from bp2_rl.env.controller import motors_of
from bp2_rl.play.session import Session, Wish
from bp2_rl.robot.actuator import joint_torque
from bp2_rl.robot.hardware import REAL, ROBOTS
from bp2_rl.simulation import laws
from bp2_rl.simulation.policy_runner import control_steps_behind
from bp2_rl.simulation.rollout import RunRequest, simulate
from bp2_rl.simulation.schedule import Ramp
from bp2_rl.simulation.simulator import DT, OUTSIDE, RobotSetup

HERE = page_build.HERE
ROWS = 300
MOST_BYTES = 14e6
SAYS = "document.querySelector('#says').textContent"


class Native:
    """page.cpp, compiled for this machine, with the numbers that it shares with
    robot.js by their names there."""

    def __init__(self, library, controller, robot):
        self.code = ctypes.CDLL(str(library))
        for name in ("load", "tick"):
            getattr(self.code, name).restype = ctypes.c_char_p
        self.code.numbers.restype = ctypes.POINTER(ctypes.c_double)
        self.code.correct.restype = ctypes.c_bool
        sizes = [ctypes.c_size_t(len(content)) for content in (controller, robot)]
        wrong = self.code.load(controller, sizes[0], robot, sizes[1])
        assert wrong == b""
        (told,) = re.findall(r"SHARED = \{(.*)\}", (HERE / "robot.js").read_text())
        shared = dict(re.findall(r"(\w+): (\d+)", told))
        place = 0
        for name, size in shared.items():
            all_numbers = np.ctypeslib.as_array(
                self.code.numbers(), (place + int(size),)
            )
            setattr(self, name, all_numbers[place:])
            place += int(size)
        self.code.reset()

    def set(self, **values):
        for name, value in values.items():
            getattr(self, name)[: len(value)] = value


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    return build(folder, HERE / "page.cpp", "-O2", "-shared", "-fPIC")


@pytest.fixture(scope="module")
def native(library, bundle, shipped, another):
    """Return a loader of a robot into the native page, which holds one at a time, with
    the robot's setup, description and bundle."""

    @functools.cache
    def describe(name):
        policy, folder = another(name) if name == "go1" else (shipped, bundle)
        settings, env = (
            json.loads((folder / "deploy.json").read_text()),
            policy.card.env,
        )
        if name in ROBOTS:
            env = dataclasses.replace(env, hardware=ROBOTS[name])
        robots = settings["robots"]
        if (
            name == "braking"
        ):  # later than other robots, and with motors that do so less
            hardware = dataclasses.replace(REAL, mass_scale=1.01)
            control = dataclasses.replace(env.control, torque_rate=3e4)
            env = dataclasses.replace(env, hardware=hardware, control=control)
            robots = _describe_robots(env)
        own = robots[name if name in ROBOTS else "own"]
        setup = RobotSetup(env)
        content = robot_numbers(setup, settings, own)
        return (
            (folder / "cpp" / "controller.bin").read_bytes(),
            content,
            setup,
            own,
            folder,
        )

    def load(name):
        controller, content, setup, own, folder = describe(name)
        return Native(library, controller, content), setup, own, folder

    return load


# --- In C++ ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["built", "ideal", "go1", "braking"])
def test_motors_and_losses_are_pythons_in_random_states(native, name):
    """Held to the laws as C MuJoCo's simulator compiles them, up to rounding."""
    page, setup, own, _ = native(name)
    motors, resistance = motors_of(setup.config), setup.resistance()
    rows = laws.stacked([laws.numbers_of(motors, resistance, DT)] * ROWS)
    rng, stand = np.random.default_rng(0), np.array(own["stand"]["qpos"])
    nv = len(stand) - 1
    qpos = stand + rng.normal(size=(ROWS, nv + 1)) * 0.3
    qvel, after = rng.normal(size=(2, ROWS, nv)) * rng.choice((1.0, 15.0), (ROWS, 1))
    before = rng.uniform(-150.0, 150.0, (ROWS, 12))
    target = np.tile(setup.config.hardware.anatomy.stand, (ROWS, 1))
    mobility = rng.uniform(1.0, 50.0, (ROWS, 12))
    forces = laws.apply(laws.forces, rows, before, qpos, qvel, target, 0.0 * target)
    states = qpos, qvel, after, mobility
    again = laws.apply(laws.correct, rows, forces[:, :12], before, *states)
    close = functools.partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-9)
    for k in range(ROWS):
        page.code.reset()
        page.set(torque=before[k], qpos=qpos[k], qvel=qvel[k])
        page.code.drive(0)
        close(page.torque, forces[k, :12])
        close(page.force[:nv], forces[k, 12:])
        page.set(after=after[k], mobility=mobility[k])
        assert page.code.correct() == (again[k, -1] > OUTSIDE)
        wanted = again[k, :-1] if again[k, -1] > OUTSIDE else forces[k]
        close(np.append(page.torque, page.force[:nv]), wanted)
    assert 0.1 < np.mean(again[:, -1] > OUTSIDE) < 1.0


@pytest.mark.parametrize("name", ["built", "braking"])
def test_it_runs_cmujocos_robot_as_python_would(onboard, native, name):
    """Every torque of a launch: measurement, controller, delay and PD law."""
    page, setup, _, folder = native(name)
    robot = onboard.robot.SimulatedRobot(folder, "built")
    controller = onboard.controller.OnboardController(folder)
    motors, behind = motors_of(setup.config), control_steps_behind(setup.latency)
    issued, data = [controller._targets] * 3, robot.data
    page.code.reset()
    page.wish[:] = 4.0, 0.0, 0.0
    for k in range(1500):
        page.set(qpos=data.qpos, qvel=data.qvel, torque=data.ctrl)
        if k % 5 == 0:
            assert page.code.tick() == b""
            seen = np.split(robot.sensors(), [12, 24, 27])
            reading = onboard.controller.SensorReading(*seen, k * DT)
            issued.insert(0, controller.step(reading, page.told.copy(), k * DT))
        q, qd, before = data.qpos[robot._q], data.qvel[robot._qd], data.ctrl.copy()
        target = issued[behind[k % 5]]
        expected = joint_torque(motors, before, q, qd, target[0], target[1], DT)
        page.code.drive(k % 5)
        # Nm: stiffness times what targets may differ by
        np.testing.assert_allclose(page.torque, expected, atol=250.0 * 2e-5)
        data.ctrl[:], data.qfrc_applied[:] = page.torque, page.force
        mujoco.mj_step(robot.model, data)
    assert len({*behind}) == (1 if name == "built" else 2)
    assert robot.place[0] > 1.0
    assert not robot.fallen


def test_a_wish_is_led_and_steered_as_in_play(native):
    page, setup, own, _ = native("built")
    config, rng = setup.config, np.random.default_rng(0)
    low, high = (np.array(x) for x in ((0.0, -0.5, -1.0), (15.5, 0.5, 1.0)))
    for _ in range(20):
        page.code.reset()
        person: Any = SimpleNamespace(
            config=config, _asked=np.zeros(3), _line=np.zeros(3)
        )
        person.qpos = np.array(own["stand"]["qpos"])
        for k in range(60):  # then the watchdog would say that the joints stand still
            if k % 30 == 0:
                person.wish = Wish(*(rng.uniform(low, high) * (rng.random(3) < 0.6)))
                yaw = rng.uniform(-3.0, 3.0)
            person.qpos[:2] += rng.normal(size=2) * 0.02
            person.qpos[3:7] = (
                np.cos(yaw / 2),
                *(1e-3 * rng.normal(size=2)),
                np.sin(yaw / 2),
            )
            page.set(qpos=person.qpos + 1e-5 * rng.normal(size=23))
            page.set(qvel=1e-3 * rng.normal(size=22), wish=person.wish)
            assert page.code.tick() == b""
            Session._lead(person)
            expected = np.clip(Session._steered(person), low, high)
            # float32 adds up, and the heading's noise times the operator's gain
            np.testing.assert_allclose(page.told, expected, atol=2e-3)


# --- Files ----------------------------------------------------------------------------


def test_the_compiled_code_that_ships_is_of_these_sources():
    assert page_build.SUMS.read_text() == page_build.sums()


THEIRS = {"js": b"1", "wasm": b"2"}


def package(path, **files):
    """Write a file like npm's."""
    with tarfile.open(path, "w:gz") as archive:
        for name, content in files.items():
            member = tarfile.TarInfo(f"package/mujoco.{name}")
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return path


def test_mujocos_files_are_fetched_once_and_never_used_unchecked(tmp_path, monkeypatch):
    cache, network = tmp_path / "cache", tmp_path / "network"
    network.mkdir()
    monkeypatch.setenv("BP2_CACHE", str(cache))
    monkeypatch.setenv("PATH", "")  # without npm
    pinned = {
        f"mujoco.{name}": hashlib.sha512(content).hexdigest()
        for name, content in THEIRS.items()
    }
    monkeypatch.setattr(mujoco_wasm, "SHA512", pinned)
    monkeypatch.setattr(mujoco_wasm, "NETWORK", network.as_uri())
    with pytest.raises(UserError, match=r"cannot fetch @mujoco.*with --mujoco-package"):
        mujoco_wasm.mujoco_files(None)
    for name, content in THEIRS.items():
        (network / f"mujoco.{name}").write_bytes(content + b" ")
    with pytest.raises(UserError, match=r"mujoco\.js is not that of npm's @mujoco"):
        mujoco_wasm.mujoco_files(None)
    assert not cache.exists()
    for name, content in THEIRS.items():
        (network / f"mujoco.{name}").write_bytes(content)
    assert mujoco_wasm.mujoco_files(None) == (b"1", b"2")
    shutil.rmtree(network)
    assert mujoco_wasm.mujoco_files(None) == (b"1", b"2")
    next(cache.rglob("mujoco.wasm")).write_bytes(b"3")
    with pytest.raises(UserError, match=r"mujoco\.wasm is not that of npm's"):
        mujoco_wasm.mujoco_files(None)


def test_a_given_package_is_checked(tmp_path):
    given = package(tmp_path / "given", js=b"not theirs", wasm=b"2")
    with pytest.raises(UserError, match=r"given: mujoco\.js is not that of npm's"):
        mujoco_wasm.mujoco_files(given)
    given.write_bytes(b"no archive")
    with pytest.raises(UserError, match="given is not npm's @mujoco/mujoco@3"):
        mujoco_wasm.mujoco_files(given)


# --- In a browser ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def site(shipped, tmp_path_factory):
    """The shipped policy's page, with MuJoCo's package from the network or the cache."""
    folder = tmp_path_factory.mktemp("page") / "site"
    try:
        write_page(folder, shipped)
    except UserError as error:
        pytest.skip(str(error))
    return folder


@pytest.fixture(scope="module")
def browser(site, tmp_path_factory):
    """Return a browser's tab, and the page's address on a file server without headers of
    its own."""
    pytest.importorskip(
        "websockets",
        reason='needs the package websockets: pip install -c constraints.txt -e ".[play]"',
    )
    if (program := find_browser()) is None:
        pytest.skip("needs a Chromium")
    handler = functools.partial(Quiet, directory=str(site))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever).start()
    try:
        with browsing(
            program, "about:blank", tmp_path_factory.mktemp("profile")
        ) as tab:
            tab.listen()
            yield tab, f"http://127.0.0.1:{server.server_port}/index.html"
    finally:
        server.shutdown()
        server.server_close()


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


def shown(tab, address, width=1280, height=800):
    """Open the page anew, and wait until the robot is there; return what was asked."""
    tab.open("about:blank", width, height)
    tab.call("Page.navigate", url=address)
    tab.wait("typeof page == 'object' && Boolean(page.robot)")
    return json.loads(tab.value("JSON.stringify(page.asked)"))


@pytest.mark.parametrize("name", ["built", "ideal"])
def test_a_browser_runs_as_far_as_cmujoco_in_python(browser, shipped, name):
    """12 m/s for ten seconds after a launch: MuJoCo 3.14 in WebAssembly and 3.17 here."""
    request = RunRequest(Ramp(12.0, acceleration=1e6, hold=14.0), ROBOTS[name])
    [run] = simulate(shipped, [request])
    tab, address = browser
    assert shown(tab, f"{address}#robot={name}&speed=0")["robot"] == name
    said = json.loads(
        tab.value(
            "JSON.stringify([page.reset(), page.run(10, 12), page.run(3.99, 12)])"
        )
    )
    for found, end, start in ((said[1], 10000, 0), (said[2], 13990, 10000)):
        assert found["fell"] is None
        metres = run.qpos[end, 0] - run.qpos[start, 0]
        assert found["metres"] == pytest.approx(metres, rel=0.01)
    assert said[2]["took"] < 3.99  # s: it runs in real time, without pictures
    assert tab.complaints == []


def test_hands_and_eyes_find_what_they_need(browser, site):
    tab, address = browser
    total = sum(file.stat().st_size for file in site.rglob("*"))
    assert total <= MOST_BYTES
    for width in (1280, 400):
        asked = shown(tab, f"{address}#policy=policy&robot=ideal&speed=2.5", width)
        assert asked == {"policy": "policy", "robot": "ideal", "speed": "2.5"}
        assert tab.value("document.documentElement.scrollWidth") <= width
        picture = tab.screenshot().astype(int)
        red = picture[..., 0] - picture[..., 1:].max(axis=-1)
        assert np.mean(red > 40) > 0.1  # the track
    tab.value("page.reset(); 0")
    for key, wish in (
        ("w", [0.5, 0, 0]),
        ("q", [0.5, 0.1, 0]),
        ("ArrowRight", [0.5, 0.1, -0.1]),
    ):
        tab.call("Input.dispatchKeyEvent", type="keyDown", key=key)
        tab.call("Input.dispatchKeyEvent", type="keyUp", key=key)
        found = json.loads(tab.value("JSON.stringify([...page.robot.wish])"))
        assert found == pytest.approx(wish)
    assert tab.value("location.hash") == "#policy=policy&robot=ideal&speed=0.5"
    stick = "axes: [0, -0.575, 0, 0], buttons: []"  # half of what is not rest
    tab.value(f"navigator.getGamepads = () => [{{ connected: true, {stick} }}]")
    tab.wait("page.robot.wish[0] == 7.75", 20.0)
    tab.value("delete navigator.getGamepads")
    tab.value("page.held = {}; page.reset()")
    assert tab.value("page.press('G'), page.run(12, 15.5), page.finished")
    assert 8.0 < tab.value("page.best") < 12.0
    tab.value("page.reset(), page.run(2, 6), page.robot.look().qvel[3] = 30")
    assert tab.value("page.run(2, 6).fell") > 2.0
    assert re.match(r"It fell at [456]\.\d m/s", tab.value(SAYS))
    tab.value("for (let k = 0; k < 1510; k++) page.step()")
    assert tab.value("page.robot.time") < 0.2  # it stands again
    assert tab.complaints == []


def test_where_it_cannot_run_the_page_says_so(browser, site):
    tab, address = browser
    tab.open((site / "index.html").as_uri(), 400, 800)
    assert tab.wait(f"{SAYS}.includes('http.server') && {SAYS}").count(".") < 4
    tab.complaints.clear()
    tab.call("Page.enable")
    code = "delete globalThis.WebAssembly"
    found = tab.call("Page.addScriptToEvaluateOnNewDocument", source=code)
    tab.open(address, 400, 800)
    assert "no WebAssembly" in tab.value(SAYS)
    tab.call("Page.removeScriptToEvaluateOnNewDocument", **found)
    tab.open("about:blank", 400, 800)
    tab.call("Page.navigate", url=f"{address}#policy=nowhere")
    tab.wait(f"{SAYS}.includes('the server has no nowhere/page.json')")
