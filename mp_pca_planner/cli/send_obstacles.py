# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`send_obstacles`: gives the running node the obstacles of a scene."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..exceptions import GoalError
from ..robot.world import World
from .common import show
from .options import SCENE, add_json, add_node
from .terminal import DONE, FAILED, PROGRAM, complain


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.description = (
        "Give the running node the obstacles of a file, beside those that it has. Obstacles of the "
        "same name are replaced."
    )
    parser.add_argument("scene", metavar="FILE", type=Path, nargs="?", help=SCENE)
    parser.add_argument("--clear", action="store_true", help="remove all obstacles before")
    add_node(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    if arguments.scene is None and not arguments.clear:
        raise GoalError("no obstacles to send: give a FILE, or --clear to remove all")
    world = World() if arguments.scene is None else World.from_file(arguments.scene)
    from ..ros.client import GoalClient

    with GoalClient(arguments.command, arguments.namespace, arguments.node) as client:
        n_obstacles, problem = client.send_obstacles(
            world, clear=arguments.clear, timeout=arguments.timeout
        )
    if problem and not arguments.json:
        complain(f"{PROGRAM} send_obstacles: {problem}")
    sent = list(world.names)
    show(arguments, {"sent": sent, "obstacles_of_the_node": n_obstacles, "rejected": problem})
    return FAILED if problem else DONE
