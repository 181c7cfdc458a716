# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The panel of the plan: a handle for the goal, and the motion that follows it."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import viser

from ..arrays import FloatArray
from ..execution.preemptive_worker import PreemptiveWorker
from ..motion.goal import Pose
from .live_panel import LivePanel
from .options import PAGE
from .plan_widgets import ViaHandles, add_export, add_settings
from .planning import InteractivePlanner, PlanAnswer, ViewRequest
from .player import Player, ShownMotion
from .stage import DrawnPaths, DrawnRobot, Stage
from .words import answer_html, limit_shares, part

NAME = "Plan"
_CONTINUE, _RESET = "At the goal", "Reset"


class PlanDrawing:
    """Ghost and paths of the newest answer; red if the goal is refused.

    Parameters
    ----------
    stage : Stage
        The scene.
    goal : array, shape (n_joints,)
        The first goal.

    Attributes
    ----------
    ghost : DrawnRobot
        The robot at the goal.
    """

    def __init__(self, stage: Stage, goal: FloatArray) -> None:
        self._stage = stage
        scene = stage.server.scene
        self.ghost = DrawnRobot(scene, "/goal", stage.shapes, PAGE.goal)
        self._path = DrawnPaths(scene, "/plan/path", PAGE.path, 5.0)
        self._splines = DrawnPaths(scene, "/plan/splines", PAGE.splines, 3.0)
        self._answer: PlanAnswer | None = None
        self.ghost.show(goal)

    def show(self, answer: PlanAnswer) -> None:
        """Draw an answer."""
        self._answer = answer
        self.ghost.show(answer.goal)
        self.ghost.paint(PAGE.refused if answer.problem else PAGE.goal)
        self._draw_paths()

    def set_visible(self, is_visible: bool) -> None:
        """Show or hide the drawing."""
        self.ghost.visible = is_visible
        self._draw_paths()

    def _draw_paths(self) -> None:
        answer = self._answer if self.ghost.visible else None
        plan = None if answer is None else answer.plan
        other = None if answer is None else answer.comparison
        colour = PAGE.refused if answer is not None and answer.problem else PAGE.path
        for path, one, tint in ((self._path, plan, colour), (self._splines, other, PAGE.splines)):
            drawn = [] if one is None else [self._stage.path(one.trajectory.positions)]
            path.show(*drawn, colour=tint)


