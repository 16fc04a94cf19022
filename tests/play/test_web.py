"""The page in a real browser: the robot is to be seen, and follows the slider."""

import contextlib
import http.client
import os
import re
import socket
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from browser import browsing, find_browser

from bp2_rl.base.errors import UserError

pytest.importorskip(
    "viser",
    reason='needs the package viser: pip install -c constraints.txt -e ".[play]"',
)
BROWSER = find_browser()
SPEED = "parseFloat(document.querySelector('[data-reading=speed]')?.textContent)"
SLIDER = "[...document.querySelectorAll('[role=slider]')][0]"
FIELD = f"{SLIDER}.closest('[class*=Flex]').querySelector('[inputmode]')"
GAMEPAD = """
    window.pad = { connected: true, axes: [0, 0, 0, 0], buttons: {} };
    navigator.getGamepads = () => [null, pad];
"""


@pytest.fixture(scope="module")
def served():
    """Start the command; return its process and its address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [
        sys.executable,
        "-m",
        "bp2_rl",
        "play",
        "--robot",
        "ideal",
        "--port",
        str(port),
    ]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert process.stdout is not None
    lines = iter(process.stdout.readline, "")
    said = next(
        filter(None, (re.search(r"open (http://\S+);", line) for line in lines)), None
    )
    assert said is not None, "the command ended early"
    yield process, said[1]
    process.terminate()
    process.wait(60)
    process.stdout.close()


@pytest.mark.skipif(BROWSER is None, reason="needs a Chromium")
def test_the_robot_is_on_the_page_and_runs_as_fast_as_the_slider_says(served, tmp_path):
    process, url = served
    assert BROWSER is not None
    with browsing(BROWSER, url, tmp_path / "profile", 700, 450) as tab:
        for part in (
            "[data-reading=speed]",
            "[role=slider]",
            "canvas",
        ):
            tab.wait(f"Boolean(document.querySelector('{part}'))")
        assert any(visible(tab.screenshot()) for _ in range(60))
        where = tab.value(
            f"(r => [r.x, r.y, r.width, r.height])({SLIDER}.closest('[class*=Slider-root]').getBoundingClientRect())"
        )
        x, y, width, height = where
        tab.click(x + 0.25 * width, y + 0.5 * height)
        told = tab.wait(
            "Number(/told ([1-9][0-9.]*)/.exec(document.body.innerText)?.[1])"
        )
        assert told >= 1.0
        assert tab.wait(f"{SPEED} > 1.0") is True
        tab.value(
            "[...document.querySelectorAll('button')].find(b => b.innerText == 'reset').click()"
        )
        # the slider follows
        assert tab.wait(f"{SLIDER}.getAttribute('aria-valuenow') == '0'") is True
        assert tab.wait("document.body.innerText.includes('ready')") is True
        tab.value(GAMEPAD)
        for moved, speed in (
            ("axes[1] = -0.575", 7.75),  # half of its way beyond the rest
            ("buttons[5] = { pressed: true }", 8.25),
            ("axes[1] = 0.1", 0),
            ("buttons[0] = { pressed: true }", 15.5),
            ("axes[1] = -0.3", 2.79),
            ("connected = false", 0),
        ):
            tab.value(f"pad.{moved}")
            assert tab.wait(f"{FIELD}.value == '{speed}'") is True
        assert process.poll() is None
        tab.open(f"{url}/", 400, 800)  # a telephone, whose lower half the panel takes
        assert any(visible(tab.screenshot()[:320]) for _ in range(60))


@pytest.mark.skipif(
    BROWSER is None or not Path("/proc/self/stat").exists(),
    reason="needs a Chromium and /proc",
)
def test_it_rests_while_no_browser_shows_it(served):
    process, _ = served  # the tab of the test before is closed

    def busy():
        fields = (
            Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
        )
        # s, of processor time
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    for _ in range(50):
        before = busy()
        time.sleep(1.0)
        if (spent := busy() - before) < 0.1:
            break
    assert spent < 0.1  # running takes 0.4


def answer(place, headers):
    """Return the status of a request with these headers."""
    with contextlib.closing(http.client.HTTPConnection(place, timeout=60)) as asked:
        asked.request("GET", "/", headers=headers)
        return asked.getresponse().status


def test_pages_of_other_sites_are_refused(served):
    place = urlsplit(served[1])
    port = place.port
    upgrade = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    }
    # an ssh tunnel has a port of its own
    own = "localhost", f"127.0.0.1:{port}", "[::1]:80", "LOCALHOST:9000"
    others = (
        *("example.org", f"example.org:{port}", "localhost.example.org"),
        *("127.0.0.1.example.org", "[", ""),
    )
    origins = (
        *("https://example.org", f"http://localhost.example.org:{port}"),
        *("null", "file://"),
    )
    cases = [
        (200, {}),
        *((200, {"Host": host}) for host in own),
        *((403, {"Host": host}) for host in others),
        (101, upgrade | {"Origin": f"http://localhost:{port}"}),
        *((403, upgrade | {"Origin": origin}) for origin in origins),
    ]
    found = [(answer(place.netloc, headers), headers) for _, headers in cases]
    assert found == cases


# no name, and an address kept for examples
@pytest.mark.parametrize("host", ["nowhere.invalid", "203.0.113.7"])
def test_an_address_that_is_not_this_machines_is_refused(session, host):
    from bp2_rl.play.web import Page

    with pytest.raises(
        UserError,
        match=rf"cannot listen at {host}:8080: .*; choose another --host or --port",
    ):
        Page(session, host=host, port=8080)


def visible(picture: np.ndarray) -> bool:
    """Return whether the robot's orange back and light shell are to be seen on the red
    ground."""
    red, green, blue = (picture[:, :400, k].astype(int) for k in range(3))
    orange = (
        (red > 170) & (green > 60) & (green < 150) & (blue < 110) & (red - blue > 90)
    )
    shell = (
        (abs(red - green) < 25) & (abs(green - blue) < 30) & (red > 110) & (red < 235)
    )
    return orange.sum() > 40 and shell.sum() > 800
