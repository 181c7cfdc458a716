# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""From goals to motions: planning, publishing, monitoring, stopping, and obstacles."""
