# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Demonstrations on the page: which are drawn, and which one is played."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ..plotting.style import COLOURS
from ..primitives.primitive import MovementPrimitive
from ..recordings.recording_set import RecordingSet
from .options import PAGE
from .player import Player, ShownMotion
from .stage import DrawnPaths, Stage, from_hex
from .words import part

_UNLABELLED = "without a label"
NAME = "Demonstrations"
_ALL, _NONE = "All", "None"


Groups = dict[str, list[ShownMotion]]
"""Demonstrations by label; by the name of the primitive, or a remark, where there is none."""


def reproduced(primitives: Iterable[MovementPrimitive]) -> Groups:
    """The demonstrations of primitives, as their weights and their own timing reproduce them."""
    found: Groups = {}
    for primitive in primitives:
        sources = primitive.metadata["demonstrations"]
        for i, (duration, source) in enumerate(zip(primitive.durations, sources, strict=True)):
            times = np.linspace(0.0, float(duration), PAGE.n_samples)
            name = _name(i, source["recording"], source["start_time_s"])
            motion = ShownMotion(name, times, primitive.reproduction(i, times))
            found.setdefault(source["label"] or primitive.name, []).append(motion)
    return found


def recorded(recordings: RecordingSet) -> Groups:
    """The demonstrations of recordings, as they were measured."""
    found: Groups = {}
    for i, one in enumerate(recordings.demonstrations):
        name = _name(i, one.recording, one.start_time)
        times = np.linspace(0.0, one.duration, PAGE.n_samples)
        motion = ShownMotion(name, times, one.time_normalised(PAGE.n_samples))
        found.setdefault(one.label or _UNLABELLED, []).append(motion)
    return found


def _name(index: int, recording: str, start: float) -> str:
    return f"{index + 1}. {recording} at {start:.1f} s"


class DemonstrationsPanel:
    """The list of the demonstrations, their paths by label, and their playback.

    Parameters
    ----------
    stage : Stage
        The scene.
    player : Player
        Plays the chosen demonstration.
    groups : dict of str to list of ShownMotion
        The demonstrations by label; at least one.
    remarks : sequence of str
        Sentences on them: where they are from, what was repaired.
    """

    def __init__(
        self, stage: Stage, player: Player, groups: Groups, remarks: Sequence[str]
    ) -> None:
        self._stage, self._player = stage, player
        gui = stage.server.gui
        gui.add_html(part("lines", remarks))
        self._is_drawn: Any = gui.add_checkbox("Draw the paths", False)
        self._motions: dict[str, ShownMotion] = {}
        self._boxes: list[list[tuple[Any, ShownMotion]]] = []
        self._paths: list[DrawnPaths] = []
        several = len(groups) > 1
        names = [
            f"{label}: {motion.name}" if several else motion.name
            for label, motions in groups.items()
            for motion in motions
        ]
        self._choice = gui.add_dropdown("Play", tuple(dict.fromkeys(names)))
        picks = gui.add_button_group("Draw", (_ALL, _NONE))
        self._add_lists(groups, iter(names))
        self._places: dict[int, Any] = {}
        stage.on_change(self._choice, self._on_choice)
        stage.on_change(self._is_drawn, self._draw)
        stage.on_click(picks, lambda: self._pick(picks.value == _ALL))
        self._player.offer(NAME, self._motions[self._choice.value], take=False)

    def _add_lists(self, groups: Groups, names: Any) -> None:
        """A folder of checkboxes for each label."""
        gui = self._stage.server.gui
        listed = max(1, PAGE.max_listed // len(groups))
        for i, (label, motions) in enumerate(groups.items()):
            colour = COLOURS[i % len(COLOURS)]
            path = DrawnPaths(
                self._stage.server.scene, f"/demonstrations/{i}", from_hex(colour), 2.0
            )
            self._paths.append(path)
            self._boxes.append([])
            title = f"{label} ({len(motions)})"
            with gui.add_folder(title, expand_by_default=False):
                gui.add_html(f'<div style="height:4px;background:{colour}"></div>')
                for k, motion in enumerate(motions):
                    self._motions[next(names)] = motion
                    if k < listed:
                        box = gui.add_checkbox(motion.name, True)
                        self._stage.on_change(box, self._on_box)
                        self._boxes[-1].append((box, motion))
                left = len(motions) - listed
                if left > 0:
                    gui.add_markdown(f"{left} more are in the list above.")

    def _on_choice(self) -> None:
        self._player.offer(NAME, self._motions[self._choice.value])

    def _on_box(self) -> None:
        self._is_drawn.value = True
        self._draw()

    def _pick(self, is_picked: bool) -> None:
        for box, _ in (pair for boxes in self._boxes for pair in boxes):
            box.value = is_picked
        self._is_drawn.value = is_picked
        self._draw()

    def _draw(self) -> None:
        for path, boxes in zip(self._paths, self._boxes, strict=True):
            picked = [motion for box, motion in boxes if box.value and self._is_drawn.value]
            path.show(*map(self._place, picked))

    def _place(self, motion: ShownMotion) -> Any:
        """The path of the end effector, computed once."""
        if id(motion) not in self._places:
            self._places[id(motion)] = self._stage.path(motion.positions)
        return self._places[id(motion)]
