# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals: a table of their topics, what is read of each message, and how each is answered.

A further topic is a row of `GOAL_TOPICS`: node, client and live view are made from it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState as JointStateMessage
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..arrays import FloatArray
from ..exceptions import GoalError, quote_names, unknown_name
from ..execution.serving.assembly import Model, is_outdated
from ..execution.serving.execution import GoalOutcome, Served
from ..execution.serving.motion_server import (
    AnyPlan,
    GoalRequest,
    GoalStatistics,
    MotionServer,
    UnexecutablePlanError,
)
from ..execution.threads import SAFETY_WAIT, BusyError, IsCancelled, PreemptiveWorker
from ..files import reading
from ..input_limits import INPUT_LIMITS
from ..motion.goal import Goal, JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from ..planning.plan import ALREADY_THERE
from ..planning.resolve import in_order
from ..recordings.joint_states import NS_PER_S
from ..robot.model import Robot
from .last_motion import LastMotion
from .messages import check_finite, joint_state, to_goal_report, to_plan_report, to_seconds, to_text
from .nodes import EVERY, GOALS, LOG_PERIOD, GroupExecutor, GuardedNode, ThreadGroup
from .obstacle_topic import ForeignFrames
from .planning_setup import PlanningSetup
from .serialised import CdrReader, read_message

MakeGoal = Callable[[JointState], Goal]
"""Returns a goal for a motion from a start state."""

PoseOf = Callable[[str], FloatArray | None]
"""Returns the pose of a frame in the base frame, shape (7,), or None if it is unknown."""

