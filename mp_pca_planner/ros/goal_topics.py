# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The topics of goals, the thread of planning, and the report of each goal."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState as JointStateMessage
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from ..exceptions import GoalError, unknown_name
from ..execution.serving.assembly import Model, is_outdated
from ..execution.serving.execution import Served
from ..execution.serving.goal_planner import GoalRequest, UnexecutablePlanError
from ..execution.serving.motion_server import GoalStatistics, MotionServer
from ..execution.threads import CancelledError, IsCancelled, PreemptiveWorker
from ..motion.goal import JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from ..planning.requests.resolve import in_order
from ..robot.model import Robot
from . import messages
from .last_motion import LastMotion
from .nodes import LOG_PERIOD, GuardedNode
from .planning_setup import PlanningSetup
from .subscriptions import EVERY, GOALS, GroupExecutor, ThreadGroup

# Longest wait for a model of the present positions of other joints [s], and how many models a goal
# is planned with at most.
_LONGEST_WAIT, _MAX_MODELS = 1.0, 5


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
    message : object
        The message.
    ignored_joints : tuple of str
        Joints of the message that the primitives don't move.
    """

    message: Any = None
    ignored_joints: tuple[str, ...] = ()

    def check(self) -> None:
        """Raise a `PlannerError` if the goal can be rejected without planning."""
        if isinstance(self.goal, JointGoal):
            self.model.planner.check(self.goal)


class _Reaction:
    """The request to replace a motion that would hit a new obstacle, or to go on after a stop."""


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
        self._worker: PreemptiveWorker[_Request | _Reaction] = PreemptiveWorker(
            self._serve, self._on_preempted, last_motion.show_preview, self._on_failure
        )
        group = ThreadGroup()
        for message_type, topic in (
            (JointStateMessage, "~/goal"),
            (PoseStamped, "~/goal_pose"),
            (JointTrajectory, "~/goal_sequence"),
        ):
            node.create_subscription(
                message_type,
                topic,
                partial(self._receive, message_type),
                GOALS,
                callback_group=group,
                raw=True,
            )
        # A separate thread, so that no goal waits for new parameters or primitives.
        self._executor = GroupExecutor(node, group)

    def react(self) -> None:
        """Replace the running motion, stop the robot, or go on; after the goal being served."""
        self._worker.submit_if_idle(_Reaction())

    def cancel(self) -> None:
        """Cancel all goals that wait or are being planned."""
        self._worker.cancel()

    def close(self) -> None:
        """End the threads, before the node is destroyed."""
        self._executor.shutdown()
        self._worker.close()

    def stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Callback of the service that stops the robot, which cancels all goals."""
        self._worker.cancel()
        try:
            # Whatever prevents goals, the robot that was given one can be stopped.
            context = self._setup.last_context or self._setup.ready()
            response.message = self._server.monitor.stop(context)
        except Exception as error:
            response.message = f"nothing was published: {self._node.explain(error)}"
        else:
            response.success = True
        return response

    def _receive(self, message_type: Any, content: bytes) -> None:
        try:
            context = self._setup.ready()
            request = _read(messages.read_goal(content, message_type), context)
            # An invalid goal must not preempt a running one. If none is running, planning reports
            # the error.
            if not self._worker.is_idle:
                request.check()
        except Exception as error:
            stamp = messages.read_stamp(content)
            self._reject(messages.to_refusal(self._node.explain(error), stamp))
        else:
            self._worker.submit(request)

    def _serve(self, request: _Request | _Reaction, is_cancelled: IsCancelled) -> None:
        """Serve a goal, then react to an obstacle that the running motion would hit."""
        if isinstance(request, _Request):
            self._serve_goal(request, is_cancelled)
        has_threat = self._server.monitor.surroundings.threat is not None
        if not has_threat and isinstance(request, _Request):
            return
        react = self._server.avoid_obstacle if has_threat else self._server.go_on
        logger = self._node.get_logger()
        try:
            text, served = react(self._setup.ready(), is_cancelled)
        except CancelledError:
            raise
        except Exception as error:
            text = f"no reaction to an obstacle: {self._node.explain(error)}"
            logger.error(text, throttle_duration_sec=LOG_PERIOD)
        else:
            if served is not None:
                self._last_motion.replace(served)
            if text:
                logger.warning(messages.to_text(text))

    def _serve_goal(self, request: _Request, is_cancelled: IsCancelled) -> None:
        """Plan, publish and report, in the thread of the worker."""
        stamp: Time = request.name

        def is_over() -> bool:
            is_held = bool(self._setup.hold) or self._setup.context is not request.model
            return is_cancelled() or is_held

        try:
            for _ in range(_MAX_MODELS):
                request = self._with_present_model(request, is_cancelled)
                try:
                    served = self._server.serve(request, is_over)
                    break
                except CancelledError:
                    if is_cancelled() or not self._is_relocked(request.model):
                        raise
            else:
                raise GoalError(
                    "joints that the primitives do not move were moving during planning; send the "
                    "goal again when they are at rest"
                )
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
        else:
            # The motion is published: an error in its report is logged, and rejects nothing.
            self._node.guarded(self._report)(served, request)

    def _with_present_model(self, request: _Request, is_cancelled: IsCancelled) -> _Request:
        """The request with the model of the present positions of all joints.

        The thread of parameters makes that model; while joints keep moving, the newest one counts.
        """
        monitor = self._server.monitor
        measured, world = monitor.follower.measured, monitor.surroundings.world
        deadline = time.monotonic() + _LONGEST_WAIT
        while time.monotonic() < deadline and not is_cancelled():
            if not is_outdated(self._setup.ready(), measured.others, world):
                break
            time.sleep(0.01)
        context = self._setup.ready()
        return request if context is request.model else _read(request.message, context)

    def _is_relocked(self, model: Model) -> bool:
        """Whether the present model differs in positions of locked joints alone."""
        context = self._setup.context
        return context is not None and not self._setup.hold and context.settings is model.settings

    def _report(self, served: Served, request: _Request) -> None:
        plan, stamp = served.plan, request.name
        if served.under_way:
            self._statistics.count("under_way")
            self._reports.publish(messages.to_under_way_report(plan, served.under_way, stamp))
            return
        # A cost may follow the report at once.
        self._last_motion.replace(served)
        missing = self._server.monitor.surroundings.missing
        report = messages.to_plan_report(
            plan, stamp, served.primitives, request.ignored_joints, missing
        )
        self._reports.publish(report)
        seconds = plan.trajectory.duration  # as in the report, without a hold before the motion
        times = f"{seconds:.4g} s long, planned in {1e3 * plan.solve_time:.3g} ms"
        self._node.get_logger().info(messages.to_text(f"goal served: {plan.message} ({times})"))

    def _reject(self, report: DiagnosticStatus) -> None:
        self._statistics.count("refused")
        self._node.get_logger().warning(
            f"goal refused: {report.message}", throttle_duration_sec=LOG_PERIOD
        )
        self._reports.publish(report)
        self._node.guarded(self._last_motion.erase_preview)()

    def _on_failure(self, request: _Request | _Reaction | None, error: BaseException) -> None:
        """Log what nothing else caught; a goal is rejected."""
        text = self._node.explain(error)
        self._node.get_logger().error(text, throttle_duration_sec=LOG_PERIOD)
        if isinstance(request, _Request):
            self._reject(messages.to_refusal(text, request.name))

    def _on_preempted(self, request: _Request | _Reaction) -> None:
        if isinstance(request, _Reaction):
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
        return _Request(posed, context, header.stamp, make_goal, message)
    stated: JointGoal | SequenceGoal
    if isinstance(message, JointTrajectory):
        stated = messages.to_sequence_goal(message)
    else:
        stated = messages.to_goal(message, duration)
    goal, ignored = _without_unmoved(stated, context.robot)
    return _Request(goal, context, header.stamp, message=message, ignored_joints=ignored)


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
