# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The panel of the plan: a handle for the goal, the motion that follows it, and how to plan it."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import viser

from ..arrays import FloatArray
from ..exceptions import PlannerError
from ..motion.goal import Pose
from ..planning.options import AUTO
from .planning import InteractivePlanner, PlanAnswer, ViewRequest, answer_html
from .robot_shapes import DrawnPath, DrawnRobot, Rgb
from .stage import Player, ShownMotion, Stage, part

NAME = "Plan"
_TEXT = "Drag the arrows to another goal, and the motion follows."
_INTERNAL_ERROR = "internal error; its traceback is in the log of this command"
_CONTINUE, _RESET = "At the goal", "Reset"
_NATURALNESS = (AUTO, "0", "0.01", "0.1", "1")
_FORMATS = {"CSV": "motion.csv", "JSON": "motion.json", "Bag (.mcap)": "motion.mcap"}
_GOAL: Rgb = (0, 158, 115)
_SHORT: Rgb = (230, 159, 0)
_REJECTED: Rgb = (217, 53, 43)
_PATH: Rgb = (148, 87, 235)


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
    verdict : viser.GuiHtmlHandle
        Where the answer is stated.

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
        verdict: viser.GuiHtmlHandle,
    ) -> None:
        self._verdict = verdict
        self._stage, self._player, self._planner = stage, player, planner
        self._home = request.start, request.goal
        self.answer: PlanAnswer | None = None
        self._request = request
        scene = stage.server.scene
        self._root = scene.add_frame("/plan", show_axes=False)
        self._ghost = DrawnRobot(scene, "/plan/goal", stage.shapes, _GOAL)
        self._ghost.show(request.goal)
        self._path = DrawnPath(scene, "/plan/path", _PATH, 5.0)
        self.handle = stage.add_handle("/handle", disable_rotations=True)
        stage.on_drag(self.handle, self._on_handle)
        gui = stage.server.gui
        gui.add_html(part("lines", [_TEXT]))
        self._add_goal()
        self._formats = gui.add_button_group("Save as", tuple(_FORMATS))
        self._formats.on_click(self._on_save)
        self._place_handle()
        self._requests = SimpleQueue[ViewRequest | None]()
        self._newest: ViewRequest | None = None
        self._answered: ViewRequest | None = None
        self.submit()
        # A daemon: a plan that never ends must not keep the process alive.
        self._thread = threading.Thread(target=self._run, name="planning", daemon=True)
        self._thread.start()

    def set_open(self, is_open: bool, *, with_handle: bool) -> None:
        """Show the plan, and its handle or not."""
        self._root.visible = is_open
        self.handle.visible = with_handle
        if is_open:
            self._player.show(self.motion)

    @property
    def motion(self) -> ShownMotion:
        """The newest motion that may be executed; the start before there is one."""
        answer = self.answer
        if answer is None or answer.plan is None or answer.problem:
            return ShownMotion(np.zeros(1), self._request.start[None])
        trajectory = answer.plan.trajectory
        return ShownMotion(trajectory.times, trajectory.positions)

    def submit(self, **changes: Any) -> None:
        """Request a plan with changes to the present request; the newest request wins."""
        self._request = replace(self._request, **{"is_final": False, **changes})
        self._newest = self._request
        self._requests.put(self._request)

    @property
    def is_settled(self) -> bool:
        """Whether every request has been answered."""
        return self._answered is self._newest

    def close(self) -> None:
        """End the thread, within some seconds if the served request ends."""
        self._requests.put(None)
        self._thread.join(5.0)

    def _add_goal(self) -> None:
        stage, gui = self._stage, self._stage.server.gui
        self._turns = gui.add_checkbox(
            "Orientation too", False, hint="The handle sets the full pose, not only the position"
        )
        stage.on_change(self._turns, self._on_turns)
        self._sliders: list[Any] = []
        with gui.add_folder("Goal by joint", expand_by_default=False):
            for name, goal in zip(stage.robot.joint_names, self._request.goal, strict=True):
                low, high, unit = stage.joint_range(name)
                value = float(np.clip(round(goal, 3), low, high))
                slider = gui.add_slider(f"{name} [{unit}]", low, high, 0.001, value)
                stage.on_change(slider, self._on_joints)
                self._sliders.append(slider)
        text = "0: least cost alone; more: more like the demonstrations; auto: 1 near them"
        naturalness = gui.add_dropdown("Naturalness ρ", _NATURALNESS, initial_value=AUTO, hint=text)
        stage.on_change(naturalness, lambda: self._on_naturalness(naturalness.value))
        hint = "Continue from the goal, or go back to the beginning"
        ends = gui.add_button_group("Start", (_CONTINUE, _RESET), hint=hint)
        stage.on_click(ends, lambda: self._on_start(ends.value))

    def _on_save(self, event: viser.GuiEvent[Any]) -> None:
        """Send the motion as a file to the browser that asked; none that must not be executed."""
        if event.client is None:
            return
        with self._stage.caught():
            with self._stage.lock:
                plan = None if self.answer is None else self.answer.plan
            if plan is None or not plan.is_executable:
                raise PlannerError("there is no motion to save")
            name = _FORMATS[self._formats.value]
            with TemporaryDirectory() as folder:
                path = Path(folder) / name
                plan.trajectory.save(path)
                content = path.read_bytes()
            event.client.send_file_download(name, content, save_immediately=True)

    def _on_handle(self, is_released: bool) -> None:
        self.submit(pose=self._pose(), is_final=is_released)

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
        self._ghost.show(goal)
        self._place_handle(goal)
        self.submit(goal=goal, pose=None)

    def _on_naturalness(self, value: str) -> None:
        self.submit(naturalness=None if value == AUTO else float(value))

    def _on_start(self, choice: str) -> None:
        """Start at the goal, or go back to the first start and goal."""
        start, goal = self._home if choice == _RESET else (self._request.goal, self._request.goal)
        self._place_handle(goal)
        self._player.seek(0.0)
        self.submit(start=start, goal=goal, pose=None)

    def _place_handle(self, q: FloatArray | None = None) -> None:
        """Put the handle onto the end effector in a configuration, by default at the goal."""
        goal = self._request.goal if q is None else q
        place, turn = self._stage.shapes.frame_pose(goal, self._stage.frame)
        # Where only the position counts, the arrows are the axes of the scene.
        self.handle.position = place
        self.handle.wxyz = turn if self._turns.value else np.array([1.0, 0.0, 0.0, 0.0])

    def _run(self) -> None:
        while (request := self._requests.get()) is not None:
            if self._requests.empty():  # else there is a newer one
                self._serve(request)
                self._answered = request

    def _serve(self, request: ViewRequest) -> None:
        # In the planning thread: only what is under the lock changes the page.
        if request.pose is not None and self.answer is not None:
            # The search for a pose begins where the last answer ended.
            request = replace(request, goal=self.answer.goal)
        answer = PlanAnswer(request, request.goal, None, _INTERNAL_ERROR)
        with self._stage.caught():
            answer = self._planner.answer(request, lambda: not self._requests.empty())
        with self._stage.caught(), self._stage.lock, self._stage.server.atomic():
            self._show(answer)
        self._stage.server.flush()

    def _show(self, answer: PlanAnswer) -> None:
        self.answer = answer
        if answer.request.pose is not None:
            self._request = replace(self._request, goal=answer.goal)
            for slider, q in zip(self._sliders, answer.goal, strict=True):
                slider.value = float(np.clip(round(q, 3), slider.min, slider.max))
        self._verdict.content = answer_html(answer)
        self._ghost.show(answer.goal)
        self._ghost.paint(_REJECTED if answer.problem else _SHORT if answer.distance else _GOAL)
        shown = self.motion if answer.plan is None else answer.plan.trajectory
        self._path.show(self._stage.path(shown.positions), _REJECTED if answer.problem else _PATH)
        if answer.request.is_final and answer.distance:
            self._place_handle(answer.goal)
        if self._root.visible and not answer.problem:
            self._player.show(self.motion)
