# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m mp_pca_planner COMMAND ...``."""

import os
import signal
import sys

if sys.argv[1:2] in (["planner_node"], ["simulate"]):
    # Installed before all other imports: a node that is stopped that early has nothing to clean up.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))

from .cli.main import main

sys.exit(main())
