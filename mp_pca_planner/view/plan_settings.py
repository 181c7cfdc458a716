# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The widgets of the options of a plan."""

from __future__ import annotations

from collections.abc import Callable

from ..planning.plan import DEMONSTRATED, TIMINGS
from .planning import FIXED, PlanSettings
from .stage import Stage

_NATURALNESS = ("0", "0.01", "0.1", "1", "10")
_OBJECTIVES = ("effort", "energy", "jerk", "straightness")


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
