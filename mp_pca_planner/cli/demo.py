# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Record, build, plan and execute: the whole pipeline with a simulated human-like arm.

The demo records demonstrations into a bag and builds primitives from them. It starts the planner
node and a simulated robot. Another process sends goals, the robot executes the motions, and
pictures show the results. With a ROBOT, it writes arm.urdf, session.mcap, limits.yaml and
scene.yaml, builds reach.npz from the generated recording, and shows it on a page in the browser.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from ..arrays import FloatArray, by_name
from ..exceptions import PlannerError, quote_names
from ..execution.outcomes import MotionOutcome
from ..files import config_file
from ..motion.trajectory import Trajectory
from ..plotting.motion import motion_figure
from ..plotting.primitive import primitive_figure
from ..plotting.style import picture, require_matplotlib
from ..primitives.build import build_primitive
from ..primitives.file import save_primitive
from ..primitives.primitive import MovementPrimitive, prediction_words
from ..recordings.load import load_recordings
from ..recordings.synthetic import JOINT_NAMES, generate_motions, write_example_recording
from ..robot.examples import EXAMPLE_ROBOTS, example_file
from ..robot.model import Robot
from .common import make_folder, usual_ends
from .example_robots import write_example
from .main import run_command
from .terminal import DONE, FAILED, say

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# Numbers of recorded motions and of goals; the robot returns after each goal.
_N_DEMONSTRATIONS, _N_GOALS = 30, 6
# Seed of the goals, which are ends of motions that are not among the demonstrations.
_GOAL_SEED = 2
_END_PATIENCE = 10.0  # longest time to wait for a process that was signalled to end [s]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = __doc__
    about = f"{', '.join(EXAMPLE_ROBOTS)}; all but the first need the extra 'example'"
    parser.add_argument("robot", metavar="ROBOT", nargs="?", choices=EXAMPLE_ROBOTS, help=about)
    output, about = Path("demo_output"), "folder of the results (default: %(default)s)"
    parser.add_argument("--output", metavar="DIR", type=Path, default=output, help=about)
    modes = parser.add_mutually_exclusive_group()
    modes.add_argument("--node", action="store_true", help="run node and simulated ROBOT, no page")
    modes.add_argument("--files", action="store_true", help="only write the files of ROBOT")
    parser.add_argument("--force", action="store_true", help="overwrite files of ROBOT")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    folder: Path = arguments.output
    if arguments.robot is None:
        if arguments.node or arguments.files or arguments.force:
            raise PlannerError(
                f"--node, --files and --force are for one ROBOT of {quote_names(EXAMPLE_ROBOTS)}: "
                "name it, or remove them"
            )
        return _pipeline(folder)
    make_folder(folder)
    files = write_example(arguments.robot, folder, force=arguments.force)
    say(f"written: {', '.join(map(str, files))}")
    if arguments.files:
        return DONE
    session, urdf, *others = map(str, files)
    primitive = folder / "reach.npz"
    robot = Robot.from_file(urdf, example_file(arguments.robot)[1])
    ends = _learn(Path(session), primitive, robot).boundary_states[:, [0, 3]]
    shown = by_name(robot.joint_names, usual_ends(ends)[1].round(2))
    goal = ",".join(f"{name}={q:g}" for name, q in shown.items())
    if not arguments.node:
        limits = ["--limits", others[0]] if others else []
        return run_command("view", [str(primitive), "--robot", urdf, *limits])
    node = ["planner_node", "--ros-args", "-p", f"primitives:=['{primitive}']"]
    node += ["-p", f"limits_file:={others[0]}"] if others else []
    still = [f"{name}=0" for name in robot.movable_joints if name not in robot.joint_names]
    node += ["-p", f"locked_joints:={','.join(still)}"] if still else []
    simulation = ["simulate", "--robot", urdf, "--primitive", str(primitive)]
    with suppress(KeyboardInterrupt), _children(node, simulation):
        say("The node and a simulated robot run until Ctrl-C. In another terminal:")
        say(f"   mp-pca send_goal {goal}")
        threading.Event().wait()
    return DONE


