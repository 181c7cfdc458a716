# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`demo`: the whole pipeline, from recorded demonstrations to motions of a simulated robot."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml

from ..arrays import FloatArray
from ..exceptions import MissingDependencyError, PlannerError
from ..files import write_whole
from ..motion.goal import JointGoal, JointState
from ..motion.trajectory import Trajectory
from ..motion.validation import check_executable, check_limits
from ..planning.plan import Plan, PlannerOptions
from ..planning.planner import Planner
from ..plotting.arm import arm_figure
from ..plotting.drawing import draw_motion, picture, require_matplotlib
from ..plotting.primitive import PHASES, primitive_figure
from ..plotting.text import table
from ..primitives.file import load_primitive
from ..primitives.primitive import MovementPrimitive
from ..recordings.bags import write_joint_states
from ..recordings.load import load_recordings
from ..recordings.synthetic import JOINT_NAMES, continuous_recording, generate_motions
from ..resources import config_file
from ..robot.limits import JointLimits
from ..robot.model import Robot
from . import build_primitives
from .children import Children
from .common import CommandParser, make_folder, run
from .terminal import DONE, FAILED, say

if TYPE_CHECKING:
    from ..ros.client import GoalClient
    from ..ros.monitor import Monitor

_N_DEMONSTRATIONS = 30
_N_GOALS = 6
# Held-out motions give the goals, so that the planner has never seen them.
_DEMONSTRATION_SEED, _GOAL_SEED = 1, 2
_RATE = 100.0
# Recordings start at a time that nobody takes for simulation time.
_EPOCH_NS = 1_700_000_000_000_000_000
# When the robot has arrived [rad, rad/s], and how long it may take to [s].
_AT_GOAL, _AT_REST, _PATIENCE = 1e-3, 1e-5, 30.0
_SETTLED = 1e-6  # [rad]
_ARM = ("upper_arm", "lower_arm", "wrist")
_GOOD = "executable"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    parser = CommandParser(
        "demo",
        "Record demonstrations of a human-like arm into a bag, build primitives from it, start "
        "the planner node and a simulated robot, send goals from another process, have the robot "
        "execute the motions, and draw what came of it.",
    )
    parser.add_argument(
        "--output", type=Path, default=Path("demo_output"), metavar="DIR", help="folder for results"
    )
    return run(parser, _demo, argv)


def _demo(arguments: argparse.Namespace) -> int:
    if find_spec("rclpy") is None:
        raise MissingDependencyError("rclpy", "ros", "the command 'demo'")
    require_matplotlib()
    folder = arguments.output
    make_folder(folder)

    say(f"1. Recording {_N_DEMONSTRATIONS} arm-raising motions into {folder / 'recording'}")
    bag = _record(folder / "recording")
    say("2. Building primitives from the bag", f"   $ build_primitives {bag}")
    primitive_file = folder / "arm_raising.npz"
    status = build_primitives.main(
        [
            *(str(bag), "--output", str(primitive_file), "--force"),
            *("--robot", str(config_file("human_arm.urdf")), "--joints", ",".join(JOINT_NAMES)),
        ]
    )
    if status != DONE:
        return status
    primitive = load_primitive(primitive_file)
    robot = Robot.from_file(config_file("human_arm.urdf"), JOINT_NAMES)
    say(
        "",
        "3. Starting the planner node and a simulated robot, and sending goals over ROS 2 topics",
    )
    served = _execute_over_topics(folder, primitive_file)
    failures = _report(robot, served)
    say("", f"4. Drawing into {folder}")
    for path in _draw(folder, bag, primitive, robot, served):
        say(f"   {path}")
    return FAILED if failures else DONE


def _record(path: Path) -> Path:
    """Make a person's motions and write them as a rosbag2 recording."""
    motions = generate_motions(_N_DEMONSTRATIONS, _DEMONSTRATION_SEED)
    recording = continuous_recording(motions, _RATE, seed=_DEMONSTRATION_SEED)
    stamps = _EPOCH_NS + np.round(recording.times * 1e9).astype(np.int64)
    write_joint_states(
        path, "mcap", recording.joint_names, stamps, recording.positions, overwrite=True
    )
    return path


@dataclass(frozen=True, eq=False)
class _Served:
    """A goal that was sent and what came back; how far from it the robot ended [rad]."""

    start: FloatArray
    trajectory: Trajectory | None
    values: Mapping[str, str]
    message: str
    latency: float | None
    arrival_error: float


def _execute_over_topics(folder: Path, primitive_file: Path) -> list[_Served]:
    """Start the node and a simulated robot in processes of their own, and act as their user."""
    from ..ros.client import GoalClient, this_machine_only
    from ..ros.monitor import Monitor

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
        record = ("--record", str(folder / "commands.npz"), "--force")
        children.start("simulate", "--robot", str(arm), "--start", start, *record)
        with GoalClient() as client, Monitor() as monitor:
            client.wait_for_node()
            client.wait_for_model()
            _wait_until_at(monitor, home)
            return [
                _serve(client, monitor, goal)
                for motion in goals
                for goal in (motion.positions[-1], home)
            ]


