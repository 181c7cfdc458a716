# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The node and a simulated robot, and a user of both."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import numpy as np
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from sensor_msgs.msg import JointState
from support.arm import JOINTS, arm_primitive
from support.nodes import (
    START,
    Answer,
    NodeClient,
    arm_node,
    call,
    goal_message,
    ros_node,
    set_request,
    simulated_robot,
)
from support.patience import HANG, NODE_EVER

from mp_pca_planner.ros.client import is_served, report_values

LIMITS = {"velocity": 3.0, "acceleration": 15.0}
SLOW = 20.0  # duration of a motion that is stopped long before its end [s]
STATE_TIMEOUT = 5.0
VIA = arm_primitive().boundary_states[1][3].tolist()


class Bench:
    """A user of the node and of the robot's faults, who sees where the robot is.

    Attributes
    ----------
    has_copies : bool
        Whether the node publishes its motions, wherever else it sends them.
    forgiven : list of dict
        Reports of motions that a busy machine may have spoilt.
    """

    def __init__(self, client: NodeClient, node: Node) -> None:
        self.has_copies = True
        self.client, self._node, self._stamps = client, node, count(1)
        self.measured: list[JointState] = []
        self.forgiven: list[dict[str, str]] = []
        # The client's executor takes what comes: one node is spun, the other called from.
        client.node.create_subscription(JointState, "joint_states", self._on_state, 10)

    def _on_state(self, state: JointState) -> None:
        self.measured = [state]

    @property
    def position(self) -> np.ndarray:
        """Where the robot was measured last."""
        return np.array(self.measured[0].position)

    def wait(self, is_done: Callable[[], bool]) -> None:
        self.client.wait(is_done, HANG, "did not do it")

    def send(self, positions: Sequence[float]) -> Answer:
        """Send a goal; again while it is refused because the machine was too busy to plan it."""
        deadline = time.monotonic() + HANG
        while True:
            message = goal_message(positions)
            message.header.stamp.sec = next(self._stamps)  # by which it is known
            answer = self.client.send(message, HANG, with_trajectory=self.has_copies)
            if "send the goal again" not in answer.report.message:
                return answer
            assert time.monotonic() < deadline, answer.report.message

    def execution(self, answer: Answer) -> dict[str, str]:
        """What became of the motion to a goal."""
        assert is_served(answer.report), answer.report.message
        assert (answer.trajectory is not None) == self.has_copies, answer.report.message
        stamp = answer.values["goal_stamp"]

        def reports() -> list[dict[str, str]]:
            values = map(report_values, self.client.executions)
            return [one for one in values if one["goal_stamp"] == stamp]

        self.wait(lambda: bool(reports()))
        (report,) = reports()
        return report

    def arrive(self, *goals: Sequence[float]) -> dict[str, str]:
        """The report of the last of some goals, which follow each other in motion.

        Once in the life of the bench, they are sent again where a motion is started late or not
        followed: on a busy machine, the controller may take a message too late.
        """
        while True:
            answers = [self.send(goal) for goal in goals]
            report = self.execution(answers[-1])
            if report["outcome"] == "arrived":
                return report
            assert report["outcome"] in ("never_started", "not_followed"), report
            self.forgiven.append(report)
            assert len(self.forgiven) <= 1, self.forgiven
            goals = (VIA, *goals)

    @contextmanager
    def fault(self, name: str, value: object, normal: object) -> Iterator[None]:
        """Give the simulated robot a fault for a while."""
        self._set_fault(name, value)
        try:
            yield
        finally:
            self._set_fault(name, normal)

    def _set_fault(self, name: str, value: object) -> None:
        service, request = "simulated_robot/set_parameters", set_request({name: value})
        done = call(self._node, SetParameters, service, request)
        assert done.results[0].successful, done.results[0].reason

    def begin_slowly(self, positions: Sequence[float]) -> Answer:
        """Send a goal, and wait until the robot is well on its way."""
        before = self.position
        self.client.set(duration=SLOW)
        try:
            answer = self.send(positions)
        finally:
            self.client.set(duration=0.0)
        assert answer.trajectory is not None, answer.report.message
        self.wait(lambda: np.abs(self.position - before).max() > 0.05)
        return answer


@contextmanager
def benched(folder: Path, *options: str) -> Iterator[Bench]:
    """The node and the robot, which both have to end cleanly."""
    limits = {f"limits.{j}.max_{k}": v for j in JOINTS for k, v in LIMITS.items()}
    given = {"max_solve_time": NODE_EVER, "state_timeout": STATE_TIMEOUT, **limits}
    with (
        arm_node(**given),
        simulated_robot(folder / "robot.txt", START, *options),
        NodeClient() as client,
        ros_node("user") as user,
    ):
        client.wait_for_node(HANG)
        client.wait_for_model()
        bench = Bench(client, user)
        bench.wait(lambda: bool(bench.measured))
        yield bench
