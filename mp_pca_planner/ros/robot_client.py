# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A client of the node that waits until the robot has executed the motion to a goal."""

from __future__ import annotations

import time
from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState

from ..recordings.byte_layout import NS_PER_S
from .client import DEPTH, READY, Answer, GoalClient, is_served, report_values
from .messages import UNDER_WAY


class RobotClient(GoalClient):
    """Client of the node and of its reports of executions; a context manager.

    Parameters
    ----------
    name : str
        Name of the client's own node.
    namespace, planner : str
        Namespace and name of the planner's node.
    """

    def __init__(self, name: str, namespace: str, planner: str) -> None:
        super().__init__(name, namespace, planner)
        self.executions: list[DiagnosticStatus] = []
        self._report = report = f"{planner}/execution_report"
        self.node.create_subscription(DiagnosticStatus, report, self.executions.append, DEPTH)

    def move(self, primitive: str, goal: Mapping[str, float], timeout: float) -> Answer:
        """Send a goal configuration by joint name [rad or m], for one primitive.

        Raises
        ------
        NoAnswerError
            If the node is not ready for goals or does not answer within the timeout [s].
        """
        self.wait_for_diagnostics(lambda values: values["text"] == READY, timeout)
        message = JointState(name=list(goal), position=list(goal.values()))
        message.header.frame_id = primitive
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(time.time_ns(), NS_PER_S)
        return self.send(message, timeout, with_trajectory=False)

    def execution(self, answer: Answer, margin: float = 30.0) -> DiagnosticStatus | None:
        """The report on the execution of a motion; None if nothing was published or none comes.

        None comes of a node without such reports.

        Parameters
        ----------
        answer : Answer
            The answer to its goal.
        margin : float
            Longest time from the end of the motion to its report [s].

        Raises
        ------
        NoAnswerError
            If its execution is not reported.
        """
        is_under_way = answer.values.get("status") == UNDER_WAY
        if not is_served(answer.report) or is_under_way:
            return None
        if not (self.executions or self.node.count_publishers(self._report)):
            return None
        duration, stamp = float(answer.values["duration"]), answer.values["goal_stamp"]

        def own() -> list[DiagnosticStatus]:
            return [one for one in self.executions if report_values(one)["goal_stamp"] == stamp]

        self.wait(lambda: bool(own()), duration + margin, "did not report the execution")
        return own()[0]
