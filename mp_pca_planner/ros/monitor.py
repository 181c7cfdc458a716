# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Monitor of the topics of a planner node, for the demo and the page."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from .node import NODE_NAME
from .process import NodeInOwnContext
from .subscriptions import STATES, PolledSubscription


@dataclass
class NodeView:
    """What was received so far; times by :func:`time.monotonic` [s].

    Attributes
    ----------
    states : dict
        Position [rad or m], velocity (NaN where none is given) and time of receipt, by joint.
    goal : tuple of (str, float), or None
        A description of the newest goal, and its time of receipt.
    report, diagnostics : tuple of (DiagnosticStatus, float), or None
        The newest of the node, and its time of receipt.
    """

    states: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    goal: tuple[str, float] | None = None
    report: tuple[DiagnosticStatus, float] | None = None
    diagnostics: tuple[DiagnosticStatus, float] | None = None


class Monitor(NodeInOwnContext):
    """Listens to a node; use it as a context manager.

    Messages stay in the middleware until they are polled, so that joint states at 1 kHz cost next
    to nothing.

    Parameters
    ----------
    namespace : str
        Namespace of the node.
    planner : str
        Name of the node.

    Attributes
    ----------
    seen : NodeView
        What was received until the last :meth:`look`.
    """

    def __init__(self, namespace: str = "", planner: str = NODE_NAME) -> None:
        super().__init__("monitor", namespace, planner)
        self.seen = NodeView()
        parent = self.node.get_namespace().rstrip("/")
        self._status_name = f"{parent}/{planner}: planner"
        topics: tuple[tuple[type, str, Callable[[Any], None], QoSProfile | int], ...] = (
            (JointState, "joint_states", self._on_state, STATES),
            (JointState, f"{planner}/goal", self._on_goal, 10),
            (PoseStamped, f"{planner}/goal_pose", self._on_goal, 10),
            (JointTrajectory, f"{planner}/goal_sequence", self._on_goal, 10),
            (DiagnosticStatus, f"{planner}/plan_report", self._on_report, 100),
            (DiagnosticArray, "/diagnostics", self._on_diagnostics, 100),
        )
        self._subscriptions = [
            (PolledSubscription(self.node, kind, topic, qos), keep)
            for kind, topic, keep, qos in topics
        ]

    def look(self) -> NodeView:
        """Take all that has arrived."""
        for subscription, keep in self._subscriptions:
            for message, _ in subscription.poll():
                keep(message)
        return self.seen

    def _on_state(self, message: JointState) -> None:
        velocities = message.velocity or [float("nan")] * len(message.name)
        for name, q, v in zip(message.name, message.position, velocities, strict=False):
            self.seen.states[name] = (q, v, time.monotonic())

    def _on_goal(self, message: JointState | PoseStamped | JointTrajectory) -> None:
        if isinstance(message, JointTrajectory):
            n_points, n_joints = len(message.points), len(message.joint_names)
            text = f"{n_points} configurations of {n_joints} joints"
        elif isinstance(message, PoseStamped):
            p, o = message.pose.position, message.pose.orientation
            numbers = "  ".join(f"{x:.3f}" for x in (p.x, p.y, p.z, o.x, o.y, o.z, o.w))
            text = f"pose {numbers} in '{message.header.frame_id}'"
        else:
            values = zip(message.name, message.position, strict=False)
            text = "  ".join(f"{name} {value:.3f}" for name, value in values)
        self.seen.goal = text, time.monotonic()

    def _on_report(self, message: DiagnosticStatus) -> None:
        self.seen.report = message, time.monotonic()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._status_name:
                self.seen.diagnostics = status, time.monotonic()
