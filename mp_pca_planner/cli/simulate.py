# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`simulate`: a simulated robot on ROS topics, behind a trajectory controller."""

from __future__ import annotations

import argparse
import io
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import by_name
from ..exceptions import RobotError
from ..files import write_whole
from ..primitives.library import load_primitives
from ..robot.model import Robot
from ..ros.nodes import spin_until, start_ros
from ..ros.simulated_robot import SimulatedRobotNode
from ..simulation.robot import Faults, SimulatedRobot
from .common import check_output, robot_of, show, usual_ends
from .goal_arguments import joint_values
from .options import add_file, add_report, number
from .terminal import DONE

_DESCRIPTION = """\
Simulate a robot that publishes joint_states and robot_description and executes trajectories.

Its controller has the semantics of joint_trajectory_controller. Its faults are parameters of the
node simulated_robot: speed_scaling, held, silent, delay, jitter, active, drop, payload, noise. Pass
node arguments after --ros-args. Ctrl-C ends it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = _DESCRIPTION
    needed: dict[str, Any] = {"metavar": "URDF", "type": Path, "required": True}
    parser.add_argument("--robot", **needed, help="robot description")
    help_text = "primitive file: the controller has its joints, and starts as its demonstrations"
    parser.add_argument("--primitive", metavar="FILE", help=help_text)
    help_text = "start: name=value,… or values in joint order [rad or m]"
    parser.add_argument("--start", metavar="VALUES", help=help_text)
    rate = number(0.01, 1000.0, "Hz")
    help_text = "rate of joint_states (default: %(default)g)"
    parser.add_argument("--rate", metavar="HZ", type=rate, default=500.0, help=help_text)
    topic = "mp_pca_planner/joint_trajectory"
    help_text = "of the trajectories to execute (default: %(default)s)"
    parser.add_argument("--controller-topic", metavar="TOPIC", default=topic, help=help_text)
    help_text = "speed of the controller's clock, 0 to 1"
    parser.add_argument("--speed-scaling", metavar="X", type=float, default=1.0, help=help_text)
    help_text = "unknown mass at the end effector [kg]"
    parser.add_argument("--payload", metavar="KG", type=float, default=0.0, help=help_text)
    add_file(parser, "--record", "FILE.npz", "file to write every command to, at 1 kHz")
    add_report(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command until SIGINT or SIGTERM; returns the exit status."""
    check_output(arguments.record, ".npz", force=arguments.force)
    robot = Robot.from_file(arguments.robot)
    start, others = _start_within_limits(robot), dict[str, float]()
    if arguments.primitive is not None:
        library = load_primitives([arguments.primitive])
        robot = robot_of(arguments.robot, library)
        others = {name: x for name, x in start.items() if name not in robot.joint_names}
        robot = robot.locked_at(others)
        start |= by_name(library.joint_names, usual_ends(library.ends)[0])
    if arguments.start is not None:
        given = joint_values(arguments.start, robot.described_joints, "--start")
        _check_within_limits(given, robot)
        start |= given
    simulated = SimulatedRobot(
        robot,
        np.array([start[name] for name in robot.joint_names]),
        time_ns=time.time_ns(),
        state_rate=arguments.rate,
    )
    simulated.faults = Faults(speed_scaling=arguments.speed_scaling, payload=arguments.payload)
    start_ros(arguments.ros_arguments)
    received = list[int]()
    for kind in (signal.SIGINT, signal.SIGTERM):
        signal.signal(kind, lambda caught, _: received.append(caught))
    node = SimulatedRobotNode(
        simulated,
        robot.urdf,
        arguments.controller_topic,
        others=others,
        keep_record=arguments.record is not None,
    )
    spin_until(lambda: bool(received), node, lambda: max(node.advance(), 0.0))
    if arguments.record is not None:
        content = io.BytesIO()
        np.savez_compressed(
            content,
            joint_names=np.array(robot.joint_names),
            taken=np.reshape(simulated.taken, (-1, 2)),
            delays=np.array(node.delays),
            **dict[str, Any](simulated.record.arrays()),
        )
        write_whole(arguments.record, content.getvalue(), overwrite=arguments.force)
    facts = {
        "received": simulated.n_received,
        "rejected": [{"time": when, "reason": why} for when, why in simulated.rejections],
        "joint_names": simulated.joint_names,
        "positions": simulated.measured_state()[0],
        "written": arguments.record,
    }
    show(arguments, facts)
    return DONE


def _start_within_limits(robot: Robot) -> dict[str, float]:
    """A position of each joint: 0 if its limits include that, else the middle of its range."""
    ranges, start = robot.position_ranges(), dict[str, float]()
    for name in robot.joint_names:
        low, high = ranges.get(name, (-np.inf, np.inf))
        start[name] = 0.0 if low < 0.0 < high else 0.5 * (low + high)
    return start


def _check_within_limits(start: dict[str, float], robot: Robot) -> None:
    limits = robot.limits()
    for name, low, high in zip(robot.joint_names, limits.lower, limits.upper, strict=True):
        if name in start and not low <= start[name] <= high:
            unit = "m" if name in robot.prismatic_joints else "rad"
            raise RobotError(
                f"--start: joint '{name}' at {start[name]:g} is outside its limits "
                f"[{low:g}, {high:g}] {unit}"
            )
