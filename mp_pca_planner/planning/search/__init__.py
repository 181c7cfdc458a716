# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Step 2: what is tried for a request, in which order, and what is changed after a failure."""
