# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The plan in the scene of the page: a ghost at the goal, and the paths to it."""

from __future__ import annotations

from ..arrays import FloatArray
from .drawing import DrawnPaths, DrawnRobot
from .planning import PlanAnswer
from .stage import Stage

_GOAL, _REFUSED = (0, 158, 115), (217, 53, 43)
_PATH, _SPLINES = (0, 114, 178), (204, 121, 167)


class PlanDrawing:
    """Ghost and paths of the newest answer; red if the goal is refused.

    Parameters
    ----------
    stage : Stage
        The scene.
    goal : array, shape (n_joints,)
        The first goal.
    """

    def __init__(self, stage: Stage, goal: FloatArray) -> None:
        self._stage = stage
        scene = stage.server.scene
        self._ghost = DrawnRobot(scene, "/goal", stage.shapes, _GOAL)
        self._path = DrawnPaths(scene, "/plan/path", _PATH, 5.0)
        self._splines = DrawnPaths(scene, "/plan/splines", _SPLINES, 3.0)
        self._answer: PlanAnswer | None = None
        self._ghost.show(goal)

    def show_goal(self, goal: FloatArray) -> None:
        """Put the ghost into a configuration, shape (n_joints,)."""
        self._ghost.show(goal)

    def show(self, answer: PlanAnswer) -> None:
        """Draw an answer."""
        self._answer = answer
        self._ghost.show(answer.goal)
        self._ghost.paint(_REFUSED if answer.problem else _GOAL)
        self._draw_paths()

    def set_visible(self, is_visible: bool) -> None:
        """Show or hide the drawing."""
        self._ghost.visible = is_visible
        self._draw_paths()

    def _draw_paths(self) -> None:
        answer = self._answer if self._ghost.visible else None
        plan = None if answer is None else answer.plan
        other = None if answer is None else answer.comparison
        colour = _REFUSED if answer is not None and answer.problem else _PATH
        for path, one, tint in ((self._path, plan, colour), (self._splines, other, _SPLINES)):
            drawn = [] if one is None else [self._stage.path(one.trajectory.positions)]
            path.show(*drawn, colour=tint)
