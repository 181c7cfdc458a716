# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The thread that answers ``~/stop``, over the middleware, with stops that are only counted."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (extra 'ros') is not installed")

from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from std_srvs.srv import Trigger
from support.domains import set_domain
from support.nodes import ros_node
from support.patience import HANG

from mp_pca_planner.ros.nodes import GuardedNode
from mp_pca_planner.ros.safety_thread import SafetyThread


class Goals:
    """Counts stops. While the first one is found, a second request comes."""

    def __init__(self, ask, is_successful, stays):
        self._ask, self._is_successful, self._stays = ask, is_successful, stays
        self.n_stops = 0

    def stop(self, _, response):
        self.n_stops += 1
        if self.n_stops == 1:
            self._ask()
        response.success, response.message = self._is_successful, f"stop {self.n_stops}"
        return response

    def stays_stopped(self):
        return self._stays


@pytest.mark.parametrize(
    ("is_successful", "stays", "words"),
    [
        (True, True, ["stop 1", "stop 1"]),
        (True, False, ["stop 1", "stop 2"]),  # a goal moved the robot meanwhile
        (False, True, ["stop 1", "stop 2"]),
    ],
)
def test_request_that_comes_while_a_stop_is_found_is_answered_with_it(
    monkeypatch, is_successful, stays, words
):
    set_domain(monkeypatch, 90)
    later = []
    with ros_node("planner", GuardedNode) as node, ros_node("user") as user:
        client = user.create_client(Trigger, "/planner/stop")

        def ask_again():
            later.append(client.call_async(Trigger.Request()))
            # Until it has come; the thread that answers is this one.
            (service,) = (one for one in node.services if one.service_name == "/planner/stop")
            waiting = rclpy_implementation.WaitSet(0, 0, 0, 0, 1, 0, node.context.handle)
            waiting.add_service(service.handle)
            waiting.wait(round(1e9 * HANG))

        goals = Goals(ask_again, is_successful, stays)
        nothing = SimpleNamespace(
            poll=lambda: None,
            watch=lambda *_: None,
            last_context=None,
            surroundings=SimpleNamespace(threat=None),
        )
        thread = SafetyThread(node, nothing, nothing, nothing, goals, nothing)
        executor = SingleThreadedExecutor(context=user.context)
        executor.add_node(user)
        try:
            assert client.wait_for_service(HANG)
            first = client.call_async(Trigger.Request())
            deadline = time.monotonic() + HANG
            while not (first.done() and later and later[0].done()):
                assert time.monotonic() < deadline, "not answered"
                executor.spin_once(0.1)
        finally:
            thread.close()
            executor.shutdown()
    assert [first.result().message, later[0].result().message] == words
    assert goals.n_stops == len(set(words))
