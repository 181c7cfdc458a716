# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Two nodes on one machine, in namespaces, with other names of topics, and floods of goals."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState
from support.arm import JOINTS, arm_primitive
from support.domains import set_domain
from support.nodes import (
    GOAL,
    PATIENTLY,
    START,
    URDF,
    NodeClient,
    goal_message,
    ros_node,
    running_node,
)
from support.patience import HANG
from trajectory_msgs.msg import JointTrajectory

from mp_pca_planner.cli.main import main
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.ros.client import Answer

pytestmark = pytest.mark.slow

COUNTS = ("goals_served", "goals_refused", "goals_under_way", "goals_overtaken")
N_GOALS, PERIOD = 1000, 1e-3

Clients = tuple[NodeClient, NodeClient]


@pytest.fixture(scope="module")
def clients(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Clients]:
    """Of the node /left/mp_pca_planner, whose motions go to a controller, and of /right/planner."""
    folder = tmp_path_factory.mktemp("nodes")
    save_primitive(arm_primitive(), folder / "arm.npz")
    common = ("-p", f"primitives:=['{folder}']", *PATIENTLY)
    left = ("-r", "__ns:=/left", "-r", "~/joint_trajectory:=controller/joint_trajectory")
    right = ("-r", "__ns:=/right", "-r", "__node:=planner")
    with pytest.MonkeyPatch.context() as patch:
        set_domain(patch, 25)
        with (
            running_node(folder / "left.txt", *common, *left),
            running_node(folder / "right.txt", *common, *right),
            NodeClient(namespace="left") as left_client,
            NodeClient(namespace="right", planner="planner") as right_client,
        ):
            for client in (left_client, right_client):
                client.publish_description(URDF)
                client.wait_for_node(with_trajectory=client is right_client)
            yield left_client, right_client


def wait_for_diagnostics(client: NodeClient, node: str) -> dict[str, str]:
    """The next of a node that has a model; both nodes publish them on the same topic."""
    return client.wait_for_diagnostics(
        lambda values: (
            values["model"] != "none" and client.diagnostics[-1].status[0].name.startswith(node)
        )
    )


def test_nodes_in_namespaces_keep_apart_and_feed_the_controllers_they_are_remapped_to(
    clients: Clients,
) -> None:
    left, right = clients
    executed: list[JointTrajectory] = []
    with ros_node("controller_manager") as controllers:
        controllers.create_subscription(
            JointTrajectory, "/left/controller/joint_trajectory", executed.append, 10
        )
        executor = SingleThreadedExecutor(context=controllers.context)
        executor.add_node(controllers)
        wait_for_diagnostics(left, "/left/mp_pca_planner")
        left.publish_state(JOINTS, START)
        goal = ",".join(f"{name}={value!r}" for name, value in zip(JOINTS, GOAL, strict=True))
        assert main(["send_goal", goal, "--wait", "0", "--namespace", "left"]) == 0
        deadline = time.monotonic() + HANG
        while not executed and time.monotonic() < deadline:
            executor.spin_once(0.1)
    assert len(executed) == 1
    assert list(executed[0].points[-1].positions) == GOAL
    assert not left.trajectories
    # A client waits for no motion where others get it.
    answer, trajectory = left.stop()
    assert answer.success, answer.message
    assert trajectory is None
    # Nobody told the other one where its own robot is.
    wait_for_diagnostics(right, "/right/planner")
    assert "joint_states" in right.send(goal_message()).report.message


def test_flood_of_goals_leaves_no_goal_without_a_report_and_ends_at_the_newest(
    clients: Clients,
) -> None:
    _, client = clients
    before = wait_for_diagnostics(client, "/right/planner")
    client.publish_state(JOINTS, START)
    client.reports.clear()
    shares = np.linspace(0.2, 0.9, N_GOALS)[:, None]
    due = time.monotonic()
    for k, positions in enumerate(np.array(START) + shares * (np.array(GOAL) - START)):
        goal = goal_message(positions.tolist())
        goal.header.stamp.nanosec = k
        client.publish_goal(goal)
        due += PERIOD
        while time.monotonic() < due:
            client.spin_once(0.0)
    newest, end = goal_message(), time.monotonic() + HANG
    newest.header.stamp.sec = 1
    # On a busy machine the state is too old for a robot that a goal before has set in motion.
    while (answer := client.send(newest)).values["status"] != "solved":
        assert time.monotonic() < end, answer.report.message
        newest.header.stamp.sec += 1
        client.publish_state(JOINTS, START)
    # Topics are not in step: the motion of the goal before may come after the report.
    deadline = time.monotonic() + HANG
    while list(client.trajectories[-1].points[-1].positions) != GOAL:
        assert time.monotonic() < deadline
        client.spin_once(0.1)
    after = wait_for_diagnostics(client, "/right/planner")
    # The middleware keeps the newest goal for a node that is busy, so not all of them arrive.
    answered = [Answer(report, None, None).values["goal_stamp"] for report in client.reports]
    assert len(set(answered)) == len(answered)
    n_taken = sum(int(after[count]) - int(before[count]) for count in COUNTS)
    assert n_taken == len(answered)


def test_each_goal_of_a_burst_gets_its_report_and_the_newest_good_one_its_motion(
    clients: Clients,
) -> None:
    _, client = clients
    wait_for_diagnostics(client, "/right/planner")
    client.publish_state(JOINTS, START)
    deadline = time.monotonic() + HANG
    # The goals of a burst ask for the same: where one of them has its motion, others need none.
    served = {"solved", "under_way"}
    with ros_node("operators") as operators:
        goals = operators.create_publisher(JointState, "/right/planner/goal", 20)
        while not goals.get_subscription_count():
            assert time.monotonic() < deadline
            time.sleep(0.01)
        for _ in range(10):
            client.reports.clear()
            for k in range(10):
                bad = float("nan") if k % 2 else 100.0
                goal = goal_message(GOAL if k % 3 else [bad, *GOAL[1:]])
                goal.header.stamp.nanosec = k
                goals.publish(goal)
            while len(client.reports) < 10:
                assert time.monotonic() < deadline
                client.spin_once(0.1)
            found = [Answer(report, None, None).values for report in client.reports]
            status = {values["goal_stamp"][-1]: values["status"] for values in found}
            assert len(status) == 10
            assert {number for number in status if status[number] == "refused"} == set("0369")
            assert {status[number] for number in "12457"} <= {"overtaken", *served}
            assert status["8"] in served
