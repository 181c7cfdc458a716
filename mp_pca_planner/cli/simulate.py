# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`simulate`: a simulated robot on ROS topics, behind a trajectory controller."""

from __future__ import annotations

import argparse
import io
import signal
import time
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray, by_name
from ..exceptions import GoalError, quote_names
from ..files import write_whole
from ..primitives.library import load_primitives
from ..robot.model import Robot
from ..ros.nodes import spin_until, start_ros
from ..ros.simulated_robot import SimulatedRobotNode
from ..simulation.robot import Faults, SimulatedRobot
from .common import check_output, robot_of, show, usual_ends
from .goal_arguments import angles_in_degrees, joint_values
from .options import add_file, add_report, name_list, number, whole
from .terminal import DONE

_FAULTS = {
    "speed_scaling": (1.0, "speed of the controller's clock, 0 to 1"),
    "payload": (0.0, "unknown mass at the end effector [kg]"),
    "delay": (0.0, "time until a trajectory reaches the controller [s]"),
    "jitter": (0.0, "largest random addition to the delay [s]"),
    "drop": (0.0, "probability that a trajectory is lost"),
    "noise": (0.0, "standard deviation of measured positions [rad or m]"),
}
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
    help_text = "primitive file: the robot has its joints and starts as its demonstrations"
    parser.add_argument("--primitive", metavar="FILE", help=help_text)
    help_text = "joints of the controller (default: all)"
    parser.add_argument("--joints", metavar="A,B", type=name_list, help=help_text)
    help_text = "start: name=value,… or values in joint order [rad or m]"
    parser.add_argument("--start", metavar="VALUES", help=help_text)
    parser.add_argument("--degrees", action="store_true", help="angles are in degrees")
    rate = number(0.01, 1000.0, "Hz")
    help_text = "rate of joint_states (default: %(default)g)"
    parser.add_argument("--rate", metavar="HZ", type=rate, default=500.0, help=help_text)
    topic = "mp_pca_planner/joint_trajectory"
    help_text = "of the trajectories to execute (default: %(default)s)"
    parser.add_argument("--controller-topic", metavar="TOPIC", default=topic, help=help_text)
    for name, (default, meaning) in _FAULTS.items():
        option = f"--{name.replace('_', '-')}"
        parser.add_argument(option, metavar="X", type=float, default=default, help=meaning)
    seed = whole(0, 2**63 - 1)
    help_text = "seed of all random numbers"
    parser.add_argument("--seed", metavar="N", type=seed, default=0, help=help_text)
    add_file(parser, "--record", "FILE.npz", "file to write every command to, at 1 kHz")
    add_report(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command until SIGINT or SIGTERM; returns the exit status."""
    check_output(arguments.record, ".npz", force=arguments.force)
    shown: dict[str, float] = {}
    if arguments.primitive is None:
        robot = Robot.from_file(arguments.robot, arguments.joints)
    else:
        if arguments.joints is not None:
            raise GoalError("--primitive says which joints the controller has: remove --joints")
        library = load_primitives([arguments.primitive])
        robot = robot_of(arguments.robot, library)
        shown = by_name(library.joint_names, usual_ends(library.ends)[0])
    simulated = SimulatedRobot(
        robot,
        _start(robot, arguments.start, angles_in_degrees(arguments, robot), shown),
        seed=arguments.seed,
        time_ns=time.time_ns(),
        state_rate=arguments.rate,
    )
    simulated.faults = Faults(**{name: getattr(arguments, name) for name in _FAULTS})
    start_ros(arguments.ros_arguments)
    received = list[int]()
    for kind in (signal.SIGINT, signal.SIGTERM):
        signal.signal(kind, lambda caught, _: received.append(caught))
    node = SimulatedRobotNode(
        simulated,
        robot.urdf,
        arguments.controller_topic,
        keep_record=arguments.record is not None,
    )
    spin_until(lambda: bool(received), node, lambda: max(node.advance(), 0.0))
    if arguments.record is not None:
        arrays = simulated.record.arrays() | {
            "taken": np.reshape(simulated.taken, (-1, 2)),
            "delays": np.array(node.delays),
        }
        _write(arguments.record, arrays, robot, overwrite=arguments.force)
    show(arguments, _summary(simulated) | {"written": arguments.record})
    return DONE


def _start(
    robot: Robot, text: str | None, angles: Collection[str], shown: Mapping[str, float]
) -> FloatArray:
    """The start that is given, else that of the demonstrations, else one within the limits."""
    limits = robot.limits()
    with np.errstate(invalid="ignore"):
        middle = 0.5 * (limits.lower + limits.upper)
    start = np.where((limits.lower < 0.0) & (limits.upper > 0.0), 0.0, middle)
    names = robot.described_joints
    others = [name for name in robot.movable_joints if name not in names]
    try:
        given = {} if text is None else joint_values(text, names, "--start", angles=angles)
        given = {**shown, **given}
    except GoalError as error:
        more = f"; {quote_names(others)} mimic these, or are not in --joints" if others else ""
        raise GoalError(f"{error}{more}") from None
    return np.array([given.get(n, q) for n, q in zip(robot.joint_names, start, strict=True)])


def _write(path: Path, arrays: dict[str, Any], robot: Robot, *, overwrite: bool) -> None:
    content = io.BytesIO()
    np.savez_compressed(content, joint_names=np.array(robot.joint_names), **arrays)
    write_whole(path, content.getvalue(), overwrite=overwrite)


def _summary(simulated: SimulatedRobot) -> dict[str, Any]:
    q, _ = simulated.measured_state()
    return {
        "received": simulated.n_received,
        "rejected": [{"time": when, "reason": why} for when, why in simulated.rejections],
        "joint_names": simulated.joint_names,
        "positions": q,
    }
