# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A worker by itself: it is ended where it hangs, and hands its obstacles on."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from geometry_msgs.msg import Point, Vector3
from rclpy.serialization import serialize_message
from support.arm import GRIPPER_URDF, JOINTS, URDF, arm_primitive, arm_robot
from support.nodes import GOAL, START
from support.patience import HANG
from visualization_msgs.msg import Marker, MarkerArray

from mp_pca_planner.execution.link import (
    ModelFacts,
    Place,
    Planned,
    PlanRequest,
    Positions,
    Rejected,
    SetUp,
    SetUpDone,
    WatchedRobot,
    WorkerDied,
    WorldFacts,
)
from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.ros import workers as worker_module
from mp_pca_planner.ros.markers import Markers
from mp_pca_planner.ros.worker import PLANNER, WATCHER
from mp_pca_planner.ros.workers import WorkerProcess, Workers

T = TypeVar("T")


@pytest.fixture
def workers(tmp_path: Path) -> Iterator[Callable[[], WorkerProcess]]:
    """Starts planners that are set up."""
    started = list[WorkerProcess]()
    save_primitive(arm_primitive(), tmp_path / "arm.npz")
    settings = Settings(primitives=(str(tmp_path / "arm.npz"),))

    def start(urdf: str = URDF) -> WorkerProcess:
        started.append(WorkerProcess(PLANNER, lambda: None))
        started[-1].send(SetUp(1, urdf, settings))
        assert not answer_of(started[-1], SetUpDone).problem
        return started[-1]

    yield start
    for worker in started:
        worker.close()


def heard_until(worker: WorkerProcess, kind: type[T]) -> list[Any]:
    """What a worker says up to its first message of a kind, and what comes with that."""
    heard, deadline = list[Any](), time.monotonic() + HANG
    while not any(isinstance(message, kind) for message in heard):
        ends = [message for message in heard if isinstance(message, WorkerDied)]
        assert not ends, ends[0].reason
        assert time.monotonic() < deadline, f"no {kind.__name__}"
        time.sleep(0.005)
        heard += worker.receive()
    return heard


def answer_of(worker: WorkerProcess, kind: type[T]) -> T:
    return next(one for one in heard_until(worker, kind) if isinstance(one, kind))


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
    os.kill(worker.pid, signal.SIGSTOP)
    worker.send(SetUp(2, "", Settings()))
    worker.send(request(2))
    later += 30.0  # a request that waits for a set-up is not late
    worker.check()
    os.kill(worker.pid, signal.SIGCONT)
    answer_of(worker, Rejected)
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


def test_node_hears_where_a_gripper_is_although_its_goal_is_rejected(
    workers: Callable[[], WorkerProcess], tmp_path: Path
) -> None:
    worker, settings = workers(), Settings(primitives=(str(tmp_path / "arm.npz"),))
    worker.send(SetUp(2, GRIPPER_URDF, settings, {"finger": 0.02}))
    assert answer_of(worker, SetUpDone).model is not None
    far = JointGoal(JointState(JOINTS, [9.0] * len(JOINTS)))
    worker.send(PlanRequest(1, far, JointState(JOINTS, START), {"finger": 0.08}))
    heard = heard_until(worker, Rejected)
    (facts,) = (message for message in heard if isinstance(message, ModelFacts))
    assert dict(facts.locked) == {"finger": 0.08}


def test_worker_that_starts_ignores_the_interrupt_of_a_terminal() -> None:
    worker = WorkerProcess(PLANNER, lambda: None)
    try:
        os.kill(worker.pid, signal.SIGINT)
        worker.send(request(1))
        answer_of(worker, Rejected)
    finally:
        worker.close()


def test_goal_does_not_wait_for_each_place_of_a_gripper_that_moves(
    workers: Callable[[str], WorkerProcess],
) -> None:
    worker = workers(GRIPPER_URDF)
    os.kill(worker.pid, signal.SIGSTOP)
    for place in np.linspace(0.0, 0.1, 50):
        worker.send(Positions({"finger": float(place)}))
    worker.send(replace(request(1), measured={"finger": 0.1}))
    os.kill(worker.pid, signal.SIGCONT)
    heard = heard_until(worker, Planned)
    facts = [message for message in heard if isinstance(message, ModelFacts)]
    assert [one.locked["finger"] for one in facts] == [0.1]  # and not where it was, 49 times


