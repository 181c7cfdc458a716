# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Who may open the page, and what a browser may send: asked by real HTTP and WebSocket clients."""

import http.client
import logging
import random
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

import pytest
from support.arm import arm_primitive
from support.patience import HANG

pytest.importorskip("viser", reason="the extra 'view' is not installed")

import msgspec
import viser
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from mp_pca_planner.files import config_file
from mp_pca_planner.view.content import LiveView, NodeStatus, read_content
from mp_pca_planner.view.page import ViewPage
from mp_pca_planner.view.server import PageServer, frame_problem

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1, 0.0, 0.0, 0.0],
    "position": [1.0, 2.0, 3.0],
    "fov": 0.8,
    "near": 0.01,
    "far": 100,
    "image_height": 600,
    "image_width": 800,
    "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0.0, 0.0, 1.0],
}


@pytest.fixture(scope="module")
def local() -> Iterator[PageServer]:
    server = PageServer("127.0.0.1", 0)
    yield server
    server.stop()


@pytest.fixture(scope="module")
def public() -> Iterator[PageServer]:
    server = PageServer("0.0.0.0", 0)
    yield server
    server.stop()


def until(holds: Callable[[], object]) -> None:
    deadline = time.monotonic() + HANG
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def token(server: PageServer) -> str:
    return server.url.rstrip("/").rpartition("/")[2]


def opened(server: PageServer, origin: str | None, path: str = "", host: str = "") -> None:
    """Connect as a browser does that shows a page of an origin, and close."""
    port = server.get_port()
    address = f"ws://{host or '127.0.0.1'}:{port}/{path}"
    connected(address, origin, port).close()


def connected(address: str, origin: str | None, port: int) -> ClientConnection:
    return connect(
        address,
        origin=None if origin is None else Origin(origin.format(port=port)),
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
        sock=socket.create_connection(("127.0.0.1", port), HANG),
        max_queue=None,
    )


def fetched(
    server: PageServer, path: str, headers: dict[str, str]
) -> tuple[int, str, http.client.HTTPMessage]:
    client = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=HANG)
    client.putrequest("GET", path, skip_host="Host" in headers)
    for name, value in headers.items():
        client.putheader(name, value)
    client.endheaders()
    response = client.getresponse()
    return response.status, response.read().decode(errors="replace"), response.headers


# A page of this machine only


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost", "LOCALHOST", "[::1]"])
def test_the_own_page_connects_by_every_name_of_this_machine(local, name):
    opened(local, f"http://{name}:{{port}}", host=name)


@pytest.mark.parametrize(
    "origin",
    [
        "https://example.org",
        "http://127.0.0.1:1",  # another port of this machine is another origin
        "http://127.0.0.1",
        "http://localhost:{port}",  # the page was asked for as 127.0.0.1
        "http://127.0.0.1:{port}.example.org",
        "http://127.0.0.1:{port}@example.org",
        "ftp://127.0.0.1:{port}",
        "null",
        "",
        None,
    ],
)
def test_no_other_origin_connects(local, origin):
    with pytest.raises(InvalidStatus, match="403"):
        opened(local, origin)


def test_a_site_whose_name_resolves_to_this_machine_gets_nothing(local):
    with pytest.raises(InvalidStatus, match="403"):
        opened(local, "http://evil.example:{port}", host="evil.example")
    status, text, _ = fetched(local, "/", {"Host": f"evil.example:{local.get_port()}"})
    assert (status, text.count("\n")) == (403, 1) and "localhost" in text


@pytest.mark.parametrize("host", ["", "a b", "x'; script-src *", "localhost:8080, evil", "["])
def test_a_malformed_host_is_refused(local, host):
    assert fetched(local, "/", {"Host": host})[0] == 403


def test_the_page_may_connect_to_its_own_server_only_and_is_shown_in_no_frame(local):
    # Viser's page would connect to ws://evil, which could then run scripts in the page.
    status, _, headers = fetched(local, "/?websocket=ws://evil.example", {})
    (connections,) = [
        part for part in headers["Content-Security-Policy"].split("; ") if "connect" in part
    ]
    host = f"127.0.0.1:{local.get_port()}"
    assert status == 200
    assert connections == f"connect-src 'self' ws://{host} wss://{host} data: blob:"
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]


# A page that other machines reach


def test_a_public_page_has_an_address_that_nobody_guesses(public, local):
    other = PageServer("0.0.0.0", 0)
    other.stop()
    assert len(token(public)) >= 20 and token(other) != token(public)
    assert local.url == f"http://127.0.0.1:{local.get_port()}"


