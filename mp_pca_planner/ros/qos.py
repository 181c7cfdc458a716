# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Quality of service of the topics."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
EVERY = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Late subscribers receive the last message."""

GOALS = QoSProfile(depth=20, reliability=ReliabilityPolicy.RELIABLE)
"""Only the newest goal is served, but each one of a burst gets its report."""

STATES = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Receives from best-effort and reliable publishers; several may send a thousand messages a second
between two polls."""
