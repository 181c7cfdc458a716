# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Goals, sequences and poses sent to the node, calls of its services, and the answers."""

from __future__ import annotations

import argparse
import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState as JointStateMessage
from trajectory_msgs.msg import JointTrajectory

from ..exceptions import GoalError, quote_names
from ..execution.options import Serving
from ..execution.serving.execution import MotionOutcome
from ..motion.goal import JointState
from ..ros.client import (
    READY,
    GoalClient,
    NoAnswerError,
    check_node_name,
    continues,
    is_served,
    report_values,
)
from ..ros.goal_messages import to_pose_message, to_sequence_message
from .common import print_json, report_lines
from .goal_arguments import joint_values, number_list, sequence_goal, stated_pose
from .terminal import DONE, FAILED, PROGRAM, REFUSED, complain, flush, say

_SERVICES = {"reload": "reload_primitives"}
"""Names of services that differ from their command's."""

_MARGIN = 30.0  # s from the end of the motion to its report, where --wait is not given
_RESUMPTION_MARGIN = _MARGIN + Serving.resumption_timeout  # where it may go on later


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    command = arguments.command
    check_node_name(arguments.namespace, arguments.node)
    try:
        with GoalClient(command, arguments.namespace, arguments.node) as client:
            if command != "send_goal":
                return _call(arguments, client, _SERVICES.get(command, command))
            make = _pose_message if arguments.pose else _joint_message
            return _send(arguments, client, make(arguments, client))
    except NoAnswerError as error:
        complain(f"{PROGRAM} {command}: {error}")
        return FAILED


def _send(arguments: argparse.Namespace, client: GoalClient, message: Any) -> int:
    """Send a goal, and print the node's report and what became of the motion."""
    # The stamp distinguishes the report from those of other goals.
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = divmod(time.time_ns(), 10**9)
    client.wait_for_node(arguments.wait or arguments.timeout, with_trajectory=False)
    if arguments.wait:
        client.wait_for_diagnostics(lambda values: values["text"] == READY, arguments.wait)
    answer = client.send(message, arguments.timeout, with_trajectory=False)
    found, lines = answer.report, report_lines(answer.values, is_verbose=arguments.verbose)
    facts: dict[str, Any] = {"message": found.message, **answer.values}
    if not arguments.json:
        say(found.message, *lines)
        flush()
    status = DONE if is_served(found) else FAILED
    margin, earlier = arguments.wait or _MARGIN, list[dict[str, str]]()
    execution = None if arguments.wait == 0.0 else client.execution(answer, margin)
    while execution is not None:
        values = report_values(execution)
        facts["execution"] = {"message": execution.message, **values}
        status = DONE if values["outcome"] == MotionOutcome.ARRIVED else FAILED
        if not arguments.json:
            say(execution.message)
            flush()
        if not continues(execution):
            break
        earlier.append(facts["execution"])
        facts["earlier_executions"] = earlier
        margin = arguments.wait or _RESUMPTION_MARGIN
        execution = client.execution(answer, margin, len(earlier))
    if arguments.json:
        print_json(facts)
    return REFUSED if found.level == DiagnosticStatus.ERROR else status


def _call(arguments: argparse.Namespace, client: GoalClient, service: str) -> int:
    """Call a service of the node, and print its answer."""
    client.wait_for_node(arguments.timeout, with_trajectory=False)
    answer = client.call(service, arguments.timeout)
    if arguments.json:
        print_json({"success": answer.success, "message": answer.message})
    elif answer.success:
        say(answer.message)
    else:
        complain(f"{PROGRAM} {arguments.command}: {answer.message}")
    return DONE if answer.success else FAILED


def _pose_message(arguments: argparse.Namespace, _: GoalClient) -> PoseStamped:
    for option in ("via", "primitive", "degrees"):
        if getattr(arguments, option):
            raise GoalError(f"--{option} is for joint goals, and is not accepted with --pose")
    return to_pose_message(stated_pose(arguments.frame, arguments.pose))


def _joint_message(
    arguments: argparse.Namespace, client: GoalClient
) -> JointStateMessage | JointTrajectory:
    """The message of a goal and its vias, all of them positions of the same joints."""
    if arguments.frame:
        raise GoalError("--frame is for --pose, and is not accepted with joint positions")
    unit = math.pi / 180.0 if arguments.degrees else 1.0
    text = arguments.goal.partition("@")[0]
    names = [part.partition("=")[0].strip() for part in text.split(",") if "=" in part]
    names = names or _joints_of_list(arguments, client, text)

    def read(text: str, option: str) -> JointState:
        is_via = option == "--via"
        values = joint_values(text, names, option, "joint of the goal" if is_via else "joint")
        missing = [name for name in names if name not in values]
        if missing:
            raise GoalError(
                f"{option} '{text}' lacks {quote_names(missing)}: the points of a sequence name "
                "the same joints"
            )
        return JointState(names, [unit * values[name] for name in names])

    goal = sequence_goal(arguments, read, "the goal")
    message: JointStateMessage | JointTrajectory
    if len(goal.targets) > 1 or goal.times[0] is not None:
        message = to_sequence_message(goal)
    else:
        last = read(text, "the goal")
        message = JointStateMessage(name=names, position=last.positions.tolist())
    message.header.frame_id = arguments.primitive
    return message


def _joints_of_list(arguments: argparse.Namespace, client: GoalClient, goal: str) -> list[str]:
    """The joints of a goal without names: those of the node, as the robot description has them.

    Raises
    ------
    GoalError
        If it is no list of numbers.
    """
    try:
        number_list(goal, "the goal")
    except GoalError as error:
        raise GoalError(
            f"{error}; a goal is name=value,… or a list of numbers in the joint order of the robot "
            "description"
        ) from None
    longest = arguments.wait or arguments.timeout
    client.wait_for_node(longest, with_trajectory=False)
    values = client.wait_for_diagnostics(
        lambda found: found.get("joints", "none") != "none", longest
    )
    return values["joints"].split(", ")
