# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`view`: the robot, its primitives and plans on a page in the browser."""

from __future__ import annotations

import argparse
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from ..primitives.library import load_primitives
from ..robot.world import World
from .common import robot_of
from .options import add_robot_files, limits_given, whole
from .terminal import DONE, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = (
        "Show the robot, its primitives and plans on a page in the browser. You drag the goal, and "
        "the plan follows. Sliders of the components bend a typical demonstration. The page needs "
        "no ROS, and only this machine can open it. Ctrl-C ends the command."
    )
    add_robot_files(parser)
    parser.add_argument(
        "--obstacles",
        metavar="FILE",
        type=Path,
        help="obstacles: a planning scene of MoveIt, .scene or YAML",
    )
    parser.add_argument(
        "--port",
        type=whole(0, 65535),
        default=8080,
        help="port, or the first free port after it; 0: any free port (default: %(default)s)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C; returns the exit status."""
    primitives = load_primitives(arguments.primitives)
    robot = robot_of(arguments.robot, primitives)
    # After the files were read: it takes a second.
    from ..view.content import read_content
    from ..view.page import ViewPage

    given = limits_given(arguments, robot)
    content = read_content(robot.with_drives(given), primitives, arguments.package_dirs)
    limits = robot.limits(given)
    world = World() if arguments.obstacles is None else World.from_file(arguments.obstacles)
    with ViewPage(replace(content, limits=limits, world=world), arguments.port) as page:
        is_moved = arguments.port and page.server.get_port() != arguments.port
        moved = f"port {arguments.port} is in use; " if is_moved else ""
        say(f"page         {page.url} ({moved}for this machine only; Ctrl-C ends it)")
        with suppress(KeyboardInterrupt):  # the usual end
            threading.Event().wait()
    return DONE
