# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Values of the core ↔ ROS messages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState as JointStateMessage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..control.law import control_statement
from ..exceptions import GoalError, printable, quote_names
from ..execution.parameters import Declaration
from ..execution.serving.execution import ExecutionReport
from ..execution.serving.goal_planner import AdaptedPlan
from ..files import reading
from ..input_limits import INPUT_LIMITS
from ..motion.goal import JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from ..motion.trajectory import Trajectory
from ..planning.plan import Plan
from ..planning.report import remarks
from ..primitives.primitive import MovementPrimitive
from ..recordings.joint_states import NS_PER_S
from .serialised import CdrReader

UNDER_WAY = "under_way"
"""Status in the report of a goal that is under way, or reached, already."""

OVERTAKEN = "overtaken"
"""Status in the report of a valid goal that was preempted before execution."""


def read_stamp(content: bytes) -> Time:
    """The stamp at the begin of a serialised message; zero if the message is too short."""
    with suppress(GoalError), reading("a stamp", GoalError):
        return Time(**dict(zip(("sec", "nanosec"), CdrReader(content).numbers("iI"), strict=True)))
    return Time()


def read_goal(content: bytes, kind: type[Any]) -> Any:
    """Deserialise a goal.

    Joints and points are counted before: an object of each takes a second for 100,000 points.

    Raises
    ------
    GoalError
        If it is malformed, or joints or points are too many.
    """
    with reading("the message of the goal", GoalError):
        if kind is not PoseStamped:
            reader = CdrReader(content)
            reader.numbers("iI")
            reader.text()
            n_names = reader.count(4)
            _check_count("names", n_names, "joints")
            if kind is JointTrajectory:
                for _ in range(n_names):
                    reader.text()
                _check_count("has", reader.count(24), "points")
        return deserialize_message(content, kind)


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
    state = _joint_state(message, message.velocity, names, "goal", "goal")
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
    _check_finite(f"point {k} of the goal puts joint '{{}}' at {{}}", values)
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


def read_states(content: bytes) -> JointStateMessage:
    """Deserialise joint states; a message that is malformed or far too large has no joints."""
    if len(content) <= INPUT_LIMITS.state_bytes:
        with suppress(GoalError), reading("a state", GoalError):
            return deserialize_message(content, JointStateMessage)
    return JointStateMessage()


def to_state(message: JointStateMessage, joint_names: Sequence[str]) -> JointState:
    """Read the state of some joints, the others may hold anything.

    A velocity that is NaN was not measured: it becomes 0, as without velocities, and positions
    decide whether the robot moves.

    Raises
    ------
    GoalError
        If one of the joints is missing or given twice, lengths disagree, or a number that is
        needed is not finite.
    """
    for name in joint_names:
        if message.name.count(name) != 1:
            raise GoalError(
                f"the present state gives joint '{name}' {message.name.count(name)} times, "
                "exactly once is accepted"
            )
    index = [message.name.index(name) for name in joint_names]
    velocities = [0.0 if math.isnan(v) else v for v in message.velocity]
    return _joint_state(message, velocities, index, "present state", "present")


def _joint_state(
    message: JointStateMessage,
    velocities: Sequence[float],
    index: Sequence[int],
    what: str,
    which: str,
) -> JointState:
    """Read the joints at some places of a message; errors name the message and its numbers."""
    n, names = len(message.name), [message.name[i] for i in index]
    for field, fields, values, lengths, accepted in (
        ("position", "positions", message.position, (n,), "one"),
        ("velocity", "velocities", velocities, (0, n), "none or one"),
    ):
        if len(values) not in lengths:
            raise GoalError(
                f"the {what} names {n} joints and has {len(values)} {fields}, "
                f"{accepted} for each joint is accepted"
            )
        if len(values):
            found = zip(names, (values[i] for i in index), strict=True)
            _check_finite(f"the {which} {field} of joint '{{}}' is {{}}", found)
    chosen = [velocities[i] for i in index] if len(velocities) else None
    return JointState(names, [message.position[i] for i in index], chosen)


def _check_finite(text: str, values: Iterable[tuple[str, float]]) -> None:
    """Raise a `GoalError` with the first joint and number that is not finite, if there is one."""
    for name, value in values:
        if not math.isfinite(value):
            raise GoalError(f"{text.format(name, value)}, but only finite numbers are accepted")


def _check_count(verb: str, n: int, things: str) -> None:
    most = INPUT_LIMITS.goal_items
    if n > most:
        raise GoalError(f"the goal {verb} {n} {things}, at most {most} are accepted")


