# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Where the robot is, and on which motion: states, the motion published last, and starts on it."""