@pytest.mark.parametrize("name", ["robot", "192.168.1.7", "127.0.0.1", "localhost"])
def test_a_public_page_is_opened_with_its_token_only(public, name):
    headers = {"Host": f"{name}:{public.get_port()}"}
    good = token(public)
    page, status = fetched(public, f"/{good}/", headers)[1], 403
    assert "<title>" in page and fetched(public, f"/{good}", headers)[0] == 200
    wrong = ["", good[:-1], good + "x", good.swapcase(), f"x/{good}", f"?{good}", "%00"]
    for path in wrong:
        assert fetched(public, f"/{path}", headers)[0] == status


def test_a_public_page_connects_with_token_and_own_origin_only(public):
    own, foreign = "http://robot:{port}", "https://example.org"
    opened(public, own, token(public), "robot")
    opened(public, own.replace("http", "https"), token(public), "robot")  # behind a proxy
    for origin, path in ((own, ""), (own, "x" * 22), (foreign, token(public)), (None, "")):
        with pytest.raises(InvalidStatus, match="403"):
            opened(public, origin, path, "robot")


# What a browser may send


def frames(seed: int) -> Iterator[bytes | str]:
    """Frames that no page sends."""
    rng = random.Random(seed)
    good = msgspec.msgpack.encode(CAMERA)
    yield from ("text", b"", b"\xc1", b"\x91" * 5000, b"\xdf\xff\xff\xff\xff")
    for _ in range(40):
        yield rng.randbytes(rng.randrange(1, 200))
        yield good[: rng.randrange(len(good))]
    handle = {"type": "TransformControlsUpdateMessage", "name": "/handle", "position": [0, 0, 0]}
    for odd in (
        3,
        [],
        {},
        {"type": 3},
        {"type": "Message"},
        {"type": "RemoveSceneNodeMessage", "name": "/robot"},
        {"type": "ShareUrlRequest"},
        {"type": "FileTransferStartUpload", "source_component_uuid": "x", "transfer_uuid": "y"},
        {"type": "FileTransferPart", "transfer_uuid": "y", "part": 0, "content": b"x"},
        {"type": "GuiUpdateMessage", "uuid": "x", "updates": {"removed": True}},
        {"type": "GuiUpdateMessage", "uuid": "x", "updates": {"value": 1, "update_cb": [1]}},
        {"type": "GuiUpdateMessage", "uuid": "x", "updates": {"value": float("nan")}},
        {"type": "GuiUpdateMessage", "uuid": "x", "updates": {"value": [1]}},
        {"type": "GuiUpdateMessage", "uuid": "x", "updates": {"value": "y" * 2000}},
        {"type": "GuiUpdateMessage", "uuid": 3, "updates": {"value": 1}},
        {**CAMERA, "position": [1.0, 2.0]},
        {**CAMERA, "position": [1.0, 2.0, "3"]},
        {**CAMERA, "fov": float("inf")},
        {**CAMERA, "image_width": 2**70},
        {**handle, "wxyz": [float("nan"), 0, 0, 0]},
        {**handle, "wxyz": None},
        handle,
    ):
        yield encoded(odd)


def any_value(_: str, __: object) -> str:
    return ""


def encoded(value: object) -> bytes:
    try:
        return msgspec.msgpack.encode(value)
    except OverflowError:  # beyond what the format holds
        return b"\xcf" + b"\xff" * 8


def test_frames_of_the_page_are_taken_and_no_others():
    assert frame_problem(msgspec.msgpack.encode(CAMERA), any_value) == ""
    for value in (True, 1, 0.5, "a choice"):
        widget = {"type": "GuiUpdateMessage", "uuid": "x", "updates": {"value": value}}
        assert frame_problem(msgspec.msgpack.encode(widget), any_value) == ""
    odd = list(frames(0))
    assert len(odd) > 100 and all(frame_problem(frame, any_value) for frame in odd)


