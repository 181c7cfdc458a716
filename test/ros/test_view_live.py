# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The page beside a real node, in a real browser: what it shows, sends and stops."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")
pytest.importorskip("viser", reason="the extra 'view' is not installed")
pytest.importorskip("playwright", reason="playwright is not installed")

from playwright.sync_api import expect
from support.arm import JOINTS, arm_primitive
from support.domains import set_domain
from support.nodes import (
    PATIENTLY,
    START,
    NodeClient,
    described_client,
    running_node,
)
from support.patience import HANG
from view_browser import SIZE, chromium, chromium_path
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.files import config_file
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.ros.live_node import LiveNode
from mp_pca_planner.ros.nodes import LATCHED
from mp_pca_planner.view.content import read_content
from mp_pca_planner.view.page import ViewPage

if chromium_path() is None:
    pytest.skip("chromium is not installed (apt-get install chromium)", allow_module_level=True)


def until(holds: Callable[[], Any], client: NodeClient | None = None) -> None:
    """Wait until a condition holds, while a client plays a robot at rest."""
    deadline = time.monotonic() + HANG
    while not holds():
        assert time.monotonic() < deadline
        if client is not None:
            client.publish_state(JOINTS, START)
        time.sleep(0.05)


def test_the_node_is_shown_gets_goals_only_when_armed_stops_and_its_death_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_domain(monkeypatch, 35)
    save_primitive(arm_primitive(), tmp_path / "arm.npz")
    arguments = ("-p", f"primitives:=['{tmp_path / 'arm.npz'}']", *PATIENTLY)
    content = read_content(config_file("human_arm.urdf"), [arm_primitive()])
    with (
        LiveNode() as link,
        ViewPage(content, port=0, link=link) as page,
        chromium() as browser,
    ):
        live = page.live
        assert live is not None
        page.player.play(False)
        tab = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
        tab.set_default_timeout(1e3 * HANG)
        tab.goto(page.url)
        tab.get_by_role("button", name="Live", exact=True).click()
        tab.get_by_text("No node yet").wait_for()
        send = tab.get_by_role("button", name="Send the goal")
        armed = tab.get_by_role("checkbox", name="Armed")
        with running_node(tmp_path / "first.txt", *arguments), described_client() as client:
            until(lambda: live.start is not None, client)
            tab.get_by_text("ready for goals").wait_for()
            np.testing.assert_allclose(live.start, START)
            expect(send).to_be_disabled()
            live.send(np.array(START))
            armed.check()
            until(lambda: page.plan.goal is not None)
            send.click()
            until(lambda: live.view.motion is not None, client)
            np.testing.assert_allclose(live.view.motion.positions[-1], page.plan.goal, atol=1e-9)
            until(lambda: client.trajectories or client.spin_once())
            assert len(client.trajectories) == 1  # nothing was sent before the page was armed
            tab.get_by_text("Plan, ").wait_for()
            marker = Marker(ns="test", id=1, type=Marker.CUBE)
            marker.scale.x = marker.scale.y = marker.scale.z = 0.1
            marker.pose.position.x = 2.0
            topic = f"{client.planner}/obstacles"
            publisher = client.node.create_publisher(MarkerArray, topic, LATCHED)
            publisher.publish(MarkerArray(markers=[marker]))
            tab.get_by_text("test/1").first.wait_for()
            publisher.publish(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
            until(lambda: live.view.world.names == ())
            tab.get_by_role("button", name="Stop the robot").click()
            until(lambda: len(client.trajectories) > 1 or client.spin_once())
            expect(armed).not_to_be_checked(timeout=1e3 * HANG)
            armed.check()
        tab.get_by_text("The node is gone").wait_for()
        expect(armed).not_to_be_checked(timeout=1e3 * HANG)
        expect(send).to_be_disabled(timeout=1e3 * HANG)
        with running_node(tmp_path / "second.txt", *arguments), described_client() as client:
            until(lambda: live.view.has_node(time.monotonic()), client)
            tab.get_by_text("The node is gone").wait_for(state="detached")
        tab.close()
