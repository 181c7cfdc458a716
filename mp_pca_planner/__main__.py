# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m mp_pca_planner COMMAND ...``, and the script ``mp-pca``."""

import os
import signal
import sys


def main() -> int:
    """Run the command that the arguments of the process name; returns the exit status."""
    is_node = sys.argv[1:2] in (["planner_node"], ["simulate"])
    if is_node:
        # Installed before all imports: a node that is stopped that early has nothing to clean up.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: os._exit(0))
    from .cli.main import main as run_command

    status = run_command()
    if is_node:
        # A thread that still waits in rclpy would abort the end of the interpreter.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    return status


if __name__ == "__main__":
    sys.exit(main())