def _learn(bag: Path, file: Path, robot: Robot) -> MovementPrimitive:
    """Build a primitive from a recording."""
    motions = load_recordings([bag], joints=robot.joint_names).demonstrations
    primitive = build_primitive(motions, file.stem)
    save_primitive(primitive, file, overwrite=True)
    say(f"   {len(motions)} motions, {primitive.n_components} components: {file}")
    say(f"   {prediction_words(primitive)}")
    return primitive


def _pipeline(folder: Path) -> int:
    """Record, learn, send goals over topics and draw."""
    from ..ros.client import this_machine_only

    require_matplotlib()
    make_folder(folder)
    bag, file, arm = folder / "recording", folder / "arm_raising.npz", config_file("human_arm.urdf")
    say(f"1. Recording {_N_DEMONSTRATIONS} arm-raising motions and returns into {bag}")
    write_example_recording(bag, _N_DEMONSTRATIONS)
    say("2. Building primitives from the bag")
    robot = Robot.from_file(arm, JOINT_NAMES)
    primitive = _learn(bag, file, robot)
    say("", "3. Starting the planner node and a simulated robot, sending goals over ROS 2 topics")
    os.environ.update(this_machine_only())
    ends = [motion.positions[[0, -1]] for motion in generate_motions(_N_GOALS, _GOAL_SEED)]
    home = ends[0][0]
    start = ",".join(f"{name}={q}" for name, q in by_name(JOINT_NAMES, home).items())
    node = ["planner_node", "--ros-args", "--log-level", "error", "-p", f"primitives:=['{file}']"]
    simulation = ["simulate", "--robot", str(arm), "--start", start]
    record = ["--record", str(folder / "commands.npz"), "--force"]
    with _children(node, [*simulation, *record]):
        motions, has_arrived = _execute([q for _, goal in ends for q in (goal, home)])
    say("", f"4. Drawing into {folder}")
    with picture(folder / "primitive.png", force=True) as figure:
        primitive_figure(figure, primitive, title="Demonstrations and components")
    if motions:
        with picture(folder / "motion.png", force=True) as figure:
            title = "Motion to the first goal"
            motion_figure(figure, motions[0], title, robot.limits())
    return DONE if has_arrived else FAILED


@contextmanager
def _children(*commands: Sequence[str]) -> Iterator[None]:
    """Run commands of this package, and end them with the block; their stdout is discarded.

    A signal raises KeyboardInterrupt in the block.
    """
    processes = list[subprocess.Popen[bytes]]()

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    def unblock() -> None:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)

    try:
        signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)  # until all processes are known
        for number in _SIGNALS:
            signal.signal(number, interrupt)
        for words in commands:
            command = [sys.executable, "-m", __package__.partition(".")[0], *words]
            processes.append(
                subprocess.Popen(command, stdout=subprocess.DEVNULL, preexec_fn=unblock)
            )
        unblock()
        yield
    finally:
        for number in _SIGNALS:  # one is enough
            signal.signal(number, signal.SIG_IGN)
        for process in processes:
            process.send_signal(signal.SIGINT)
        for process in processes:
            try:
                process.wait(_END_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _execute(goals: Sequence[FloatArray]) -> tuple[list[Trajectory], bool]:
    """Send goals one after the other; returns the motions, and whether the robot always arrived."""
    from sensor_msgs.msg import JointState
    from trajectory_msgs.msg import JointTrajectory

    from ..ros.client import DEPTH, GoalClient, report_values
    from ..ros.messages import to_trajectory
    from ..ros.nodes import READY

    received, has_arrived = list[JointTrajectory](), True
    with GoalClient() as client:
        topic = f"{client.planner}/joint_trajectory"
        client.node.create_subscription(JointTrajectory, topic, received.append, DEPTH)
        client.wait_for_node()
        client.wait_for_diagnostics(lambda values: values["text"] == READY)
        for number, goal in enumerate(goals, start=1):
            message = JointState(name=list(JOINT_NAMES), position=goal.tolist())
            message.header.stamp = client.node.get_clock().now().to_msg()
            report = client.send(message)
            execution = client.execution(report)
            outcome = "" if execution is None else report_values(execution)["outcome"]
            has_arrived &= outcome == MotionOutcome.ARRIVED
            say(f"   goal {number}: {report.message}; {outcome}")
    return [to_trajectory(motion) for motion in received], has_arrived
