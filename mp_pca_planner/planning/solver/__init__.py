# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Step 4: sequential quadratic programming; knows nothing of robots."""
