# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`teach`: motions shown to the running robot, a primitive of them, and its first goal."""

from __future__ import annotations

import argparse
import os
import select
import sys
import termios
from contextlib import AbstractContextManager, nullcontext, suppress
from pathlib import Path
from typing import Any

from ..robot.model import Robot
from ..teaching.session import (
    KEYS,
    SessionWords,
    Source,
    TeachingSession,
    hold_dialogue,
    stored_states,
)
from .common import check_output
from .main import run_command
from .options import add_file, add_node
from .terminal import DONE, FAILED, PROGRAM, REFUSED, complain, say

_DESCRIPTION = """\
Teach a primitive to the running robot: record, cut, learn and try.

The command records all joint states while you move the arm by hand. When the arm has rested for
0.6 s, it shows the motion and a summary of all motions so far. Letters, each with Enter: d discards
the last motion; b builds the primitive and makes the node reload it; q, or the end of the input,
quits. The first goal is sent to the node after an explicit yes. The recording FILE.mcap and tables
of the motions are beside FILE.npz. The same command continues a session that was quit or killed."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    output: dict[str, Any] = {"metavar": "FILE.npz", "type": Path, "required": True}
    help_text = "primitive to write; the recording is written beside it"
    parser.add_argument("--output", **output, help=help_text)
    add_file(parser, "--robot", "URDF", "robot description, to show the end effector's positions")
    help_text = "topic of joint states (default: joint_states, or the only one of --play)"
    parser.add_argument("--topic", help=help_text)
    add_file(parser, "--play", "BAG", "recording to play back in place of a robot, without ROS")
    parser.add_argument("--force", action="store_true", help="overwrite the primitive")
    add_node(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    output = arguments.output
    check_output(output, ".npz", force=arguments.force)
    robot = Robot.from_file(arguments.robot) if arguments.robot else None
    keys, states = Keys(), list[tuple[int, bytes]]()
    source: AbstractContextManager[Source | None] = nullcontext()
    if arguments.play is not None:
        topic, states = stored_states(arguments.play, arguments.topic)
    else:
        from ..ros.live_node import JointStateSource, full_topic_name

        topic = full_topic_name(arguments.topic or "joint_states", arguments.namespace)
        source = JointStateSource(topic)
    joints, is_built = robot.joint_names if robot else None, False
    taught = TeachingSession(output, topic, joints, words=SessionWords(robot))
    with taught as session, source as heard:
        # Those that a session that is continued already holds are not recorded again.
        session.record([state for state in states if state[0] > session.last_stamp])
        say(f"recording    {topic} into {session.recording}")
        say(f"{KEYS}; press Enter after the letter")
        with suppress(KeyboardInterrupt):
            is_built = hold_dialogue(session, heard, keys.pressed, say)
    if not is_built:
        kept = f"{session.recording} holds the recording; the same command continues it"
        say(kept if session.n_messages else "nothing was recorded")
        return DONE
    session.write_segments()
    names = ",".join(session.motions[0].joint_names)
    words = ["--segments", str(session.segments), "--output", str(output), "--joints", names]
    words += ["--robot", str(arguments.robot)] if arguments.robot else []
    words += ["--force"] if arguments.force else []
    status = run_command("build_primitives", [str(session.recording), *words])
    is_live = status == DONE and arguments.play is None
    return _try(arguments, session, keys) if is_live else status


def _try(arguments: argparse.Namespace, session: TeachingSession, keys: Keys) -> int:
    """Have the node reload its primitives, and send the first goal after an explicit yes."""
    from ..ros.client import GoalClient, NoAnswerError, is_served

    names, goal, goal_words = session.first_goal()
    try:
        with GoalClient("teach_goal", arguments.namespace, arguments.node) as robot:
            robot.wait_for_node(arguments.timeout)
            reloaded = robot.call("reload_primitives", arguments.timeout)
            say(reloaded.message)
            if not reloaded.success:
                return FAILED
            say(
                f"first goal   {goal_words}",
                "y and Enter sends it to the robot, anything else does not",
            )
            if not keys.answer():
                say("not sent")
                return DONE
            goals = dict(zip(names, goal.tolist(), strict=True))
            report = robot.move(arguments.output.stem, goals, arguments.timeout)
            say(report.message)
            if not is_served(report):
                return REFUSED
            execution = robot.execution(report)
            say("" if execution is None else execution.message)
    except NoAnswerError as error:
        complain(f"{PROGRAM} teach: the primitive is built, but {error}")
        return FAILED
    return DONE


class Keys:
    """First letters of the lines of standard input."""

    def __init__(self) -> None:
        self._input, self._text, self._is_open = sys.stdin.fileno(), "", True

    def pressed(self, timeout: float | None) -> str | None:
        """The letter of the next line; '' if none comes within a time [s], None at the end."""
        while self._is_open and "\n" not in self._text:
            if not select.select([self._input], [], [], timeout)[0]:
                return ""
            new = os.read(self._input, 4096).decode(errors="replace")
            self._text, self._is_open = self._text + new, bool(new)
        if not self._text:
            return None
        line, _, self._text = self._text.partition("\n")
        return line.strip()[:1].lower()

    def answer(self) -> bool:
        """Whether the next letter is a yes; at a terminal, what was typed before doesn't count."""
        if os.isatty(self._input):
            termios.tcflush(self._input, termios.TCIFLUSH)
            self._text = ""
        return self.pressed(None) == "y"
