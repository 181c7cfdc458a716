# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The panel of what was learned: what a primitive is, and its components."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import viser
from numpy.typing import ArrayLike

from ..arrays import FloatArray
from ..primitives.primitive import MovementPrimitive
from .content import typical_demonstration
from .robot_shapes import DrawnPath, Rgb
from .stage import Player, ShownMotion, Stage, part

NAME = "Components"
_N_SAMPLES = 60  # configurations of a shown demonstration
_MAX_SLIDERS, _SLIDER_RANGE = 12, 3.0  # the range in standard deviations
_TYPICAL: Rgb = (140, 140, 140)
_BENT: Rgb = (204, 121, 167)
_SLIDERS = (
    "Each slider adds more or less of one component to a typical demonstration, in standard "
    "deviations; the percentage is its share of the differences. Grey: before. Pink: after."
)


def explanation(primitive: MovementPrimitive) -> str:
    """What a movement primitive is, in plain words with the numbers of this one, as HTML."""
    share = f"{100.0 * float(variance_shares(primitive).sum()):.0f}"
    return part("explanation", primitive, share)


def bent_demonstration(
    primitive: MovementPrimitive, index: int, deviations: ArrayLike
) -> ShownMotion:
    """A demonstration as its weights reproduce it, bent by components.

    Parameters
    ----------
    primitive : MovementPrimitive
        Any primitive.
    index : int
        Index of the demonstration.
    deviations : array, shape (n_components,)
        Weight added to that of each component, in standard deviations of the demonstrations.
    """
    duration = float(primitive.durations[index])
    times = np.linspace(0.0, duration, _N_SAMPLES)
    added = np.asarray(deviations) * np.sqrt(primitive.explained_variance)
    bend = primitive.basis.shape(added, times / duration)
    bend = bend - primitive.basis.shape(np.zeros_like(added), times / duration)
    return ShownMotion(times, primitive.reproduction(index, times) + bend)


def component_names(primitive: MovementPrimitive) -> list[str]:
    """A name for each component; one of a single joint is named after it."""
    numbers = [str(k + 1) for k in range(primitive.n_components)]
    if primitive.coupling == "arm":
        return numbers
    joints = [primitive.joint_names[joint] for joint in primitive.joint_of_component]
    return [f"{number} ({joint})" for number, joint in zip(numbers, joints, strict=True)]


def variance_shares(primitive: MovementPrimitive) -> FloatArray:
    """Share of the whole variance that each component explains, shape (n_components,)."""
    return np.asarray(primitive.explained_variance / primitive.total_variance.sum())


class ComponentsPanel:
    """Sliders that bend a typical demonstration along the components of its primitive.

    Parameters
    ----------
    stage : Stage
        The scene.
    player : Player
        Plays the bent demonstration.
    primitives : sequence of MovementPrimitive
        At least one.

    Attributes
    ----------
    motion : ShownMotion
        The bent demonstration.
    """

    def __init__(
        self, stage: Stage, player: Player, primitives: Sequence[MovementPrimitive]
    ) -> None:
        self._stage, self._player = stage, player
        self._primitives = {primitive.name: primitive for primitive in primitives}
        gui, names = stage.server.gui, tuple(self._primitives)
        self._choice = gui.add_dropdown("Primitive", names, visible=len(names) > 1)
        self._text = gui.add_html("")
        gui.add_html(part("lines", [_SLIDERS]))
        self._folder = gui.add_folder(None)
        reset = gui.add_button("Back to the demonstration", icon=viser.Icon.ROTATE)
        self._sliders: dict[int, Any] = {}  # of the largest components
        self._root = stage.server.scene.add_frame("/components", show_axes=False, visible=False)
        self._typical = DrawnPath(stage.server.scene, "/components/typical", _TYPICAL)
        self._bent = DrawnPath(stage.server.scene, "/components/bent", _BENT, 4.0)
        stage.on_change(self._choice, self._on_choice)
        stage.on_click(reset, self._on_reset)
        self._on_choice()

    def set_open(self, is_open: bool) -> None:
        """Show the bent demonstration, or hide its paths."""
        self._root.visible = is_open
        self._show()

    def _on_choice(self) -> None:
        gui, primitive = self._stage.server.gui, self._primitives[self._choice.value]
        self._index = typical_demonstration(primitive)
        self._text.content = explanation(primitive)
        for slider in self._sliders.values():
            slider.remove()
        self._sliders = {}
        shares, names = variance_shares(primitive), component_names(primitive)
        with self._folder:
            for k in sorted(np.argsort(-shares, kind="stable")[:_MAX_SLIDERS].tolist()):
                label, ends = f"{names[k]}: {100.0 * shares[k]:.1f} %", _SLIDER_RANGE
                self._sliders[k] = slider = gui.add_slider(label, -ends, ends, 0.1, 0.0)
                self._stage.on_change(slider, self._on_slider)
        self._on_slider()

    def _on_reset(self) -> None:
        for slider in self._sliders.values():
            slider.value = 0.0
        self._on_slider()

    def _on_slider(self) -> None:
        primitive = self._primitives[self._choice.value]
        deviations = np.zeros(primitive.n_components)
        self._unbent = bent_demonstration(primitive, self._index, deviations)
        for k, slider in self._sliders.items():
            deviations[k] = slider.value
        self.motion = bent_demonstration(primitive, self._index, deviations)
        self._show()

    def _show(self) -> None:
        for drawn, motion in ((self._typical, self._unbent), (self._bent, self.motion)):
            drawn.show(self._stage.path(motion.positions))
        if self._root.visible:
            self._player.show(self.motion)
