"""Messages of a browser by a real websocket: they move the page's widgets to possible
values, or do nothing."""

import math
import random
import socket
import time

import pytest

pytest.importorskip(
    "viser",
    reason='needs the package viser: pip install -c constraints.txt -e ".[play]"',
)
import msgspec
import viser
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from bp2_rl.play.gate import is_understood
from bp2_rl.play.pace import Pace
from bp2_rl.play.session import STEP
from bp2_rl.play.web import SLOWER, Page

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1, 0, 0, 0],
    "position": [1, -2, 1],
    "look_at": [0, 0, 0],
    "up_direction": [0, 0, 1],
    "fov": 0.8,
    "near": 0.1,
    "far": 100,
    "image_height": 600,
    "image_width": 800,
}
ODD = (
    None,
    True,
    False,
    -1,
    0,
    1e300,
    -1e300,
    2**63,
    math.nan,
    math.inf,
    -math.inf,
    "",
    "x",
    "nan",
    "0.5",
    "1/3",
    "stand\0",
    "__class__",
    "x" * 100_000,
    b"",
    b"1",
    [],
    [1.0],
    ["stand"],
    {},
    {"value": 1.0},
)


@pytest.fixture
def page(session):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    page = Page(session, host="127.0.0.1", port=port)
    yield page
    page.close()


def address(page):
    return f"ws://127.0.0.1:{page.server.get_port()}"


def browser(page):
    page_of_viser = Subprotocol(f"viser-v{viser.__version__}")
    return connect(
        address(page),
        subprotocols=[page_of_viser],
        max_size=None,
    )


def moved(uuid, value, name="value"):
    return {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {name: value}}


def values(page):
    return {uuid: widget.value for uuid, widget in page._widgets.items()}


def wait_until(condition):
    deadline = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def name_of(page, widget):
    return next(uuid for uuid, known in page._widgets.items() if known is widget)


def hostile(page):
    """Yield messages that no page sends, as bytes and as text."""
    encode = msgspec.msgpack.encode
    widgets = [*page._widgets, "", "nobody", "x" * 100_000]
    for uuid in widgets:
        right = values(page).get(uuid)
        yield from (
            encode(moved(uuid, odd)) for odd in ODD if not fits(page, uuid, odd)
        )
        yield from (
            encode(moved(uuid, right, name))
            for name in ("_value", "uuid", "removed", "props", "min", "nothing")
        )
    yield from (
        encode({"type": kind, "uuid": name_of(page, page._slower), **rest})
        for kind, rest in OTHERS.items()
    )
    yield from (
        encode(CAMERA | {name: odd})
        for name in CAMERA
        for odd in ODD
        if not fits_camera(name, odd)
    )
    yield from (
        encode(CAMERA | {"wxyz": [odd, 0, 0, 0]})
        for odd in (math.nan, math.inf, None, "x", [1])
    )
    yield from (encode(odd) for odd in ODD)
    yield from (b"\x91" * 100_000, b"\xdf\xff\xff\xff\xff", b"\xc1", "text", "")
    rng, whole = random.Random(0), encode(moved(name_of(page, page._slower), "1/2"))
    yield from (
        flipped
        for _ in range(500)
        if (flipped := flip(rng, whole)) and not is_understood(flipped, page._widgets)
    )


OTHERS = {
    "GuiUpdateMessage": {},
    "GuiButtonHoldMessage": {"frequency": math.nan},
    "GuiFormSubmitMessage": {},
    "GuiFormDirtyMessage": {},
    "ShareUrlRequest": {},
    "ShareUrlDisconnect": {},
    "CommandTriggerMessage": {"times": 3},
    "FileTransferStartUpload": {},
    "FileTransferPart": {},
    "GuiCloseModalMessage": {},
    "RemoveSceneNodeMessage": {},
    "Message": {},
    "no such": {},
    "": {},
}


def fits(page, uuid, value):
    """Return whether a widget can have this value, so that the value is no mistake."""
    widget = page._widgets.get(uuid)
    if widget is page._ghost or widget is page._forces:
        return isinstance(value, bool)
    if (
        hasattr(widget, "min")
        and isinstance(value, int | float)
        and not isinstance(value, bool)
    ):
        return widget.min <= value <= widget.max
    return False


