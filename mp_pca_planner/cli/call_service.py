# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""`stop`, `save_motion` and `reload`: calls of the services of the node."""

from __future__ import annotations

import argparse

from ..ros.client import GoalClient, NoAnswerError, check_node_name
from .common import print_json
from .terminal import DONE, FAILED, complain, say

_SERVICES = {"reload": "reload_primitives"}
"""Names of services that differ from their command's."""


def run(arguments: argparse.Namespace) -> int:
    """Run the command; returns the exit status."""
    command, timeout = arguments.command, arguments.timeout
    check_node_name(arguments.namespace, arguments.node)
    try:
        with GoalClient(command, arguments.namespace, arguments.node) as client:
            client.wait_for_node(timeout, with_trajectory=False)
            answer = client.call(_SERVICES.get(command, command), timeout)
    except NoAnswerError as error:
        complain(f"mp_pca_planner {command}: {error}")
        return FAILED
    if arguments.json:
        print_json({"success": answer.success, "message": answer.message})
    elif answer.success:
        say(answer.message)
    else:
        complain(f"mp_pca_planner {command}: {answer.message}")
    return DONE if answer.success else FAILED
