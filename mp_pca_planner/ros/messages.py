# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Values of the core ↔ ROS messages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress

from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from sensor_msgs.msg import JointState as JointStateMessage
from trajectory_msgs.msg import JointTrajectory

from ..control.law import control_statement
from ..exceptions import GoalError, printable, quote_names
from ..execution.parameters import Declaration
from ..execution.serving.execution import ExecutionReport, GoalOutcome
from ..execution.serving.motion_server import AdaptedPlan
from ..files import reading
from ..input_limits import INPUT_LIMITS
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from ..planning.plan import Plan
from ..primitives.primitive import MovementPrimitive
from ..recordings.joint_states import NS_PER_S
from .serialised import CdrReader


def read_states(content: bytes) -> JointStateMessage:
    """Read joint states; a message that is malformed or far too large has no joints.

    To have rclpy check and read a hundred names takes twice as long, which a stop would wait for.
    """
    if len(content) <= INPUT_LIMITS.state_bytes:
        with suppress(GoalError), reading("a state", GoalError):
            reader, read = CdrReader(content), JointStateMessage()
            read.header.stamp.sec, read.header.stamp.nanosec = reader.numbers("iI")
            read.header.frame_id = reader.text()
            n = reader.count(1)
            if n <= INPUT_LIMITS.state_joints:
                read.name = [reader.text() for _ in range(n)]
                read.position, read.velocity, read.effort = (
                    reader.array("f8", reader.count(8)).tolist() for _ in range(3)
                )
                return read
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
    return joint_state(message, velocities, index, "present state", "present")


def joint_state(
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
            check_finite(f"the {which} {field} of joint '{{}}' is {{}}", found)
    chosen = [velocities[i] for i in index] if len(velocities) else None
    return JointState(names, [message.position[i] for i in index], chosen)


def check_finite(text: str, values: Iterable[tuple[str, float]]) -> None:
    """Raise a `GoalError` with the first joint and number that is not finite, if there is one."""
    for name, value in values:
        if not math.isfinite(value):
            raise GoalError(f"{text.format(name, value)}, but only finite numbers are accepted")


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
    found = plan.remarks
    if missing_obstacle:
        found.append(f"an obstacle is not avoided: {missing_obstacle}")
    if ignored_joints:
        found.append(
            f"joints {quote_names(ignored_joints)} of the goal are not moved: the primitives lack "
            "them"
        )
    laws = {f"control_law.{p.name}": control_statement(p) for p in primitives}
    text = "; ".join(found) or plan.message
    return to_goal_report(
        GoalOutcome.SERVED, text, goal_stamp, plan, is_unusual=bool(found), more=laws
    )


def to_execution_report(report: ExecutionReport) -> DiagnosticStatus:
    """Report the execution of a published motion; the stamp of its goal identifies it."""
    names = ("outcome", "progress", "error", "largest_deviation", "deviation_time")
    values = {name: getattr(report, name) for name in names}
    if report.controller:
        values["controller"] = report.controller
    values["continues"] = str(report.continues).lower()
    values["goal_stamp"] = to_stamp_text(report.goal)
    level = DiagnosticStatus.OK if report.outcome.is_good else DiagnosticStatus.ERROR
    return to_status("mp_pca_planner: execution", level, report.message, values)


def to_goal_report(
    outcome: GoalOutcome,
    text: str,
    goal_stamp: Time,
    plan: Plan | AdaptedPlan | None = None,
    *,
    is_unusual: bool = False,
    more: Mapping[str, str] | None = None,
) -> DiagnosticStatus:
    """Report a goal.

    Parameters
    ----------
    outcome :
        What became of it.
    text :
        One sentence for a person.
    goal_stamp :
        Its stamp, which identifies the report.
    plan :
        Its plan, if there is one. Its status is reported if the plan decided the outcome.
    is_unusual : bool
        Whether the report is a warning, however good the outcome is.
    more :
        Further values.
    """
    values = dict(plan.summary()) if plan else {}
    if plan is None or outcome is GoalOutcome.UNDER_WAY:
        values["status"] = outcome
    level = max(outcome.level, int(is_unusual))
    values |= {**(more or {}), "goal_stamp": to_stamp_text(goal_stamp)}
    return to_status("mp_pca_planner: plan", bytes([level]), text, values)


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
