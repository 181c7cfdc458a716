# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Callbacks that raise end nothing, and every request is answered in one printable sentence."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import cycle

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.task import Future
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from support.domains import set_domain
from support.nodes import ros_node
from support.patience import HANG

from mp_pca_planner.exceptions import GoalError
from mp_pca_planner.ros.nodes import GuardedNode

ERRORS = (
    ValueError("a defect"),
    MemoryError(),
    RecursionError("too deep"),
    OSError(36, "File name too long", "x" * 5000),
    GoalError("refused:\n\x1b[31m" + "x" * 5000),
)


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Iterator[GuardedNode]:
    set_domain(monkeypatch, 91)
    with ros_node("guarded", GuardedNode) as node:
        yield node


@pytest.fixture
def spin(node: GuardedNode) -> Iterator[Callable[[Future], None]]:
    """Runs the callbacks of the guarded node until something is done."""
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    yield lambda future: executor.spin_until_future_complete(future, HANG)
    executor.shutdown()


class Raising:
    """A callback that raises one error after the other."""

    def __init__(self) -> None:
        self.calls, self._errors = Future(), cycle(ERRORS)
        self._n_calls = 0

    def __call__(self, *_: object) -> None:
        self._n_calls += 1
        if self._n_calls == 2 * len(ERRORS):
            self.calls.set_result(None)
        raise next(self._errors)


def test_timer_whose_callback_raises_goes_on(
    node: GuardedNode, spin: Callable[[Future], None]
) -> None:
    raising = Raising()
    node.create_timer(1e-3, raising)
    spin(raising.calls)
    assert raising.calls.done()


def test_subscription_whose_callback_raises_goes_on(
    node: GuardedNode, spin: Callable[[Future], None]
) -> None:
    raising = Raising()
    node.create_subscription(Float64, "number", raising, 10)
    publisher = node.create_publisher(Float64, "number", 10)
    node.create_timer(1e-3, lambda: publisher.publish(Float64()))
    spin(raising.calls)
    assert raising.calls.done()


@pytest.mark.parametrize("error", ERRORS)
def test_service_whose_callback_raises_says_why_in_a_line(
    node: GuardedNode, spin: Callable[[Future], None], error: Exception
) -> None:
    def fail(*_: object) -> Trigger.Response:
        raise error

    node.create_service(Trigger, "fail", fail)
    client = node.create_client(Trigger, "fail")
    assert client.wait_for_service(HANG)
    future = client.call_async(Trigger.Request())
    spin(future)
    answer = future.result()
    assert not answer.success
    assert 0 < len(answer.message) <= 1100
    assert answer.message.isprintable()


def test_parameter_of_a_type_that_ros_does_not_have_gets_an_answer(
    node: GuardedNode, spin: Callable[[Future], None]
) -> None:
    client = node.create_client(SetParameters, "guarded/set_parameters")
    assert client.wait_for_service(HANG)
    odd = Parameter(name="use_sim_time", value=ParameterValue(type=200))
    future = client.call_async(SetParameters.Request(parameters=[odd]))
    spin(future)
    assert future.done()
    assert not any(result.successful for result in future.result().results)
