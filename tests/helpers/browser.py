"""A headless Chromium by its DevTools protocol: open a page, look at it, click on
it."""

import base64
import contextlib
import io
import itertools
import json
import re
import shutil
import subprocess
import time
import urllib.request
from typing import Any

import numpy as np
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-dev-shm-usage",
    "--mute-audio",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--remote-debugging-port=0",
)


def find_browser() -> str | None:
    """Return the path of an installed browser, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Tab:
    """A page in a browser."""

    def __init__(self, socket: Any):
        self._socket, self._numbers = socket, itertools.count(1)
        self.url = "about:blank"
        # errors and warnings of the page's console, from `listen` on
        self.complaints: list[Any] = []

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        number = next(self._numbers)
        self._socket.send(
            json.dumps({"id": number, "method": method, "params": parameters})
        )
        while True:
            answer = json.loads(self._socket.recv(timeout=120))
            self._hear(answer)
            if answer.get("id") == number:
                assert "error" not in answer, answer["error"]
                return answer["result"]

    def listen(self) -> None:
        """Begin to collect the errors that the page reports."""
        self.call("Runtime.enable")
        self.call("Log.enable")

    def _hear(self, event: dict[str, Any]) -> None:
        said = event.get("params", {})
        kind = {
            "Runtime.exceptionThrown": "error",
            "Runtime.consoleAPICalled": said.get("type"),
            "Log.entryAdded": said.get("entry", {}).get("level"),
        }.get(event.get("method", ""))
        if kind in ("error", "warning", "assert"):
            self.complaints.append(said)

    def open(self, url: str, width: int, height: int) -> None:
        """Open another page, in a window of this size, and wait until it is loaded."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        self.call("Page.navigate", url=url)
        self.wait(
            f"document.readyState == 'complete' && location.href == {json.dumps(url)}"
        )

    def value(self, expression: str) -> Any:
        """Return the value of a JavaScript expression on the page."""
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)[
            "result"
        ].get("value")

    def wait(self, expression: str, seconds: float = 120.0) -> Any:
        """Wait until a JavaScript expression is true on the page, and return its
        value."""
        end = time.monotonic() + seconds
        while not (said := self.value(expression)):
            assert time.monotonic() < end, (
                f"{expression} is not so after {seconds:.0f} s"
            )
            time.sleep(0.2)
        return said

    def click(self, x: float, y: float) -> None:
        for kind in ("mousePressed", "mouseReleased"):
            self.call(
                "Input.dispatchMouseEvent",
                type=kind,
                x=x,
                y=y,
                button="left",
                clickCount=1,
            )

    def screenshot(self) -> np.ndarray:
        """Return a picture of the page: rows, columns, RGB."""
        png = base64.b64decode(
            self.call("Page.captureScreenshot", format="png")["data"]
        )
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


@contextlib.contextmanager
def browsing(program: str, url: str, profile: Any, width: int = 900, height: int = 700):
    """Open a page in a headless browser, and yield its tab."""
    from websockets.sync.client import connect

    command = [
        program,
        *FLAGS,
        f"--user-data-dir={profile}",
        f"--window-size={width},{height}",
        url,
    ]
    browser = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    try:
        assert browser.stderr is not None
        said = (
            re.search(r"DevTools listening on ws://([^/]+)/", line)
            for line in browser.stderr
        )
        host = next(filter(None, said))[1]
        for _ in range(100):
            with urllib.request.urlopen(f"http://{host}/json") as answer:
                pages = [
                    target for target in json.load(answer) if target["type"] == "page"
                ]
            if pages:
                break
            time.sleep(0.1)
        with connect(pages[0]["webSocketDebuggerUrl"], max_size=None) as socket:
            yield Tab(socket)
    finally:
        browser.terminate()
        browser.wait(30)
        if browser.stderr is not None:
            browser.stderr.close()
