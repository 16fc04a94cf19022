"""The page in a real browser: the robot is to be seen, and follows the slider."""

import re
import socket
import subprocess
import sys

import numpy as np
import pytest
from browser import browsing, find_browser

pytest.importorskip("viser", reason='needs the package viser: pip install -c constraints.txt -e ".[play]"')
BROWSER = find_browser()
SPEED = "Number(document.querySelector('[data-reading=speed]')?.textContent)"
SLIDER = "[...document.querySelectorAll('[role=slider]')][0]"


@pytest.fixture(scope="module")
def served():
    """The command, running; (its process, its address)."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "bp2_rl", "play", "--web", "--robot", "ideal", "--port", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    lines = iter(process.stdout.readline, "")
    said = next(filter(None, (re.search(r"open (http://\S+);", line) for line in lines)), None)
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
        for part in ("[data-reading=speed]", "[data-chart=torque-speed]", "[role=slider]", "canvas"):
            tab.wait(f"Boolean(document.querySelector('{part}'))")
        for _ in range(60):
            seen = tab.screenshot()
            if visible(seen):
                break
        assert visible(seen)
        where = tab.value(
            f"(r => [r.x, r.y, r.width, r.height])({SLIDER}.closest('[class*=Slider-root]').getBoundingClientRect())"
        )
        x, y, width, height = where
        tab.click(x + 0.25 * width, y + 0.5 * height)
        told = tab.wait("Number(/told ([1-9][0-9.]*)/.exec(document.body.innerText)?.[1])")
        assert told >= 1.0
        assert tab.wait(f"{SPEED} > 1.0") is True
        assert process.poll() is None


def visible(picture: np.ndarray) -> bool:
    """Whether the robot's orange back and its light shell are to be seen on the red ground."""
    red, green, blue = (picture[:, :400, k].astype(int) for k in range(3))
    orange = (red > 170) & (green > 60) & (green < 150) & (blue < 110) & (red - blue > 90)
    shell = (abs(red - green) < 25) & (abs(green - blue) < 30) & (red > 110) & (red < 235)
    return orange.sum() > 40 and shell.sum() > 800