def _serve(client: GoalClient, monitor: Monitor, goal: FloatArray) -> _Served:
    """Send a goal to the arm, which stands still, and let it get there."""
    from sensor_msgs.msg import JointState as JointStateMessage

    from ..ros.messages import to_trajectory

    start = _measured(monitor)[0]
    answer = client.send(JointStateMessage(name=list(JOINT_NAMES), position=goal.tolist()))
    return _Served(
        start=start,
        trajectory=None if answer.trajectory is None else to_trajectory(answer.trajectory),
        values=answer.values,
        message=answer.report.message,
        latency=answer.latency,
        arrival_error=_wait_until_at(monitor, goal if answer.trajectory else start),
    )


def _measured(monitor: Monitor) -> FloatArray:
    """Newest positions and velocities, shape (2, n_joints); NaN before there are any."""
    states = monitor.look().states
    return np.array([states.get(name, (np.nan, np.nan))[:2] for name in JOINT_NAMES]).T


def _wait_until_at(monitor: Monitor, goal: FloatArray) -> float:
    """Let the robot come to rest at a goal; returns how far from it the robot is [rad]."""
    deadline = time.monotonic() + _PATIENCE
    while True:
        q, v = _measured(monitor)
        error = float(np.abs(q - goal).max())
        is_there = error < _AT_GOAL and np.abs(v).max() < _AT_REST
        if is_there or time.monotonic() > deadline:
            return error
        time.sleep(1.0 / _RATE)


def _report(robot: Robot, served: Sequence[_Served]) -> int:
    """Print a table; returns how many goals were not served as they should be."""
    limits = robot.limits()
    rows, failures = [], 0
    for i, goal in enumerate(served, start=1):
        verdict = _verdict(robot, limits, goal)
        failures += verdict != _GOOD or not goal.arrival_error < _AT_GOAL
        rows.append(
            [
                str(i),
                _number(goal.values.get("duration"), 1.0, ".2f"),
                _number(goal.values.get("effort_cost"), 1.0, ".2f"),
                _number(goal.values.get("solve_time_s"), 1e3, ".2f"),
                _number(goal.values.get("goal_error"), 1.0, ".1g"),
                _number(goal.latency, 1e3, ".2f"),
                _number(goal.arrival_error, 1e3, ".2g"),
                verdict,
            ]
        )
    header = ["goal", "duration [s]", "effort [N²m²s]", "solve [ms]", "end error [rad]"]
    header += ["goal to trajectory [ms]", "arrival error [mrad]", "checked on receipt"]
    say(*table(rows, header=header).splitlines())
    return failures


def _verdict(robot: Robot, limits: JointLimits, goal: _Served) -> str:
    """Check what was received, without believing what its sender says of it."""
    if goal.trajectory is None:
        return goal.message
    # The robot settles by some nanometres between our look at it and the planner's.
    first = goal.trajectory.positions[0]
    start = first if np.abs(first - goal.start).max() < _SETTLED else goal.start
    try:
        check = check_limits(goal.trajectory, robot, limits)
        check_executable(goal.trajectory, check, JointState(JOINT_NAMES, start))
    except PlannerError as error:
        return str(error)
    return _GOOD


def _number(value: str | float | None, factor: float, form: str) -> str:
    return "" if value is None else format(float(value) * factor, form)


def _draw(
    folder: Path,
    bag: Path,
    primitive: MovementPrimitive,
    robot: Robot,
    served: Sequence[_Served],
) -> list[Path]:
    demonstrations = load_recordings([bag], joints=JOINT_NAMES).demonstrations
    shown = np.array([motion.time_normalised(PHASES.size) for motion in demonstrations])
    path = folder / "primitive.png"
    with picture(path, force=True) as figure:
        primitive_figure(
            figure,
            primitive,
            shown,
            "Demonstrations, and mean shape with principal components (±1 standard deviation)",
        )
    pictures = [path]
    first = next((goal for goal in served if goal.trajectory is not None), None)
    if first is None or first.trajectory is None:
        return pictures
    goal = JointGoal(
        JointState(JOINT_NAMES, first.trajectory.positions[-1]), first.trajectory.duration
    )
    plans = {
        name: _plan_offline(robot, primitive, basis_name, goal, first.start)
        for name, basis_name in (("principal components", "pca"), ("B-splines", "bspline"))
    }
    labels = {
        f"{name}, {plan.solution.effort_cost:.1f} N²m²s"
        + ("" if plan.is_executable else " (breaks limits)"): plan.trajectory
        for name, plan in plans.items()
    }
    (label, planned), *others = labels.items()
    path = folder / "motion.png"
    draw_motion(
        path,
        planned,
        title="Planned motion, and the same goal with B-splines",
        label=label,
        others=dict(others),
        limits=robot.limits(),
        force=True,
    )
    pictures.append(path)
    path = folder / "arm.png"
    chains = {
        name: robot.frame_positions(plan.trajectory.positions, _ARM) for name, plan in plans.items()
    }
    with picture(path, force=True) as figure:
        arm_figure(figure, chains, "The arm on its way to the goal", _ARM[-1])
    return [*pictures, path]


def _plan_offline(
    robot: Robot, primitive: MovementPrimitive, basis: str, goal: JointGoal, start: FloatArray
) -> Plan:
    planner = Planner(robot, [primitive], robot.limits(), PlannerOptions(basis=basis))
    return planner.plan(goal, JointState(JOINT_NAMES, start))
