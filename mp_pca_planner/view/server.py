# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The web server of the page, which this machine alone reaches."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import rich
import viser

_HOST = "127.0.0.1"


class PageServer(viser.ViserServer):
    """A server for browsers on this machine.

    Parameters
    ----------
    port : int
        Port, or the first free one after it; 0: any free one.
    """

    def __init__(self, port: int) -> None:
        with _quiet():
            super().__init__(_HOST, port, label="mp_pca_planner", verbose=False)

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
        return f"http://{_HOST}:{self.get_port()}"


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep Viser from printing on stdout, where it prints its addresses in any case."""
    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
