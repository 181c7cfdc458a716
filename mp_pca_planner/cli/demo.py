# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`demo`: the whole pipeline, from recorded demonstrations to motions of a simulated robot."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.ndimage import find_objects, label
from sensor_msgs.msg import JointState as JointStateMessage

from ..arrays import FloatArray, text_table
from ..exceptions import PlannerError
from ..files import config_file, write_whole
from ..motion.goal import JointState
from ..motion.trajectory import Trajectory
from ..motion.validation import check_executable, check_limits
from ..plotting.arm import arm_figure, at_frames, primitive_figure, write_animation
from ..plotting.motion import motion_figure, nearest_curves
from ..plotting.style import picture, require_matplotlib
from ..plotting.text import cells
from ..primitives.differences import PHASES
from ..primitives.file import load_primitive
from ..primitives.primitive import MovementPrimitive
from ..recordings.load import load_recordings
from ..recordings.synthetic import JOINT_NAMES, generate_motions, write_example_recording
from ..robot.limits import JointLimits
from ..robot.model import Robot
from ..ros.client import READY, Answer, GoalClient, this_machine_only
from ..ros.live_node import LiveNode
from ..ros.messages import to_trajectory
from .common import make_folder
from .main import run_command
from .terminal import DONE, FAILED, say

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_ARM = ("upper_arm", "lower_arm", "wrist")
_GOOD = "executable"
_RECORD = "commands.npz"
_COLUMNS = {
    "duration [s]": ("duration", ".2f", ""),
    "effort [N²m²s]": ("effort_cost", ".2f", ""),
    "solve [ms]": ("solve_time_s", ".2f", "ms"),
    "end error [rad]": ("goal_error", ".1g", ""),
    "goal to trajectory [ms]": ("latency", ".2f", "ms"),
    "arrival error [mrad]": ("arrival_error", ".3f", "mrad"),
}


