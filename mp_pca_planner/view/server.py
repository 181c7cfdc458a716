# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The web server of the page: who may open it, and what a browser may send to it."""

from __future__ import annotations

import asyncio
import http
import logging
import re
import secrets
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, Any, Union
from unittest import mock

import msgspec
import rich
import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from ..arrays import check_number
from ..exceptions import PlannerError, printable

LOCAL_HOSTS = ("127.0.0.1", "localhost", "::1")
"""Hosts that only this machine reaches."""

LOG = logging.getLogger("mp_pca_planner.view.server")
"""Log of the server: one line per event, because others cause these."""

# A name or an address, and a port. The policy below repeats it, so it may hold nothing else.
_HOST = re.compile(r"(?P<name>[\w.-]+|\[[0-9a-fA-F:.]+\])(:\d+)?", re.ASCII)
_LOCAL_NAMES = ("127.0.0.1", "localhost", "[::1]")

# Frames of a browser are short, because the page takes no uploads.
_MAX_FRAME_SIZE = 64 * 1024

_Number = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
_Text = Annotated[str, msgspec.Meta(max_length=1000)]
_Vector = tuple[_Number, _Number, _Number]
_Quaternion = tuple[_Number, _Number, _Number, _Number]


_Handle = {"name": _Text, "owner": (_Text, "")}
_Place = {"wxyz": _Quaternion, "position": _Vector}
_VALUE = msgspec.defstruct("Value", [("value", bool | _Number | _Text)], forbid_unknown_fields=True)
# The messages that a page sends, by Viser's names: their fields, some with a default.
_MESSAGES: dict[str, dict[str, Any]] = {
    "ViewerCameraMessage": {
        **_Place,
        **dict.fromkeys(("fov", "near", "far"), _Number),
        **dict.fromkeys(("image_height", "image_width"), int),
        **dict.fromkeys(("look_at", "up_direction"), _Vector),
    },
    "GuiUpdateMessage": {"uuid": _Text, "updates": _VALUE},
    "CommandTriggerMessage": {"uuid": _Text},
    "TransformControlsUpdateMessage": {**_Handle, **_Place},
    "TransformControlsDragStartMessage": _Handle,
    "TransformControlsDragEndMessage": _Handle,
    "SceneNodeClickMessage": {
        **_Handle,
        "instance_index": int | None,
        **dict.fromkeys(("ray_origin", "ray_direction"), _Vector),
        "screen_pos": tuple[_Number, _Number],
        "modifier": _Text | None,
    },
}


def _struct(name: str, fields: dict[str, Any]) -> Any:
    """The type of a message."""
    every = [(key, *(x if isinstance(x, tuple) else (x,))) for key, x in fields.items()]
    return msgspec.defstruct(name, every, tag=name, tag_field="type", kw_only=True)


_FRAMES: Any = msgspec.msgpack.Decoder(Union[*(_struct(*one) for one in _MESSAGES.items())])


ValueProblem = Callable[[str, Any], str]
"""Why a widget, by its identity, can't have a value; empty if it can."""


class _Connection(ServerConnection):
    """A connection whose owner gets frames only that a page could have sent."""

    value_problem: ValueProblem
    _is_blamed = False

    async def recv(self, decode: bool | None = None) -> Any:
        """Return the next frame that the page could have sent; the others are dropped."""
        while True:
            frame = await super().recv(decode)
            reason = frame_problem(frame, self.value_problem)
            if not reason:
                return frame
            if not self._is_blamed:  # further ones of the same browser are dropped in silence
                self._is_blamed = True
                LOG.warning("a browser at %s sent no frame of the page: %s", self._sender, reason)

    @property
    def _sender(self) -> str:
        return str(self.remote_address[0]) if self.remote_address else "an unknown address"


def frame_problem(frame: str | bytes, value_problem: ValueProblem) -> str:
    """Why a frame of a browser is dropped; empty if the page takes it."""
    if isinstance(frame, str):
        return "it is text"
    try:
        message = _FRAMES.decode(frame)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        return printable(str(error))[:200]
    if hasattr(message, "updates"):
        return value_problem(message.uuid, message.updates.value)
    return ""


def _refusal(request: Request, token: str) -> str:
    """Why a request for the page is refused; empty if it is admitted.

    A browser lets every web site open a websocket to this machine. Therefore, a request must name
    the page's own host as its origin. A site whose name resolves to this machine does so, too:
    a local page must be asked for by a local name, and any other needs a token.

    Parameters
    ----------
    request : Request
        The request.
    token : str
        First part of the path of each request; empty for a page that only this machine reaches.
    """
    hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
    found = _HOST.fullmatch(hosts[0]) if len(hosts) == 1 else None
    if found is None:
        return "expected one host"
    if not token and found["name"].lower() not in _LOCAL_NAMES:
        return "this page is asked for as localhost or 127.0.0.1"
    own = [[f"{scheme}://{hosts[0].lower()}"] for scheme in ("http", "https")]
    is_connection = "Upgrade" in request.headers
    if (is_connection or origins) and [origin.lower() for origin in origins] not in own:
        return "another web site can't use this page"
    first, *_ = re.split("[/?]", request.path.removeprefix("/"), maxsplit=1)
    given = first.encode("utf-8", "surrogateescape")
    if token and not secrets.compare_digest(given, token.encode()):
        return "the address of this page ends with a token, which the command has printed"
    return ""


