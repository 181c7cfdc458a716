# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The web server of the page, which serves this machine only unless the host says otherwise."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any
from unittest import mock

import rich
import viser
import websockets.asyncio.server

from ..arrays import check_number
from ..exceptions import PlannerError

LOCAL_HOSTS = ("127.0.0.1", "localhost", "::1")

# Pages that may connect to a server of this machine only: its own. Browsers let every site open
# websockets to this machine; without this check, any site could move the handle.
_LOCAL_ORIGIN = re.compile(r"http://(127\.0\.0\.1|localhost|\[::1\])(:\d+)?")


class PageServer(viser.ViserServer):
    """A server that other sites can't connect to, and that no page can open to the internet.

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
        serve: Any = websockets.asyncio.server.serve
        if self.is_local:
            serve = partial(serve, origins=[_LOCAL_ORIGIN])
        # Viser has no option for this; its server is up when its constructor returns.
        with mock.patch.object(websockets.asyncio.server, "serve", serve), _quiet():
            super().__init__(host, port, label="mp_pca_planner", verbose=False)

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse a public address, which any client of Viser may request."""
        return None

    def stop(self) -> None:
        """Stop the server and its threads."""
        with _quiet():
            super().stop()

    @property
    def url(self) -> str:
        """Address of the page."""
        host = self.get_host()
        shown = socket.gethostname() if host in ("0.0.0.0", "::") else host
        return f"http://{f'[{shown}]' if ':' in shown else shown}:{self.get_port()}"


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Viser from printing on stdout, where it prints its addresses in any case."""
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
