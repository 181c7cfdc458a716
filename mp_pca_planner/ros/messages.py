# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Values of the core ↔ ROS messages."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Mapping, Sequence

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from sensor_msgs.msg import JointState as JointStateMessage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..arrays import FloatArray
from ..control.statement import control_statement
from ..exceptions import GoalError, printable
from ..execution.adaptation import AdaptedPlan
from ..execution.execution_monitor import ExecutionReport
from ..execution.parameters import Declaration
from ..motion.goal import JointGoal, JointState, Pose, PoseGoal, SequenceGoal
from ..motion.trajectory import Trajectory
from ..planning.plan import Plan
from ..planning.remarks import remarks
from ..planning.sequence import SequencePlan
from ..primitives.primitive import MovementPrimitive

UNDER_WAY = "under_way"
"""Status in the report of a goal that is under way, or reached, already."""

OVERTAKEN = "overtaken"
"""Status in the report of a valid goal that was preempted before execution."""

_NANOSECONDS = 10**9
_LONGEST_TEXT = 1000
_LONGEST_TIME = 2**31

MAX_NAMES = 1000
"""Most joints that a goal may name."""

MAX_POINTS = 1000
"""Most points that a sequence may have."""


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
    names = message.name
    _check_count("names", len(names), "joints", MAX_NAMES)
    _check_lengths("goal", message)
    for field in ("position", "velocity"):
        values = zip(names, getattr(message, field), strict=False)
        _check_finite(f"the goal {field} of joint '{{}}' is {{}}", values)
    state = JointState(names, message.position, message.velocity or None)
    return JointGoal(state, duration or None, message.header.frame_id or None)


def to_pose_goal(message: PoseStamped, frame: str, duration: float) -> PoseGoal:
    """Read a pose goal, in whichever frame it is stated.

    Parameters
    ----------
    message :
        The pose; its frame_id is not looked at.
    frame : str
        The link of the robot that shall be there.
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
        times don't increase, or velocities, accelerations or efforts are asked for.
    """
    n_joints = len(message.joint_names)
    _check_count("names", n_joints, "joints", MAX_NAMES)
    _check_count("has", len(message.points), "points", MAX_POINTS)
    targets, times, stops = [], [], []
    for k, point in enumerate(message.points, start=1):
        if len(point.positions) != n_joints:
            raise GoalError(
                f"the goal names {n_joints} joints and point {k} has {len(point.positions)} "
                "positions, one for each joint is accepted"
            )
        values = zip(message.joint_names, point.positions, strict=True)
        _check_finite(f"point {k} of the goal puts joint '{{}}' at {{}}", values)
        if len(point.velocities) not in (0, n_joints):
            raise GoalError(
                f"the goal names {n_joints} joints and point {k} has {len(point.velocities)} "
                "velocities: none, or one of 0 for each joint to stop there, is accepted"
            )
        for field in ("velocities", "accelerations", "effort"):
            if any(getattr(point, field)):
                raise GoalError(
                    f"point {k} of the goal asks for {field}, but only positions are accepted, "
                    "and velocities of 0 to stop there: how they are passed is what is planned"
                )
        targets.append(JointState(message.joint_names, point.positions))
        since = point.time_from_start
        times.append(since.sec + since.nanosec / _NANOSECONDS or None)
        stops.append(bool(point.velocities))
    primitive = message.header.frame_id or None
    return SequenceGoal(tuple(targets), tuple(times), primitive, tuple(stops))


def to_sequence_message(goal: SequenceGoal) -> JointTrajectory:
    """Write a sequence of configurations of the same joints.

    Raises
    ------
    GoalError
        If there is a pose among them, they differ in joints, or a time is too long for a message.
    """
    message = JointTrajectory()
    message.header.frame_id = goal.primitive or ""
    for target, when, stops in zip(goal.targets, goal.times, goal.stops, strict=True):
        if not isinstance(target, JointState) or (
            message.points and target.joint_names != tuple(message.joint_names)
        ):
            raise GoalError(
                "the targets of a sequence that is sent must be configurations of the same joints"
            )
        message.joint_names = list(target.joint_names)
        point = JointTrajectoryPoint(positions=_numbers(target.positions))
        if stops:
            point.velocities = [0.0] * len(target.joint_names)
        message.points.append(point)
        if when is None:
            continue
        if when >= _LONGEST_TIME:
            raise GoalError(f"the time {when:g} s of a target is longer than a message can say")
        since = point.time_from_start
        since.sec, since.nanosec = divmod(round(when * _NANOSECONDS), _NANOSECONDS)
    return message


