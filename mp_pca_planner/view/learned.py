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
from .robot_shapes import Rgb, add_paths, show_paths
from .stage import Player, ShownMotion, Stage, part

NAME = "Components"
_N_SAMPLES = 60  # configurations of a shown demonstration
_N_CURVES = 25  # demonstrations in the picture of a primitive
_MAX_SLIDERS, _SLIDER_RANGE = 12, 3.0  # the range in standard deviations
_TYPICAL: Rgb = (140, 140, 140)
_BENT: Rgb = (204, 121, 167)
_SLIDERS = (
    "Each slider adds more or less of one component to a typical demonstration, in standard "
    "deviations; the bar is the component's share of the differences. Grey: before. Pink: after."
)


def explanation(primitive: MovementPrimitive, *, is_open: bool = False) -> str:
    """What a movement primitive is, in plain words, with a picture of this one, as HTML."""
    facts = {
        "name": primitive.name,
        "n_demonstrations": len(primitive.durations),
        "n_joints": primitive.n_joints,
        "n_components": primitive.n_components,
        "share": f"{100.0 * float(variance_shares(primitive).sum()):.0f}",
    }
    return part("explanation", facts, _curves(primitive), is_open)


def _curves(primitive: MovementPrimitive) -> dict[str, Any]:
    """Curves of the joint that moves most, as points of a picture that is 100 wide and 50 high."""
    times = np.linspace(0.0, 1.0, 41)
    typical = typical_demonstration(primitive)
    chosen = np.unique(np.linspace(0, len(primitive.durations) - 1, _N_CURVES).astype(int))
    motions = np.array([primitive.reproduction(i, primitive.durations[i] * times) for i in chosen])
    # The joint that moves most, and the component that bends it most.
    bends = np.abs(primitive.component_coefficients).sum(axis=2)
    bends = bends * np.sqrt(primitive.explained_variance)[:, None]
    joint = int(np.ptp(motions, axis=1).mean(axis=0).argmax())
    deviations = np.zeros(primitive.n_components)
    if deviations.size:
        deviations[bends[:, joint].argmax()] = _SLIDER_RANGE
    curves = [motions[..., joint]]
    for sign in (0.0, 1.0, -1.0):
        motion = bent_demonstration(primitive, typical, sign * deviations, len(times))
        curves.append(motion.positions[None, :, joint])
    shown = np.concatenate(curves)
    low, high = shown.min(), max(shown.max(), shown.min() + 1e-6)
    heights = 47.0 - 44.0 * (shown - low) / (high - low)
    lines = [
        " ".join(f"{100.0 * t:.1f},{y:.1f}" for t, y in zip(times, row, strict=True))
        for row in heights
    ]
    return {
        "joint": primitive.joint_names[joint],
        "demonstrations": lines[:-3],
        "typical": lines[-3],
        "bent": lines[-2:] if deviations.any() else [],
    }


def bent_demonstration(
    primitive: MovementPrimitive, index: int, deviations: ArrayLike, n_samples: int = _N_SAMPLES
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
    n_samples : int
        Number of configurations.
    """
    duration = float(primitive.durations[index])
    times = np.linspace(0.0, duration, n_samples)
    added = np.asarray(deviations) * np.sqrt(primitive.explained_variance)
    bend = primitive.basis.shape(added, times / duration)
    bend = bend - primitive.basis.shape(np.zeros_like(added), times / duration)
    return ShownMotion(times, primitive.reproduction(index, times) + bend)


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
        self._stage, self._player, self._is_open = stage, player, False
        self._primitives = {primitive.name: primitive for primitive in primitives}
        gui, names = stage.server.gui, tuple(self._primitives)
        self._choice = gui.add_dropdown("Primitive", names, visible=len(names) > 1)
        self._text = gui.add_html("")
        gui.add_html(part("lines", [_SLIDERS]))
        self._folder = gui.add_folder(None)
        reset = gui.add_button("Back to the demonstration", icon=viser.Icon.ROTATE)
        # The sliders of the shown components, and all that belongs to them.
        self._sliders: dict[int, Any] = {}
        self._widgets: list[Any] = []
        self._typical = add_paths(stage.server.scene, "/components/typical", _TYPICAL)
        self._bent = add_paths(stage.server.scene, "/components/bent", _BENT, 4.0)
        stage.on_change(self._choice, self._on_choice)
        stage.on_click(reset, self._on_reset)
        self._on_choice()

    def set_open(self, is_open: bool) -> None:
        """Show the bent demonstration, or hide its paths."""
        self._is_open = is_open
        self._show()

    def _on_choice(self) -> None:
        gui, primitive = self._stage.server.gui, self._primitives[self._choice.value]
        self._index = typical_demonstration(primitive)
        self._text.content = explanation(primitive, is_open=True)
        for widget in self._widgets:
            widget.remove()
        self._widgets, self._sliders = [], {}
        shares, names = variance_shares(primitive), component_names(primitive)
        with self._folder:
            for k in sorted(np.argsort(-shares, kind="stable")[:_MAX_SLIDERS].tolist()):
                label, ends = f"{names[k]}: {100.0 * shares[k]:.1f} %", _SLIDER_RANGE
                slider = gui.add_slider(label, -ends, ends, 0.1, 0.0)
                self._stage.on_change(slider, self._on_slider)
                self._sliders[k] = slider
                self._widgets += [slider, gui.add_html(part("padded_bar", shares[k]))]
            left = len(names) - len(self._sliders)
            if left:
                text = f"{left} smaller components are not shown."
                self._widgets.append(gui.add_html(part("lines", [text])))
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
        if not self._is_open:
            show_paths(self._typical)
            show_paths(self._bent)
            return
        show_paths(self._typical, self._stage.path(self._unbent.positions))
        show_paths(self._bent, self._stage.path(self.motion.positions))
        self._player.show(self.motion)
