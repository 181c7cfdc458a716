# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Values of the core ↔ ROS messages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, Quaternion
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from trajectory_msgs.msg import JointTrajectory

from ..exceptions import printable, quote_names
from ..execution.link import Planned
from ..execution.outcomes import ExecutionReport, GoalOutcome
from ..execution.parameters import Declaration
from ..motion.trajectory import Trajectory
from ..planning.plan import SOLVED
from ..recordings.joint_states import NS_PER_S


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


def to_pose(numbers: Iterable[float]) -> Pose:
    """Write a position [m] and a quaternion (x, y, z, w)."""
    x, y, z, *turn = map(float, numbers)
    orientation = Quaternion(**dict(zip("xyzw", turn, strict=True)))
    return Pose(position=Point(x=x, y=y, z=z), orientation=orientation)


def to_plan_report(
    planned: Planned,
    goal_stamp: Time,
    ignored_joints: Sequence[str] = (),
    missing_obstacle: str = "",
) -> DiagnosticStatus:
    """Report a motion that was published: OK, or WARN with what is unusual about it.

    Parameters
    ----------
    planned :
        The motion.
    goal_stamp :
        Stamp of the goal.
    ignored_joints : sequence of str
        Joints of the goal that the primitives don't move.
    missing_obstacle : str
        Why an obstacle that was given is not avoided; empty if all are.
    """
    found = list(planned.remarks)
    if missing_obstacle:
        found.append(f"an obstacle is not avoided: {missing_obstacle}")
    if ignored_joints:
        found.append(
            f"joints {quote_names(ignored_joints)} of the goal are not moved: the primitives lack "
            "them"
        )
    laws = {f"control_law.{name}": text for name, text in planned.laws.items()}
    text, values = "; ".join([planned.message, *found]), {**planned.values, **laws}
    is_unusual = bool(found) or values["status"] != SOLVED
    return to_goal_report(GoalOutcome.SERVED, text, goal_stamp, values, is_unusual=is_unusual)


def to_execution_report(report: ExecutionReport) -> DiagnosticStatus:
    """Report the execution of a published motion; the stamp of its goal identifies it."""
    names = ("outcome", "progress", "error", "largest_deviation", "deviation_time")
    values = {name: getattr(report, name) for name in names}
    if report.controller:
        values["controller"] = report.controller
    values["goal_stamp"] = to_stamp_text(report.goal)
    level = DiagnosticStatus.OK if report.outcome.is_good else DiagnosticStatus.ERROR
    return to_status("mp_pca_planner: execution", level, report.message, values)


def to_goal_report(
    outcome: GoalOutcome,
    text: str,
    goal_stamp: Time,
    planned: Mapping[str, Any],
    *,
    is_unusual: bool = False,
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
    planned :
        Facts of its plan; none if there is none. Its status is reported if the plan decided the
        outcome.
    is_unusual : bool
        Whether the report is a warning, however good the outcome is.
    """
    values = dict(planned)
    if not values or outcome is GoalOutcome.UNDER_WAY:
        values["status"] = outcome
    level = max(outcome.level, int(is_unusual))
    values["goal_stamp"] = to_stamp_text(goal_stamp)
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
