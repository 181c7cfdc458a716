# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Options of all commands.

This module imports no other room, so that help is printed at once. Choices and defaults that
belong to other rooms are repeated here; a test compares them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

from .option_types import count, duration, jobs, name_list, number, seconds, seed, whole
from .parser import Options, parse_command
from .ros_options import demo, reload, save_motion, send_goal, simulate, stop, teach
from .shared_options import add_node_options, add_report_options, add_via

VALUES = "name=value,… or values in the robot description's joint order [rad or m]"
_PLACE = "configuration (name=value,…) or pose ('FRAME: X Y Z' or with a quaternion)"


# Options that several commands have


def _add_bag_options(add: Options) -> None:
    add("--topic", "JointState topic of the bags (default: the only one)")
    add("--field a.b", "field of the topic's messages that is a JointState")
    add.flag("--recover --salvage", "of a damaged bag, use the part before the damage")


def _add_motion_options(add: Options) -> None:
    """Add what every planned motion needs."""
    add("primitives FILE", "primitive files or folders", nargs="+")
    add("--robot URDF", "the robot", Path, required=True)
    add("--start", f"start configuration: {VALUES}", required=True)
    add("--primitive --use NAME", "primitive to use (default: the nearest)")
    likeness = "weight of likeness to the demonstrations against effort"
    add("--naturalness ρ", likeness, number(0.0, 1e6), 1.0)
    add("--limits FILE.yaml", "limits in the form of joint_limits.yaml", Path)
    add("--sample-period", "time step [s]", number(1e-4, 1.0, "s"), 0.01)
    add.flag("--collision", "avoid self-collisions")
    text = "obstacles to avoid: a planning scene of MoveIt, .scene or YAML"
    add("--obstacles FILE", text, Path)
    add("--margin", "least clearance from --obstacles [m] (default: 0)", number(0.0, 10.0, "m"))
    add("--srdf FILE", "link pairs to skip (default: neighbours, and those in contact)", Path)
    text = "folders of packages with meshes; searched before ROS's and those above the URDF"
    add("--package-dirs DIR", text, Path, (), nargs="+")


def _add_single_goal(add: Options, via_form: str, via_time: str) -> None:
    """Add where one motion ends, how, and what it passes."""
    goal = add.one_of(required=True)
    goal("--goal", f"goal: {VALUES}; unnamed joints stay")
    text = "pose of a frame [m, unit quaternion] in the base frame; 3 numbers: position only"
    goal("--goal-pose 'X Y Z QX QY QZ QW'", text)
    add("--frame", "link of --goal-pose (default: the last)")
    for end in ("start", "goal"):
        for rate in ("velocity", "acceleration"):
            add(f"--{end}-{rate} {rate[0].upper()}", f"{rate} at the {end}, likewise")
    add_via(add, via_form, f"{_PLACE} to pass, {via_time}")
    text = "duration [s], 'shortest', or 'free' for least cost (default: like the demonstrations)"
    add("--duration T", text, duration)
    text = "weighted sum to minimise, of effort, energy, jerk, time, straightness"
    add("--objective NAME=WEIGHT,…", text, default="effort=1")
    add("--basis", "basis functions", default="pca", choices=("pca", "bspline"))
    add("--starts N", "starts of the search, if naturalness is below 0.1", whole(1, 5), 5)


def _add_motion_outputs(add: Options) -> None:
    add("--output FILE", "motion to write: .csv, .json, .npz, or a bag", Path)
    add("--plot FILE.png", "picture to draw", Path)
    add_report_options(add)


# Planning


def plan(add: Options) -> None:
    """Plan one motion of least effort from primitive files."""
    _add_motion_options(add)
    _add_single_goal(add, "V[@PHASE]", "at a phase from 0 to 1 or at the best one")
    _add_motion_outputs(add)


def sequence(add: Options) -> None:
    """Plan one motion through configurations and poses that stops only where asked."""
    _add_motion_options(add)
    text = f"{_PLACE} to pass, with @T at T s after the start"
    add_via(add, "V[@T]", text, with_stops=True)
    add("--goal", "goal, likewise", required=True)
    add("--mode", "join segments, or optimise", default="optimal", choices=("real_time", "optimal"))
    _add_motion_outputs(add)


