# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the node until it is told to stop."""

from __future__ import annotations

import argparse
import mmap
import os
import signal
import sys
import threading
from collections.abc import Sequence

from ..exceptions import MissingDependencyError, PlannerError, printable

DONE, FAILED, REFUSED = 0, 1, 2

_PROGRAM = "mp_pca_planner planner_node"
_ROS_ARGUMENTS = "--ros-args"
_ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM)
# What a node takes: threads, most of which are those of DDS, and addresses [bytes].
_N_THREADS = 24
_ADDRESS_SPACE = 3 * 2**29


class _ShortageError(Exception):
    """The system has too little for a node."""


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM.

    Parameters
    ----------
    args :
        The arguments without the program's name; those of the process by default.

    Returns
    -------
    :
        The exit status: 0 stopped by a signal, 1 too little memory or too few threads, 2 refused
        arguments or parameters.
    """
    arguments = list(sys.argv[1:] if args is None else args)
    own = arguments[: arguments.index(_ROS_ARGUMENTS)] if _ROS_ARGUMENTS in arguments else arguments
    options, unknown = _parser().parse_known_args(own)
    # The matrices of planning are small: more threads would only wait for one another.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Before anything else is imported, which takes long enough to be interrupted.
    stop = threading.Event()
    for number in _ENDING_SIGNALS:
        signal.signal(number, lambda *_: stop.set())
    try:
        _check_resources()
        _run(arguments, unknown, options.managed, stop)
    except (PlannerError, _ShortageError) as error:
        print(f"{_PROGRAM}: {printable(str(error))}", file=sys.stderr)
        return REFUSED if isinstance(error, PlannerError) else FAILED
    finally:
        # Python drops handlers before all else when it ends: one more signal would kill it then.
        for number in _ENDING_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
    return DONE


def _check_resources() -> None:
    """Raise a `_ShortageError` if the node could not have its memory and its threads.

    DDS does not survive a thread that it can't start: it hangs, or aborts the process.
    """
    try:
        mmap.mmap(-1, _ADDRESS_SPACE, flags=mmap.MAP_PRIVATE, prot=0).close()
    except OSError as error:
        raise _ShortageError(
            f"the node needs {_ADDRESS_SPACE / 2**30:g} GiB of address space, and the system "
            f"refuses it ({error.strerror}): raise the limit (ulimit -v)"
        ) from None
    end = threading.Event()
    threads = [threading.Thread(target=end.wait, daemon=True) for _ in range(_N_THREADS)]
    try:
        for thread in threads:
            thread.start()
    except RuntimeError:
        raise _ShortageError(
            f"the node needs {_N_THREADS} threads, and the system refuses them: raise the limits "
            "of processes (ulimit -u, pids of the container) and of memory (ulimit -v)"
        ) from None
    finally:
        end.set()


def _run(
    arguments: list[str], unknown: Sequence[str], is_managed: bool, stop: threading.Event
) -> None:
    from ..execution.parameters import ParameterError

    if unknown:
        raise ParameterError(
            f"'{unknown[0]}' can't be used: what the node is told comes after {_ROS_ARGUMENTS}"
        )
    try:
        import rclpy
    except ModuleNotFoundError as error:
        raise MissingDependencyError(str(error.name), "ros", "the node") from error
    from rclpy.signals import SignalHandlerOptions

    try:
        # rclpy's own handlers would shut the context down under a running callback.
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise ParameterError(f"the arguments after --ros-args are refused: {reason}") from error
    try:
        _spin(is_managed, stop)
    finally:
        rclpy.try_shutdown()


def _spin(is_managed: bool, stop: threading.Event) -> None:
    from rclpy.executors import SingleThreadedExecutor

    from .node import PlannerNode

    if is_managed:
        from .lifecycle_node import LifecyclePlannerNode

        node: PlannerNode = LifecyclePlannerNode()
    else:
        node = PlannerNode()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    # Meanwhile, the nodes of the robot find this one.
    threading.Thread(target=_load_what_goals_may_need).start()
    try:
        # A message ends the wait at once; the time bounds only how long a signal waits.
        while not stop.is_set():
            executor.spin_once(timeout_sec=0.1)
    finally:
        executor.shutdown()
        node.destroy_node()


def _load_what_goals_may_need() -> None:
    """Import the slow modules that the start could do without, before a goal waits for them."""
    import scipy.interpolate
    import scipy.optimize
    import scipy.spatial.transform  # noqa: F401  # that it is loaded is all that is wanted


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=_PROGRAM,
        usage="%(prog)s [-h] [--managed] [--ros-args ...]",
        description="The ROS 2 node: plans a least-effort motion for each goal configuration on "
        "~/goal and publishes it on ~/joint_trajectory.",
        epilog="Everything is set by ROS parameters, for example --ros-args -p "
        "primitives:=[reach.npz]; config/planner.yaml of this package explains them all.",
    )
    # The guard around all commands takes it; here it is for the help.
    parser.add_argument("--debug", action="store_true", help="print the traceback of an error")
    parser.add_argument(
        "--managed",
        action="store_true",
        help="as a managed (lifecycle) node: it loads primitives when it is configured, and "
        "serves goals when it is active",
    )
    return parser