class PlanPanel:
    """The goal, its plan, and their controls.

    Parameters
    ----------
    stage : Stage
        The scene.
    player : Player
        Plays the plan.
    planner : InteractivePlanner
        Used by one thread of this panel only.
    request : ViewRequest
        The first request.
    live : LivePanel, optional
        The running node, from whose robot motions start, and that gets the goals.

    Attributes
    ----------
    handle : viser.TransformControlsHandle
        The handle of the goal.
    answer : PlanAnswer or None
        The newest answer.
    """

    def __init__(
        self,
        stage: Stage,
        player: Player,
        planner: InteractivePlanner,
        request: ViewRequest,
        live: LivePanel | None = None,
    ) -> None:
        self._stage, self._player, self._planner = stage, player, planner
        self._live = live
        self._home = request.start, request.goal
        self.answer: PlanAnswer | None = None
        self._request = request
        self._drawing = PlanDrawing(stage, request.goal)
        self.handle = stage.server.scene.add_transform_controls(
            "/handle", scale=0.16 * stage.size, disable_rotations=True, depth_test=False
        )
        self.handle.on_update(self._on_handle)
        self._add_goal()
        self._vias = ViaHandles(stage, self._new_via, lambda vias: self.submit(vias=vias))
        add_settings(stage, lambda settings: self.submit(settings=settings))
        gui = stage.server.gui
        with gui.add_folder("Limits used"):
            self._bars = gui.add_html("")
        add_export(stage, lambda: None if self.answer is None else self.answer.plan)
        self._worker = PreemptiveWorker[ViewRequest](
            lambda request, _: self._serve(request), lambda _: None, lambda: None, self._on_failure
        )
        player.when_shown(NAME, self._drawing.set_visible)
        self._place_handle()
        self.submit()

    def submit(self, **changes: Any) -> None:
        """Request a plan with changes to the present request; the newest request wins."""
        if self._live is not None and self._live.start is not None:
            limits = self._stage.limits
            changes["start"] = np.clip(self._live.start, limits.lower, limits.upper)
        self._request = replace(self._request, **{"is_final": False, **changes})
        self._worker.submit(self._request)

    @property
    def goal(self) -> FloatArray | None:
        """The goal configuration, shape (n_joints,), if there is a motion to it."""
        return None if self.answer is None or self.answer.problem else self.answer.goal

    @property
    def is_settled(self) -> bool:
        """Whether every request has been answered."""
        return self._worker.is_idle and self.answer is not None

    def close(self) -> None:
        """End the thread."""
        self._worker.close()

    def _add_goal(self) -> None:
        stage, gui = self._stage, self._stage.server.gui
        self._verdict = gui.add_html("")
        self._turns = gui.add_checkbox(
            "Orientation too", False, hint="The handle sets the full pose, not only the position"
        )
        stage.on_change(self._turns, self._on_turns)
        self._sliders: list[Any] = []
        with gui.add_folder("Goal by joint", expand_by_default=False):
            limits = stage.limits
            for i, name in enumerate(stage.robot.joint_names):
                low, high = max(limits.lower[i], -np.pi), min(limits.upper[i], np.pi)
                value = float(np.clip(self._request.goal[i], low, high))
                slider = gui.add_slider(name, float(low), float(high), 0.001, value)
                stage.on_change(slider, self._on_joints)
                self._sliders.append(slider)
        ends = gui.add_button_group(
            "Start", (_CONTINUE, _RESET), hint="Continue from the goal, or go back to the beginning"
        )
        stage.on_click(
            ends, lambda: self._on_swap() if ends.value == _CONTINUE else self._on_reset()
        )

    async def _on_handle(self, event: viser.TransformControlsEvent) -> None:
        # Viser keeps the order of the events for coroutines only; the release must be the last.
        with self._stage.lock:
            self.submit(pose=self._pose(), is_final=event.phase == "end")

    def _pose(self) -> Pose:
        handle = self.handle
        turn = np.roll(handle.wxyz, -1) if self._turns.value else None
        return Pose(self._stage.frame, handle.position, turn)

    def _on_turns(self) -> None:
        self.handle.disable_rotations = not self._turns.value
        self._place_handle()
        self.submit(pose=self._pose())

    def _on_joints(self) -> None:
        goal = np.array([slider.value for slider in self._sliders])
        self._drawing.ghost.show(goal)
        self._place_handle(goal)
        self.submit(goal=goal, pose=None)

    def _on_swap(self) -> None:
        self._player.seek(0.0)
        self.submit(start=self._request.goal)

    def _on_reset(self) -> None:
        start, goal = self._home
        self._vias.clear()
        self._place_handle(goal)
        self._player.seek(0.0)
        self.submit(start=start, goal=goal, pose=None, vias=())

    def _new_via(self) -> FloatArray:
        """The place that the end effector passes in the middle of the present motion."""
        plan = None if self.answer is None else self.answer.plan
        motion = self._request.start[None] if plan is None else plan.trajectory.positions
        return np.asarray(self._stage.path(motion[len(motion) // 2][None])[0])

    def _place_handle(self, q: FloatArray | None = None) -> None:
        """Put the handle onto the end effector in a configuration, by default at the goal."""
        goal = self._request.goal if q is None else q
        self.handle.position, self.handle.wxyz = self._stage.shapes.frame_pose(
            goal, self._stage.frame
        )

    def _serve(self, request: ViewRequest) -> None:
        # In the planning thread: only what is under the lock changes the page.
        request = self._with_newest_goal(request)
        answer = self._planner.answer(request)
        # Words sent alone appear at once; with the scene, they would wait until it is drawn.
        self._show(self._say, answer)
        self._show(self._draw, answer)

    def _on_failure(self, request: ViewRequest | None, error: BaseException) -> None:
        traceback.print_exception(error)
        if request is not None:
            problem = f"internal error, {type(error).__name__}: {error}"
            answer = PlanAnswer(request, request.goal, None, problem, None, 0.0)
            self._show(self._say, answer)
            self._show(self._draw, answer)

    def _show(self, show: Callable[[PlanAnswer], None], answer: PlanAnswer) -> None:
        with self._stage.lock, self._stage.server.atomic():
            show(answer)
        self._stage.server.flush()

    def _with_newest_goal(self, request: ViewRequest) -> ViewRequest:
        """Begin the search for a pose where the last answer ended."""
        if request.pose is None or self.answer is None:
            return request
        return replace(request, goal=self.answer.goal)

    def _say(self, answer: PlanAnswer) -> None:
        self.answer, plan = answer, answer.plan
        if answer.request.pose is not None:
            self._request = replace(self._request, goal=answer.goal)
            for slider, q in zip(self._sliders, answer.goal, strict=True):
                slider.value = float(np.clip(q, slider.min, slider.max))
        self._verdict.content = answer_html(answer)
        if plan is not None:
            shares = limit_shares(plan.trajectory, self._stage.limits)
            self._bars.content = part("bars", plan.trajectory.joint_names, shares)

    def _draw(self, answer: PlanAnswer) -> None:
        self._player.take(NAME)
        self._drawing.show(answer)
        if self._live is not None and answer.request.is_final:
            self._live.send(self.goal)
        if answer.plan is not None and not answer.problem:
            self._player.offer(NAME, ShownMotion.of(NAME, answer.plan.trajectory))
