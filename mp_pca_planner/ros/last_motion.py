# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The motion that was published last: its preview, its cost, and its storage as a primitive."""

from __future__ import annotations

import math
from pathlib import Path

from visualization_msgs.msg import MarkerArray

from ..exceptions import GoalError
from ..execution.kept_motion import keep_motion
from ..execution.parameters import ParameterError
from ..execution.served_goal import Served
from .preview import to_preview


class LastMotion:
    """The motion that was published last, and its measured cost.

    Attributes
    ----------
    cost : float or None
        The measured cost; None if none was reported.
    """

    def __init__(self) -> None:
        self.cost: float | None = None
        self._served: Served | None = None
        self._previewed: Served | None = None

    def replace(self, served: Served) -> None:
        """Record a published motion."""
        self._served, self.cost = served, None

    def report_cost(self, cost: float) -> None:
        """Record the measured cost, and learn from it if the motion is a trial.

        Raises
        ------
        GoalError
            If the cost is not finite, or no motion was published.
        """
        served = self._served
        if served is None or not math.isfinite(cost):
            raise GoalError(
                f"the cost {cost} of a trial is ignored: it must be a finite number that follows "
                "a motion"
            )
        if served.trial is not None:
            served.trial.record(cost)
        self.cost = cost

    def preview(self) -> MarkerArray | None:
        """Draw the motion; None if there is none, or it was drawn already."""
        served = self._served
        if served is None or served is self._previewed:
            return None
        self._previewed = served
        context = served.model
        robot, frame = context.planning_robot, context.end_effector
        return to_preview(served.plan.trajectory, robot, frame, context.urdf)

    def keep(self, folder: str, kept_by: str) -> Path:
        """Write the motion as a primitive; returns the file.

        Raises
        ------
        PlannerError
            If there is no folder or no motion, or the motion can't be saved.
        """
        if not folder:
            raise ParameterError(
                "motions can't be saved: set the parameter 'save_folder' to a folder"
            )
        if self._served is None:
            raise GoalError("there is no motion to save: none was published")
        cost = {} if self.cost is None else {"trial_cost": self.cost}
        return keep_motion(self._served, Path(folder), {"kept_by": kept_by, **cost})
