# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`send_goal`: goals, sequences and poses sent to the node, and its answers."""

from __future__ import annotations

import argparse
import re
import time
from typing import TYPE_CHECKING, Any

from ..arrays import read_numbers
from ..exceptions import GoalError, quote_names
from ..execution.outcomes import MotionOutcome
from ..motion.goal import JointState, Pose
from .common import print_json
from .goal_arguments import joint_values, pose, sequence_goal
from .options import add_json, add_node, add_targets, number
from .terminal import DONE, FAILED, REFUSED, say

if TYPE_CHECKING:
    from ..ros.client import GoalClient

_MARGIN = 30.0  # s from the end of the motion to its report, where --wait is not given
_DESCRIPTION = """\
Send a goal configuration, a sequence of them, or a pose to the running planner node.

The command waits for a node that has just started, prints its report, and waits until the robot has
arrived. The status is 0 if it arrived, and 2 if the goal was rejected. It is 1 if the robot did not
arrive, the node did not answer, or a newer goal or a stop came. With --wait 0, status 0 means that
the motion was published."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    place = "name=value,… or values in joint order,"
    goal = parser.add_mutually_exclusive_group(required=True)
    absent: dict[str, Any] = {"nargs": "?", "default": argparse.SUPPRESS}
    goal.add_argument("goal", metavar="NAME=VALUE,…", **absent, help=f"goal: {place[:-1]}")
    goal.add_argument("--goal", metavar="NAME=VALUE,…[@T]", help="the same as an option")
    pose_options: dict[str, Any] = {"metavar": "'X Y Z …'", "dest": "goal_pose"}
    help_text = "pose of the end effector in the base frame [m, quaternion]; 3 numbers: position"
    goal.add_argument("--goal-pose", "--pose", **pose_options, help=help_text)
    add_targets(parser, place)
    parser.add_argument("--degrees", action="store_true", help="positions are in degrees")
    help_text = "primitive to use (default: the nearest)"
    parser.add_argument("--primitive", metavar="NAME", default="", help=help_text)
    help_text = "longest time to wait for the node (default: that of --timeout), and for arrival "
    help_text += f"after the motion [s] (default: {_MARGIN:g}); 0: not for arrival"
    parser.add_argument("--wait", metavar="S", type=number(0.0, 1e6, "s"), help=help_text)
    add_node(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    from ..ros.client import GoalClient

    with GoalClient("send_goal", arguments.namespace, arguments.node) as client:
        make = _pose_message if arguments.goal_pose else _joint_message
        return _send(arguments, client, make(arguments, client))


def _send(arguments: argparse.Namespace, client: GoalClient, message: Any) -> int:
    """Send a goal, and print the node's report and what became of the motion."""
    from diagnostic_msgs.msg import DiagnosticStatus

    from ..ros.client import is_served, report_values
    from ..ros.nodes import WAITING

    # The stamp distinguishes the report from those of other goals.
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = divmod(time.time_ns(), 10**9)
    longest = arguments.wait or arguments.timeout
    client.wait_for_node(longest)
    # A node that has just started waits for its robot first.
    client.wait_for_diagnostics(lambda found: not found["text"].startswith(WAITING), longest)
    found = client.send(message, arguments.timeout)
    facts = {"message": found.message, **_with_numbers(report_values(found))}
    if not arguments.json:
        say(found.message)
    status = DONE if is_served(found) else FAILED
    margin = arguments.wait or _MARGIN
    execution = None if arguments.wait == 0.0 else client.execution(found, margin)
    if execution is not None:
        values = report_values(execution)
        facts["execution"] = {"message": execution.message, **_with_numbers(values)}
        status = DONE if values["outcome"] == MotionOutcome.ARRIVED else FAILED
        if not arguments.json:
            say(execution.message)
    if arguments.json:
        print_json(facts)
    return REFUSED if found.level == DiagnosticStatus.ERROR else status


def _with_numbers(values: dict[str, str]) -> dict[str, Any]:
    """Values of a report; texts that are numbers become numbers, but not the stamp of the goal."""
    found: dict[str, Any] = dict(values)
    for name, text in values.items():
        if name != "goal_stamp" and re.fullmatch(r"-?\d+(\.\d+)?(e[-+]?\d+)?", text):
            found[name] = float(text) if "." in text or "e" in text else int(text)
    return found


def _pose_message(arguments: argparse.Namespace, _: GoalClient) -> Any:
    from ..ros.goals import to_pose_message

    for option in ("via", "primitive", "degrees"):
        if getattr(arguments, option):
            raise GoalError(f"--{option} is for joint goals, and is not accepted with --goal-pose")
    return to_pose_message(pose("", arguments.goal_pose, "--goal-pose"))


def _joint_message(arguments: argparse.Namespace, client: GoalClient) -> Any:
    """The message of a goal and its vias, all of them positions of the same joints."""
    from sensor_msgs.msg import JointState as JointStateMessage

    from ..ros.goals import to_sequence_message

    goal = arguments.goal
    for option, text in [*(("--via or --stop", via) for via in arguments.via), ("the goal", goal)]:
        if ":" in text and "=" not in text:
            raise GoalError(
                f"{option} '{text}' is a pose, but the node takes joint positions here, such as "
                "name=value,…; it takes a single pose as --goal-pose, and `plan` takes sequences "
                "of poses"
            )
    text = goal.partition("@")[0]
    names = [part.partition("=")[0].strip() for part in text.split(",") if "=" in part]
    if not names:  # those of the node, as the robot description has them
        read_numbers(text, "the goal, name=value,… or a list,")
        longest = arguments.wait or arguments.timeout
        client.wait_for_node(longest)
        values = client.wait_for_diagnostics(lambda x: x.get("joints", "none") != "none", longest)
        names = values["joints"].split(", ")

    def read(text: str, option: str) -> JointState:
        kind = "joint of the goal" if option == "--via" else "joint"
        angles = names if arguments.degrees else ()
        values = joint_values(text, names, option, kind, angles)
        if missing := [name for name in names if name not in values]:
            raise GoalError(
                f"{option} '{text}' lacks {quote_names(missing)}: the points of a sequence name "
                "the same joints"
            )
        return JointState(names, [values[name] for name in names])

    found = sequence_goal(arguments, read, ("the goal", goal))
    last = found.targets[-1]
    if len(found.targets) > 1 or found.times[0] is not None or isinstance(last, Pose):
        message = to_sequence_message(found)
    else:
        message = JointStateMessage(name=names, position=last.positions.tolist())
    message.header.frame_id = arguments.primitive
    return message