def to_trajectory(message: JointTrajectory) -> Trajectory:
    """Read a trajectory that was received.

    Raises
    ------
    TrajectoryError
        If it is not well-formed.
    """
    points = message.points
    return Trajectory(
        message.joint_names,
        [to_seconds(p.time_from_start) for p in points],
        [p.positions for p in points],
        [p.velocities for p in points],
        [p.accelerations for p in points],
        [p.effort for p in points] if any(p.effort for p in points) else None,
    )


def to_seconds(time: Duration | Time) -> float:
    """Convert a duration or a time of ROS [s]."""
    return float(time.sec + time.nanosec / NS_PER_S)


def to_plan_report(
    plan: Plan | AdaptedPlan,
    goal_stamp: Time,
    primitives: Sequence[MovementPrimitive] = (),
    ignored_joints: Sequence[str] = (),
    missing_obstacle: str = "",
) -> DiagnosticStatus:
    """Report a motion that was published: OK, or WARN with what is unusual about it.

    Parameters
    ----------
    plan :
        The plan.
    goal_stamp :
        Stamp of the goal.
    primitives : sequence of MovementPrimitive
        Those that were used; what is known of their control laws is reported.
    ignored_joints : sequence of str
        Joints of the goal that the primitives don't move.
    missing_obstacle : str
        Why an obstacle that was given is not avoided; empty if all are.
    """
    found = remarks(plan)
    if missing_obstacle:
        found.append(f"an obstacle is not avoided: {missing_obstacle}")
    if ignored_joints:
        found.append(
            f"joints {quote_names(ignored_joints)} of the goal are not moved: the primitives lack "
            "them"
        )
    level = DiagnosticStatus.WARN if found else DiagnosticStatus.OK
    laws = {f"control_law.{p.name}": control_statement(p) for p in primitives}
    return _report(level, "; ".join(found) or plan.message, goal_stamp, {**plan.summary(), **laws})


def to_under_way_report(
    plan: Plan | AdaptedPlan, reason: str, goal_stamp: Time
) -> DiagnosticStatus:
    """Report a goal that is under way or reached already, so that nothing was published."""
    values = {**plan.summary(), "status": UNDER_WAY}
    return _report(DiagnosticStatus.OK, reason, goal_stamp, values)


def to_execution_report(report: ExecutionReport) -> DiagnosticStatus:
    """Report the execution of a published motion; the stamp of its goal identifies it."""
    names = ("outcome", "progress", "error", "largest_deviation", "deviation_time")
    values = {name: getattr(report, name) for name in names}
    values["goal_stamp"] = to_stamp_text(report.goal)
    level = DiagnosticStatus.OK if report.is_good else DiagnosticStatus.ERROR
    return to_status("mp_pca_planner: execution", level, report.message, values)


def to_overtaken_report(goal_stamp: Time) -> DiagnosticStatus:
    """Report a valid goal that was preempted before execution."""
    text = "preempted: a newer goal or a stop came before its motion was planned"
    return _report(DiagnosticStatus.WARN, text, goal_stamp, {"status": OVERTAKEN})


def to_refusal(reason: str, goal_stamp: Time, plan: Plan | None = None) -> DiagnosticStatus:
    """Report a rejected goal, with its plan if there is one."""
    values = plan.summary() if plan else {"status": "refused"}
    return _report(DiagnosticStatus.ERROR, reason, goal_stamp, values)


def _report(
    level: bytes, text: str, goal_stamp: Time, values: Mapping[str, str | float | int]
) -> DiagnosticStatus:
    stamp = to_stamp_text(goal_stamp)
    return to_status("mp_pca_planner: plan", level, text, {**values, "goal_stamp": stamp})


def to_stamp_text(stamp: Time) -> str:
    """Write a stamp as seconds with all nine decimals."""
    return f"{stamp.sec}.{stamp.nanosec:09d}"


def to_text(text: object) -> str:
    """Convert a text with names from others to one printable line of at most 1000 characters."""
    return printable(str(text)[:1000])


def to_status(
    name: str, level: bytes, text: str, values: Mapping[str, str | float | int]
) -> DiagnosticStatus:
    """Write a diagnostic status."""
    return DiagnosticStatus(
        name=name,
        level=level,
        message=to_text(text),
        values=[KeyValue(key=key, value=printable(str(v))) for key, v in values.items()],
    )


def to_descriptor(declaration: Declaration) -> ParameterDescriptor:
    """Describe a parameter to ROS."""
    descriptor = ParameterDescriptor(
        name=declaration.name,
        description=declaration.description,
        additional_constraints=f"must be {declaration.accepted}",
    )
    if isinstance(declaration.default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=declaration.low, to_value=declaration.high)
        ]
    return descriptor
