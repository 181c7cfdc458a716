# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Step 1: a goal becomes requests, with configurations, primitives and durations filled in."""