def _policy(host: str) -> str:
    """What the page may connect to, and that no site may show it in a frame of its own.

    Viser's page connects to any server that its address names; that server could run scripts in it.
    """
    own = f"'self' ws://{host} wss://{host} data: blob:"
    return f"connect-src {own}; frame-ancestors 'none'; form-action 'none'"


class PageServer(viser.ViserServer):
    """A server that other sites can't connect to, and that no page can open to the internet.

    A host that other machines reach has a token in its address.

    Parameters
    ----------
    host : str
        Address to listen on.
    port : int
        Port, or the first free one after it; 0: any free one.

    Raises
    ------
    PlannerError
        If the address is not one of this machine.
    """

    def __init__(self, host: str, port: int) -> None:
        check_number(port, "the port", PlannerError, 0, 65535, is_whole=True)
        try:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            with socket.create_server((host, 0), family=family):
                pass
        except OSError as error:
            raise PlannerError(
                f"the page can't be served at '{host}': {error.strerror or error}; expected an "
                "address of this machine, such as 127.0.0.1 or 0.0.0.0"
            ) from None
        self.is_local = host in LOCAL_HOSTS
        self._token = "" if self.is_local else secrets.token_urlsafe(16)
        # Viser has no option for this; its server is up when its constructor returns.
        serve = _guarded(self._token, self.value_problem)
        with mock.patch.object(websockets.asyncio.server, "serve", serve), _quiet():
            super().__init__(host, port, label="mp_pca_planner", verbose=False)

    def value_problem(self, widget: str, value: Any) -> str:
        """Why a widget can't have a value of a browser; empty if it can, or if it is gone.

        Viser casts values and passes them on, whatever the widget offers.
        """
        handle: Any = self.gui._gui_input_handle_from_uuid.get(widget)
        if handle is None:
            return ""
        present, is_number = handle.value, isinstance(value, (int, float))
        if hasattr(handle, "options"):
            is_offered = value in handle.options
        elif isinstance(present, bool) or isinstance(value, bool):
            is_offered = isinstance(value, bool) and isinstance(present, bool)
        else:  # rounded in the browser
            is_offered = is_number and handle.min - 1e-6 <= value <= handle.max + 1e-6
        return "" if is_offered else printable(f"'{handle.label}' can't have the value {value!r}")

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse a public address, which any client of Viser may request."""
        return None

    def stop(self) -> None:
        """Stop the server and its threads."""
        with _quiet():
            super().stop()

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        host = self.get_host()
        shown = socket.gethostname() if host in ("0.0.0.0", "::") else host
        address = f"http://{f'[{shown}]' if ':' in shown else shown}:{self.get_port()}"
        return f"{address}/{self._token}/" if self._token else address


def _guarded(token: str, value_problem: ValueProblem) -> Callable[..., Any]:
    """The function of websockets that serves, for admitted requests and frames of the page."""
    serve = websockets.asyncio.server.serve

    def connection(*arguments: Any, **options: Any) -> _Connection:
        made = _Connection(*arguments, **options)
        made.value_problem = value_problem
        return made

    def guarded(*arguments: Any, process_request: Any, **options: Any) -> Any:
        def admit(connection: ServerConnection, request: Request) -> Response | None:
            if reason := _refusal(request, token):
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"Refused: {reason}.\n")
            request.path = "/" + request.path.removeprefix(f"/{token}").removeprefix("/")
            response: Response | None = process_request(connection, request)
            if response is not None:
                response.headers["Content-Security-Policy"] = _policy(request.headers["Host"])
                response.headers["Referrer-Policy"] = "no-referrer"
            return response

        asyncio.get_running_loop().set_exception_handler(_log_failure)
        options |= {"max_size": _MAX_FRAME_SIZE, "logger": LOG, "create_connection": connection}
        return serve(*arguments, process_request=admit, **options)

    return guarded


def _log_failure(_: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Log what failed in the server in one line."""
    LOG.error("the page: %s", context["message"], exc_info=context.get("exception"))


def _in_one_line(record: logging.LogRecord) -> bool:
    """Name an exception in the message of a record, instead of its traceback."""
    if record.exc_info and record.exc_info[1] is not None:
        error = record.exc_info[1]
        text = f"{record.getMessage()}: {type(error).__name__}: {error}"
        record.msg, record.args, record.exc_info = printable(text), None, None
    return True


LOG.addFilter(_in_one_line)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Viser from printing on stdout, where it prints its addresses in any case."""
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
