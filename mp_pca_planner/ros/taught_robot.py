# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The running node after a teaching session: new primitives, and a goal for one of them."""

from __future__ import annotations

import time
from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState

from ..recordings.byte_layout import NS_PER_S
from .client import DEPTH, READY, Answer, GoalClient, is_served, report_values


class TaughtRobot(GoalClient):
    """Client of the node that shall move as it was taught; a context manager.

    Parameters
    ----------
    namespace, planner : str
        Namespace and name of the node.
    """

    def __init__(self, namespace: str, planner: str) -> None:
        super().__init__("teach_goal", namespace, planner)
        self.executions: list[DiagnosticStatus] = []
        report = f"{planner}/execution_report"
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

    def outcome(self, answer: Answer, margin: float = 30.0) -> str:
        """What became of the motion; '' if there is none.

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
        if not is_served(answer.report):
            return ""
        duration, stamp = float(answer.values["duration"]), answer.values["goal_stamp"]

        def own() -> list[str]:
            reports = ((one.message, report_values(one)) for one in self.executions)
            return [text for text, values in reports if values["goal_stamp"] == stamp]

        self.wait(lambda: bool(own()), duration + margin, "did not report the execution")
        return own()[0]
