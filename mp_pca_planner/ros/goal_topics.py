# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The topics of goals, the report of each goal, and the service that stops the robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState as JointStateMessage
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from ..exceptions import GoalError, unknown_name
from ..execution.assembly import Model
from ..execution.avoidance import avoid_obstacle
from ..execution.goal_planner import GoalRequest, UnexecutablePlanError
from ..execution.motion_server import GoalStatistics, MotionServer
from ..execution.preemptive_worker import CancelledError, IsCancelled, PreemptiveWorker
from ..execution.served_goal import Served
from ..motion.goal import JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from ..planning.requests.states import in_order
from ..robot.model import Robot
from . import messages
from .guarded_node import LOG_PERIOD, GuardedNode
from .last_motion import LastMotion
from .planning_setup import PlanningSetup
from .subscriptions import EVERY, GOALS, GroupExecutor, ThreadGroup


def stated_in(goal: PoseGoal, reference: str, robot: Robot) -> Callable[[JointState], PoseGoal]:
    """Return the conversion of a goal from a reference frame to the frame of the base.

    Parameters
    ----------
    goal : PoseGoal
        Its pose is relative to the reference frame.
    reference : str
        A link of the robot; empty: its base. For a moving link, its pose at the start of the
        motion counts: "10 cm forward" in the frame of a tool.
    robot : Robot
        The robot with the links.

    Raises
    ------
    GoalError
        If there is no such link.

    Returns
    -------
    :
        Takes the start state of the motion and returns the goal in the frame of the base.
    """
    if not reference:
        return lambda _: goal
    if reference not in robot.frame_names:
        reason = unknown_name("link of the robot", reference, robot.frame_names)
        raise GoalError(
            f"the goal is stated in the frame '{reference}', but {reason}; an empty frame_id "
            "means the base"
        )

    def make_goal(start: JointState) -> PoseGoal:
        # Imported late for a fast start of the node.
        from scipy.spatial.transform import Rotation

        q = in_order(start, robot.joint_names).positions
        (place,) = robot.attached_poses(q[None], [reference], np.zeros((1, 6)))[0]
        turned, pose = Rotation.from_quat(place[3:]), goal.pose
        orientation = pose.orientation
        if orientation is not None:
            orientation = (turned * Rotation.from_quat(orientation)).as_quat()
        position = place[:3] + turned.as_matrix() @ pose.position
        return replace(goal, pose=Pose(pose.frame, position, orientation))

    return make_goal


@dataclass(frozen=True, eq=False)
class _Request(GoalRequest):
    """A goal, named by the stamp of its message.

    Attributes
    ----------
    ignored_joints : tuple of str
        Joints of the message that the primitives don't move.
    """

    ignored_joints: tuple[str, ...] = ()

    def check(self) -> None:
        """Raise a `PlannerError` if the goal can be rejected without planning."""
        if isinstance(self.goal, JointGoal):
            self.model.planner.check(self.goal)


class _Avoidance:
    """The request to replace a motion that would hit a new obstacle."""


