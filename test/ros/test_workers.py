# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Workers that hang or die cost their goal: the node answers, and serves the next one."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import TypeVar

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, Vector3
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from support.arm import JOINTS, arm_primitive, arm_robot
from support.domains import set_domain
from support.nodes import (
    GOAL,
    START,
    URDF,
    NodeClient,
    column,
    described_client,
    goal_message,
    planner_of,
    running_node,
)
from support.patience import HANG
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.execution.link import (
    Planned,
    PlanRequest,
    Rejected,
    SetUp,
    SetUpDone,
    WorkerDied,
    WorldFacts,
)
from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.ros import worker as worker_module
from mp_pca_planner.ros.markers import Markers
from mp_pca_planner.ros.worker import PLANNER, TakeObstacles, WorkerProcess

T = TypeVar("T")


@pytest.fixture(scope="module")
def node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen[str]]:
    folder = tmp_path_factory.mktemp("workers")
    save_primitive(arm_primitive(), folder / "arm.npz")
    arguments = ["-p", f"primitives:=['{folder / 'arm.npz'}']", "-p", "state_timeout:=0.0"]
    with pytest.MonkeyPatch.context() as patch:
        set_domain(patch, 33)
        with running_node(folder / "log.txt", *arguments) as process:
            yield process


@pytest.fixture
def client(node: subprocess.Popen[str]) -> Iterator[NodeClient]:
    with described_client() as client:
        client.publish_state(JOINTS, START)
        client.call("stop", HANG)
        yield client


def serve(client: NodeClient) -> None:
    """Have a goal served, as soon as goals are."""
    for _ in range(100):
        answer = client.send(goal_message(GOAL), HANG)
        if answer.trajectory is not None:
            client.call("stop", HANG)
            np.testing.assert_array_equal(column(answer.trajectory, "positions")[-1], GOAL)
            return
        assert "send the goal again" in answer.report.message, answer.report.message
        client.wait_for_diagnostics(timeout=HANG)
    raise AssertionError(answer.report.message)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
def test_goal_whose_planner_dies_is_refused_with_the_reason_and_the_next_one_served(
    node: subprocess.Popen[str], client: NodeClient, number: signal.Signals
) -> None:
    serve(client)
    planner, n = planner_of(node), len(client.reports)
    os.kill(planner, signal.SIGSTOP)
    client.publish_goal(goal_message(GOAL))
    answer = client.call("stop", HANG)  # the planner hangs, and the node answers
    assert answer.success
    client.publish_goal(goal_message(GOAL))
    os.kill(planner, number)
    os.kill(planner, signal.SIGCONT)
    client.wait(lambda: len(client.reports) >= n + 2, HANG, "did not report")
    overtaken, refused = client.reports[n : n + 2]
    assert "preempted" in overtaken.message
    assert refused.level == DiagnosticStatus.ERROR
    assert "the planner has ended" in refused.message or "started again" in refused.message
    serve(client)


def test_planner_that_ignores_a_cancelled_goal_is_ended(
    node: subprocess.Popen[str], client: NodeClient
) -> None:
    serve(client)
    planner = planner_of(node)
    os.kill(planner, signal.SIGSTOP)
    client.publish_goal(goal_message(GOAL))
    assert client.call("stop", HANG).success
    client.wait_for_diagnostics(lambda values: int(values["worker_restarts"]) > 0, HANG)
    serve(client)
    assert planner_of(node) != planner


def test_parameter_whose_planner_dies_is_refused(
    node: subprocess.Popen[str], client: NodeClient
) -> None:
    serve(client)
    planner = planner_of(node)
    os.kill(planner, signal.SIGSTOP)
    value = Parameter("naturalness", value=0.3).to_parameter_msg()
    service = client._services["set_parameters"]
    changed = service.call_async(service.srv_type.Request(parameters=[value]))
    assert client.call("stop", HANG).success
    os.kill(planner, signal.SIGKILL)
    client.wait(changed.done, HANG, "did not answer")
    (result,) = changed.result().results
    assert not result.successful and "has ended while it was set up" in result.reason
    serve(client)


