# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`view`: the robot, its primitives and plans on a page in the browser."""

from __future__ import annotations

import argparse
import threading
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from ..exceptions import PlannerError
from ..primitives.library import load_primitives
from ..recordings.load import load_recordings, position_limits
from ..robot.world import World
from ..view.content import LiveLink, PageContent, read_content
from ..view.page import ViewPage
from .common import check_frame
from .options import add_node, add_robot_files, seconds, whole
from .terminal import DONE, complain, flush, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = (
        "Show the robot, its primitives and plans on a page in the browser. You drag the goal, and "
        "the plan follows. Sliders of the components bend a typical demonstration. The page also "
        "plays demonstrations. Ctrl-C ends the command."
    )
    add_robot_files(parser)
    parser.add_argument(
        "--obstacles",
        metavar="FILE",
        type=Path,
        help="obstacles: a planning scene of MoveIt, .scene or YAML",
    )
    parser.add_argument(
        "--frame",
        metavar="LINK",
        default="",
        help="link that the handle moves (default: the last link that most joints move)",
    )
    parser.add_argument(
        "--demonstrations",
        metavar="BAG",
        nargs="+",
        help="recordings of the demonstrations (default: as the primitives reproduce them)",
    )
    parser.add_argument("--topic", help="JointState topic of --demonstrations (default: the only)")
    parser.add_argument(
        "--port",
        type=whole(0, 65535),
        default=8080,
        help="port, or the first free port after it; 0: any free port (default: %(default)s)",
    )
    parser.add_argument(
        "--for", metavar="S", dest="duration", type=seconds, help="end after this time [s]"
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on")
    parser.add_argument("--live", action="store_true", help="show a node and its robot")
    parser.add_argument("--controller-topic", default="", help="topic of the node's motions")
    add_node(parser)


def run(arguments: argparse.Namespace) -> int:
    """Serve the page until the time has passed or Ctrl-C; returns the exit status."""
    for option, needed in (("topic", "demonstrations"), ("controller_topic", "live")):
        if getattr(arguments, option) and not getattr(arguments, needed):
            name = option.replace("_", "-")
            raise PlannerError(f"--{name} is for --{needed}: also pass --{needed}")
    primitives = load_primitives(arguments.primitives)
    content = read_content(arguments.robot, primitives, arguments.package_dirs)
    limits = content.robot.limits(arguments.limits or {})
    recordings = None
    if arguments.demonstrations:
        recordings = load_recordings(
            arguments.demonstrations,
            joints=content.robot.joint_names,
            topic=arguments.topic,
            same_joints=True,
            position_limits=position_limits(content.robot),
        )
        recordings.require_motion()
        for refusal in recordings.refused:
            complain(f"rejected {refusal.recording}: {refusal.reason}")
    check_frame(arguments.frame, content.robot)
    world = World() if arguments.obstacles is None else World.from_file(arguments.obstacles)
    content = replace(
        content, limits=limits, frame=arguments.frame, recordings=recordings, world=world
    )
    if not arguments.live:
        serve(content, arguments.host, arguments.port, arguments.duration)
        return DONE
    from ..ros.live_node import LiveNode

    names = arguments.namespace, arguments.node, arguments.controller_topic
    with LiveNode(*names) as link:
        serve(content, arguments.host, arguments.port, arguments.duration, link)
    return DONE


def serve(
    content: PageContent, host: str, port: int, duration: float | None, link: LiveLink | None = None
) -> None:
    """Serve a page for a time [s], or until Ctrl-C."""
    with ViewPage(content, host, port, link) as page:
        reach = "this machine only" if page.server.is_local else "whoever has this address"
        moved = "" if page.server.get_port() == port or not port else f"port {port} is in use; "
        say(f"page         {page.url} ({moved}for {reach}; Ctrl-C ends it)")
        flush()
        with suppress(KeyboardInterrupt):  # the usual end
            threading.Event().wait(duration)
