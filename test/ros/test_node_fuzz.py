# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A short run of `test/campaigns/node_fuzz.py`: anything that ROS can send, to every input."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from campaigns.node_fuzz import Fuzzer
from support.domains import set_domain
from support.nodes import PATIENCE, arm_node, described_client


@pytest.mark.slow
def test_good_goals_are_served_after_garbage_and_odd_values_on_every_input(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    set_domain(monkeypatch, 37)
    with (
        arm_node(**PATIENCE | {"max_solve_time": 0.05}) as (node, folder),
        described_client() as client,
    ):
        fuzzer = Fuzzer(node, client)
        fuzzer.send_garbage(60)
        fuzzer.send_too_much()
        fuzzer.send_odd_states(20)
        fuzzer.set_odd_values(share=25)
        assert "internal error" not in (folder / "log.txt").read_text()
