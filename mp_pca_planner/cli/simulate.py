# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`simulate`: a simulated robot on ROS topics, behind a trajectory controller."""

from __future__ import annotations

import argparse
import io
import signal
import sys
import threading
import time
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..exceptions import MissingDependencyError
from ..files import write_whole
from ..robot.model import Robot
from .common import (
    CommandParser,
    check_output,
    joint_list,
    joint_values,
    number,
    print_json,
    run,
)
from .common import seed as seed_number
from .terminal import DONE, say, written_lines

CONTROLLER_TOPIC = "mp_pca_planner/joint_trajectory"
"""Topic of the motions that the node publishes by default."""

_ROS_ARGUMENTS = "--ros-args"
_ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_FAULTS = {
    "speed_scaling": (1.0, "SHARE", "speed of the controller's clock, 0 to 1"),
    "payload": (0.0, "KG", "mass at the end effector that gravity compensation doesn't know"),
    "delay": (0.0, "S", "time that a trajectory takes to the controller"),
    "jitter": (0.0, "S", "largest random addition to the delay"),
    "drop": (0.0, "P", "probability that a trajectory is lost"),
    "noise": (0.0, "RAD", "standard deviation of measured positions"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    stop = threading.Event()
    previous = {number: signal.signal(number, lambda *_: stop.set()) for number in _ENDING_SIGNALS}
    arguments = list(sys.argv[1:] if argv is None else argv)
    cut = arguments.index(_ROS_ARGUMENTS) if _ROS_ARGUMENTS in arguments else len(arguments)

    def body(options: argparse.Namespace) -> int:
        return _simulate(options, arguments[cut:], stop)

    try:
        return run(_parser(), body, arguments[:cut])
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _parser() -> CommandParser:
    parser = CommandParser(
        "simulate",
        "Simulate a robot: publish its joint_states and robot_description, and execute "
        "trajectories as joint_trajectory_controller does. Its faults are parameters of the node "
        "simulated_robot: speed_scaling, held, silent, delay, jitter, active, drop, payload, "
        "noise. Pass node arguments after --ros-args. Ctrl-C ends it.",
    )
    parser.add_argument("--robot", type=Path, required=True, metavar="URDF", help="the robot")
    parser.add_argument(
        "--joints", type=joint_list, metavar="A,B", help="joints of the controller; all by default"
    )
    parser.add_argument(
        "--start",
        metavar="VALUES",
        help="name=value,… or one value per joint [rad or m]; by default 0, or the middle between "
        "limits that exclude it",
    )
    parser.add_argument(
        "--rate",
        type=number(0.01, 1000.0, "Hz"),
        default=500.0,
        metavar="HZ",
        help="rate of joint_states",
    )
    parser.add_argument(
        "--controller-topic",
        default=CONTROLLER_TOPIC,
        metavar="TOPIC",
        help="topic of the trajectories to execute",
    )
    for name, (default, unit, text) in _FAULTS.items():
        option = "--" + name.replace("_", "-")
        parser.add_argument(option, type=float, default=default, metavar=unit, help=text)
    parser.add_argument(
        "--seed", type=seed_number, default=0, metavar="N", help="seed of all random numbers"
    )
    parser.add_argument(
        "--plant", choices=("pinocchio", "mujoco"), default="pinocchio", help="physics engine"
    )
    parser.add_argument(
        "--record", type=Path, metavar="FILE", help="file (.npz) for every command at 1 kHz"
    )
    parser.add_argument("--force", action="store_true", help="overwrite the file")
    parser.add_argument("--json", action="store_true", help="print one JSON object at the end")
    return parser


def _simulate(
    arguments: argparse.Namespace, ros_arguments: Sequence[str], stop: threading.Event
) -> int:
    if find_spec("rclpy") is None:
        raise MissingDependencyError("rclpy", "ros", "the command 'simulate'")
    check_output(arguments.record, ".npz", force=arguments.force)
    robot = Robot.from_file(arguments.robot, arguments.joints)
    start = _start(robot, arguments.start)
    from ..ros.simulated_robot import SimulatedRobotNode, run_node, start_ros
    from ..simulation import Faults, SimulatedRobot

    faults = Faults(**{field: getattr(arguments, field) for field in _FAULTS})
    simulated = SimulatedRobot(
        robot,
        robot.joint_names,
        start,
        seed=arguments.seed,
        plant=arguments.plant,
        time_ns=time.time_ns(),
        state_rate=arguments.rate,
    )
    simulated.faults = faults
    start_ros(ros_arguments)
    node = SimulatedRobotNode(
        simulated,
        arguments.robot.read_text(encoding="utf-8"),
        arguments.controller_topic,
        keep_record=arguments.record is not None,
    )
    run_node(node, stop)
    if arguments.record is not None:
        arrays = simulated.record.arrays() | {"taken": np.reshape(simulated.taken, (-1, 2))}
        _write(arguments.record, arrays, robot, overwrite=arguments.force)
    summary = _summary(simulated)
    if arguments.json:
        print_json(summary)
    else:
        say(f"{summary['received']} trajectories received, {len(summary['rejected'])} rejected")
        say(*written_lines([arguments.record]))
    return DONE


def _start(robot: Robot, text: str | None) -> FloatArray:
    limits = robot.limits()
    with np.errstate(invalid="ignore"):
        middle = 0.5 * (limits.lower + limits.upper)
    start = np.where((limits.lower < 0.0) & (limits.upper > 0.0), 0.0, middle)
    given = {} if text is None else joint_values(text, robot.joint_names, "--start")
    return np.array([given.get(n, q) for n, q in zip(robot.joint_names, start, strict=True)])


def _write(path: Path, arrays: dict[str, Any], robot: Robot, *, overwrite: bool) -> None:
    content = io.BytesIO()
    np.savez_compressed(content, joint_names=np.array(robot.joint_names), **arrays)
    write_whole(path, content.getvalue(), overwrite=overwrite)


def _summary(simulated: Any) -> dict[str, Any]:
    q, _ = simulated.measured_state()
    return {
        "received": simulated.n_received,
        "rejected": [{"time": when, "reason": why} for when, why in simulated.rejections],
        "joint_names": simulated.joint_names,
        "positions": q,
    }
