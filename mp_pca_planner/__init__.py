# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Movement primitives from recorded demonstrations, and least-effort motions made of them."""

__version__ = "0.1.0"
