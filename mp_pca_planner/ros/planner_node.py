# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The command `planner_node`: runs the node until a signal ends it."""

from __future__ import annotations

import argparse
import gc
import mmap
import os
import signal
import sys
import threading
from collections.abc import Sequence

from ..exceptions import MissingDependencyError, PlannerError, printable

DONE, FAILED, REFUSED = 0, 1, 2

_PROGRAM = "mp-pca planner_node"
_ROS_ARGUMENTS = "--ros-args"
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_SWITCH_INTERVAL = 1e-4  # [s]


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
    # One thread, because the matrices of planning are too small for several.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # The thread that stops the robot soon gets the lock of the interpreter, whatever is computed.
    sys.setswitchinterval(_SWITCH_INTERVAL)
    # Installed before the slow imports, which a signal may interrupt.
    stop = threading.Event()
    for number in _SIGNALS:
        signal.signal(number, lambda *_: stop.set())
    try:
        if shortage := _shortage():
            print(f"{_PROGRAM}: {shortage}", file=sys.stderr)
            return FAILED
        _run(arguments, unknown, options.managed, stop)
    except PlannerError as error:
        print(f"{_PROGRAM}: {printable(str(error))}", file=sys.stderr)
        return REFUSED
    finally:
        # Python removes handlers first when it exits; another signal would then kill the process.
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)
    return DONE


def _shortage() -> str:
    """What the system refuses of the memory and the threads of a node; empty if nothing.

    DDS does not survive a thread that it can't start: it hangs, or aborts the process.
    """
    n_threads, address_space = 24, 3 * 2**29  # most of the threads are those of DDS
    try:
        mmap.mmap(-1, address_space, flags=mmap.MAP_PRIVATE, prot=0).close()
    except OSError as error:
        return (
            f"the node needs {address_space / 2**30:g} GiB of address space, and the system "
            f"refuses it ({error.strerror}): raise the limit (ulimit -v)"
        )
    end = threading.Event()
    threads = [threading.Thread(target=end.wait, daemon=True) for _ in range(n_threads)]
    try:
        for thread in threads:
            thread.start()
    except RuntimeError:
        return (
            f"the node needs {n_threads} threads, and the system refuses them: raise the limits "
            "of processes (ulimit -u, pids of the container) and of memory (ulimit -v)"
        )
    finally:
        end.set()
    return ""


def _run(
    arguments: list[str], unknown: Sequence[str], is_managed: bool, stop: threading.Event
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
        # Meanwhile, the nodes of the robot discover this one.
        threading.Thread(target=_load_slow_modules).start()
        # A message ends the wait at once; the time bounds only how long a signal waits.
        spin_until(stop, node, lambda: 0.1)
    finally:
        rclpy.try_shutdown()


def _load_slow_modules() -> None:
    """Import slow modules that the start does not need, so that no goal waits for them."""
    import scipy.interpolate
    import scipy.optimize
    import scipy.spatial.transform  # noqa: F401

    # What lives as long as the node is searched for garbage no more, not even now: that stops all
    # threads for 50 ms each time.
    gc.freeze()


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