def fits_camera(name, value):
    number = isinstance(value, int | float) and not isinstance(value, bool)
    whole = name not in ("image_height", "image_width") or value == 0
    return (
        name not in ("type", "wxyz", "position", "look_at", "up_direction")
        and number
        and abs(value) <= 1e9
        and whole
    )


def flip(rng, content):
    flipped = bytearray(content)
    flipped[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    return bytes(flipped)


def test_no_message_of_a_browser_ends_or_changes_more_than_its_own_widgets(
    page, session, capfd
):
    pace, before = Pace(), values(page)
    with browser(page) as ours, browser(page) as theirs:
        ours.send(msgspec.msgpack.encode(CAMERA))
        theirs.send(
            msgspec.msgpack.encode(
                CAMERA
                | {"wxyz": [0, 0, 0, math.nan], "image_height": -1, "image_width": -2}
            )
        )
        wait_until(lambda: len(page.server.get_clients()) == 2)
        count = 0
        for message in hostile(page):
            theirs.send(message)
            count += 1
        assert count > 500
        # the last word, a right one
        theirs.send(msgspec.msgpack.encode(moved(name_of(page, page._slower), "1/5")))
        wait_until(lambda: page._slower.value == "1/5")
        page.show(pace)
        changed = {name_of(page, page._slower)}
        assert {
            uuid: value for uuid, value in values(page).items() if uuid not in changed
        } == {uuid: value for uuid, value in before.items() if uuid not in changed}
        assert pace.slow == SLOWER["1/5"]
        # JavaScript's 1.0
        ours.send(
            msgspec.msgpack.encode(moved(name_of(page, page._sliders["speed"]), 1))
        )
        wait_until(lambda: page._sliders["speed"].value == 1.0)
        page.show(pace)
        assert session.wish.speed == 1.0
        assert len(page.server.get_clients()) == 2
    said = capfd.readouterr()
    assert "Traceback" not in said.out + said.err
    assert said.err == ""


def test_every_widget_and_key_does_what_a_browser_asks(page, session):
    pace, encode = Pace(), msgspec.msgpack.encode
    with browser(page) as tab:
        tab.send(encode(CAMERA | {"image_height": 800, "image_width": 600}))
        wait_until(lambda: page.server.get_clients())
        for uuid, widget in page._widgets.items():
            options, least = (
                getattr(widget, "options", None),
                getattr(widget, "min", None),
            )
            value = (
                options[-1]
                if options
                else (not widget.value if least is None else least)
            )
            tab.send(encode(moved(uuid, value)))
            wait_until(lambda widget=widget, value=value: widget.value == value)
        for uuid in page.server.gui._command_handle_from_uuid:
            tab.send(encode({"type": "CommandTriggerMessage", "uuid": uuid}))
        keys = len(page.server.gui._command_handle_from_uuid)
        wait_until(lambda: page._wanted.qsize() >= keys)
        page.show(pace)
    assert session.friction == 0.1
    assert pace.slow == 10.0


def test_a_gamepad_says_keys_and_shares_and_nothing_else_is_heard(page, session):
    odd = "", "w", b"W", "W W", "speed", "up 1", "speed 1e9", "speed nan", "speed 0.5"
    with connect(f"{address(page)}/pad") as pad:
        for said in (*odd, "x" * 100_000, "left 1000", "left -50", "speed 999", "S"):
            pad.send(said)
        wait_until(lambda: page._wanted.qsize() >= 3)
        page.show(Pace())
        assert not page.server.get_clients()
    limits = session.config.commands
    fast = limits.max_forward - STEP.speed
    assert session.wish == (fast, -0.5 * limits.max_lateral, 0.0)
    assert page._sliders["speed"].value == fast


def test_a_flood_of_wishes_does_not_keep_the_robot_from_running(page, session):
    """As many as came before are heard, and what comes meanwhile at the next
    picture."""
    heard = []

    def once_more(_):
        heard.append(True)
        page._wanted.put(once_more)

    page._wanted.put(once_more)
    page.show(Pace())
    assert len(heard) == 1
