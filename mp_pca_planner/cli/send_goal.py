# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`send_goal`: give the node a goal configuration and print what it answers."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence
from importlib.util import find_spec

from ..exceptions import GoalError, MissingDependencyError
from .common import DONE, FAILED, REFUSED, CommandParser, joint_values, print_json, run

_NANOSECONDS = 10**9


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    parser = CommandParser(
        "send_goal",
        "Send a goal configuration to the running planner node, wait for its report and print it. "
        "Status 0: the motion was published; 1: no answer, or a newer goal came; 2: refused.",
    )
    parser.add_argument("goal", metavar="NAME=VALUE,...", help="positions [rad or m] by joint name")
    parser.add_argument(
        "--degrees", action="store_true", help="positions are in degrees, not in radians"
    )
    parser.add_argument(
        "--primitive", default="", metavar="NAME", help="primitive to use; empty: the node chooses"
    )
    parser.add_argument("--node", default="mp_pca_planner", metavar="NAME", help="name of the node")
    parser.add_argument("--namespace", default="", metavar="NS", help="namespace of the node")
    parser.add_argument(
        "--timeout", type=float, default=10.0, metavar="S", help="longest time to wait [s]"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return run(parser, _send, argv)


def _send(arguments: argparse.Namespace) -> int:
    names = [part.partition("=")[0].strip() for part in arguments.goal.split(",") if "=" in part]
    if not names:
        # The order of joints is the node's business, a list without names can't be sent.
        raise GoalError(f"the goal '{arguments.goal}' must be name=value,…")
    values = joint_values(arguments.goal, names, "the goal")
    if find_spec("rclpy") is None:
        raise MissingDependencyError("rclpy", "ros", "the command 'send_goal'")
    from diagnostic_msgs.msg import DiagnosticStatus
    from sensor_msgs.msg import JointState

    from ..ros.client import GoalClient, NoAnswerError, is_served

    unit = math.pi / 180.0 if arguments.degrees else 1.0
    goal = JointState(name=list(values), position=[unit * value for value in values.values()])
    goal.header.frame_id = arguments.primitive
    # By its stamp the report is told from those of other goals.
    seconds, nanoseconds = divmod(time.time_ns(), _NANOSECONDS)
    goal.header.stamp.sec, goal.header.stamp.nanosec = seconds, nanoseconds
    try:
        with GoalClient("send_goal", arguments.namespace, arguments.node) as client:
            client.wait_for_node(arguments.timeout)
            answer = client.send(goal, arguments.timeout)
    except NoAnswerError as error:
        print(f"mp_pca_planner send_goal: {error}", file=sys.stderr)
        return FAILED
    report = answer.report
    if arguments.json:
        print_json({"message": report.message, **answer.values})
    else:
        print(report.message)
        print("\n".join(f"  {key}: {value}" for key, value in answer.values.items()))
    if report.level == DiagnosticStatus.ERROR:
        return REFUSED
    return DONE if is_served(report) else FAILED
