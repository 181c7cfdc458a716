# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The controller of the robot: the command that it states, and its action."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.action.graph import get_action_server_names_and_types_by_node
from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from ..exceptions import GoalError
from ..execution.parameters import Settings
from ..execution.serving.execution import ACCEPTED, MotionOutcome
from ..execution.threads import TimedLock
from ..execution.tracking.estimation import StatedCommand
from ..files import reading
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from .messages import to_seconds, to_text
from .nodes import LOG_PERIOD, GroupExecutor, GuardedNode, ThreadGroup
from .serialised import read_message

__all__ = ["HAS_CONTROL_MSGS", "FollowJointTrajectory", "JointTrajectoryControllerState"]

try:
    from control_msgs.action import FollowJointTrajectory
    from control_msgs.msg import JointTrajectoryControllerState
except ImportError:
    FollowJointTrajectory: Any = None  # type: ignore[no-redef]
    JointTrajectoryControllerState: Any = None  # type: ignore[no-redef]

HAS_CONTROL_MSGS = JointTrajectoryControllerState is not None
"""Whether that package is installed."""


_SUCCEEDED, _CANCELED = 4, 5  # of action_msgs/GoalStatus
_CODES = {
    0: "SUCCESSFUL",
    -1: "INVALID_GOAL",
    -2: "INVALID_JOINTS",
    -3: "OLD_HEADER_TIMESTAMP",
    -4: "PATH_TOLERANCE_VIOLATED",
    -5: "GOAL_TOLERANCE_VIOLATED",
}

Hear = Callable[[Trajectory, str, MotionOutcome | None], bool]


def to_command(content: bytes, joint_names: Sequence[str]) -> StatedCommand:
    """Read the command of some joints from the serialised state of a controller.

    Raises
    ------
    GoalError
        If it is malformed, lacks one of the joints, or a number is not finite.
    """
    with reading("the state of the controller", GoalError):
        message = read_message(content, JointTrajectoryControllerState)
    names, reference = list(message.joint_names), message.reference
    rows = [reference.positions, reference.velocities, reference.accelerations]
    if len(reference.accelerations) == 0:
        rows[2] = [0.0] * len(names)
    lengths = {len(row) for row in rows}
    if lengths != {len(names)} or any(names.count(name) != 1 for name in joint_names):
        raise GoalError("the state of the controller lacks a joint, or a number of one")
    q, v, a = ([row[names.index(name)] for name in joint_names] for row in rows)
    rate, since = message.speed_scaling_factor, to_seconds(reference.time_from_start)
    if not (all(map(math.isfinite, (*q, *v, *a))) and 0.0 <= rate <= 10.0):
        raise GoalError("the state of the controller has a number that is not finite")
    return StatedCommand(JointState(tuple(joint_names), q, v, a), since, rate)


