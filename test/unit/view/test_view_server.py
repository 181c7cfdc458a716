# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Where the page listens."""

import socket

import pytest

pytest.importorskip("viser", reason="the extra 'view' is not installed")

from mp_pca_planner.view.server import PageServer


def test_only_this_machine_reaches_the_page_and_a_used_port_is_passed_over(capfd):
    with socket.create_server(("127.0.0.1", 0)) as used:
        server = PageServer(used.getsockname()[1])
        try:
            assert server.get_host() == "127.0.0.1"
            assert server.get_port() > used.getsockname()[1]
            assert server.url == f"http://127.0.0.1:{server.get_port()}"
            assert server.request_share_url() is None
        finally:
            server.stop()
    assert capfd.readouterr().out == ""
