# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A worker by itself: it is ended where it hangs, and hands its obstacles on."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import TypeVar

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from geometry_msgs.msg import Point, Vector3
from rclpy.serialization import serialize_message
from support.arm import JOINTS, URDF, arm_primitive, arm_robot
from support.nodes import GOAL, START
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
from mp_pca_planner.ros import workers as worker_module
from mp_pca_planner.ros.markers import Markers
from mp_pca_planner.ros.worker import PLANNER, TakeObstacles
from mp_pca_planner.ros.workers import WorkerProcess

T = TypeVar("T")


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
    clock = SimpleNamespace(
        monotonic=lambda: time.monotonic() + 5.0 * later, clock_gettime=time.clock_gettime
    )
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
    first.send(request(1))  # what comes meanwhile waits
    first.send(Markers(content, 1, False))
    first.send(TakeObstacles())
    second.send(answer_of(first, TakeObstacles))
    assert answer_of(second, WorldFacts).n_obstacles == 1
    second.send(request(1))
    assert "ball" in answer_of(second, Rejected).reason


def test_goal_is_answered_while_obstacles_keep_coming(
    workers: Callable[[], WorkerProcess],
) -> None:
    worker, stamps = workers(), count(1)
    boxes = [Marker(id=k, type=Marker.CUBE) for k in range(1000)]
    for one in boxes:
        one.scale.x = one.scale.y = one.scale.z = 0.01
        one.pose.position.z = 3.0
    content = bytes(serialize_message(MarkerArray(markers=boxes)))
    worker.send(request(1))
    deadline = time.monotonic() + 5.0
    while time.monotonic() < deadline:
        if worker.backlog < 5:
            worker.send(Markers(content, next(stamps), False))
        answers = [one for one in worker.receive() if isinstance(one, Planned | Rejected)]
        if answers:
            return
        time.sleep(0.002)
    raise AssertionError("no answer")
