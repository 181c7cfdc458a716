# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""``python -m mp_pca_planner COMMAND ...``."""

import sys

from .cli.main import main

sys.exit(main())