def refine(add: Options) -> None:
    """Plan a motion or, with --via, a sequence, then improve it segment by segment.

    The amplitude, the duration and the timing of a segment are changed: by the robot's model, or
    with --trials by the cost of executions.
    """
    _add_motion_options(add)
    _add_single_goal(add, "V", "as in `sequence`, but at any time")
    add.preset(mode="optimal")
    price = number(0.0, 1e12)
    add("--time-price P", "cost of 1 s, in units of ½∫‖τ‖²dt (default: the duration stays)", price)
    add("--min-gain SHARE", "least gain for a new primitive", number(0.0, 0.999), 0.01)
    add("--name", "name of the new primitive (default: OLD_refined)")
    add("--output FILE.npz", "new primitive to write; numbered for segments of a sequence", Path)
    text = "refined motion, or next trial, to write: .csv, .json, .npz, or a bag"
    add("--trajectory FILE", text, Path)
    text = "Each call proposes a motion; the next reports its cost. Other options stay the same."
    trials = add.group("trials", text)
    trials("--trials FILE.json", "file of the trials", Path)
    cost = trials.one_of()
    cost("--cost C", "cost of the last proposal", number(-1e12, 1e12))
    cost("--executed BAG", "recording of its execution; its ½∫‖τ‖²dt is the cost", Path)
    trials("--tracking-price P", "price of ∫‖q − q_planned‖²dt of --executed", price, 0.0)
    trials("--seed", "seed of the random numbers", seed, 0)
    add_report_options(add)


def verify(add: Options) -> None:
    """Simulate a planned motion under a control law, and compare with the claimed error bound.

    The simulations have errors of the model and the start, effort limits, sampling and delay.
    """
    _add_motion_options(add)
    _add_single_goal(add, "V[@PHASE]", "at a phase from 0 to 1 or at the best one")
    law = add.group("control law (default: the primitive's own, if it has one)")
    kinds = ("feedforward_pd", "computed_torque")
    law("--law", "kind of law (default: feedforward_pd)", choices=kinds)
    law("--natural-frequency ω", "for gains [rad/s]", number(1e-3, 1e5), 30.0)
    law("--damping-ratio ζ", "for gains", number(1e-3, 1e3), 1.0)
    law("--position-gains P", "gains: name=value,… of all joints")
    law("--velocity-gains D", "gains: name=value,… of all joints")
    errors = add.group("assumed errors")
    text = "of masses and principal moments of inertia of links, either way"
    errors("--inertia-error SHARE", text, number(0.0, 1.0), 0.05)
    errors("--payload", "largest unknown mass [kg]", number(0.0, 1e4), 0.0)
    errors("--payload-link LINK", "link that carries it (default: the last)")
    errors("--start-error", "of each joint [rad or m]", number(0.0, 10.0), 0.001)
    errors("--control-period", "sampling [s]", number(1e-6, 1.0, "s"), 1e-3)
    errors("--delay", "samples from measurement to action", whole(0, 1000), 1)
    add("--trials", "simulations", count, 100)
    add("--seed", "seed of the errors", seed, 0)
    add("--output FILE.npz", "primitive with this law to write", Path)
    add("--controller-parameters FILE.yaml", "gains to write, for the controller", Path)
    add("--controller", "name of the controller", default="joint_trajectory_controller")
    add_report_options(add)


# Recordings and primitives


def build_primitives(add: Options) -> None:
    """Learn a movement primitive from recorded bags and write it to a file."""
    add("bags BAG", "ROS 1 .bag, rosbag2 folder, .db3, .mcap; globs and folders of bags", nargs="*")
    _add_input(add.group("input"))
    _add_segmentation(add.group("cutting recordings into motions"))
    primitive = add.group("primitive")
    primitive("--name", "name of the primitive (default: that of the file)")
    _add_primitive(primitive)
    output = add.group("output")
    text = "primitive to add the recordings to; its options stay unless others are given"
    output("--update FILE", text, Path)
    text = "recordings to take out of --update, by name or checksum"
    output("--remove a,b,c", text, name_list, ())
    output("--output FILE", "file to write (default: that of --update)", Path)
    output("--report FILE.html", "page that shows what was found", Path)
    output("--write-segments FILE.csv", "motions as a table to edit, for --segments", Path)
    add_report_options(output, "the outputs")


