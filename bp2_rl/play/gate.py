"""Who may open the page, and what a browser may say: viser believes whatever comes, and a wrong word would end it."""

import contextlib
import http
from collections.abc import Callable, Generator
from typing import Annotated, Any, Literal
from unittest import mock
from urllib.parse import urlsplit

import msgspec
import websockets.asyncio.server

OWN_NAMES = "localhost", "127.0.0.1", "::1"
"""What a machine calls itself."""
Number = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
Pixels = Annotated[int, msgspec.Meta(ge=0, le=1 << 20)]
Vector = tuple[Number, Number, Number]


class _Message(msgspec.Struct, tag_field="type", tag=lambda name: f"{name}Message", forbid_unknown_fields=True):
    """A message as viser's page sends it: the class's name is the `type` of it."""


class GuiUpdate(_Message):
    """A widget has been moved."""

    uuid: str
    updates: dict[Literal["value"], bool | float | str]


class CommandTrigger(_Message):
    """A key has been pressed."""

    uuid: str


class ViewerCamera(_Message):
    """The camera has been turned."""

    wxyz: tuple[Number, Number, Number, Number]
    position: Vector
    look_at: Vector
    up_direction: Vector
    fov: Number
    near: Number
    far: Number
    image_height: Pixels
    image_width: Pixels


_DECODER = msgspec.msgpack.Decoder(GuiUpdate | CommandTrigger | ViewerCamera)


def takes(widget: Any, value: bool | float | str) -> bool:
    """Return whether a widget of viser's can have a value: one of a list, a number of a slider, or a tick."""
    if hasattr(widget, "options"):
        return value in widget.options
    if hasattr(widget, "min"):
        return isinstance(value, float) and widget.min <= value <= widget.max
    return isinstance(value, bool)


def is_understood(message: bytes | str, widgets: dict[str, Any]) -> bool:
    """Return whether a message can be from the page, and moves one of its widgets to a value that it can have."""
    if isinstance(message, str):
        return False
    try:
        said = _DECODER.decode(message)
    except (ValueError, RecursionError):
        return False
    return not isinstance(said, GuiUpdate) or all(
        said.uuid in widgets and takes(widgets[said.uuid], value) for value in said.updates.values()
    )


@contextlib.contextmanager
def guarding(widgets: dict[str, Any], *, own_names: bool) -> Generator[None]:
    """Let servers of viser's that start within pass over messages that are not understood; no traceback tells of them.

    With `own_names` they answer 403 where a browser asks for another machine or comes from one. A site may let its own
    name lead to this machine, or open a connection to it from its page; a browser's request tells both, in `Host` and
    `Origin`. viser has no setting for either, so its way to websockets' server is led past them.

    Args:
        widgets: of the page by their uuid; they may come later.
        own_names: whether the page is for this machine's browsers alone.
    """
    serve = websockets.asyncio.server.serve

    def serve_guarded(handler: Callable[..., Any], *arguments: Any, process_request: Any, **options: Any) -> Any:
        async def handle(connection: Any) -> None:
            receive = connection.recv

            async def receive_understood() -> bytes:
                while not is_understood(message := await receive(), widgets):
                    pass
                return message

            connection.recv = receive_understood
            await handler(connection)

        def answer(connection: Any, request: Any) -> Any:
            headers = request.headers
            if not own_names or all(map(is_own, (*headers.get_all("Host"), *headers.get_all("Origin")))):
                return process_request(connection, request)
            return connection.respond(http.HTTPStatus.FORBIDDEN, "bp2 play is for this machine's browsers alone\n")

        return serve(handle, *arguments, process_request=answer, **options)

    with mock.patch.object(websockets.asyncio.server, "serve", serve_guarded):
        yield


def is_own(place: str) -> bool:
    """Return whether a `Host` or an `Origin` is this machine."""
    try:
        return urlsplit(place if "//" in place else f"//{place}").hostname in OWN_NAMES
    except ValueError:  # no address at all
        return False