class ControllerAction:
    """Sends motions as goals to the action of a controller, and hears its answers.

    Goals are never cancelled while the controller may execute a newer one: a stop is a goal, too,
    which replaces the running one smoothly. A controller that is told to cancel holds the measured
    position at once. Only if it rejects a stop, or does not answer, its goal is cancelled.

    Parameters
    ----------
    node : GuardedNode
        The node.
    hear : callable
        Takes a trajectory that was sent, the answer to it, and how it failed, if it did; returns
        whether it is the stop that was sent last. See `MotionMonitor.hear`.
    """

    answer_time = 0.3
    """Time after which a stop without an answer does not count [s]."""

    def __init__(self, node: GuardedNode, hear: Hear) -> None:
        self._node, self._hear = node, hear
        self._name = ""
        self._client: ActionClient | None = None
        # A thread of its own: whatever is set up, an answer is reported at once.
        self._group = ThreadGroup()
        self._executor = GroupExecutor(node, self._group)
        self._lock = TimedLock()
        self._running: ClientGoalHandle | None = None
        self._newest: Trajectory | None = None
        # The trajectory without an answer yet, when it was sent [s], and the goal before it.
        self._waiting: tuple[Trajectory, float, ClientGoalHandle | None] | None = None

    def use(self, settings: Settings) -> None:
        """Be a client of the action that the parameters name."""
        if settings.controller_action == self._name:
            return
        old, self._name = self._client, settings.controller_action
        self._running = self._waiting = self._client = None
        if self._name:
            self._client = ActionClient(
                self._node, FollowJointTrajectory, self._name, callback_group=self._group
            )
        self._executor.wake()  # it waits for the clients that it knew before
        if old is not None:
            old.destroy()

    def close(self) -> None:
        """End the thread, before the node is destroyed."""
        self._executor.shutdown()

    @property
    def state(self) -> str:
        """Whether motions are sent to the action, and why not."""
        if self._client is None:
            return "none"
        if self._client.server_is_ready():
            return "ready"
        return f"nobody serves '{self._name}': motions are sent on the topic alone"

    def is_served_by_subscriber(self, topic: str) -> bool:
        """Whether a node that serves the action may listen to a topic, too.

        It would execute a motion twice. A node that is not known yet counts as such a one.
        """
        name = self._node.resolve_service_name(self._name)
        for endpoint in self._node.get_subscriptions_info_by_topic(topic):
            try:
                served = get_action_server_names_and_types_by_node(
                    self._node, endpoint.node_name, endpoint.node_namespace
                )
            except Exception:  # it is being discovered, or has just gone
                return True
            if name in dict(served):
                return True
        return False

    def send(self, sent: Trajectory, content: bytes) -> bool:
        """Send a trajectory and its serialised message as a goal; returns whether that was done.

        Answers to it are heard later, in another thread.
        """
        client = self._client
        if client is None or not client.server_is_ready():
            return False
        try:
            goal = FollowJointTrajectory.Goal(
                trajectory=deserialize_message(content, JointTrajectory)
            )
            future = client.send_goal_async(goal)
        except Exception as error:  # in any case, a stop must go out: by the topic then
            text = f"a goal was not sent to the controller: {self._node.explain(error)}"
            self._node.get_logger().error(text, throttle_duration_sec=LOG_PERIOD)
            return False
        with self._lock:
            # The goal that the controller executes, however many stops have not been answered.
            before = self._waiting[2] if self._waiting else None
            self._waiting = sent, time.monotonic(), self._running or before
            self._newest, self._running = sent, None
        future.add_done_callback(self._node.guarded(partial(self._on_answer, sent)))
        return True

    def watch(self) -> None:
        """Cancel the goal before a stop that is not answered."""
        waiting = self._waiting
        if waiting is None or time.monotonic() - waiting[1] < self.answer_time:
            return
        # A goal may still be answered; a robot that is to stop does not wait for that.
        self._cancel_before(waiting[0], "", None)

    def _on_answer(self, sent: Trajectory, future: Any) -> None:
        handle = future.result()
        if not handle.accepted:
            self._cancel_before(sent, "rejected the goal", MotionOutcome.NEVER_STARTED)
            return
        with self._lock:
            if self._newest is sent:
                self._waiting, self._running = None, handle
        self._hear(sent, ACCEPTED, None)
        result = handle.get_result_async()
        result.add_done_callback(self._node.guarded(partial(self._on_result, sent, handle)))

    def _cancel_before(self, sent: Trajectory, text: str, failure: MotionOutcome | None) -> None:
        """Hear that a goal is not executed; cancel the one before if it was a stop."""
        is_stop = self._hear(sent, text, failure)
        with self._lock:
            waiting = self._waiting
            if waiting is None or waiting[0] is not sent:
                return
            self._waiting, self._running = None, waiting[2]
        if is_stop and waiting[2] is not None:
            waiting[2].cancel_goal_async()

    def _on_result(self, sent: Trajectory, handle: ClientGoalHandle, future: Any) -> None:
        with self._lock:
            if self._running is handle:
                self._running = None
        status, result = future.result().status, future.result().result
        code = f"{result.error_code} ({_CODES.get(result.error_code, 'unknown')})"
        end = {_SUCCEEDED: "ended", _CANCELED: "cancelled"}.get(status, "aborted")
        text = to_text(f"{end} the goal with code {code}: {result.error_string or 'no text'}")
        failure = None if status == _SUCCEEDED else MotionOutcome.NOT_FOLLOWED
        with suppress(Exception):  # the node may be ending
            self._hear(sent, text, failure)
