# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The state and the action of a controller, over the middleware."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (extra 'ros') is not installed")

import rclpy
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from support.arm import JOINTS
from support.bench import benched
from support.commands import with_folder
from support.domains import set_domain
from support.nodes import GOAL, ros_node
from support.nodes import START as REST
from support.patience import HANG
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from mp_pca_planner.exceptions import GoalError
from mp_pca_planner.files import config_file
from mp_pca_planner.ros import controller

START = (0.1, 0.2, 0.0, 0.8)
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


@pytest.fixture(autouse=True)
def _own_domain(monkeypatch, control_msgs):
    set_domain(monkeypatch, 83)


class Controller:
    """A client of a simulated robot's controller."""

    def __init__(self, node):
        from control_msgs.action import FollowJointTrajectory
        from control_msgs.msg import JointTrajectoryControllerState

        self.type, self.states = FollowJointTrajectory, []
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        node.create_subscription(
            JointTrajectoryControllerState, "/arm/controller_state", self.states.append, 1000
        )
        self.action = ActionClient(node, FollowJointTrajectory, "/arm/follow_joint_trajectory")
        self.wait(lambda: self.action.server_is_ready() and self.states)

    def wait(self, is_done):
        deadline = time.monotonic() + HANG
        while not is_done():
            assert time.monotonic() < deadline, "in vain"
            self._executor.spin_once(timeout_sec=0.05)

    def result(self, future):
        self.wait(future.done)
        return future.result()

    def send(self, trajectory):
        goal = self.type.Goal(trajectory=trajectory)
        return self.result(self.action.send_goal_async(goal))

    def end(self, handle):
        answer = self.result(handle.get_result_async())
        return answer.status, answer.result.error_code


@contextmanager
def simulated():
    """A simulated robot, and a client of its controller."""
    command = [sys.executable, "-m", "mp_pca_planner", "simulate"]
    command += ["--robot", str(config_file("human_arm.urdf")), "--joints", ",".join(JOINTS)]
    pairs = zip(JOINTS, START, strict=True)
    command += ["--start", ",".join(f"{name}={value}" for name, value in pairs)]
    command += ["--controller-topic", "/arm/joint_trajectory"]
    process = subprocess.Popen(command)
    try:
        with ros_node("user") as node:
            yield Controller(node)
    finally:
        process.terminate()
        process.wait(HANG)


def motion(to, duration=0.3, last_velocity=0.0):
    message = JointTrajectory(joint_names=list(JOINTS))
    for t, q, v in ((0.0, START, 0.0), (duration, to, last_velocity)):
        point = JointTrajectoryPoint(positions=list(map(float, q)), velocities=[v] * len(JOINTS))
        point.accelerations = [0.0] * len(JOINTS)
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(round(t * 1e9), 10**9)
        message.points.append(point)
    return message


def test_goals_of_the_action_are_answered_and_the_state_is_published():
    there = np.array(START) + 0.1
    with simulated() as controller:
        state = controller.states[-1]
        assert tuple(state.joint_names) == tuple(JOINTS)
        assert np.allclose(state.reference.positions, START)
        assert state.speed_scaling_factor == 1.0
        # Rejected, replaced, reached, cancelled.
        assert not controller.send(motion(there, last_velocity=0.1)).accepted
        first = controller.send(motion(there, duration=20.0))
        second = controller.send(motion(there))
        assert controller.end(first) == (ABORTED, -1)
        assert controller.end(second) == (SUCCEEDED, 0)
        controller.wait(lambda: np.allclose(controller.states[-1].reference.positions, there))
        third = controller.send(motion(START, duration=20.0))
        controller.result(third.cancel_goal_async())
        assert controller.end(third)[0] == CANCELED


def use_action(bench, name):
    """Have the node send its motions to an action, once it has found that."""
    bench.set(controller_action=name)
    bench.client.wait_for_diagnostics(lambda values: values["controller_action"] == "ready")


# Before the tests of one node: two with their robots are more than a small machine runs in time.
@pytest.mark.parametrize("scaling", [-0.1, np.nan, 0.5])
def test_command_with_an_impossible_speed_is_unusable(control_msgs, monkeypatch, scaling):
    from control_msgs.msg import JointTrajectoryControllerState as State

    monkeypatch.setattr(controller, "JointTrajectoryControllerState", State)
    state = State(joint_names=JOINTS, speed_scaling_factor=scaling)
    state.reference.positions = state.reference.velocities = [0.0] * len(JOINTS)
    content = bytes(serialize_message(state))
    if scaling == 0.5:
        assert controller.to_command(content, JOINTS[:2]).rate == 0.5
    else:
        with pytest.raises(GoalError, match="a number that is not finite"):
            controller.to_command(content, JOINTS[:2])


@pytest.mark.slow
def test_motion_is_executed_once_by_a_controller_that_listens_to_the_topic_too(
    monkeypatch, tmp_path
):
    set_domain(monkeypatch, 88)
    with benched(tmp_path) as bench:
        use_action(bench, "mp_pca_planner/follow_joint_trajectory")
        n_copies, executions = len(bench.client.trajectories), bench.client.executions
        bench.has_copies = False
        report = bench.arrive(GOAL)
        assert "SUCCESSFUL" in report["controller"]
        assert len(bench.client.trajectories) == n_copies
    received, *_ = (tmp_path / "robot.txt").read_text().splitlines()
    assert received.split() == ["received", str(len(executions))]


