# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Topics and services in files of ``config/`` are those that the running node has."""

from __future__ import annotations

import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

import yaml
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from support.domains import set_domain
from support.nodes import ros_node, running_node
from support.patience import HANG
from visualization_msgs.msg import MarkerArray

from mp_pca_planner.files import config_file

NAME, NAMESPACE = "mp_pca_planner", "/"
Rights = dict[str, set[str]]


@pytest.fixture
def onlooker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, control_msgs: ModuleType
) -> Iterator[Node]:
    """A node beside a planner that has all topics that it may have."""
    set_domain(monkeypatch, 12)
    with (
        running_node(tmp_path / "log.txt", "-p", "use_sim_time:=true"),
        ros_node("onlooker") as node,
    ):
        # The planner subscribes to obstacles once somebody publishes them.
        node.create_publisher(MarkerArray, f"/{NAME}/obstacles", 1)
        yield node


def real_names(onlooker: Node) -> Rights:
    """What the node publishes, subscribes, serves and calls; nothing if it isn't known yet."""
    if (NAME, NAMESPACE) not in onlooker.get_node_names_and_namespaces():
        return {}
    found = {
        "publish": onlooker.get_publisher_names_and_types_by_node(NAME, NAMESPACE),
        "subscribe": onlooker.get_subscriber_names_and_types_by_node(NAME, NAMESPACE),
        "reply": onlooker.get_service_names_and_types_by_node(NAME, NAMESPACE),
        "request": onlooker.get_client_names_and_types_by_node(NAME, NAMESPACE),
    }
    return {right: {name for name, _ in names} for right, names in found.items()}


def allowed_names() -> Rights:
    """What the policy allows."""
    rights: Rights = {right: set() for right in ("publish", "subscribe", "reply", "request")}
    root = ET.parse(config_file("sros2_policy.xml")).getroot()
    (enclave,) = root.findall("enclaves/enclave")
    (profile,) = enclave.findall("profiles/profile")
    assert (profile.get("ns"), profile.get("node")) == (NAMESPACE, NAME)
    for group in profile:
        for right, verdict in group.items():
            assert verdict == "ALLOW"
            for entry in group:
                assert entry.text is not None
                name = entry.text.replace("~", f"/{NAME}")
                rights[right].add(name if name.startswith("/") else f"/{name}")
    return rights


def displays() -> dict[str, Any]:
    """Displays of the RViz configuration by their class."""
    content = yaml.safe_load(config_file("planner.rviz").read_text(encoding="utf-8"))
    shown = content["Visualization Manager"]["Displays"]
    return {display["Class"].rpartition("/")[2]: display for display in shown}


@pytest.mark.slow
def test_policy_allows_what_the_node_does_and_rviz_shows_what_it_publishes(onlooker: Node) -> None:
    executor = SingleThreadedExecutor(context=onlooker.context)
    executor.add_node(onlooker)
    deadline = time.monotonic() + HANG
    # They become known one by one.
    while real_names(onlooker) != allowed_names() and time.monotonic() < deadline:
        executor.spin_once(0.05)
    assert real_names(onlooker) == allowed_names()
    preview = displays()["MarkerArray"]["Topic"]
    (publisher,) = onlooker.get_publishers_info_by_topic(preview["Value"])
    assert publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert preview["Durability Policy"] == "Transient Local"
    description = displays()["RobotModel"]["Description Topic"]
    assert description["Value"] in allowed_names()["subscribe"]
    assert description["Durability Policy"] == "Transient Local"