def build_library(add: Options) -> None:
    """Find the kinds of motions in mixed recordings, and learn a primitive of each.

    The primitives go into a folder that keeps every version; `plan` and the node accept it. Motions
    that belong to no kind are kept apart. Recordings of other joints go into folders of their own.
    """
    add("bags BAG", "ROS 1 .bag, rosbag2 folder, .db3, .mcap; globs and folders of bags", nargs="*")
    _add_input(add.group("input"))
    _add_segmentation(add.group("cutting recordings into motions"))
    kinds = add.group("kinds and their primitives")
    kinds("--min-kind N", "least number of motions of a kind; fewer are outliers", count, 3)
    _add_primitive(kinds)
    output = add.group("output")
    output("--output FOLDER", "the library", Path, required=True)
    output.flag("--update", "add the recordings to the library, without reading the old ones again")
    output("--remove a,b,c", "recordings to take out of it, by name or checksum", name_list, ())
    output("--report FILE.html", "page that shows the kinds", Path)
    add_report_options(output, "the report")


def _add_input(add: Options) -> None:
    _add_bag_options(add)
    add("--joints a,b,c", "joints, in this order", name_list)
    add("--robot URDF", "robot whose joints are used, or with which --joints are checked", Path)
    add("--markers TOPIC", "topic of markers to find joint angles from")
    add("--marker-map FILE.yaml", "places of the markers on the robot's links", Path)
    add.flag("--no-cache", "neither keep what is read in ~/.cache nor use what is kept there")
    add("--max-gap S", "cut at longer gaps [s] (default: 0.5, or 5 usual periods)", seconds)
    workers = add.one_of()
    workers("--jobs N", "recordings to read at the same time", jobs, 1)
    workers("--dask ADDRESS", "scheduler (tcp://HOST:PORT) of a Dask cluster that reads them")
    add("--resume FOLDER", "keep what was read in this folder, and read only the rest", Path)


def _add_segmentation(add: Options) -> None:
    add("--segment", "cut at rests, or not at all", default="auto", choices=("auto", "none"))
    add("--min-rest S", "shorter rests don't cut [s] (default: 0.6)", seconds)
    add("--min-motion S", "no motion is shorter [s] (default: 0.25)", seconds)
    add("--segments FILE.csv", "motions: recording,start_time_s,end_time_s[,label]", Path)
    add("--label a,b,c", "only motions with these labels in the table of --segments", name_list)


def _add_primitive(add: Options) -> None:
    add("--coupling", "a PCA of each", default="arm", choices=("joint", "arm"))
    size = add.one_of()
    size("--components K", "number of components", int)
    size("--variance", "share of the variance that the components explain", float, 0.99)
    add("--phases", "samples per motion", int, 101)
    add("--degree", "degree of the polynomials", int, 15)
    kinds = ("linear", "arc_length", "dtw")
    text = "by time, by path length, or to the mean shape, with all samples in memory"
    add("--align", text, default="arc_length", choices=kinds)


def inspect(add: Options) -> None:
    """Show what is in bags and primitive files."""
    add("files FILE", "bag, folder of bags, or .npz", nargs="+")
    _add_bag_options(add)
    add_report_options(add, written=None)


def library(add: Options) -> None:
    """Add primitives to a folder, retire them, or roll them back to an earlier version.

    Every version is kept, every change recorded; `plan` and the node accept the folder.
    """
    add("action", "what to do", choices=("list", "history", "add", "retire", "rollback"))
    add("folder FOLDER", "the library", Path)
    add("what FILE|NAME", "files to add, or names of primitives", nargs="*")
    add("--version N", "version to roll back to", int)
    add("--note", "reason, for the history", default="")
    add_report_options(add, written=None)


# Evaluation