def test_frames_of_no_page_are_one_line_and_the_page_goes_on(local, caplog, capfd):
    """112 of them were 112 tracebacks; an upload could fill the memory through any widget."""
    address = local.url.replace("http", "ws")
    slider = local.gui.add_slider("x", 0.0, 1.0, 0.1, 0.5)
    with caplog.at_level(logging.WARNING), connected(address, local.url, local.get_port()) as peer:
        for frame in frames(1):
            peer.send(frame)
        upload = {
            "type": "FileTransferStartUpload",
            "source_component_uuid": slider._impl.uuid,
            "transfer_uuid": "y",
            "filename": "f",
            "mime_type": "",
            "part_count": 2,
            "size_bytes": 10,
        }
        peer.send(msgspec.msgpack.encode(upload))
        widget = {"type": "GuiUpdateMessage", "uuid": slider._impl.uuid, "updates": {"value": 0.7}}
        peer.send(msgspec.msgpack.encode(widget))
        deadline = time.monotonic() + HANG
        while slider.value != 0.7:
            assert time.monotonic() < deadline
            time.sleep(0.01)
    assert local.gui._current_file_upload_states == {}
    (record,) = [one for one in caplog.records if "no frame of the page" in one.getMessage()]
    assert "127.0.0.1" in record.getMessage() and "\n" not in record.getMessage()
    assert "Traceback" not in capfd.readouterr().err
    slider.remove()


@pytest.mark.parametrize(
    "request_",
    [b"\x16\x03\x01\x00\n\n", b"GET / HTTP/1.1\r\n\xff:\r\n\r\n", b"GET /\xff HTTP/9\r\n\r\n"],
)
def test_what_is_no_request_is_no_traceback(local, caplog, request_):
    with (
        caplog.at_level(logging.WARNING),
        socket.create_connection(("127.0.0.1", local.get_port()), HANG) as peer,
    ):
        peer.sendall(request_)
        while answer := peer.recv(1000):
            assert b" 101 " not in answer
    assert all(one.exc_info is None for one in caplog.records)
    assert not any("\n" in one.getMessage() for one in caplog.records)


def test_a_frame_of_megabytes_ends_its_connection(local):
    address = local.url.replace("http", "ws")
    with connected(address, local.url, local.get_port()) as peer:
        with suppress(ConnectionClosed):
            peer.send(b"x" * (1 << 21))
            for _ in peer:
                pass
        assert peer.close_code == 1009


def test_a_foreign_site_cannot_arm_the_page(local):
    """The robot moves for pages of this server only: here, a click in one of them arms it."""

    class Link:
        def view(self) -> LiveView:
            return LiveView(diagnostics=NodeStatus(0, "ready", {}, time.monotonic()))

        def send_goal(self, positions: object) -> None:
            raise AssertionError("no goal was sent")

        def stop(self) -> str:
            return "stopped"

    content = read_content(config_file("human_arm.urdf"), [arm_primitive()])
    with ViewPage(content, port=0, link=Link()) as page:
        assert page.live is not None
        armed = page.live._armed
        port, address = page.server.get_port(), page.url.replace("http", "ws")
        click = {"type": "GuiUpdateMessage", "uuid": armed._impl.uuid, "updates": {"value": True}}
        for origin in ("https://example.org", f"http://127.0.0.1:{port + 1}", None):
            with pytest.raises(InvalidStatus, match="403"):
                connected(address, origin, port)
        assert not armed.value
        with connected(address, page.url, port) as peer:
            peer.send(msgspec.msgpack.encode(click))
            deadline = time.monotonic() + HANG
            while not armed.value:
                assert time.monotonic() < deadline
                time.sleep(0.01)


def test_no_widget_gets_a_value_that_it_does_not_offer_and_the_page_goes_on(caplog, capfd):
    content = read_content(config_file("human_arm.urdf"), [arm_primitive()])
    with ViewPage(content, port=0) as page, caplog.at_level(logging.WARNING):
        page.player.play(False)
        handles = page.server.gui._gui_input_handle_from_uuid
        address, odd = page.url.replace("http", "ws"), ("zzz", -1e8, 1e8, True, 0.3)
        with connected(address, page.url, page.server.get_port()) as peer:
            peer.send(msgspec.msgpack.encode(CAMERA))
            until(page.server.get_clients)
            for uuid in list(handles):
                for value in odd:
                    update = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}
                    peer.send(msgspec.msgpack.encode(update))
            peer.ping().wait(HANG)

            def is_planned() -> bool:  # clicks may still be worked off, and ask for other plans
                page.plan._on_reset()
                until(lambda: page.plan.is_settled)
                return page.plan.goal is not None

            until(is_planned)
        for handle in list(handles.values()):
            assert handle.value in getattr(handle, "options", [handle.value])
            if hasattr(handle, "min"):
                assert handle.min <= handle.value <= handle.max
    (record,) = caplog.records  # one for all
    assert "zzz" in record.getMessage() and "\n" not in record.getMessage()
    assert capfd.readouterr().err == ""
