"""Restrict who may open the page of `bp2 play`, and drop browser messages that the
viser server cannot take."""

import contextlib
import dataclasses
import http
from collections.abc import Awaitable, Callable, Generator, Mapping
from typing import Any
from unittest import mock
from urllib.parse import urlsplit

import msgspec
import websockets.asyncio.server
from viser._messages import CommandTriggerMessage, GuiUpdateMessage, ViewerCameraMessage
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

OWN_NAMES = "localhost", "127.0.0.1", "::1"
"""Names and addresses of the local host."""
PAD = "/pad"  # path of the websocket on which a gamepad is heard
KINDS = {
    kind.__name__: kind
    for kind in (CommandTriggerMessage, GuiUpdateMessage, ViewerCameraMessage)
}
"""Messages that the page sends: a key pressed, a widget moved, a camera turned."""


def is_understood(message: bytes | str, widgets: Mapping[str, object]) -> bool:
    """Return whether a browser's message is valid: of a known kind, with a value that
    its widget can have."""
    try:
        packed = message.encode() if isinstance(message, str) else message
        fields = msgspec.msgpack.decode(packed)
        kind = KINDS[fields.pop("type")]
        content = msgspec.convert(fields, kind)
    except (
        ValueError,
        TypeError,
        LookupError,
        AttributeError,
        RecursionError,
    ):  # text, a list, another kind ...
        return False
    if fields.keys() != {field.name for field in dataclasses.fields(kind)}:
        return False
    if not isinstance(content, GuiUpdateMessage):
        return True
    return (
        content.uuid in widgets
        and content.updates.keys() == {"value"}
        and takes(widgets[content.uuid], **content.updates)
    )


def takes(widget: Any, value: Any) -> bool:
    """Return whether a viser widget can have a value: an option of a list, a slider's
    number, or a tick."""
    if hasattr(widget, "options"):
        return value in widget.options
    if hasattr(widget, "min"):
        return type(value) in (float, int) and widget.min <= value <= widget.max
    return isinstance(value, bool)


@contextlib.contextmanager
def guarding(
    widgets: Mapping[str, object],
    hear: Callable[[bytes | str], None],
    *,
    own_names: bool,
) -> Generator[None]:
    """Make viser servers started in the block ignore invalid messages and, with
    `own_names`, other machines.

    With `own_names` they answer 403 to requests for or from another machine. A site may
    let its own name lead to this machine, or open a connection to it from its page; a
    browser's request tells both, in `Host` and `Origin`. viser has no setting for
    either, so its way to websockets' server is led past them.

    Args:
        widgets: of the page by their uuid; they may come later.
        hear: takes each message at `PAD`, which does not come to viser.
        own_names: whether the page is for this machine's browsers alone.
    """
    serve = websockets.asyncio.server.serve

    def serve_guarded(
        handler: Callable[[ServerConnection], Awaitable[None]],
        *arguments: Any,
        process_request: Callable[[ServerConnection, Request], Response | None],
        **options: Any,
    ) -> Any:
        async def handle(connection: Any) -> None:
            if connection.request.path == PAD:
                async for message in connection:
                    hear(message)
                return
            receive = connection.recv

            async def receive_understood() -> bytes:
                while not is_understood(message := await receive(), widgets):
                    pass
                return message

            connection.recv = receive_understood
            await handler(connection)

        def answer(connection: ServerConnection, request: Request) -> Response | None:
            headers = request.headers
            if not own_names or all(
                map(is_own, (*headers.get_all("Host"), *headers.get_all("Origin")))
            ):
                return process_request(connection, request)
            return connection.respond(
                http.HTTPStatus.FORBIDDEN,
                "bp2 play is for this machine's browsers alone\n",
            )

        return serve(handle, *arguments, process_request=answer, **options)

    with mock.patch.object(websockets.asyncio.server, "serve", serve_guarded):
        yield


def is_own(place: str) -> bool:
    """Return whether the address in a `Host` or `Origin` header is this machine."""
    try:
        return urlsplit(place if "//" in place else f"//{place}").hostname in OWN_NAMES
    except ValueError:  # no address at all
        return False
