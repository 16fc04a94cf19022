"""The run in a report's page: numbers are the run's, links are where MuJoCo has them,
and a browser shows the run."""

import base64
import dataclasses

import mujoco
import numpy as np
import pytest
from browser import browsing, find_browser

from bp2_rl.base.plotting import moving_mean
from bp2_rl.evaluation.benchmarks.outcome import Evaluation
from bp2_rl.evaluation.benchmarks.run import run_pictures, run_tables
from bp2_rl.evaluation.report.page import page
from bp2_rl.evaluation.report.player.content import SHOWN_TIME, describe_run
from bp2_rl.robot.model import load_model
from bp2_rl.settings.terrain import Terrain
from bp2_rl.simulation.world import World

BROWSER = find_browser()
PLAYER = "document.querySelector('.player').player"


def channel(content, name):
    return numbers(content["channels"][name])


def numbers(told):
    values = np.frombuffer(base64.b64decode(told["data"]), "<" + told["type"]).reshape(
        -1, told["width"]
    )
    return values * told["scale"]


def test_the_page_is_told_the_run_to_a_tenth_of_a_millimetre(busy_run):
    content, qpos = describe_run(busy_run), busy_run.qpos[::5]
    assert content["motion"]["rate"] == pytest.approx(200.0)
    forces = moving_mean(busy_run.foot_force, 5)[::5].reshape(-1, 12)
    for name, values, error in (
        ("place", qpos[:, :3], 1e-5),
        ("turn", qpos[:, 3:7], 2e-5),
        ("joints", qpos[:, 7:], 5e-5),
        ("force", forces, 0.05),
    ):
        np.testing.assert_allclose(channel(content, name), values, atol=error)


def test_ground_that_is_not_flat_is_told_and_the_level_below_the_trunk(busy_run):
    """Against the planes from which the ground is made."""
    run = dataclasses.replace(busy_run, terrain=Terrain("rough", 0.05, cell=0.3))
    content, ground = describe_run(run), World(run.terrain).ground
    assert ground
    [geom] = [geom for geom in content["geoms"] if geom["link"] < 0]
    x, y = np.meshgrid(geom["field"]["x"], geom["field"]["y"])
    (left, right, height), heights = geom["position"], geom["field"]["heights"]
    found = numbers(heights).reshape(x.shape) + height
    # 16 bits of 10 cm, and x and y to a micrometre
    np.testing.assert_allclose(
        found, ground.below(x + left, y + right).height, atol=5e-6
    )
    assert np.ptp(x) == pytest.approx(np.ptp(run.qpos[:, 0]) + 10.0, abs=0.6)
    assert np.ptp(channel(content, "level")) > 0.01


def test_a_turn_is_told_without_jumps(make_run):
    """A quaternion and its negative are one turn, and a simulator may give either."""
    run = make_run(duration=1.0)
    run.qpos[300:600, 3:7] *= -1.0
    np.testing.assert_allclose(channel(describe_run(run), "turn")[:, 0], 1.0)


def test_of_a_long_run_the_best_minute_is_shown(make_run):
    run = make_run(duration=90.0)
    run.qvel[80000:81000, 0] = 7.0
    motion = describe_run(run)["motion"]
    assert motion["start"] == pytest.approx(90.0 - SHOWN_TIME)
    assert motion["start"] + motion["best"] == pytest.approx(80.5, abs=0.01)
    assert (motion["count"] - 1) / motion["rate"] == pytest.approx(SHOWN_TIME, abs=0.01)


@pytest.fixture(scope="module")
def tab(busy_run, tmp_path_factory):
    """The report of a run, open in a browser that has no network."""
    pytest.importorskip(
        "websockets",
        reason='needs the package websockets: pip install -c constraints.txt -e ".[play]"',
    )
    if BROWSER is None:
        pytest.skip("needs a Chromium")
    evaluation = Evaluation(
        "topspeed",
        "a trot",
        conditions={},
        verdict="It ran.",
        good=True,
        rows=(),
        tiles=(),
        pictures=run_pictures(busy_run),
        metrics=None,
        results={},
        tables=run_tables(busy_run.metrics),
        trajectory=busy_run,
    )
    place = tmp_path_factory.mktemp("report")
    (place / "index.html").write_text(page(evaluation, has_video=False))
    with browsing(BROWSER, "about:blank", tmp_path_factory.mktemp("profile")) as tab:
        tab.listen()
        tab.call("Network.enable")
        tab.call(
            "Network.emulateNetworkConditions",
            offline=True,
            latency=0,
            downloadThroughput=0,
            uploadThroughput=0,
        )
        tab.url = (place / "index.html").as_uri()
        yield tab


