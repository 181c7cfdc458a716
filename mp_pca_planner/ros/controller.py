# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The controller of the robot: the command that it states, and its action."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.action.graph import get_action_server_names_and_types_by_node
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from ..exceptions import GoalError
from ..execution.outcomes import ACCEPTED, MotionOutcome
from ..execution.parameters import Settings
from ..execution.tracking import StatedCommand
from ..files import reading
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from .messages import to_text
from .nodes import LOG_PERIOD

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

Hear = Callable[[Trajectory, str, MotionOutcome | None], None]


def to_command(content: bytes, joint_names: Sequence[str], time: float) -> StatedCommand:
    """Read the command of some joints from the state of a controller, serialised at a time [s].

    Raises
    ------
    GoalError
        If it is malformed, lacks one of the joints, or a number is not finite.
    """
    with reading("the state of the controller", GoalError):
        message = deserialize_message(content, JointTrajectoryControllerState)
    names, reference = list(message.joint_names), message.reference
    rows = [reference.positions, reference.velocities, reference.accelerations]
    if len(reference.accelerations) == 0:
        rows[2] = [0.0] * len(names)
    lengths = {len(row) for row in rows}
    if lengths != {len(names)} or any(names.count(name) != 1 for name in joint_names):
        raise GoalError("the state of the controller lacks a joint, or a number of one")
    q, v, a = ([row[names.index(name)] for name in joint_names] for row in rows)
    rate = message.speed_scaling_factor
    if not (all(map(math.isfinite, (*q, *v, *a))) and 0.0 <= rate <= 10.0):
        raise GoalError("the state of the controller has a number that is not finite")
    return StatedCommand(JointState(tuple(joint_names), q, v, a), rate, time)


@dataclass(eq=False)
class _SentGoal:
    """A trajectory that was sent as a goal, and its handle once it is accepted."""

    sent: Trajectory
    is_stop: bool
    time: float
    handle: ClientGoalHandle | None = None
    is_revoked: bool = False


class ControllerAction:
    """Sends motions as goals to the action of a controller, and hears its answers.

    Goals are never cancelled while the controller may execute a newer one: a stop is a goal, too,
    which replaces the running one smoothly. A controller that is told to cancel holds the measured
    position at once. A goal is cancelled only if it is accepted after a stop was sent, or if the
    controller rejects the stop or does not answer it.

    Parameters
    ----------
    node : Node
        The node.
    hear : callable
        Takes a trajectory that was sent, the answer to it, and how it failed, if it did. See
        `MotionServer.hear`.
    """

    answer_time = 0.3
    """Time after which a stop without an answer does not count [s]."""

    def __init__(self, node: Node, hear: Hear) -> None:
        self._node, self._hear = node, hear
        self._name = ""
        self._client: ActionClient | None = None
        # Goals without a result, the newest last.
        self._goals: list[_SentGoal] = []

    def use(self, settings: Settings) -> None:
        """Be a client of the action that the parameters name."""
        if settings.controller_action == self._name:
            return
        old, self._name = self._client, settings.controller_action
        self._client, self._goals = None, []
        if self._name:
            self._client = ActionClient(self._node, FollowJointTrajectory, self._name)
        if old is not None:
            old.destroy()

    @property
    def state(self) -> str:
        """Whether motions are sent to the action, and why not."""
        if self._client is None:
            return "none"
        if self._client.server_is_ready():
            return "ready"
        return f"no server for '{self._name}': motions are sent on the topic alone"

    @property
    def has_unanswered_motion(self) -> bool:
        """Whether a motion that is no stop may still be accepted."""
        return any(goal.handle is None and not goal.is_stop for goal in self._goals)

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

    def send(self, sent: Trajectory, content: bytes, *, is_stop: bool) -> bool:
        """Send a trajectory and its serialised message as a goal; returns whether that was done."""
        client = self._client
        if client is None or not client.server_is_ready():
            return False
        try:
            goal = FollowJointTrajectory.Goal(
                trajectory=deserialize_message(content, JointTrajectory)
            )
            future = client.send_goal_async(goal)
        except Exception as error:  # in any case, a stop must go out: by the topic then
            text = f"a goal was not sent to the controller: {error!r:.500}"
            self._node.get_logger().error(text, throttle_duration_sec=LOG_PERIOD)
            return False
        if is_stop:
            for before in self._goals:
                before.is_revoked = True
        entry = _SentGoal(sent, is_stop, time.monotonic())
        self._goals.append(entry)
        future.add_done_callback(partial(self._on_answer, entry))
        return True

    def watch(self) -> None:
        """Cancel what is executed before a stop that is not answered."""
        # A goal may still be answered; a robot that is to stop does not wait for that.
        late = time.monotonic() - self.answer_time
        for goal in self._goals:
            if goal.is_stop and goal.handle is None and goal.time <= late:
                self._cancel_before(goal)

    def _on_answer(self, entry: _SentGoal, future: Any) -> None:
        handle = future.result()
        if not handle.accepted:
            self._hear(entry.sent, "rejected the goal", MotionOutcome.NEVER_STARTED)
            if entry.is_stop:
                self._cancel_before(entry)
            self._forget(entry)
            return
        entry.handle = handle
        if entry.is_revoked and not entry.is_stop:
            handle.cancel_goal_async()
        self._hear(entry.sent, ACCEPTED, None)
        handle.get_result_async().add_done_callback(partial(self._on_result, entry))

    def _cancel_before(self, stop: _SentGoal) -> None:
        """Cancel the motions before a stop that is not executed."""
        for goal in self._goals:
            if goal is stop:
                return
            if goal.handle is not None and not goal.is_stop:
                goal.handle.cancel_goal_async()

    def _on_result(self, entry: _SentGoal, future: Any) -> None:
        self._forget(entry)
        status, result = future.result().status, future.result().result
        constants = {v: name for name, v in vars(type(result)).items() if isinstance(v, int)}
        code = f"{result.error_code} ({constants.get(result.error_code, 'unknown')})"
        end = {_SUCCEEDED: "ended", _CANCELED: "cancelled"}.get(status, "aborted")
        text = to_text(f"{end} the goal with code {code}: {result.error_string or 'no text'}")
        failure = None if status == _SUCCEEDED else MotionOutcome.NOT_FOLLOWED
        self._hear(entry.sent, text, failure)

    def _forget(self, entry: _SentGoal) -> None:
        # A controller that never answers must not fill the memory.
        self._goals = [goal for goal in self._goals if goal is not entry][-100:]