class GoalTopics:
    """Receives goals, has the newest one served, and publishes a report for each.

    Parameters
    ----------
    node : GuardedNode
        The node.
    setup : PlanningSetup
        Makes the planning context.
    server : MotionServer
        Plans and publishes motions.
    statistics : GoalStatistics
        Counts goals.
    last_motion : LastMotion
        Records each published motion before its report, and previews it when no goals have come for
        a moment; a rejected goal erases the preview.
    """

    def __init__(
        self,
        node: GuardedNode,
        setup: PlanningSetup,
        server: MotionServer,
        statistics: GoalStatistics,
        last_motion: LastMotion,
    ) -> None:
        self._node, self._setup, self._server = node, setup, server
        self._statistics, self._last_motion = statistics, last_motion
        self._reports = node.create_publisher(DiagnosticStatus, "~/plan_report", EVERY)
        self._worker: PreemptiveWorker[_Request | _Avoidance] = PreemptiveWorker(
            self._serve, self._on_preempted, node.guarded(last_motion.show_preview)
        )
        group = ThreadGroup()
        for message_type, topic in (
            (JointStateMessage, "~/goal"),
            (PoseStamped, "~/goal_pose"),
            (JointTrajectory, "~/goal_sequence"),
        ):
            node.create_subscription(
                message_type, topic, self._receive, GOALS, callback_group=group
            )
        node.create_service(Trigger, "~/stop", self._on_stop, callback_group=group)
        # A separate thread, so that neither waits for new parameters or primitives.
        self._executor = GroupExecutor(node, group)

    def avoid(self) -> None:
        """Replace the running motion, or stop the robot; after the goal that is being served."""
        self._worker.submit_if_idle(_Avoidance())

    def cancel(self) -> None:
        """Cancel all goals that wait or are being planned."""
        self._worker.cancel()

    def close(self) -> None:
        """End the threads, before the node is destroyed."""
        self._executor.shutdown()
        self._worker.close()

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._worker.cancel()
        try:
            # Whatever prevents goals, the robot that was given one can be stopped.
            context = self._setup.last_context or self._setup.ready()
            response.message = self._server.stop(context)
        except Exception as error:
            response.message = f"nothing was published: {self._node.explain(error)}"
        else:
            response.success = True
        return response

    def _receive(self, message: Any) -> None:
        try:
            request = _read(message, self._setup.ready())
            # An invalid goal must not preempt a running one. If none is running, planning reports
            # the error.
            if not self._worker.is_idle:
                request.check()
        except Exception as error:
            self._reject(messages.to_refusal(self._node.explain(error), message.header.stamp))
        else:
            self._worker.submit(request)

    def _serve(self, request: _Request | _Avoidance, is_cancelled: IsCancelled) -> None:
        """Serve a goal, then avoid an obstacle that the running motion would hit."""
        if isinstance(request, _Request):
            self._serve_goal(request, is_cancelled)
        if self._server.surroundings.threat is None:
            return
        logger = self._node.get_logger()
        try:
            text, served = avoid_obstacle(self._server, self._setup.ready(), is_cancelled)
        except CancelledError:
            raise
        except Exception as error:
            text = f"the robot was not stopped: {self._node.explain(error)}"
            logger.error(text, throttle_duration_sec=LOG_PERIOD)
        else:
            if served is not None:
                self._last_motion.replace(served)
            logger.warning(messages.to_text(text or "the obstacle is no longer on the path"))

    def _serve_goal(self, request: _Request, is_cancelled: IsCancelled) -> None:
        """Plan, publish and report, in the thread of the worker."""
        stamp: Time = request.name

        def is_over() -> bool:
            is_held = bool(self._setup.hold) or self._setup.context is not request.model
            return is_cancelled() or is_held

        try:
            served = self._server.serve(request, is_over)
            self._report(served, request)
        except UnexecutablePlanError as error:
            self._reject(messages.to_refusal(str(error), stamp, error.plan))
        except CancelledError:
            if is_cancelled():
                raise
            changed = "the parameters, the primitives or the robot description changed during "
            reason = self._setup.hold or f"{changed}planning; send the goal again"
            self._reject(messages.to_refusal(reason, stamp))
        except Exception as error:
            self._reject(messages.to_refusal(self._node.explain(error), stamp))

    def _report(self, served: Served, request: _Request) -> None:
        plan, stamp = served.plan, request.name
        if served.under_way:
            self._statistics.count("under_way")
            self._reports.publish(messages.to_under_way_report(plan, served.under_way, stamp))
            return
        # A cost may follow the report at once.
        self._last_motion.replace(served)
        library = served.model.planner.primitives
        used = [library.named(name) for name in dict.fromkeys(plan.primitives)]
        report = messages.to_plan_report(
            plan, stamp, used, request.ignored_joints, self._server.surroundings.missing
        )
        self._reports.publish(report)
        times = f"{served.motion.duration:.3g} s long, planned in {1e3 * plan.solve_time:.3g} ms"
        self._node.get_logger().info(messages.to_text(f"goal served: {plan.message} ({times})"))

    def _reject(self, report: DiagnosticStatus) -> None:
        self._statistics.count("refused")
        self._node.get_logger().warning(
            f"goal refused: {report.message}", throttle_duration_sec=LOG_PERIOD
        )
        self._reports.publish(report)
        self._last_motion.erase_preview()

    def _on_preempted(self, request: _Request | _Avoidance) -> None:
        if isinstance(request, _Avoidance):
            return
        try:
            request.check()
        except Exception as error:
            self._reject(messages.to_refusal(self._node.explain(error), request.name))
        else:
            self._statistics.count("overtaken")
            self._reports.publish(messages.to_overtaken_report(request.name))


def _read(message: JointStateMessage | PoseStamped | JointTrajectory, context: Model) -> _Request:
    """Read a goal, or raise a `PlannerError` if it is malformed."""
    header, duration = message.header, context.settings.duration
    if isinstance(message, PoseStamped):
        posed = messages.to_pose_goal(message, context.end_effector, duration)
        make_goal = stated_in(posed, header.frame_id, context.planning_robot)
        return _Request(posed, context, header.stamp, make_goal)
    stated: JointGoal | SequenceGoal
    if isinstance(message, JointTrajectory):
        stated = messages.to_sequence_goal(message)
    else:
        stated = messages.to_goal(message, duration)
    goal, ignored = _without_unmoved(stated, context.robot)
    return _Request(goal, context, header.stamp, ignored_joints=ignored)


def _without_unmoved(
    goal: JointGoal | SequenceGoal, robot: Robot
) -> tuple[JointGoal | SequenceGoal, tuple[str, ...]]:
    """The goal without the robot's joints that don't move here, and the names of these.

    Messages of a whole robot name the joints of its gripper, too. A goal that names no other
    joints is left as it is, and rejected later.
    """
    states = goal.targets if isinstance(goal, SequenceGoal) else (goal.state,)
    names = next(state.joint_names for state in states if isinstance(state, JointState))
    still = set(robot.movable_joints) - set(robot.joint_names)
    kept = tuple(name for name in names if name not in still)
    if len(kept) in (0, len(names)):
        return goal, ()
    reduced = tuple(in_order(state, kept) for state in states if isinstance(state, JointState))
    ignored = tuple(name for name in names if name in still)
    if isinstance(goal, SequenceGoal):
        return replace(goal, targets=reduced), ignored
    return replace(goal, state=reduced[0]), ignored
