# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What one node's parameters are, written to a file, makes another node like it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

import yaml
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from support.arm import arm_primitive
from support.domains import set_domain
from support.nodes import URDF, call, ros_node, running_node

from mp_pca_planner.primitives.file import save_primitive

pytestmark = pytest.mark.slow


def dumped(caller: Node) -> dict[str, Any]:
    """All parameters by name, as ``ros2 param dump`` asks for them."""
    there = "/mp_pca_planner"
    listed = call(caller, ListParameters, f"{there}/list_parameters", ListParameters.Request())
    request = GetParameters.Request(names=listed.result.names)
    values = call(caller, GetParameters, f"{there}/get_parameters", request).values
    converted = [parameter_value_to_python(value) for value in values]
    return dict(zip(listed.result.names, converted, strict=True))


def test_parameters_written_to_a_file_make_the_next_node_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_domain(monkeypatch, 62)
    save_primitive(arm_primitive(), tmp_path / "arm.npz")
    file = tmp_path / "parameters.yaml"
    values: dict[str, Any] = {
        "primitives": [str(tmp_path / "arm.npz")],
        "robot_description": URDF,
        "limits.elbow.max_velocity": 0.7,
        "duration": 2.5,
        "publish_effort": True,
        "start_from": "commanded",
    }
    for name in ("first", "second"):
        content = {"/mp_pca_planner": {"ros__parameters": values}}
        file.write_text(yaml.safe_dump(content), encoding="utf-8")
        with (
            running_node(tmp_path / f"{name}.txt", "--params-file", str(file)),
            ros_node("caller") as caller,
        ):
            found = dumped(caller)
        assert found.items() >= values.items()
        values = found
