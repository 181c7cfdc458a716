# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`view`: the robot, its primitives and plans on a page in the browser."""

from __future__ import annotations

import argparse
import threading
from contextlib import suppress
from dataclasses import replace

from ..exceptions import GoalError
from ..primitives.library import PrimitiveLibrary, load_primitives
from ..primitives.primitive import MovementPrimitive
from ..robot.examples import HUMAN_ARM
from ..robot.model import Robot
from ..robot.world import World
from .common import robot_of
from .example_robots import demonstrations_of
from .options import SCENE, add_file, add_robot_files, limits_given, number
from .terminal import DONE, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = (
        "Show the robot, its primitives and plans on a page in the browser. You drag the goal, and "
        "the plan follows. Without FILE, it is an example. The page needs no ROS, and only this "
        "machine can open it. Ctrl-C ends the command."
    )
    add_robot_files(parser, is_needed=False)
    add_file(parser, "--obstacles", "FILE", SCENE)
    help_text = "port, or the first free one after it; 0: any (default: %(default)s)"
    parser.add_argument("--port", type=number(0, 65535, kind=int), default=8080, help=help_text)


def run(arguments: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C; returns the exit status."""
    if (arguments.robot is None) != (not arguments.primitives):
        raise GoalError(
            "pass primitive files and --robot URDF; without both, the page shows an example"
        )
    robot, primitives = _read(arguments)
    # After the files were read: it takes a second.
    from ..view.content import read_content
    from ..view.page import ViewPage

    given = limits_given(arguments, robot)
    content = read_content(robot.with_drives(given), primitives, arguments.package_dirs)
    limits = robot.limits(given)
    world = World() if arguments.obstacles is None else World.from_file(arguments.obstacles)
    with ViewPage(replace(content, limits=limits, world=world), arguments.port) as page:
        say(f"page         {page.url} (for this machine only; Ctrl-C ends it)")
        with suppress(KeyboardInterrupt):  # the usual end
            threading.Event().wait()
    return DONE


def _read(arguments: argparse.Namespace) -> tuple[Robot, PrimitiveLibrary]:
    """The robot and the primitives of the files, or an example."""
    if arguments.primitives:
        primitives = load_primitives(arguments.primitives)
        return robot_of(arguments.robot, primitives), primitives
    say("no FILE is given: the page shows the human-like arm with a primitive of generated motions")
    robot = Robot.example(HUMAN_ARM)
    motions = demonstrations_of(HUMAN_ARM, robot, robot.limits())
    return robot, PrimitiveLibrary([MovementPrimitive.fit(motions, name="example")])
