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
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from support.arm import JOINTS, arm_primitive
from support.nodes import (
    START,
    NodeClient,
    call,
    goal_message,
    ros_node,
    running_node,
    simulated_robot,
    words,
)
from support.patience import HANG, NODE_EVER

from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.ros.client import Answer, is_served, report_values

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

    def __init__(self, client: NodeClient, node: Node, primitive: str) -> None:
        self.primitive, self.has_copies = primitive, True
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

    def message(self, positions: Sequence[float]) -> JointState:
        """A goal, known by its stamp."""
        goal = goal_message(list(positions))
        goal.header.stamp.sec = next(self._stamps)
        return goal

    def wait(self, is_done: Callable[[], bool]) -> None:
        deadline = time.monotonic() + HANG
        while not is_done():
            assert time.monotonic() < deadline
            self.client.spin_once()

    def send(self, positions: Sequence[float]) -> Answer:
        """Send a goal; again while it is refused because the machine was too busy to plan it."""
        deadline = time.monotonic() + HANG
        while True:
            message = self.message(positions)
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

    def set(self, **values: object) -> None:
        """Set parameters of the planner."""
        messages = [Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        for result in self.client.set_parameters(*messages):
            assert result.successful, result.reason

    @contextmanager
    def fault(self, name: str, value: object, normal: object) -> Iterator[None]:
        """Give the simulated robot a fault for a while."""
        self._set_fault(name, value)
        try:
            yield
        finally:
            self._set_fault(name, normal)

    def _set_fault(self, name: str, value: object) -> None:
        message = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[message])
        done = call(self._node, SetParameters, "simulated_robot/set_parameters", request)
        assert done.results[0].successful, done.results[0].reason

    def begin_slowly(self, positions: Sequence[float]) -> Answer:
        """Send a goal, and wait until the robot is well on its way."""
        before = self.position
        self.set(duration=SLOW)
        try:
            answer = self.send(positions)
        finally:
            self.set(duration=0.0)
        assert answer.trajectory is not None, answer.report.message
        self.wait(lambda: np.abs(self.position - before).max() > 0.05)
        return answer


@contextmanager
def benched(folder: Path, *options: str) -> Iterator[Bench]:
    """The node and the robot, which both have to end cleanly."""
    save_primitive(arm_primitive(), folder / "arm.npz")
    limits = {f"limits.{j}.max_{k}": v for j in JOINTS for k, v in LIMITS.items()}
    given = {"max_solve_time": NODE_EVER, "state_timeout": STATE_TIMEOUT, **limits}
    primitives = words(primitives=f"['{folder / 'arm.npz'}']")
    with (
        running_node(folder / "log.txt", *primitives, *words(**given)),
        simulated_robot(folder / "robot.txt", START, *options),
        NodeClient() as client,
        ros_node("user") as user,
    ):
        client.wait_for_node(HANG)
        client.wait_for_model()
        bench = Bench(client, user, str(folder / "arm.npz"))
        bench.wait(lambda: bool(bench.measured))
        yield bench