@pytest.mark.parametrize("width", [400, 1280])
def test_the_run_plays_without_a_network_and_without_a_complaint(tab, width):
    show(tab, width)
    # nothing hangs out at the side
    assert tab.value("document.documentElement.scrollWidth") <= width
    tables = tab.value(
        "[...document.querySelectorAll('.wide:has(table)')].map(e => e.scrollWidth - e.clientWidth)"
    )
    assert tables == [0, 0, 0]  # measures, motors and legs are seen whole
    still = stage(tab)
    red, green, blue = (still[..., k].astype(int) for k in range(3))
    assert np.mean((red > 110) & (green < 90) & (blue < 80)) > 0.2  # the track
    # the back
    assert (
        np.mean(
            (abs(red - green) < 25)
            & (abs(green - blue) < 30)
            & (red > 110)
            & (red < 235)
        )
        > 0.005
    )
    move_slider(tab, 0.5)
    assert tab.value(f"{PLAYER}.seconds") == pytest.approx(4.0, abs=0.1)
    scrubbed = stage(tab)
    assert np.mean(np.any(abs(scrubbed.astype(int) - still) > 40, axis=-1)) > 0.01
    assert float(
        tab.value("document.querySelector('[data-shows=speed]').textContent")
    ) == pytest.approx(5.0, abs=0.1)
    tab.value("document.querySelector('[data-does=play]').click()")
    tab.wait(f"{PLAYER}.seconds > 4.3", seconds=20)
    tab.value("document.querySelector('[data-does=play]').click()")
    assert tab.complaints == []
    fetched = tab.value(
        "performance.getEntriesByType('resource').map(entry => entry.name.slice(0, 5))"
    )
    assert set(fetched) <= {"data:"}


def show(tab, width):
    """Show the page in a window of this width, unless it is shown so already."""
    if tab.value("[location.href, innerWidth]") != [tab.url, width]:
        tab.open(tab.url, width, 700)


def box(tab, selector):
    """Return (x, y, width, height) of an element, in pixels of the window."""
    place = f"document.querySelector('{selector}').getBoundingClientRect()"
    return tab.value(f"(r => [r.x, r.y, r.width, r.height])({place})")


def stage(tab):
    """Return a picture of the page's canvas, without the text at its edges."""
    tab.value("document.querySelector('.player').scrollIntoView()")
    x, y, width, height = box(tab, "canvas")
    picture = tab.screenshot()[int(y) : int(y + height), int(x) : int(x + width)]
    return picture[picture.shape[0] // 4 : -picture.shape[0] // 8]


def move_slider(tab, share):
    tab.value("document.querySelector('.scrub').scrollIntoView({block: 'center'})")
    x, y, width, height = box(tab, ".scrub input")
    tab.click(x + share * width, y + height / 2)


def test_forces_are_seen_and_can_be_hidden(tab):
    show(tab, 1280)
    tab.value(f"{PLAYER}.seek(5.28)")  # a right fore and a left hind foot stand
    shown = stage(tab).astype(int)
    tab.value("document.querySelector('[data-does=forces]').click()")
    hidden = stage(tab).astype(int)
    red, _, blue = (shown[..., k] for k in range(3))
    # FR's is blue
    assert np.sum((blue > red + 60) & np.any(shown != hidden, axis=-1)) > 100


def test_a_hand_turns_the_camera(tab):
    show(tab, 1280)
    before = tab.value(f"[{PLAYER}.camera.yaw, {PLAYER}.camera.pitch]")
    tab.value("document.querySelector('.player').scrollIntoView()")
    for kind, x, y in (
        ("mousePressed", 600, 300),
        ("mouseMoved", 500, 350),
        ("mouseReleased", 500, 350),
    ):
        tab.call(
            "Input.dispatchMouseEvent",
            type=kind,
            x=x,
            y=y,
            button="left",
            buttons=1,
            clickCount=1,
        )
    yaw, pitch = tab.value(f"[{PLAYER}.camera.yaw, {PLAYER}.camera.pitch]")
    assert yaw - before[0] == pytest.approx(0.8)
    assert pitch - before[1] == pytest.approx(0.4)


def test_the_links_are_where_mujoco_puts_them(tab, busy_run):
    """To 0.2 mm: angles come in steps of 0.05 mrad, 0.7 m from the feet, and between
    samples as chords of 5 ms."""
    show(tab, 1280)
    model = load_model(busy_run.hardware)
    data = mujoco.MjData(model)
    for k in (0, 2500, 6130, 7995):
        data.qpos[:] = busy_run.qpos[k]
        mujoco.mj_kinematics(model, data)
        found = np.array(
            tab.value(f"{PLAYER}.motion.poses({k / 1000}, false)")
        ).reshape(-1, 4, 4)
        np.testing.assert_allclose(found[:, 3, :3], data.xpos[1:], atol=2e-4)
        turns = found[:, :3, :3].transpose(0, 2, 1)
        np.testing.assert_allclose(turns, data.xmat[1:].reshape(-1, 3, 3), atol=2e-4)
