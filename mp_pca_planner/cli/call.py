# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`call` and `stop`: services of the running node."""

from __future__ import annotations

import argparse

from .common import print_json
from .options import add_json, add_node
from .terminal import DONE, FAILED, PROGRAM, complain, say

_SERVICES = {"reload": "reload_primitives", "save_motion": "save_motion", "stop": "stop"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    if parser.prog.endswith(" stop"):
        parser.description = "Make the node bring the robot to rest as fast as the limits allow."
        parser.set_defaults(service="stop")
    else:
        parser.description = (
            "Make the node read its primitive files again, or save its last motion as a primitive "
            "in its `save_folder`."
        )
        parser.add_argument("service", choices=["reload", "save_motion"], help="what to do")
    add_node(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    """Call a service of the node, and print its answer; returns the exit status."""
    from ..ros.client import GoalClient

    with GoalClient(arguments.command, arguments.namespace, arguments.node) as client:
        client.wait_for_node(arguments.timeout)
        answer = client.call(_SERVICES[arguments.service], arguments.timeout)
    if arguments.json:
        print_json({"success": answer.success, "message": answer.message})
    elif answer.success:
        say(answer.message)
    else:
        complain(f"{PROGRAM} {arguments.command}: {answer.message}")
    return DONE if answer.success else FAILED
