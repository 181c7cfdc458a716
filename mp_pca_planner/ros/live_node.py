# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The running planner node for the page: what it publishes, goals, and its stop service."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from ..exceptions import PlannerError, WorldError
from ..motion.collision import package_folders
from ..motion.trajectory import Trajectory
from ..robot.world import World
from ..view.live import LiveView, NodeStatus
from .client import report_values
from .messages import to_trajectory
from .monitor import Monitor
from .node import NODE_NAME
from .obstacle_markers import MarkerMessages
from .process import NoAnswerError
from .subscriptions import BURSTS, EVERY, LATCHED_BURSTS, NEWEST, PolledSubscription

_STOP_TIMEOUT = 2.0  # [s]


class LiveNode(Monitor):
    """A connection to a planner node; use it as a context manager, in one thread.

    Parameters
    ----------
    namespace : str
        Namespace of the node.
    planner : str
        Name of the node.
    trajectories : str
        Topic of the motions, if it is remapped to that of a controller.
    """

    def __init__(
        self, namespace: str = "", planner: str = NODE_NAME, trajectories: str = ""
    ) -> None:
        super().__init__(namespace, planner)
        self._motion: Trajectory | None = None
        self._execution: NodeStatus | None = None
        topic = trajectories or f"{planner}/joint_trajectory"
        self._motions = PolledSubscription(self.node, JointTrajectory, topic, EVERY)
        report = f"{planner}/execution_report"
        self._executions = PolledSubscription(self.node, DiagnosticStatus, report, EVERY)
        self._world, self._markers = World(), MarkerMessages()
        self._obstacles = [
            PolledSubscription(self.node, MarkerArray, f"{planner}/obstacles", qos)
            for qos in (BURSTS, LATCHED_BURSTS)
        ]
        self._goals = self.node.create_publisher(JointState, f"{planner}/goal", NEWEST)
        self._stops = self.node.create_client(Trigger, f"{planner}/stop")

    def view(self) -> LiveView:
        """What was received up to now."""
        seen = self.look()
        for message, _ in self._motions.poll():
            try:
                self._motion = to_trajectory(message)
            except PlannerError:  # another publisher's; the node publishes none like that
                self._motion = None
        for message, _ in self._executions.poll():
            self._execution = _status((message, time.monotonic()))
        for is_late, subscription in enumerate(self._obstacles):
            for message, facts in subscription.poll():
                self._mark(message, facts["source_timestamp"], is_late=bool(is_late))
        return LiveView(
            dict(seen.states),
            seen.goal,
            _status(seen.report),
            self._execution,
            _status(seen.diagnostics),
            self._motion,
            self._world,
        )

    def _mark(self, message: MarkerArray, stamp: int, *, is_late: bool) -> None:
        """Apply markers as the node does, which reports those that it rejects."""
        applied = self._markers.apply(
            self._world, message, stamp, is_late=is_late, links=None, folders=package_folders(())
        )
        if applied is not None:
            with suppress(WorldError):
                self._world = World(applied[0])

    def send_goal(self, positions: Mapping[str, float]) -> None:
        """Send a goal configuration by joint name [rad or m]."""
        message = JointState(name=list(positions), position=list(positions.values()))
        message.header.stamp = self.node.get_clock().now().to_msg()
        self._goals.publish(message)

    def stop(self) -> str:
        """Stop the robot; returns the node's answer, or why there is none."""
        if not self._stops.service_is_ready():
            return "not stopped: the node is not there"
        try:
            answer = self.result(self._stops, Trigger.Request(), _STOP_TIMEOUT)
        except NoAnswerError as error:
            return f"not stopped: {error}"
        return str(answer.message)


def _status(received: tuple[DiagnosticStatus, float] | None) -> NodeStatus | None:
    if received is None:
        return None
    status, when = received
    level = int.from_bytes(status.level, "little")
    return NodeStatus(level, status.message, report_values(status), when)
