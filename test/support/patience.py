# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Times that never count: what a test finds must not depend on how busy the machine is."""

from mp_pca_planner.planning.options import PlannerOptions

EVER = 1e6
"""A max_solve_time [s]."""
PATIENT = PlannerOptions(max_solve_time=EVER)
NODE_EVER = 3600.0
"""The longest that parameters of the node accept [s]."""
HANG = 300.0
"""What takes longer than this [s] hangs."""
