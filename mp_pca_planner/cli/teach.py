# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`teach`: motions shown to the running robot, a primitive of them, and its first goal."""

from __future__ import annotations

import argparse
import os
import select
import sys
import termios
import tty
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
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
from .common import check_frame, check_output, fact_lines, reported
from .main import run_command
from .options import add_file, add_node, name_list
from .terminal import DONE, FAILED, PROGRAM, REFUSED, complain, say

_DESCRIPTION = """\
Teach a primitive to the running robot: record, cut, learn and try.

The command records all joint states while you move the arm by hand. When the arm has rested for
0.6 s, it shows the motion and a summary of all motions so far. Keys: d discards the last motion;
b builds the primitive and makes the node reload it; q, or the end of the input, quits. The first
goal is sent to the node after an explicit yes. The recording FILE.mcap and tables of the
motions are beside FILE.npz. The same command continues a session that was quit or killed."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    output: dict[str, Any] = {"metavar": "FILE.npz", "type": Path, "required": True}
    help_text = "primitive to write; the recording is written beside it"
    parser.add_argument("--output", **output, help=help_text)
    help_text = "joints to use, in this order (default: the robot's joints, or all)"
    parser.add_argument("--joints", metavar="a,b,c", type=name_list, help=help_text)
    add_file(parser, "--robot", "URDF", "robot description, to show the end effector's positions")
    help_text = "end effector of the robot (default: the last link that most joints move)"
    parser.add_argument("--frame", metavar="LINK", default="", help=help_text)
    help_text = "topic of joint states (default: joint_states, or the only one of --play)"
    parser.add_argument("--topic", help=help_text)
    add_file(parser, "--play", "BAG", "recording to play back in place of a robot, without ROS")
    parser.add_argument("--force", action="store_true", help="overwrite the primitive")
    add_node(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    check_output(arguments.output, ".npz", force=arguments.force)
    robot = Robot.from_file(arguments.robot, arguments.joints) if arguments.robot else None
    check_frame(arguments.frame, robot)
    words = SessionWords(robot, arguments.frame)
    joints = robot.joint_names if robot else arguments.joints
    with Keys() as keys:
        session, is_finished = _taught(arguments, joints, keys, words)
        if not is_finished:
            kept = f"{session.recording} holds the recording; the same command continues it"
            say(kept if session.n_messages else "nothing was recorded")
            return DONE
        status = _build(arguments, session)
        is_live = status == DONE and arguments.play is None
        return _try(arguments, session, keys) if is_live else status


def _taught(
    arguments: argparse.Namespace, joints: Sequence[str] | None, keys: Keys, words: SessionWords
) -> tuple[TeachingSession, bool]:
    """Hold a session until it is left; returns it, and whether to build the primitive."""
    output = arguments.output
    # Without --joints, all joints of the robot, also those of a gripper.
    options: dict[str, Any] = {"moving_only": not arguments.joints, "words": words}
    if arguments.play is not None:
        topic, states = stored_states(arguments.play, arguments.topic)
        with TeachingSession(output, topic, joints, **options) as session:
            new = [(stamp, data) for stamp, data in states if stamp > session.last_stamp]
            if len(new) < len(states):
                n_known = len(states) - len(new)
                say(f"{session.recording} already holds {n_known} of the messages to play")
            session.record(new)
            return session, _is_built(session, None, keys)
    from ..ros.live_node import JointStateSource, full_topic_name

    topic = full_topic_name(arguments.topic or "joint_states", arguments.namespace)
    taught = TeachingSession(output, topic, joints, **options)
    with taught as session, JointStateSource(topic) as source:
        say(f"recording    {topic} into {session.recording}")
        return session, _is_built(session, source, keys)


def _is_built(session: TeachingSession, source: Source | None, keys: Keys) -> bool:
    """Whether to build the primitive; Ctrl-C quits."""
    say(KEYS)
    with suppress(KeyboardInterrupt):
        return hold_dialogue(session, source, keys.pressed, say)
    return False


def _build(arguments: argparse.Namespace, session: TeachingSession) -> int:
    """Build the primitive of the recording and its table of motions."""
    session.write_segments()
    names = ",".join(session.motions[0].joint_names)
    options = ["--segments", str(session.segments), "--output", str(arguments.output)]
    options += ["--joints", names, *(["--robot", str(arguments.robot)] if arguments.robot else [])]
    options += ["--force"] if arguments.force else []
    return run_command("build_primitives", [str(session.recording), *options])


def _try(arguments: argparse.Namespace, session: TeachingSession, keys: Keys) -> int:
    """Have the node reload its primitives, and send the first goal after an explicit yes."""
    from ..ros.client import GoalClient, NoAnswerError, is_served

    names, goal, goal_words = session.first_goal()
    try:
        with GoalClient("teach_goal", arguments.namespace, arguments.node) as robot:
            robot.wait_for_node(arguments.timeout, with_trajectory=False)
            reloaded = robot.call("reload_primitives", arguments.timeout)
            say(reloaded.message)
            if not reloaded.success:
                return FAILED
            say(
                f"first goal   {goal_words}",
                "y sends it to the robot, any other key does not",
            )
            if not keys.answer():
                say("not sent")
                return DONE
            goals = dict(zip(names, goal.tolist(), strict=True))
            answer = robot.move(arguments.output.stem, goals, arguments.timeout)
            say(answer.report.message, *fact_lines(reported(answer.values)))
            if not is_served(answer.report):
                return REFUSED
            execution = robot.execution(answer)
            say("" if execution is None else execution.message)
    except NoAnswerError as error:
        complain(f"{PROGRAM} teach: the primitive is built, but {error}")
        return FAILED
    return DONE


class Keys:
    """Keys of standard input; a context manager.

    At a terminal, each key counts at once. Otherwise the first letter of each line does.
    """

    def __init__(self) -> None:
        self._input = 0 if sys.stdin is None else sys.stdin.fileno()
        self._waiting, self._line, self._is_open = "", "", True
        self._settings: list[Any] | None = None

    def __enter__(self) -> Keys:
        if os.isatty(self._input):
            self._settings = termios.tcgetattr(self._input)
            tty.setcbreak(self._input)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        if self._settings is not None:
            termios.tcsetattr(self._input, termios.TCSADRAIN, self._settings)

    def pressed(self, timeout: float | None) -> str | None:
        """The next key; '' if none comes within a time [s], None if none can come any more."""
        if not self._waiting and self._is_open:
            ready, _, _ = select.select([self._input], [], [], timeout)
            if ready:
                self._read()
        if not self._waiting:
            return "" if self._is_open else None
        key, self._waiting = self._waiting[0], self._waiting[1:]
        return key

    def answer(self) -> bool:
        """Whether the next key is a yes; at a terminal, keys pressed before don't count."""
        if self._settings is not None:
            termios.tcflush(self._input, termios.TCIFLUSH)
            self._waiting = ""
        key = ""
        while key == "":
            key = self.pressed(None) or ("" if self._is_open else "n")
        return key == "y"

    def _read(self) -> None:
        text = os.read(self._input, 4096).decode(errors="replace")
        self._is_open = bool(text)
        if self._settings is not None:
            self._waiting += text.lower()
            return
        *lines, self._line = (self._line + text).split("\n")
        if not text:
            lines, self._line = [self._line], ""
        self._waiting += "".join(line.strip()[:1].lower() for line in lines)