def to_state(message: JointStateMessage, joint_names: Sequence[str]) -> JointState:
    """Read the state of some joints, the others may hold anything.

    Raises
    ------
    GoalError
        If one of the joints is missing or given twice, lengths disagree, or a number that is
        needed is not finite.
    """
    _check_lengths("present state", message)
    for name in joint_names:
        if message.name.count(name) != 1:
            raise GoalError(
                f"the present state gives joint '{name}' {message.name.count(name)} times, "
                "exactly once is accepted"
            )
    index = [message.name.index(name) for name in joint_names]
    for field in ("position", "velocity"):
        values = getattr(message, field)
        if values:
            chosen = ((message.name[i], values[i]) for i in index)
            _check_finite(f"the present {field} of joint '{{}}' is {{}}", chosen)
    velocities = [message.velocity[i] for i in index] if message.velocity else None
    return JointState(joint_names, [message.position[i] for i in index], velocities)


def _check_finite(said: str, values: Iterable[tuple[str, float]]) -> None:
    """Refuse numbers by the name of their joint: where `said` has its braces is what."""
    for name, value in values:
        if not math.isfinite(value):
            raise GoalError(f"{said.format(name, value)}, but only finite numbers are accepted")


def _check_count(verb: str, n: int, things: str, most: int) -> None:
    if n > most:
        raise GoalError(f"the goal {verb} {n} {things}, at most {most} are accepted")


def _check_lengths(what: str, message: JointStateMessage) -> None:
    n = len(message.name)
    if len(message.position) != n:
        raise GoalError(
            f"the {what} names {n} joints and has {len(message.position)} positions, "
            "one for each joint is accepted"
        )
    if len(message.velocity) not in (0, n):
        raise GoalError(
            f"the {what} names {n} joints and has {len(message.velocity)} velocities, "
            "none or one for each joint is accepted"
        )


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
        [p.time_from_start.sec + p.time_from_start.nanosec / _NANOSECONDS for p in points],
        [p.positions for p in points],
        [p.velocities for p in points],
        [p.accelerations for p in points],
        [p.effort for p in points] if any(p.effort for p in points) else None,
    )


def _numbers(values: FloatArray) -> array[float]:
    # The only form that message fields take without looking at every element.
    return array("d", values.tobytes())


def to_plan_report(
    plan: Plan | SequencePlan | AdaptedPlan,
    goal_stamp: Time,
    more: Mapping[str, str | float | int] | None = None,
    primitives: Sequence[MovementPrimitive] = (),
) -> DiagnosticStatus:
    """Report a motion that was published: OK, or WARN with what is unusual about it.

    Parameters
    ----------
    plan :
        The plan.
    goal_stamp :
        Stamp of the goal.
    more : mapping, optional
        Further values.
    primitives : sequence of MovementPrimitive
        Those of the planner: of the ones used, the control laws are reported.
    """
    found = remarks(plan)
    level = DiagnosticStatus.WARN if found else DiagnosticStatus.OK
    used = plan.primitives if isinstance(plan, Plan) else (plan.primitive,)
    laws = {f"control_law.{p.name}": control_statement(p) for p in primitives if p.name in used}
    values = {**plan.summary(), **laws, **(more or {})}
    return _report(level, "; ".join(found) or plan.message, goal_stamp, values)


def to_under_way_report(
    plan: Plan | SequencePlan | AdaptedPlan, reason: str, goal_stamp: Time
) -> DiagnosticStatus:
    """Report a goal that is under way, or reached, already: nothing was published for it."""
    values = {**plan.summary(), "status": UNDER_WAY}
    return _report(DiagnosticStatus.OK, reason, goal_stamp, values)


def to_execution_report(report: ExecutionReport) -> DiagnosticStatus:
    """Report what became of a published motion; the stamp of its goal identifies it."""
    values: dict[str, str | float | int] = {
        "outcome": report.outcome,
        "progress": report.progress,
        "error": report.error,
        "largest_deviation": report.largest_deviation,
        "deviation_time": report.deviation_time,
        "goal_stamp": to_stamp_text(report.goal),
    }
    level = DiagnosticStatus.OK if report.is_good else DiagnosticStatus.ERROR
    return to_status("mp_pca_planner: execution", level, report.message, values)


def to_overtaken_report(goal_stamp: Time) -> DiagnosticStatus:
    """Report a valid goal that was preempted before execution."""
    text = "given up: a newer goal or a stop came before its motion was planned"
    return _report(DiagnosticStatus.WARN, text, goal_stamp, {"status": OVERTAKEN})


def to_refusal(
    reason: str, goal_stamp: Time, plan: Plan | SequencePlan | None = None
) -> DiagnosticStatus:
    """Report a goal for which nothing was published, with the plan if it came to one."""
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
    """Write a text that may hold names from others: one printable line, not too long."""
    return printable(str(text)[:_LONGEST_TEXT])


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
    elif isinstance(declaration.default, int) and not isinstance(declaration.default, bool):
        descriptor.integer_range = [
            IntegerRange(from_value=int(declaration.low), to_value=int(declaration.high))
        ]
    return descriptor
