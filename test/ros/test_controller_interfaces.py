# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The state and the action of a controller, over the middleware."""

from __future__ import annotations

import time

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (extra 'ros') is not installed")

from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import serialize_message
from support.arm import JOINTS
from support.bench import benched
from support.commands import with_folder
from support.domains import set_domain
from support.nodes import GOAL, ros_node, simulated_robot
from support.nodes import START as REST
from support.patience import HANG

from mp_pca_planner.exceptions import GoalError
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.ros import controller
from mp_pca_planner.ros.serialised import trajectory_message

START = (0.1, 0.2, 0.0, -0.8)
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


def motion(to, duration=0.3, last_velocity=0.0):
    still, v = np.zeros((2, len(JOINTS))), [[0.0] * len(JOINTS), [last_velocity] * len(JOINTS)]
    sent = Trajectory(JOINTS, [0.0, duration], [START, to], v, still)
    return trajectory_message(sent, with_efforts=False)


def test_goals_of_the_action_are_answered_and_the_state_is_published(tmp_path):
    there = np.array(START) + 0.1
    options = ("--controller-topic", "/arm/joint_trajectory")
    with simulated_robot(tmp_path / "log.txt", START, *options), ros_node("user") as node:
        controller = Controller(node)
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
    bench.client.set(controller_action=name)
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
        assert controller.to_command(content, JOINTS[:2], 1.0).rate == 0.5
    else:
        with pytest.raises(GoalError, match="a number that is not finite"):
            controller.to_command(content, JOINTS[:2], 1.0)


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
            bench.client.set(controller_state_topic="/arm/controller_state")
            use_action(bench, "/arm/follow_joint_trajectory")
            yield bench


@pytest.mark.slow
def test_motions_that_are_sent_as_goals_are_reported_with_the_answers_of_the_controller(bench):
    report = bench.arrive(GOAL)
    assert report["controller"] == (
        "accepted the goal; ended the goal with code 0 (SUCCESSFUL): the end was reached"
    )
    bench.wait(lambda: np.allclose(bench.position, GOAL, atol=1e-3))
    with bench.fault("active", False, True):
        report = bench.execution(bench.send(REST))
    assert (report["outcome"], report["controller"]) == ("never_started", "rejected the goal")
    answer = bench.begin_slowly(REST)
    with bench.fault("active", False, True):
        report = bench.execution(answer)
    assert report["outcome"] == "not_followed"
    assert "aborted the goal with code -1 (INVALID_GOAL)" in report["controller"]
    # A stop is a goal, too, which replaces the running one.
    answer = bench.begin_slowly(GOAL)
    assert bench.client.stop()[0].success
    assert bench.execution(answer)["outcome"] == "stopped"