class Children:
    """Context manager that starts commands, and ends all of them when its block ends.

    The first SIGINT, SIGTERM or SIGHUP raises KeyboardInterrupt, except while a child is started
    and while the children are ended; then it is deferred or ignored.
    """

    def __init__(self) -> None:
        self._processes: list[subprocess.Popen[str]] = []
        self._previous: dict[int, Any] = {}
        self._is_starting = self._is_interrupted = False

    def start(self, command: str, *arguments: str) -> None:
        """Start a command of this package; its stdout is discarded."""
        words = [sys.executable, "-m", __package__.partition(".")[0], command, *arguments]
        self._is_starting = True
        self._processes.append(subprocess.Popen(words, stdout=subprocess.DEVNULL, text=True))
        self._is_starting = False
        if self._is_interrupted:
            raise KeyboardInterrupt

    def __enter__(self) -> Children:
        for number in _SIGNALS:
            # An ignored SIGHUP, as under nohup, stays ignored. SIGINT, which shells ignore for
            # background jobs, is handled, because it must end the children.
            if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:
                self._previous[number] = signal.signal(number, self._interrupt)
        return self

    def __exit__(self, *_: object) -> None:
        self._is_interrupted = True  # from now on, signals are ignored
        for process in self._processes:
            process.send_signal(signal.SIGINT)
        for process in self._processes:
            try:
                process.wait(_END_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        for ending, handler in self._previous.items():
            signal.signal(ending, handler)

    def _interrupt(self, *_: object) -> None:
        is_first, self._is_interrupted = not self._is_interrupted, True
        if is_first and not self._is_starting:
            raise KeyboardInterrupt


_DESCRIPTION = """\
Record, build, plan and execute: the whole pipeline with a simulated human-like arm.

The demo records demonstrations into a bag and builds primitives from them. It starts the planner
node and a simulated robot. Another process sends goals, the robot executes the motions, and
pictures show the results."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    parser.add_argument(
        "--output",
        metavar="DIR",
        type=Path,
        default=Path("demo_output"),
        help="folder of the results (default: %(default)s)",
    )
    parser.add_argument(
        "--view",
        action="store_true",
        help="at the end, show the robot, its primitive and plans on a page in the browser",
    )


# Numbers of recorded motions and of goals; the robot returns after each goal.
_N_DEMONSTRATIONS = 30
_N_GOALS = 6
# Seeds of both. Goals are ends of motions that are not among the demonstrations.
_SEED = 1
_GOAL_SEED = 2
# Rate of the recording [Hz].
_RATE = 100.0
# Largest error [rad] and speed [rad/s] at which the robot counts as arrived.
_POSITION_ERROR = 1e-3
_SPEED = 1e-5
# Longest times to wait for the arrival, and for a process that was signalled to end [s].
_PATIENCE = 30.0
_END_PATIENCE = 10.0
# Largest difference between the measured starts here and in the node [rad]: a robot that still
# settles at `_SPEED` takes a second for it.
_START_ERROR = 1e-5
# Motions of the robot in the animation.
_N_ANIMATED = 4


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    require_matplotlib()
    if arguments.view:
        import_module("..view.page", __package__)  # fail before the work if it can't be served
    folder, urdf = arguments.output, config_file("human_arm.urdf")
    make_folder(folder)
    bag, file = folder / "recording", folder / "arm_raising.npz"
    n = _N_DEMONSTRATIONS
    say(f"1. Recording {n} arm-raising motions, and returns between them, into {bag}")
    write_example_recording(bag, n, seed=_SEED)
    say("2. Building primitives from the bag", f"   $ build_primitives {bag}")
    options = ["--robot", str(urdf), "--joints", ",".join(JOINT_NAMES), "--force"]
    run_command("build_primitives", [str(bag), "--output", str(file), *options])
    robot = Robot.from_file(urdf, JOINT_NAMES)
    say("", "3. Starting the planner node and a simulated robot, sending goals over ROS 2 topics")
    served = _execute_over_topics(folder, file)
    failures = _report(robot, served)
    say("", f"4. Drawing into {folder}")
    for path in _draw(folder, bag, load_primitive(file), robot, served):
        say(f"   {path}")
    if arguments.view:
        say("", "5. Open this address in a browser")
        run_command("view", [str(file), "--robot", str(urdf)])
    return FAILED if failures else DONE


_Served = tuple[FloatArray, Answer, float]
"""The start of a motion, the node's answer to its goal, and the error at the end [rad]."""


def _motion(answer: Answer) -> Trajectory | None:
    """The motion of an answer, if there is one."""
    return None if answer.trajectory is None else to_trajectory(answer.trajectory)


def _execute_over_topics(folder: Path, primitive_file: Path) -> list[_Served]:
    """Start the node and a simulated robot as processes, and send goals to them."""
    os.environ.update(this_machine_only())
    parameters, arm = folder / "planner.yaml", config_file("human_arm.urdf")
    description = arm.read_text(encoding="utf-8")
    values = {"primitives": [str(primitive_file)], "robot_description": description}
    content = {"mp_pca_planner": {"ros__parameters": values}}
    write_whole(parameters, yaml.safe_dump(content).encode(), overwrite=True)
    goals = generate_motions(_N_GOALS, _GOAL_SEED)
    home = goals[0].positions[0]
    start = ",".join(f"{name}={q}" for name, q in zip(JOINT_NAMES, home, strict=True))
    ros_arguments = ("--params-file", str(parameters), "--log-level", "warn")
    with Children() as children:
        children.start("planner_node", "--ros-args", *ros_arguments)
        record = ("--record", str(folder / _RECORD), "--force")
        children.start("simulate", "--robot", str(arm), "--start", start, *record)
        with GoalClient() as client, LiveNode() as monitor:
            client.wait_for_node()
            _wait_until_at(monitor, home)
            client.wait_for_diagnostics(lambda values: values["text"] == READY)
            return [
                _serve(client, monitor, goal)
                for motion in goals
                for goal in (motion.positions[-1], home)
            ]


def _serve(client: GoalClient, monitor: LiveNode, goal: FloatArray) -> _Served:
    """Send a goal to the arm at rest, and wait until it is there."""
    start = _measured(monitor)[0]
    answer = client.send(JointStateMessage(name=list(JOINT_NAMES), position=goal.tolist()))
    return start, answer, _wait_until_at(monitor, goal if answer.trajectory else start)


def _measured(monitor: LiveNode) -> FloatArray:
    """Newest positions and velocities, shape (2, n_joints); NaN before there are any."""
    states = monitor.states()
    return np.array([states.get(name, (np.nan, np.nan)) for name in JOINT_NAMES]).T


def _wait_until_at(monitor: LiveNode, goal: FloatArray) -> float:
    """Wait until the robot rests at a goal; return its distance from the goal [rad]."""
    deadline = time.monotonic() + _PATIENCE
    while True:
        q, v = _measured(monitor)
        error = float(np.abs(q - goal).max())
        is_there = error < _POSITION_ERROR and np.abs(v).max() < _SPEED
        if is_there or time.monotonic() > deadline:
            return error
        time.sleep(1.0 / _RATE)


def _report(robot: Robot, served: Sequence[_Served]) -> int:
    """Print a table; return the number of goals that failed."""
    limits = robot.limits()
    rows, failures = [], 0
    for i, (start, answer, error) in enumerate(served, start=1):
        verdict = _verdict(robot, limits, start, answer)
        failures += verdict != _GOOD or not error < _POSITION_ERROR
        reported = {name: answer.values.get(name) for name, _, _ in _COLUMNS.values()}
        values = {name: None if text is None else float(text) for name, text in reported.items()}
        values |= {"latency": answer.latency, "arrival_error": error}
        rows.append([str(i), *cells(values, _COLUMNS), verdict])
    say(*text_table(rows, header=["goal", *_COLUMNS, "checked on receipt"]).splitlines())
    return failures


def _verdict(robot: Robot, limits: JointLimits, start: FloatArray, answer: Answer) -> str:
    """Check a received motion independently of its report."""
    trajectory = _motion(answer)
    if trajectory is None:
        return str(answer.report.message)
    # Between this measurement and the planner's, the settling robot moves by some nanometres.
    first = trajectory.positions[0]
    start = first if np.abs(first - start).max() < _START_ERROR else start
    try:
        check = check_limits(trajectory, robot, limits)
        check_executable(trajectory, check, JointState(JOINT_NAMES, start))
    except PlannerError as error:
        return str(error)
    return _GOOD


def _draw(
    folder: Path, bag: Path, primitive: MovementPrimitive, robot: Robot, served: Sequence[_Served]
) -> list[Path]:
    names = ("primitive.png", "motion.png", "arm.png", "animation.gif")
    pictures = [folder / name for name in names]
    motions = load_recordings([bag], joints=JOINT_NAMES).demonstrations
    shown = np.array([motion.time_normalised(PHASES.size) for motion in motions])
    title = "Demonstrations, and mean shape with principal components (±1 standard deviation)"
    with picture(pictures[0], force=True) as figure:
        primitive_figure(figure, primitive, shown, title)
    planned = [motion for _, answer, _ in served if (motion := _motion(answer)) is not None]
    if not planned:
        return pictures[:1]
    first = planned[0]
    ends = first.positions[[0, -1]]
    behind = nearest_curves(primitive, first.joint_names, ends, 0.0, first.duration)
    with picture(pictures[1], force=True) as figure:
        title = "Motion to the first goal"
        motion_figure(figure, {"planned": first}, title, robot.limits(), curves=behind)
    chain = robot.frame_positions(planned[0].positions, _ARM)
    with picture(pictures[2], force=True) as figure:
        arm_figure(figure, {"planned": chain}, "The arm on its path to the goal", _ARM[-1])
    # Motions away from the start: every other one.
    demonstrated = [at_frames(motion.times, motion.positions) for motion in motions[:16:4]]
    executed = _measured_motions(folder / _RECORD)[:_N_ANIMATED]
    arms = ([robot.frame_positions(q, _ARM) for q in some] for some in (demonstrated, executed))
    write_animation(pictures[3], *arms, force=True)
    return pictures


def _measured_motions(file: Path) -> list[FloatArray]:
    """Measured positions in each interval in which the robot was commanded to move."""
    with np.load(file) as record:
        times, measured, is_moving = record["times"], record["measured"], record["v"].any(axis=1)
    intervals, _ = label(is_moving)
    return [at_frames(times[span], measured[span]) for (span,) in find_objects(intervals)]