def test_watcher_that_hangs_during_a_motion_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    later = 0.0
    clock = SimpleNamespace(
        monotonic=lambda: time.monotonic() + 5.0 * later, clock_gettime=time.clock_gettime
    )
    monkeypatch.setattr(worker_module, "time", clock)
    worker = WorkerProcess(WATCHER, lambda: None)
    try:
        worker.send(Place(1, 0.5))
        deadline = time.monotonic() + HANG
        while worker.due:
            assert time.monotonic() < deadline
            assert not worker.receive()
            time.sleep(0.005)
        later = 1000.0
        worker.check()
        os.kill(worker.pid, signal.SIGSTOP)
        for place in (0.6, 0.7):
            worker.send(Place(1, place))
            later += 1.5
            worker.check()
        assert answer_of_end(worker) == "it did not answer in time"
    finally:
        worker.close()


def answer_of_end(worker: WorkerProcess) -> str:
    with pytest.raises(AssertionError) as end:
        answer_of(worker, Planned)
    return str(end.value).splitlines()[0]


def test_obstacles_survive_the_death_of_one_worker_after_the_other(tmp_path: Path) -> None:
    robot, stamps = arm_robot(), count(1)
    x, y, z = robot.frame_positions(np.array([GOAL]), [robot.frame_names[-1]])[0, 0].tolist()

    def ball(name: str, height: float) -> Markers:
        one = Marker(ns=name, type=Marker.SPHERE, scale=Vector3(x=0.1, y=0.1, z=0.1))
        one.pose.position = Point(x=x, y=y, z=z + height)
        return Markers(bytes(serialize_message(MarkerArray(markers=[one]))), next(stamps), False)

    heard = list[tuple[str, object]]()
    save_primitive(arm_primitive(), tmp_path / "arm.npz")
    settings = Settings(primitives=(str(tmp_path / "arm.npz"),))
    workers = Workers(lambda: None, 1.0, lambda *what: heard.append(what))

    def until(is_done: Callable[[], bool]) -> None:
        deadline = time.monotonic() + HANG
        while not is_done():
            assert time.monotonic() < deadline
            workers.receive()
            time.sleep(0.005)

    def kill(worker: WorkerProcess) -> None:
        n = workers.n_restarts
        os.kill(worker.pid, signal.SIGKILL)
        until(lambda: workers.n_restarts > n)
        assert isinstance(heard[-1][1], WorkerDied)

    def heard_of_planner(kind: type[T]) -> list[T]:
        return [one for role, one in heard if role == PLANNER and isinstance(one, kind)]

    try:
        done = workers.ask(lambda number: SetUp(number, URDF, settings))
        until(done.done)
        workers.watch(WatchedRobot(URDF, JOINTS, {}, settings))
        until(lambda: workers.is_watching)
        workers.planner.send(request(1))  # what comes meanwhile waits
        workers.send_obstacles(ball("first", 0.0))
        kill(workers.watcher)
        assert not workers.is_watching
        workers.send_obstacles(ball("second", 3.0))
        workers.watch(WatchedRobot(URDF, JOINTS, {}, settings))
        until(lambda: workers.is_watching)
        kill(workers.planner)
        workers.planner.send(SetUp(0, URDF, settings))
        heard.clear()
        until(lambda: any(one.n_obstacles == 2 for one in heard_of_planner(WorldFacts)))
        workers.planner.send(request(2))
        until(lambda: bool(heard_of_planner(Rejected)))
        assert "first" in heard_of_planner(Rejected)[0].reason
    finally:
        workers.close()


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
    deadline = time.monotonic() + HANG
    while time.monotonic() < deadline:
        if worker.backlog < 5:
            worker.send(Markers(content, next(stamps), False))
        answers = [one for one in worker.receive() if isinstance(one, Planned | Rejected)]
        if answers:
            return
        time.sleep(0.002)
    raise AssertionError("no answer")
