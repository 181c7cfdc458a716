# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Widgets of a plan: points to pass, options, and buttons that save the motion."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import viser

from ..arrays import FloatArray
from ..motion.goal import Pose
from ..planning.plan import DEMONSTRATED, TIMINGS, Plan
from .options import PAGE
from .planning import FIXED, PlanSettings
from .stage import Stage

_ADD, _REMOVE = "Add", "Remove all"
_NATURALNESS = ("0", "0.01", "0.1", "1", "10")
_OBJECTIVES = ("effort", "energy", "jerk", "straightness")
_FORMATS = {"CSV": "motion.csv", "JSON": "motion.json", "Bag (.mcap)": "motion.mcap"}


class ViaHandles:
    """Handles of the vias, and the buttons that add and remove them.

    Parameters
    ----------
    stage : Stage
        The scene.
    new_place : callable
        Position of a new point [m], shape (3,).
    react : callable
        Called with the vias when a person changes them.
    """

    def __init__(
        self,
        stage: Stage,
        new_place: Callable[[], FloatArray],
        react: Callable[[tuple[Pose, ...]], None],
    ) -> None:
        self._stage, self._new_place, self._react = stage, new_place, react
        self._handles: list[viser.TransformControlsHandle] = []
        gui = stage.server.gui
        choice = gui.add_button_group(
            "Points to pass", (_ADD, _REMOVE), hint="Places that the end effector passes, in order"
        )
        stage.on_click(
            choice, lambda: self._on_add() if choice.value == _ADD else self._on_remove()
        )

    def clear(self) -> None:
        """Remove all points without a call."""
        for handle in self._handles:
            handle.remove()
        self._handles = []

    def add(self, position: FloatArray) -> None:
        """Add a point [m], shape (3,)."""
        handle = self._stage.server.scene.add_transform_controls(
            f"/vias/{len(self._handles)}",
            scale=0.1 * self._stage.size,
            disable_rotations=True,
            depth_test=False,
            position=position,
        )
        self._stage.server.scene.add_icosphere(
            f"/vias/{len(self._handles)}/ball", 0.012 * self._stage.size, color=(230, 159, 0)
        )
        handle.on_update(self._on_moved)
        self._handles.append(handle)

    @property
    def poses(self) -> tuple[Pose, ...]:
        """The points in the order in which they were added."""
        return tuple(Pose(self._stage.frame, handle.position) for handle in self._handles)

    def _on_moved(self, _: viser.TransformControlsEvent) -> None:
        with self._stage.lock:
            self._react(self.poses)

    def _on_add(self) -> None:
        if len(self._handles) < PAGE.max_vias:
            self.add(self._new_place())
            self._react(self.poses)

    def _on_remove(self) -> None:
        self.clear()
        self._react(())


def add_settings(stage: Stage, react: Callable[[PlanSettings], None]) -> None:
    """Add the widgets.

    Parameters
    ----------
    stage : Stage
        The scene.
    react : callable
        Called with the options when a person changes them.
    """
    gui = stage.server.gui
    with gui.add_folder("How", expand_by_default=False):
        text = "0: least cost alone"
        naturalness = gui.add_dropdown("Naturalness ρ", _NATURALNESS, initial_value="1", hint=text)
        objective = gui.add_dropdown("Least", _OBJECTIVES)
        timing = gui.add_dropdown("Duration", (*TIMINGS, FIXED), initial_value=DEMONSTRATED)
        duration = gui.add_number("Seconds", 1.0, min=0.1, max=60.0, step=0.1, visible=False)
        compares = gui.add_checkbox("Compare with B-splines", False)

    def on_change() -> None:
        duration.visible = timing.value == FIXED
        settings = PlanSettings(
            naturalness=float(naturalness.value),
            objective=objective.value,
            timing=timing.value,
            duration=float(duration.value),
            compares=compares.value,
        )
        react(settings)

    for widget in (naturalness, objective, timing, duration, compares):
        stage.on_change(widget, on_change)


def add_export(stage: Stage, plan: Callable[[], Plan | None]) -> None:
    """Add the buttons.

    Parameters
    ----------
    stage : Stage
        The scene.
    plan : callable
        The present plan, if there is one. A plan that must not be executed is not saved.
    """
    formats = stage.server.gui.add_button_group(
        "Save as", tuple(_FORMATS), hint="Save the motion as a file"
    )

    def save(event: viser.GuiEvent[Any]) -> None:
        with stage.lock:
            present = plan()
        if event.client is None:
            return
        if present is None or not present.is_executable:
            text = "there is no motion to save"
            event.client.add_notification("Not saved", text, auto_close_seconds=4.0)
            return
        name = _FORMATS[formats.value]
        with TemporaryDirectory() as folder:
            path = Path(folder) / name
            present.trajectory.save(path)
            content = path.read_bytes()
        event.client.send_file_download(name, content, save_immediately=True)

    formats.on_click(save)