def test_goal_is_refused_if_the_limits_change_while_it_is_planned(
    node: subprocess.Popen[str], client: NodeClient
) -> None:
    serve(client)
    planner, n = planner_of(node), len(client.reports)
    os.kill(planner, signal.SIGSTOP)
    client.publish_goal(goal_message(GOAL))
    limit = Parameter("limits.elbow.max_velocity", value=0.5).to_parameter_msg()
    service = client._services["set_parameters"]
    changed = service.call_async(service.srv_type.Request(parameters=[limit]))
    assert client.call("stop", HANG).success  # while a parameter waits for the planner
    os.kill(planner, signal.SIGCONT)
    client.wait(changed.done, HANG, "did not set the parameter")
    (result,) = changed.result().results
    assert result.successful, result.reason
    client.wait(lambda: len(client.reports) > n, HANG, "did not report")
    answer = client.send(goal_message(GOAL), HANG)
    assert answer.trajectory is not None
    elbow = column(answer.trajectory, "velocities")[:, JOINTS.index("elbow")]
    assert np.abs(elbow).max() <= 0.5


# A worker by itself


@pytest.fixture
def workers(tmp_path: Path) -> Iterator[Callable[[], WorkerProcess]]:
    """Starts planners that are set up."""
    started = list[WorkerProcess]()
    save_primitive(arm_primitive(), tmp_path / "arm.npz")
    settings = Settings(primitives=(str(tmp_path / "arm.npz"),))

    def start() -> WorkerProcess:
        started.append(WorkerProcess(PLANNER, lambda: None))
        started[-1].send(SetUp(1, URDF, settings))
        assert not answer_of(started[-1], SetUpDone).problem
        return started[-1]

    yield start
    for worker in started:
        worker.close()


def answer_of(worker: WorkerProcess, kind: type[T]) -> T:
    deadline = time.monotonic() + HANG
    while time.monotonic() < deadline:
        for message in worker.receive():
            if isinstance(message, kind):
                return message
            assert not isinstance(message, WorkerDied), message.reason
        time.sleep(0.005)
    raise AssertionError(f"no {kind.__name__}")


def request(key: int) -> PlanRequest:
    return PlanRequest(key, JointGoal(JointState(JOINTS, GOAL)), JointState(JOINTS, START))


def test_worker_is_ended_if_it_ignores_a_cancelled_request_and_not_once_it_has_answered(
    workers: Callable[[], WorkerProcess], monkeypatch: pytest.MonkeyPatch
) -> None:
    worker, later = workers(), 0.0
    clock = SimpleNamespace(monotonic=lambda: time.monotonic() + later, time=time.time)
    monkeypatch.setattr(worker_module, "time", clock)
    worker.send(request(1))
    answer_of(worker, Planned)
    later = 1000.0
    worker.check()
    worker.send(request(2))
    answer_of(worker, Planned)
    os.kill(worker.pid, signal.SIGSTOP)
    worker.send(request(3))
    later += 1.9
    worker.check()
    worker.cancel(3)
    later += 1.9
    worker.check()
    later += 0.2
    worker.check()
    assert answer_of_end(worker) == "it did not answer in time"


def answer_of_end(worker: WorkerProcess) -> str:
    with pytest.raises(AssertionError) as end:
        answer_of(worker, Planned)
    return str(end.value).splitlines()[0]


def test_obstacles_of_one_worker_are_avoided_by_another(
    workers: Callable[[], WorkerProcess],
) -> None:
    first, second = workers(), workers()
    robot = arm_robot()
    x, y, z = robot.frame_positions(np.array([GOAL]), [robot.frame_names[-1]])[0, 0].tolist()
    ball = Marker(ns="ball", type=Marker.SPHERE, scale=Vector3(x=0.1, y=0.1, z=0.1))
    ball.pose.position = Point(x=x, y=y, z=z)
    content = bytes(serialize_message(MarkerArray(markers=[ball])))
    first.send(Markers(content, 1, False, 0.0))
    first.send(TakeObstacles())
    second.send(answer_of(first, TakeObstacles))
    assert answer_of(second, WorldFacts).n_obstacles == 1
    second.send(request(1))
    assert "ball" in answer_of(second, Rejected).reason
