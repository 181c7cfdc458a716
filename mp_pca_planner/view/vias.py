# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Points that the end effector is to pass, as handles in the scene."""

from __future__ import annotations

from collections.abc import Callable

import viser

from ..arrays import FloatArray
from ..motion.goal import Pose
from .stage import Stage

_MAX_VIAS = 4
_ADD, _REMOVE = "Add", "Remove all"


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
        if len(self._handles) < _MAX_VIAS:
            self.add(self._new_place())
            self._react(self.poses)

    def _on_remove(self) -> None:
        self.clear()
        self._react(())