@pytest.fixture(scope="module")
def bench(_control_msgs_folder, tmp_path_factory):
    """A node that sends its motions to the action of a robot, whose topic it does not use."""
    with pytest.MonkeyPatch.context() as patch:
        if _control_msgs_folder is not None:
            patch.setenv("PYTHONPATH", with_folder(_control_msgs_folder))
        set_domain(patch, 87)
        folder = tmp_path_factory.mktemp("robot")
        with benched(folder, "--controller-topic", "/arm/joint_trajectory") as bench:
            bench.set(controller_state_topic="/arm/controller_state")
            use_action(bench, "/arm/follow_joint_trajectory")
            yield bench


@pytest.mark.slow
def test_motion_that_is_sent_as_a_goal_is_reported_with_the_answers_of_the_controller(bench):
    report = bench.arrive(GOAL)
    assert report["controller"] == (
        "accepted the goal; ended the goal with code 0 (SUCCESSFUL): the end was reached"
    )
    bench.wait(lambda: np.allclose(bench.position, GOAL, atol=1e-3))
    bench.arrive(REST)


@pytest.mark.slow
def test_goal_that_the_controller_rejects_or_aborts_is_reported_with_its_words(bench):
    with bench.fault("active", False, True):
        report = bench.execution(bench.send(GOAL))
    assert report["outcome"] == "never_started"
    assert report["controller"] == "rejected the goal"
    answer = bench.begin_slowly(GOAL)
    with bench.fault("active", False, True):
        report = bench.execution(answer)
    assert report["outcome"] == "not_followed"
    assert "aborted the goal with code -1 (INVALID_GOAL)" in report["controller"]
    bench.arrive(REST)


@pytest.mark.realtime
def test_stop_replaces_the_goal_and_brings_the_robot_to_rest_on_its_path(bench):
    answer = bench.begin_slowly(GOAL)
    stopped, _ = bench.client.stop()
    assert "comes to rest on its path" in stopped.message
    assert bench.execution(answer)["outcome"] == "stopped"
    bench.arrive(REST)


class Server:
    """A controller that answers goals when it is told to, and a node that sends them."""

    def __init__(self, monkeypatch):
        from control_msgs.action import FollowJointTrajectory

        # Where the module was imported before there were the interfaces, it has none.
        monkeypatch.setattr(controller, "FollowJointTrajectory", FollowJointTrajectory)
        self.cancelled, self.heard = threading.Event(), []
        self.answers = {True: threading.Event(), False: threading.Event()}  # to stops, to motions
        self.accepts = {True: False, False: True}
        self._result = FollowJointTrajectory.Result
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._robot, self._node = (
            rclpy.create_node(name, context=self._context) for name in ("robot", "user")
        )
        self._server = ActionServer(
            self._robot,
            FollowJointTrajectory,
            "follow",
            self._execute,
            goal_callback=self._on_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )
        self._executor = MultiThreadedExecutor(4, context=self._context)
        self._executor.add_node(self._robot)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()
        self._own = SingleThreadedExecutor(context=self._context)
        self._own.add_node(self._node)
        self.action = controller.ControllerAction(self._node, self._hear)
        self.action.use(SimpleNamespace(controller_action="follow"))
        self.wait(lambda: self.action.state == "ready")

    def send(self, name, duration):
        is_stop = duration < 1.0
        content = serialize_message(motion(START, duration=duration))
        assert self.action.send(name, content, is_stop=is_stop)

    def wait(self, is_done):
        deadline = time.monotonic() + HANG
        while not is_done():
            assert time.monotonic() < deadline, "in vain"
            self._own.spin_once(0.02)

    def close(self):
        for answer in self.answers.values():
            answer.set()
        self._executor.shutdown()
        self._own.shutdown()
        self._thread.join(HANG)
        self._server.destroy()
        self._node.destroy_node()
        self._robot.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def _hear(self, sent, text, failure):
        self.heard.append((sent, text))

    def _on_goal(self, request):
        is_stop = not request.trajectory.points[-1].time_from_start.sec
        self.answers[is_stop].wait(HANG)
        return GoalResponse.ACCEPT if self.accepts[is_stop] else GoalResponse.REJECT

    def _execute(self, handle):
        deadline = time.monotonic() + HANG
        while not handle.is_cancel_requested and time.monotonic() < deadline:
            time.sleep(0.01)
        handle.canceled()
        self.cancelled.set()
        return self._result()


@pytest.fixture
def server(monkeypatch):
    server = Server(monkeypatch)
    yield server
    server.close()


@pytest.mark.parametrize("is_silent", [False, True])
def test_goal_before_a_stop_that_is_rejected_or_not_answered_is_cancelled(server, is_silent):
    server.answers[False].set()
    server.send("motion", 20.0)
    server.wait(lambda: ("motion", "accepted the goal") in server.heard)
    server.action.watch()
    assert not server.cancelled.is_set()
    if not is_silent:
        server.answers[True].set()
    sent_at = time.monotonic()
    server.send("stop", 0.2)
    if is_silent:  # a second stop comes before the first one is answered
        server.send("another stop", 0.2)

    def is_cancelled():
        server.action.watch()
        return server.cancelled.is_set()

    server.wait(is_cancelled)
    if is_silent:
        assert time.monotonic() >= sent_at + server.action.answer_time
    else:
        assert ("stop", "rejected the goal") in server.heard


def test_motion_that_is_accepted_after_a_stop_is_cancelled_at_once(server):
    server.accepts[True] = True
    server.send("motion", 20.0)
    assert server.action.has_unanswered_motion
    server.answers[True].set()
    server.send("stop", 0.2)
    server.wait(lambda: ("stop", "accepted the goal") in server.heard)
    assert server.action.has_unanswered_motion
    server.answers[False].set()
    server.wait(server.cancelled.is_set)
    server.wait(lambda: not server.action.has_unanswered_motion)
    server.wait(
        lambda: any(
            name == "motion" and text.startswith("cancelled") for name, text in server.heard
        )
    )
