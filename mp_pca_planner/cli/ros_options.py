# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Options of the commands that run a robot, or talk to the running node."""

from __future__ import annotations

from pathlib import Path

from .parser import NODE, Options, name_list, number, seconds, seed


def demo(add: Options) -> None:
    """Record, build, plan and execute: the whole pipeline with a simulated human-like arm.

    Demonstrations are recorded into a bag and become primitives. The planner node and a simulated
    robot are started, goals are sent from another process, the robot executes the motions, and
    pictures show the results.
    """
    add("--output DIR", "folder of the results", Path, Path("demo_output"))
    add.flag("--view", "then show the robot, its primitive and plans on a page in the browser")


def send_goal(add: Options) -> None:
    """Send a goal configuration, a sequence of them, or a pose to the running planner node.

    The command waits for the node's report and prints it. Status 0: the motion was published; 1:
    no answer, or a newer goal came; 2: refused.
    """
    goal = add.one_of(required=True)
    goal("goal NAME=VALUE,...", "positions [rad or m] by joint name", nargs="?")
    goal("--pose 'X Y Z QX QY QZ QW'", "pose of the end effector [m, unit quaternion]")
    add("--frame LINK", "link in whose frame --pose is stated; empty: the base", default="")
    text = "positions of the same joints to pass; @T, also of the goal: T s after the start"
    add.via("NAME=VALUE,...[@T]", text, with_stops=True)
    add.flag("--degrees", "positions are in degrees, not in radians")
    add("--primitive NAME", "primitive to use; empty: the node chooses", default="")
    add("--wait S", "first wait up to S s until the node is ready for goals", seconds)
    add.node()
    add("--timeout S", "longest time to wait [s]", seconds, 10.0)
    add.flag("--verbose", "print all values of the report")
    add.report(written=None)


def _add_service_options(add: Options) -> None:
    add.node()
    add("--timeout S", "longest time to wait for the node, and for its answer [s]", seconds, 10.0)
    add.report(written=None)


def stop(add: Options) -> None:
    """Have the running planner node bring the robot to rest as fast as the limits allow."""
    _add_service_options(add)


def save_motion(add: Options) -> None:
    """Have the running planner node save its last motion as a primitive in its `save_folder`."""
    _add_service_options(add)


def reload(add: Options) -> None:
    """Have the running planner node read its primitive files again."""
    _add_service_options(add)


def simulate(add: Options) -> None:
    """Simulate a robot that publishes joint_states and robot_description and executes trajectories.

    Its controller has the semantics of joint_trajectory_controller. Its faults are parameters of
    the node simulated_robot: speed_scaling, held, silent, delay, jitter, active, drop, payload,
    noise. Pass node arguments after --ros-args. Ctrl-C ends it.
    """
    add("--robot URDF", "the robot", Path, required=True)
    add("--joints A,B", "joints of the controller; all by default", name_list)
    text = "name=value,… or one per joint [rad or m]; by default 0, or the middle between limits"
    add("--start VALUES", text)
    add("--rate HZ", "rate of joint_states", number(0.01, 1000.0, "Hz"), 500.0)
    topic = f"{NODE}/joint_trajectory"
    add("--controller-topic TOPIC", "topic of the trajectories to execute", default=topic)
    add("--speed-scaling SHARE", "speed of the controller's clock, 0 to 1", float, 1.0)
    add("--payload KG", "unknown mass at the end effector", float, 0.0)
    add("--delay S", "time that a trajectory takes to the controller", float, 0.0)
    add("--jitter S", "largest random addition to the delay", float, 0.0)
    add("--drop P", "probability that a trajectory is lost", float, 0.0)
    add("--noise RAD", "standard deviation of measured positions", float, 0.0)
    add("--seed N", "seed of all random numbers", seed, 0)
    add("--plant", "physics engine", default="pinocchio", choices=("pinocchio", "mujoco"))
    add("--record FILE", "file (.npz) for every command at 1 kHz", Path)
    add.report("the file")


def teach(add: Options) -> None:
    """Teach a primitive to the running robot: record, cut, learn and try.

    All joint states are recorded while the arm is moved by hand. A motion is shown when the arm has
    rested for 0.6 s, with what the motions up to then teach. Keys: d discards the last motion; b
    builds the primitive and has the node reload it; q, or the end of the input, quits. The first
    goal is sent to the node after an explicit yes. The recording FILE.mcap and tables of the
    motions are beside FILE.npz; the same command continues a session that was quit or killed.
    """
    add("--output FILE.npz", "primitive to write; the recording is beside it", Path, required=True)
    add("--joints a,b,c", "joints, in this order (default: the robot's, or all)", name_list)
    add("--robot URDF", "the robot; places of its end effector are shown", Path)
    add("--frame LINK", "its end effector (default: the last link)", default="")
    add("--topic", "topic of joint states (default: joint_states, or the only one of --play)")
    add("--play BAG", "recording to play back instead, without ROS", Path)
    add.node()
    add("--timeout S", "longest time to wait for the node and its answers [s]", seconds, 10.0)
    add.flag("--force", "overwrite the primitive")
