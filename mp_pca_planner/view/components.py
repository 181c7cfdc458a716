# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Components of a primitive: the mean motion, bent by sliders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import viser
from numpy.typing import ArrayLike

from ..arrays import FloatArray
from ..primitives.boundary import boundary_values, hermite_functions
from ..primitives.primitive import MovementPrimitive
from .options import PAGE
from .player import Player, ShownMotion
from .stage import DrawnPaths, Stage
from .words import part

NAME = "Components"
_TEXT = (
    "The **mean motion** of the demonstrations, and how they vary about it. Each slider bends the "
    "motion along one principal component, in standard deviations. Plans are such bends, too."
)


def bent_motion(primitive: MovementPrimitive, deviations: ArrayLike) -> ShownMotion:
    """The mean motion between the mean ends of the demonstrations, bent by components.

    Parameters
    ----------
    primitive : MovementPrimitive
        Any primitive.
    deviations : array, shape (n_components,)
        Weight of each component in standard deviations of the demonstrations.
    """
    phases = np.linspace(0.0, 1.0, PAGE.n_phases)
    rest = np.zeros(primitive.n_joints)
    duration = float(np.median(primitive.durations))
    start, goal = (primitive.boundary_states[:, k].mean(axis=0) for k in (0, 3))
    boundary = boundary_values((start, rest, rest), (goal, rest, rest), duration)
    weights = np.asarray(deviations) * np.sqrt(primitive.explained_variance)
    positions = hermite_functions(phases) @ boundary + primitive.basis.shape(weights, phases)
    return ShownMotion("Components", duration * phases, positions)


def component_names(primitive: MovementPrimitive) -> list[str]:
    """A name for each component; one of a single joint is named after it."""
    if primitive.coupling == "arm":
        return [f"{k}" for k in range(1, primitive.n_components + 1)]
    counts: dict[str, int] = {}
    names = []
    for joint in primitive.joint_of_component:
        name = primitive.joint_names[joint]
        counts[name] = counts.get(name, 0) + 1
        names.append(f"{name} {counts[name]}")
    return names


def variance_shares(primitive: MovementPrimitive) -> FloatArray:
    """Share of the whole variance that each component explains, shape (n_components,)."""
    return np.asarray(primitive.explained_variance / primitive.total_variance.sum())


class ComponentsPanel:
    """Sliders of the components of one primitive at a time.

    Parameters
    ----------
    stage : Stage
        The scene.
    player : Player
        Plays the bent motion.
    primitives : sequence of MovementPrimitive
        At least one.
    """

    def __init__(
        self, stage: Stage, player: Player, primitives: Sequence[MovementPrimitive]
    ) -> None:
        self._stage, self._player = stage, player
        self._primitives = {primitive.name: primitive for primitive in primitives}
        gui = stage.server.gui
        gui.add_markdown(_TEXT)
        names = tuple(self._primitives)
        self._choice = gui.add_dropdown("Primitive", names, visible=len(names) > 1)
        reset = gui.add_button("Back to the mean motion", icon=viser.Icon.ROTATE)
        self._folder = gui.add_folder(None)
        self._sliders: list[Any] = []
        self._mean = DrawnPaths(stage.server.scene, "/components/mean", PAGE.mean)
        self._bent = DrawnPaths(stage.server.scene, "/components/bent", PAGE.bent, 4.0)
        stage.on_change(self._choice, self._on_choice)
        stage.on_click(reset, self._on_reset)
        self._is_shown = False
        self._on_choice(take=False)
        player.when_shown(NAME, self._on_shown)

    @property
    def primitive(self) -> MovementPrimitive:
        """The chosen primitive."""
        return self._primitives[self._choice.value]

    def _on_choice(self, *, take: bool = True) -> None:
        for slider in self._sliders:
            slider.remove()
        self._sliders = []
        gui, primitive = self._stage.server.gui, self.primitive
        shares, names = variance_shares(primitive), component_names(primitive)
        shown = np.sort(np.argsort(-shares, kind="stable")[: PAGE.max_sliders])
        self._shown = [int(k) for k in shown]
        with self._folder:
            for k in self._shown:
                gui_slider = gui.add_slider(
                    f"{names[k]}: {100.0 * shares[k]:.1f} %",
                    -PAGE.slider_range,
                    PAGE.slider_range,
                    0.1,
                    0.0,
                )
                self._stage.on_change(gui_slider, self._update)
                bar = gui.add_html(part("padded_bar", shares[k]))
                self._sliders += [gui_slider, bar]
            left = len(names) - len(self._shown)
            if left:
                self._sliders.append(gui.add_markdown(f"{left} smaller components are not shown."))
        self._update(take=take)

    def _on_shown(self, is_shown: bool) -> None:
        self._is_shown = is_shown
        self._draw()

    def _on_reset(self) -> None:
        for slider in self._sliders[: 2 * len(self._shown) : 2]:
            slider.value = 0.0
        self._update()

    def _update(self, *, take: bool = True) -> None:
        deviations = np.zeros(self.primitive.n_components)
        deviations[self._shown] = [s.value for s in self._sliders[: 2 * len(self._shown) : 2]]
        self._motion = bent_motion(self.primitive, deviations)
        self._player.offer(NAME, self._motion, take=take)
        self._draw()

    def _draw(self) -> None:
        if not self._is_shown:
            self._mean.show()
            self._bent.show()
            return
        mean = bent_motion(self.primitive, np.zeros(self.primitive.n_components))
        self._mean.show(self._stage.path(mean.positions))
        self._bent.show(self._stage.path(self._motion.positions))
