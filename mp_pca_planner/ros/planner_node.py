# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The command `planner_node`: runs the node until a signal ends it."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Sequence

from ..exceptions import MissingDependencyError, PlannerError, printable

DONE, REFUSED = 0, 2

_PROGRAM = "mp-pca planner_node"
_ROS_ARGUMENTS = "--ros-args"
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM.

    Parameters
    ----------
    args :
        The arguments without the program's name; those of the process by default.

    Returns
    -------
    :
        The exit status: 0 stopped by a signal, 2 refused arguments or parameters.
    """
    arguments = list(sys.argv[1:] if args is None else args)
    own = arguments[: arguments.index(_ROS_ARGUMENTS)] if _ROS_ARGUMENTS in arguments else arguments
    options, unknown = _parser().parse_known_args(own)
    # One thread, because the matrices of planning are too small for several.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Installed before the slow imports, which a signal may interrupt.
    received = list[int]()
    for number in _SIGNALS:
        signal.signal(number, lambda number, _: received.append(number))
    try:
        _run(arguments, unknown, options.managed, received)
    except PlannerError as error:
        print(f"{_PROGRAM}: {printable(str(error))}", file=sys.stderr)
        return REFUSED
    finally:
        # Python removes handlers first when it exits; another signal would then kill the process.
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)
    return DONE


def _run(
    arguments: list[str], unknown: Sequence[str], is_managed: bool, received: list[int]
) -> None:

    if unknown:
        raise PlannerError(
            f"unknown argument '{unknown[0]}': pass node arguments after {_ROS_ARGUMENTS}"
        )
    try:
        import rclpy
    except ModuleNotFoundError as error:
        raise MissingDependencyError(str(error.name), "ros", "the node") from error
    from .nodes import spin_until, start_ros

    start_ros(arguments)
    try:
        from .node import LifecyclePlannerNode, PlannerNode

        node = LifecyclePlannerNode() if is_managed else PlannerNode()
        # A message ends the wait at once; the time bounds only how long a signal waits.
        spin_until(lambda: bool(received), node, lambda: 0.1, node.failed)
    finally:
        rclpy.try_shutdown()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=_PROGRAM,
        usage="%(prog)s [-h] [--managed] [--ros-args ...]",
        description="The ROS 2 node: plans a least-effort motion for each goal configuration on "
        "~/goal and publishes it on ~/joint_trajectory.",
        epilog="Everything is set by ROS parameters, for example --ros-args -p "
        "primitives:=[reach.npz]; config/planner.yaml of this package explains them all.",
    )
    # The guard around all commands handles this option. It is added here for the help only.
    parser.add_argument("--debug", action="store_true", help="print the traceback of an error")
    parser.add_argument(
        "--managed",
        action="store_true",
        help="as a managed (lifecycle) node: it loads primitives when it is configured, and "
        "serves goals when it is active",
    )
    return parser
