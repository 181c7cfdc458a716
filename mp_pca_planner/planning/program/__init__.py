# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Step 3: a request and a setting become a nonlinear program of terms and constraints."""
