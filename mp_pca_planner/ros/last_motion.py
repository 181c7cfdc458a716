# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The motion that was published last: its preview, its cost, and its storage as a primitive."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from pathlib import Path

from visualization_msgs.msg import Marker, MarkerArray

from ..exceptions import GoalError
from ..execution.execution_monitor import NEVER_STARTED, REPLACED
from ..execution.parameters import ParameterError
from ..execution.served_goal import Served
from ..execution.trial_store import keep_motion
from .preview import to_preview


class LastMotion:
    """The motion that was published last, its preview and its measured cost.

    Parameters
    ----------
    show : callable
        Publishes the markers of a preview.

    Attributes
    ----------
    cost : float or None
        The measured cost; None if none was reported.
    """

    def __init__(self, show: Callable[[MarkerArray], None]) -> None:
        self.cost: float | None = None
        self._show = show
        self._served: Served | None = None
        self._previewed: Served | None = None
        self._is_over, self._is_shown = True, False
        self._lock = threading.Lock()

    def replace(self, served: Served) -> None:
        """Record a published motion."""
        self._served, self.cost, self._is_over = served, None, False

    def end(self, outcome: str) -> None:
        """Record that a motion is over; its preview is erased if the robot has left its start."""
        if outcome != REPLACED:
            self._is_over = True
            if outcome != NEVER_STARTED:
                self.erase_preview()

    @property
    def facts(self) -> dict[str, str | float]:
        """The measured cost, for the diagnostics."""
        return {"trial_cost": "none" if self.cost is None else self.cost}

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

    def show_preview(self) -> None:
        """Show the motion, if it was not shown before."""
        with self._lock:
            served = self._served
            if served is None or served is self._previewed:
                return
            self._previewed, self._is_shown = served, True
            context = served.model
            robot, frame = context.planning_robot, context.end_effector
            self._show(to_preview(served.plan.trajectory, robot, frame, context.urdf))

    def erase_preview(self) -> None:
        """Erase the preview, unless its motion is being executed."""
        with self._lock:
            if self._is_over:
                self._previewed = self._served
                if self._is_shown:
                    self._show(MarkerArray(markers=[Marker(action=Marker.DELETEALL)]))
                self._is_shown = False

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
