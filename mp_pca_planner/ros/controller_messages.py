# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The interfaces of a trajectory controller, where control_msgs is installed.

Every machine with ros2_control has that package, which is not on PyPI.
"""

from __future__ import annotations

from typing import Any

__all__ = ["HAS_CONTROL_MSGS", "FollowJointTrajectory", "JointTrajectoryControllerState"]

try:
    from control_msgs.action import FollowJointTrajectory
    from control_msgs.msg import JointTrajectoryControllerState
except ImportError:
    FollowJointTrajectory: Any = None  # type: ignore[no-redef]
    JointTrajectoryControllerState: Any = None  # type: ignore[no-redef]

HAS_CONTROL_MSGS = JointTrajectoryControllerState is not None
"""Whether that package is installed."""