Stated = tuple[Goal, MakeGoal | None, tuple[str, ...]]
"""A goal, how it depends on the start if it does, and the joints that the primitives don't move."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ReceivedGoal(GoalRequest):
    """A goal that was received, named by the stamp of its message.

    Attributes
    ----------
    message : object
        The message.
    topic : GoalTopic
        The topic that it came on.
    ignored_joints : tuple of str
        Joints of the message that the primitives don't move.
    """

    message: Any
    topic: GoalTopic
    ignored_joints: tuple[str, ...] = ()

    def check(self) -> None:
        """Raise a `PlannerError` if the goal can be rejected without planning."""
        if isinstance(self.goal, JointGoal):
            self.model.planner.check(self.goal)


@dataclass(frozen=True)
class GoalTopic:
    """A topic of goals.

    Attributes
    ----------
    name : str
        Its name, below that of the node.
    message_type : type
        Type of its messages.
    read : callable
        Returns the goal of a message for a model, given the poses of frames that are not links;
        raises a `PlannerError` if it is malformed.
    text : callable
        Describes a message in one line.
    """

    name: str
    message_type: type[Any]
    read: Callable[[Any, Model, PoseOf], Stated]
    text: Callable[[Any], str]

    def goal(self, message: Any, model: Model, pose_of: PoseOf) -> ReceivedGoal:
        """The goal of a message for a model, or a `PlannerError` if it is malformed."""
        goal, make_goal, ignored = self.read(message, model, pose_of)
        return ReceivedGoal(
            goal,
            model,
            message.header.stamp,
            make_goal,
            message=message,
            topic=self,
            ignored_joints=ignored,
        )


def read_stamp(content: bytes) -> Time:
    """The stamp at the begin of a serialised message; zero if the message is too short."""
    with suppress(GoalError), reading("a stamp", GoalError):
        return Time(**dict(zip(("sec", "nanosec"), CdrReader(content).numbers("iI"), strict=True)))
    return Time()


def read_goal(content: bytes, message_type: type[Any]) -> Any:
    """Deserialise the message of a goal.

    Joints and points are counted before: an object of each takes a second for 100,000 points.

    Raises
    ------
    GoalError
        If it is malformed, or joints or points are too many.
    """
    _, *kinds = message_type.get_fields_and_field_types().values()  # after the header
    with reading("the message of the goal", GoalError):
        if kinds[0] == "sequence<string>":
            reader = CdrReader(content)
            reader.numbers("iI")
            reader.text()
            n_names = reader.count(4)
            _check_count("names", n_names, "joints")
            if kinds[1] == "sequence<trajectory_msgs/JointTrajectoryPoint>":
                for _ in range(n_names):
                    reader.text()
                _check_count("has", reader.count(24), "points")
        return read_message(content, message_type)


def _check_count(verb: str, n: int, things: str) -> None:
    most = INPUT_LIMITS.goal_items
    if n > most:
        raise GoalError(f"the goal {verb} {n} {things}, at most {most} are accepted")


def _read_configuration(message: JointStateMessage, model: Model, _: PoseOf) -> Stated:
    goal, ignored = _without_unmoved(to_goal(message, model.settings.duration), model.robot)
    return goal, None, ignored


def _read_pose(message: PoseStamped, model: Model, pose_of: PoseOf) -> Stated:
    goal = to_pose_goal(message, model.end_effector, model.settings.duration)
    return goal, stated_in(goal, message.header.frame_id, model.planning_robot, pose_of), ()


def _read_sequence(message: JointTrajectory, model: Model, _: PoseOf) -> Stated:
    goal, ignored = _without_unmoved(to_sequence_goal(message), model.robot)
    return goal, None, ignored


def _configuration_text(message: JointStateMessage) -> str:
    values = zip(message.name, message.position, strict=False)
    return "  ".join(f"{name} {value:.3f}" for name, value in values)


def _pose_text(message: PoseStamped) -> str:
    p, o = message.pose.position, message.pose.orientation
    numbers = "  ".join(f"{x:.3f}" for x in (p.x, p.y, p.z, o.x, o.y, o.z, o.w))
    return f"pose {numbers} in '{message.header.frame_id}'"


def _sequence_text(message: JointTrajectory) -> str:
    return f"{len(message.points)} configurations of {len(message.joint_names)} joints"


GOAL_TOPICS = (
    GoalTopic("goal", JointStateMessage, _read_configuration, _configuration_text),
    GoalTopic("goal_pose", PoseStamped, _read_pose, _pose_text),
    GoalTopic("goal_sequence", JointTrajectory, _read_sequence, _sequence_text),
)
"""All topics of goals."""


def to_goal(message: JointStateMessage, duration: float) -> JointGoal:
    """Read a goal.

    Parameters
    ----------
    message :
        Positions by joint name; velocities at the end, if there are any; in its frame_id the
        name of the primitive, if it isn't empty. Efforts are not used.
    duration : float
        Duration of the motion [s]; 0 leaves it to the planner.

    Raises
    ------
    GoalError
        If names repeat or are too many, lengths disagree or a number is not finite.
    """
    _check_count("names", len(message.name), "joints")
    names = range(len(message.name))
    state = joint_state(message, message.velocity, names, "goal", "goal")
    return JointGoal(state, duration or None, message.header.frame_id or None)


def to_pose_goal(message: PoseStamped, frame: str, duration: float) -> PoseGoal:
    """Read a pose goal, relative to the frame in which it is stated.

    Parameters
    ----------
    message :
        The pose; its frame_id is not used.
    frame : str
        The link of the robot that the pose is for.
    duration : float
        Duration of the motion [s]; 0 leaves it to the planner.

    Raises
    ------
    GoalError
        If a number is not finite or the quaternion not of length 1.
    """
    p, o = message.pose.position, message.pose.orientation
    return PoseGoal(Pose(frame, [p.x, p.y, p.z], [o.x, o.y, o.z, o.w]), duration or None)


def to_sequence_goal(message: JointTrajectory) -> SequenceGoal:
    """Read configurations to pass and to end at.

    Parameters
    ----------
    message :
        One configuration per point; a time from start above 0 says when to be there, velocities
        of 0 that the motion stops there. In its frame_id the name of the primitive, if it isn't
        empty.

    Raises
    ------
    GoalError
        If names repeat, names or points are too many, lengths disagree, a number is not finite,
        times don't increase, or velocities, accelerations or efforts are specified.
    """
    _check_count("names", len(message.joint_names), "joints")
    _check_count("has", len(message.points), "points")
    targets = []
    for k, point in enumerate(message.points, start=1):
        _check_point(k, point, message.joint_names)
        targets.append(JointState(message.joint_names, point.positions))
    times = tuple(to_seconds(point.time_from_start) or None for point in message.points)
    stops = tuple(bool(point.velocities) for point in message.points)
    return SequenceGoal(tuple(targets), times, message.header.frame_id or None, stops)


def _check_point(k: int, point: JointTrajectoryPoint, joint_names: Sequence[str]) -> None:
    """Raise a `GoalError` if the k-th point of a sequence is not accepted."""
    n = len(joint_names)
    if len(point.positions) != n:
        raise GoalError(
            f"the goal names {n} joints and point {k} has {len(point.positions)} positions, "
            "one for each joint is accepted"
        )
    values = zip(joint_names, point.positions, strict=True)
    check_finite(f"point {k} of the goal puts joint '{{}}' at {{}}", values)
    if len(point.velocities) not in (0, n):
        raise GoalError(
            f"the goal names {n} joints and point {k} has {len(point.velocities)} velocities: "
            "none, or one of 0 for each joint to stop there, is accepted"
        )
    for field in ("velocities", "accelerations", "effort"):
        if any(getattr(point, field)):
            raise GoalError(
                f"point {k} of the goal specifies {field}; accepted are positions, and "
                "velocities of 0 to stop there"
            )


def stated_in(
    goal: PoseGoal, reference: str, robot: Robot, pose_of: PoseOf
) -> Callable[[JointState], PoseGoal]:
    """Return the conversion of a goal from a reference frame to the frame of the base.

    Parameters
    ----------
    goal : PoseGoal
        Its pose is relative to the reference frame.
    reference : str
        A link of the robot, or another frame; empty: the base. For a moving link, its pose at the
        start of the motion counts: "10 cm forward" in the frame of a tool.
    robot : Robot
        The robot with the links.
    pose_of : callable
        Returns the poses of other frames.

    Raises
    ------
    GoalError
        If the pose of the frame is not known.

    Returns
    -------
    :
        Takes the start state of the motion and returns the goal in the frame of the base.
    """
    if not reference:
        return lambda _: goal
    if reference not in robot.frame_names:
        foreign = pose_of(reference)
        if foreign is None:
            reason = unknown_name("link of the robot", reference, robot.frame_names)
            raise GoalError(
                f"the goal is stated in the frame '{reference}', but {reason}; an empty frame_id "
                "means the base. For other frames, set the parameter 'fixed_frames' (FRAME: X Y "
                "Z), or publish their transforms to tf2"
            )
        moved = _moved(goal, foreign)
        return lambda _: moved

    def make_goal(start: JointState) -> PoseGoal:
        q = in_order(start, robot.joint_names).positions
        (place,) = robot.attached_poses(q[None], [reference], np.zeros((1, 6)))[0]
        return _moved(goal, place)

    return make_goal


def _moved(goal: PoseGoal, place: FloatArray) -> PoseGoal:
    """A goal that is stated in a frame at a place (x, y, z and a quaternion)."""
    # Imported late for a fast start of the node.
    from scipy.spatial.transform import Rotation

    turned, pose = Rotation.from_quat(place[3:]), goal.pose
    orientation = pose.orientation
    if orientation is not None:
        orientation = (turned * Rotation.from_quat(orientation)).as_quat()
    position = place[:3] + turned.as_matrix() @ pose.position
    return replace(goal, pose=Pose(pose.frame, position, orientation))


def _without_unmoved(
    goal: JointGoal | SequenceGoal, robot: Robot
) -> tuple[JointGoal | SequenceGoal, tuple[str, ...]]:
    """The goal without the robot's joints that don't move here, and the names of these.

    Messages of a whole robot name the joints of its gripper, too.

    Raises
    ------
    GoalError
        If it names no other joints.
    """
    states = goal.targets if isinstance(goal, SequenceGoal) else (goal.state,)
    names = next(state.joint_names for state in states if isinstance(state, JointState))
    still = set(robot.movable_joints) - set(robot.joint_names)
    kept = tuple(name for name in names if name not in still)
    if names and not kept:
        raise GoalError(
            f"the primitives do not move {quote_names(names)} of the goal; a goal names at least "
            f"one of {quote_names(robot.joint_names)}"
        )
    if len(kept) == len(names):
        return goal, ()
    reduced = tuple(in_order(state, kept) for state in states if isinstance(state, JointState))
    ignored = tuple(name for name in names if name in still)
    if isinstance(goal, SequenceGoal):
        return replace(goal, targets=reduced), ignored
    return replace(goal, state=reduced[0]), ignored


def to_sequence_message(goal: SequenceGoal) -> JointTrajectory:
    """Write a sequence of configurations of the same joints.

    Raises
    ------
    GoalError
        If there is a pose among them, they differ in joints, or a time is too long for a message.
    """
    message = JointTrajectory(joint_names=list(getattr(goal.targets[0], "joint_names", ())))
    message.header.frame_id = goal.primitive or ""
    for target, when, stops in zip(goal.targets, goal.times, goal.stops, strict=True):
        if not isinstance(target, JointState) or [*target.joint_names] != message.joint_names:
            raise GoalError("all targets of a sequence must be configurations of the same joints")
        point = JointTrajectoryPoint(positions=target.positions.tolist())
        point.velocities = [0.0] * (len(target.joint_names) if stops else 0)
        if when is not None and when >= 2**31:
            raise GoalError(f"the time {when:g} s of a target is longer than a message can hold")
        since = point.time_from_start
        since.sec, since.nanosec = divmod(round((when or 0.0) * NS_PER_S), NS_PER_S)
        message.points.append(point)
    return message


def to_pose_message(pose: Pose) -> PoseStamped:
    """Write a pose that is stated in the frame that it names."""
    message = PoseStamped()
    message.header.frame_id = pose.frame
    to, turned = message.pose.position, message.pose.orientation
    to.x, to.y, to.z = pose.position.tolist()
    if pose.orientation is not None:
        turned.x, turned.y, turned.z, turned.w = pose.orientation.tolist()
    return message


# Longest wait for a model of the present positions of other joints [s], and how many models a goal
# is planned with at most.
_LONGEST_WAIT, _MAX_MODELS = 1.0, 5
# Longest wait for the transform of a frame [s]; a further goal waits, too.
_TRANSFORM_WAIT = 0.5

Work = ReceivedGoal | Literal["react"]
"""A goal, or the request to replace a motion that would hit a new obstacle."""


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
    frames : ForeignFrames
        Looks up the frames of poses that are not links.
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
        frames: ForeignFrames,
        last_motion: LastMotion,
    ) -> None:
        self._node, self._setup, self._server = node, setup, server
        self._statistics, self._frames, self._last_motion = statistics, frames, last_motion
        self._reports = node.create_publisher(DiagnosticStatus, "~/plan_report", EVERY)
        self._worker: PreemptiveWorker[Work] = PreemptiveWorker(
            self._serve, self._on_preempted, last_motion.show_preview, self._on_failure
        )
        group = ThreadGroup()
        for topic in GOAL_TOPICS:
            node.create_subscription(
                topic.message_type,
                f"~/{topic.name}",
                partial(self._receive, topic),
                GOALS,
                callback_group=group,
                raw=True,
            )
        # A separate thread, so that no goal waits for new parameters or primitives.
        self._executor = GroupExecutor(node, group)

    def react(self) -> None:
        """Replace the running motion or give it up; after the goal being served."""
        self._worker.submit_if_idle("react")

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

    def stays_stopped(self) -> bool:
        """Cancel all goals; whether none has moved the robot since it was stopped."""
        self._worker.cancel()
        monitor = self._server.monitor
        # A goal that is not cancelled is just being published, and holds the lock.
        with suppress(BusyError), monitor.follower.lock.within(SAFETY_WAIT):
            return monitor.served is None
        return False

    def _receive(self, topic: GoalTopic, content: bytes) -> None:
        try:
            context = self._setup.ready()
            request = self._goal(topic, read_goal(content, topic.message_type), context)
            # An invalid goal must not preempt a running one. If none is running, planning reports
            # the error.
            if not self._worker.is_idle:
                request.check()
        except Exception as error:
            self._reject(self._node.explain(error), read_stamp(content))
        else:
            self._worker.submit(request)

    def _serve(self, request: Work, is_cancelled: IsCancelled) -> None:
        """Serve a goal, then react to an obstacle that the running motion would hit."""
        if isinstance(request, ReceivedGoal):
            self._serve_goal(request, is_cancelled)
        has_threat = self._server.monitor.surroundings.threat is not None
        if not has_threat:
            return
        logger = self._node.get_logger()
        try:
            text, served = self._server.avoid_obstacle(self._setup.ready(), is_cancelled)
        except CancelledError:
            raise
        except Exception as error:
            text = f"no reaction to an obstacle: {self._node.explain(error)}"
            logger.error(text, throttle_duration_sec=LOG_PERIOD)
        else:
            if served is not None:
                self._last_motion.replace(served)
            if text:
                logger.warning(to_text(text))

    def _serve_goal(self, request: ReceivedGoal, is_cancelled: IsCancelled) -> None:
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
            if error.plan.status == ALREADY_THERE:
                self._finish(GoalOutcome.UNDER_WAY, str(error), stamp, error.plan)
            else:
                self._reject(str(error), stamp, error.plan)
        except CancelledError:
            if is_cancelled():
                raise
            changed = "the parameters, the primitives or the robot description changed during "
            reason = self._setup.hold or f"{changed}planning; send the goal again"
            self._reject(reason, stamp)
        except Exception as error:
            self._reject(self._node.explain(error), stamp)
        else:
            # The motion is published: an error in its report is logged, and rejects nothing.
            self._node.guarded(self._report)(served, request)

    def _with_present_model(self, request: ReceivedGoal, is_cancelled: IsCancelled) -> ReceivedGoal:
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
        if context is request.model:
            return request
        return self._goal(request.topic, request.message, context)

    def _goal(self, topic: GoalTopic, message: Any, model: Model) -> ReceivedGoal:
        pose_of = partial(self._frames.pose, model=model, wait=_TRANSFORM_WAIT)
        return topic.goal(message, model, pose_of)

    def _is_relocked(self, model: Model) -> bool:
        """Whether the present model differs in positions of locked joints alone."""
        context = self._setup.context
        return context is not None and not self._setup.hold and context.settings is model.settings

    def _report(self, served: Served, request: ReceivedGoal) -> None:
        plan, stamp = served.plan, request.name
        if served.under_way:
            self._finish(GoalOutcome.UNDER_WAY, served.under_way, stamp, plan)
            return
        # A cost may follow the report at once.
        self._last_motion.replace(served)
        missing = self._server.monitor.surroundings.missing
        report = to_plan_report(plan, stamp, served.primitives, request.ignored_joints, missing)
        self._reports.publish(report)
        seconds = plan.trajectory.duration  # as in the report, without a hold before the motion
        times = f"{seconds:.4g} s long, planned in {1e3 * plan.solve_time:.3g} ms"
        self._node.get_logger().info(to_text(f"goal served: {plan.message} ({times})"))

    def _reject(self, reason: str, stamp: Time, plan: AnyPlan | None = None) -> None:
        self._node.get_logger().warning(
            f"goal rejected: {to_text(reason)}", throttle_duration_sec=LOG_PERIOD
        )
        self._finish(GoalOutcome.REFUSED, reason, stamp, plan)
        self._node.guarded(self._last_motion.erase_preview)()

    def _finish(
        self, outcome: GoalOutcome, text: str, stamp: Time, plan: AnyPlan | None = None
    ) -> None:
        """Count a goal without a motion of its own, and report it."""
        self._statistics.count(outcome)
        self._reports.publish(to_goal_report(outcome, text, stamp, plan))

    def _on_failure(self, request: Work | None, error: BaseException) -> None:
        """Log what nothing else caught; a goal is rejected."""
        text = self._node.explain(error)
        self._node.get_logger().error(text, throttle_duration_sec=LOG_PERIOD)
        if isinstance(request, ReceivedGoal):
            self._reject(text, request.name)

    def _on_preempted(self, request: Work) -> None:
        if not isinstance(request, ReceivedGoal):
            return
        try:
            request.check()
        except Exception as error:
            self._reject(self._node.explain(error), request.name)
        else:
            text = "preempted: a newer goal or a stop came before its motion was planned"
            self._finish(GoalOutcome.OVERTAKEN, text, request.name)