def benchmark(add: Options) -> None:
    """Compare components with B-splines and other methods on the same problems."""
    text = "URDF file, 'human_arm', or of example-robot-data: panda, ur5, kinova"
    add("--robot NAME|URDF", f"{text} (default: human_arm, or that of --scenes)")
    add("--joints a,b,c", "joints that move (default: the robot's arm, or all)", name_list)
    add("--primitives FILE", "primitive file (default: from generated motions)", Path)
    add("--limits FILE.yaml", "limits in the form of joint_limits.yaml", Path)
    text = "folder of problems among obstacles, in the files of MotionBenchMaker: compare there"
    add("--scenes DIR", text, Path)
    add("--problems N", "number of problems; of each set with --scenes", count, 200)
    add.flag("--random-ends", "problems within the limits, not within the demonstrations")
    add("--seed", "seed of the problems", seed, 2)
    add(
        "--peers a,b,c",
        "other methods: all, none, or some of promp, dmp, fddp, box_fddp, slsqp_differences, "
        "slsqp_gradients, drake, ruckig; with --scenes, ompl_toppra",
        default="all",
    )
    add("--peer-problems N", "problems for slow peers", count, 10)
    add("--repeats", "times each is solved", count, 3)
    add("--time-limit S", "for one problem [s] (default: 10, with --scenes 1)", seconds)
    add("--plot FILE.png", "picture of cost over time to draw", Path)
    add_report_options(add, "the picture")


def case_study(add: Options) -> None:
    """The case study of the paper, from recordings of arm motions.

    It shows components of the motions, an arm-raising motion planned with them and with
    B-splines, and the distance of planned motions from human ones.
    """
    add("--recordings BAG", "recordings of markers (default: generated motions)", nargs="+")
    add("--markers TOPIC", "their topic", default="/markers")
    add("--joint-states TOPIC", "topic of joint states, if the recordings hold those")
    add("--robot URDF", "model (default: human_arm.urdf)", Path)
    add("--marker-map YAML", "default: human_arm_markers.yaml", Path)
    add("--segments FILE.csv", "motions cut by hand")
    add("--motions N", "number of motions to study", count, 52)
    add("--arm A,B,C", "frames along the arm, to its tip", default="upper_arm,lower_arm,wrist")
    add("--jobs N", "recordings to read at the same time", jobs, 1)
    add("--output DIR", "folder of the results", Path, Path("case_study_output"))
    add_report_options(add, "earlier results")


# Running with ROS


def view(add: Options) -> None:
    """Show the robot, its primitives and plans on a page in the browser.

    The goal is dragged and the plan follows; components bend the mean motion; demonstrations are
    played. With --live it shows a running planner node and its robot, too, and sends goals to it
    once that is armed on the page. Ctrl-C ends it.
    """
    add("primitives FILE", "primitive files or folders", nargs="+")
    add("--robot URDF", "the robot", Path, required=True)
    add("--limits FILE.yaml", "limits in the form of joint_limits.yaml", Path)
    text = "folders of packages with meshes; searched before ROS's and those above the URDF"
    add("--package-dirs DIR", text, Path, (), nargs="+")
    add("--obstacles FILE", "obstacles: a planning scene of MoveIt, .scene or YAML", Path)
    add("--frame LINK", "link that the handle moves (default: the last)", default="")
    text = "recordings of the demonstrations (default: as the primitives reproduce them)"
    add("--demonstrations BAG", text, nargs="+")
    add("--topic", "JointState topic of --demonstrations (default: the only one)")
    text = "address to listen on; with 0.0.0.0, every machine that reaches it can use the page"
    add("--host", text, default="127.0.0.1")
    add("--port", "port, or the first free one after it; 0: any", whole(0, 65535), 8080)
    add("--for S", "end after this time [s]", seconds, dest="duration")
    live = add.group("beside a running node")
    live.flag("--live", "show the node and its robot, with a stop button")
    add_node_options(live)
    text = "topic of the node's motions, if it is remapped (default: NODE/joint_trajectory)"
    live("--controller-topic TOPIC", text, default="")


_COMMANDS = (
    *(build_primitives, build_library, inspect, plan, sequence, refine, benchmark, library),
    *(verify, case_study),
    *(demo, send_goal, stop, save_motion, reload, simulate, view, teach),
)


def parse(command: str, argv: Sequence[str]) -> argparse.Namespace:
    """Parse the arguments of a command; prints a message and exits if they are wrong."""
    add_options = options_of(command)
    assert add_options is not None
    return parse_command(command, add_options, argv)


def options_of(command: str) -> Callable[[Options], None] | None:
    """The function that declares the options of a command; None for the node."""
    return next((function for function in _COMMANDS if function.__name__ == command), None)
