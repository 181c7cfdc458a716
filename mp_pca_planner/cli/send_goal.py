# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`send_goal`: give the node a goal, or a sequence of them, and print what it answers."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Mapping, Sequence
from importlib.util import find_spec

from ..exceptions import GoalError, MissingDependencyError, quote_names
from ..motion.goal import JointState, SequenceGoal
from .common import (
    REPORTED,
    CommandParser,
    Stop,
    add_via_options,
    joint_values,
    known,
    print_json,
    run,
    seconds,
    short,
    split_time,
)
from .terminal import DONE, FAILED, REFUSED, complain, say

_NANOSECONDS = 10**9


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    parser = CommandParser(
        "send_goal",
        "Send a goal configuration, or a sequence of them, to the running planner node, wait for "
        "its report and print it. Status 0: the motion was published; 1: no answer, or a newer "
        "goal came; 2: refused.",
    )
    parser.add_argument("goal", metavar="NAME=VALUE,...", help="positions [rad or m] by joint name")
    add_via_options(
        parser,
        "NAME=VALUE,...[@T]",
        "positions of the same joints, with @T (also of the goal) to be there T s after the "
        "motion has begun,",
    )
    parser.add_argument(
        "--degrees", action="store_true", help="positions are in degrees, not in radians"
    )
    parser.add_argument(
        "--primitive", default="", metavar="NAME", help="primitive to use; empty: the node chooses"
    )
    parser.add_argument("--node", default="mp_pca_planner", metavar="NAME", help="name of the node")
    parser.add_argument("--namespace", default="", metavar="NS", help="namespace of the node")
    parser.add_argument(
        "--timeout", type=seconds, default=10.0, metavar="S", help="longest time to wait [s]"
    )
    parser.add_argument("--verbose", action="store_true", help="print all values of the report")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return run(parser, _send, argv)


def _send(arguments: argparse.Namespace) -> int:
    goal_text, when = split_time(arguments.goal, "the goal")
    names = [part.partition("=")[0].strip() for part in goal_text.split(",") if "=" in part]
    if not names:
        # The order of joints is the node's business, a list without names can't be sent.
        raise GoalError(f"the goal '{arguments.goal}' must be name=value,…")
    unit = math.pi / 180.0 if arguments.degrees else 1.0
    values = joint_values(goal_text, names, "the goal")
    last = JointState(names, [unit * values[name] for name in names])
    vias = [_via(text, names, unit) for text in arguments.via]
    targets, times = zip(*vias, (last, when), strict=True)
    stops = (*(isinstance(via, Stop) for via in arguments.via), False)
    sequence = SequenceGoal(targets, times, stops=stops)
    if find_spec("rclpy") is None:
        raise MissingDependencyError("rclpy", "ros", "the command 'send_goal'")
    from diagnostic_msgs.msg import DiagnosticStatus
    from rclpy.exceptions import NameValidationException
    from rclpy.validate_full_topic_name import validate_full_topic_name
    from sensor_msgs.msg import JointState as JointStateMessage

    from ..ros.client import GoalClient, NoAnswerError, is_served
    from ..ros.messages import to_sequence_message

    full_name = f"/{arguments.namespace}/{arguments.node}".replace("//", "/")
    try:
        validate_full_topic_name(full_name)
    except NameValidationException as error:
        reason = str(error).splitlines()[0].rstrip(":")
        raise GoalError(f"no node can be called '{full_name}': {reason}") from None
    if vias or when is not None:
        goal = to_sequence_message(sequence)
    else:
        goal = JointStateMessage(name=names, position=last.positions.tolist())
    goal.header.frame_id = arguments.primitive
    # By its stamp the report is told from those of other goals.
    seconds, nanoseconds = divmod(time.time_ns(), _NANOSECONDS)
    goal.header.stamp.sec, goal.header.stamp.nanosec = seconds, nanoseconds
    try:
        with GoalClient("send_goal", arguments.namespace, arguments.node) as client:
            client.wait_for_node(arguments.timeout, with_trajectory=False)
            answer = client.send(goal, arguments.timeout, with_trajectory=False)
    except NoAnswerError as error:
        complain(f"mp_pca_planner send_goal: {error}")
        return FAILED
    report = answer.report
    if arguments.json:
        print_json({"message": report.message, **answer.values})
    else:
        say(report.message, *report_lines(answer.values, is_verbose=arguments.verbose))
    if report.level == DiagnosticStatus.ERROR:
        return REFUSED
    return DONE if is_served(report) else FAILED


def report_lines(values: Mapping[str, str], *, is_verbose: bool) -> list[str]:
    """Lines of text with the values of a report: all, or those that everybody wants to see."""
    if is_verbose:
        return [f"  {name:<18} {value}" for name, value in known(values).items()]
    return [f"  {name:<18} {short(value)}" for name, value in known(values, REPORTED).items()]


def _via(text: str, names: Sequence[str], unit: float) -> tuple[JointState, float | None]:
    """What to pass, in the order of the goal's joints, and when."""
    via, when = split_time(text, "--via")
    values = joint_values(via, names, "--via", "joint of the goal")
    missing = [name for name in names if name not in values]
    if missing:
        raise GoalError(
            f"--via '{text}' lacks {quote_names(missing)}: the points of a sequence name the "
            "same joints"
        )
    return JointState(names, [unit * values[name] for name in names]), when
