# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Options of the page: sizes, periods and colours."""

from __future__ import annotations

from dataclasses import dataclass

Rgb = tuple[int, int, int]


@dataclass(frozen=True)
class PageOptions:
    """Sizes, periods and colours of the page.

    Attributes
    ----------
    n_phases, n_samples : int
        Numbers of configurations of a bent motion, and of a shown demonstration.
    max_sliders, slider_range : int, float
        Sliders of components, and their range [standard deviations].
    max_listed, max_vias : int
        Demonstrations with a checkbox, and points to pass.
    frame_period, slider_steps : float, int
        Time between two configurations of a played motion [s]; the slider follows every so many.
    n_ghosts : int
        Ghosts of a motion.
    max_faces : int
        Faces of a mesh above which its convex hull is drawn; browsers without a GPU need that.
    ghost_growth : float
        Size of a ghost as a multiple of the robot's, whose surface would flicker with an equal one.
    live_period, text_steps : float, int
        Time between two looks at the node [s]; its text follows every so many.
    silence : float
        Time without diagnostics, which come once a second, after which the node counts as gone [s].
    stale : float
        Age above which joint states count as old [s].
    like_score : float
        In-span score up to which a request is like the demonstrations; about 1 is usual.
    brand, mean, bent, ghost, measured, goal, refused, path, splines, obstacle, chosen : Rgb
        Colours of the page's buttons, and of what is in the scene.
    """

    n_phases: int = 101
    n_samples: int = 60
    max_sliders: int = 12
    slider_range: float = 3.0
    max_listed: int = 60
    max_vias: int = 4
    frame_period: float = 1.0 / 30.0
    slider_steps: int = 4
    n_ghosts: int = 4
    max_faces: int = 40_000
    ghost_growth: float = 1.02
    live_period: float = 0.05
    text_steps: int = 4
    silence: float = 3.0
    stale: float = 0.5
    like_score: float = 1.5
    brand: Rgb = (0, 82, 130)
    mean: Rgb = (140, 140, 140)
    bent: Rgb = (204, 121, 167)
    ghost: Rgb = (120, 144, 176)
    measured: Rgb = (230, 159, 0)
    goal: Rgb = (0, 158, 115)
    refused: Rgb = (217, 53, 43)
    path: Rgb = (0, 114, 178)
    splines: Rgb = (204, 121, 167)
    obstacle: Rgb = (150, 128, 104)
    chosen: Rgb = (230, 159, 0)


PAGE = PageOptions()
