# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The page of the case study: tables beside the paper's, figures, and an animation."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..evaluation.case_study import OURS, PAPER, CaseStudy
from ..evaluation.naturalness import BSPLINES, DEFAULT_RHO, EXPECTED, Comparison, planned
from ..evaluation.paper import PAPER_OPTIONS
from ..robot.model import Robot
from .arm import arm_figure
from .case_study_tables import less_than_paper, tables, verdict
from .comparison import trade_off_figure
from .drawing import picture
from .page import image_address, render
from .primitive import angle_components_figure


def draw_pictures(study: CaseStudy, robot: Robot, frames: Sequence[str]) -> dict[str, io.BytesIO]:
    """Draw all figures as PNGs, by the names of their files."""
    pictures = {name: io.BytesIO() for name in ("figure_2", "figures_3_4", "trade_off")}
    with picture(pictures["figure_2"]) as figure:
        angle_components_figure(
            figure,
            study.motions[0].joint_names,
            [found.truncated(PAPER_OPTIONS.n_components).components for found in study.components],
            "Principal components of the joint angles (paper: Fig. 2)",
        )
    with picture(pictures["figures_3_4"]) as figure:
        chains = _chains(study, robot, frames)
        title = "The arm-raising motion (paper: Figs. 3 and 4)"
        arm_figure(figure, chains, title, frames[-1])
    others = {
        name: _place(study.held_out, name)
        for name in study.held_out.results
        if not name.startswith("planned") and name != EXPECTED
    }
    with picture(pictures["trade_off"]) as figure:
        title = "Effort against distance to people's motions"
        trade_off_figure(figure, _curve(study.held_out), others, title)
    return pictures


def case_study_page(
    study: CaseStudy,
    robot: Robot,
    frames: Sequence[str],
    source: str,
    pictures: Mapping[str, io.BytesIO],
) -> str:
    """Make the page.

    Raises
    ------
    MissingDependencyError
        If matplotlib or jinja2 is not installed.
    """
    return render(
        "case_study.html",
        title="Case study: movement primitives of arm motions",
        study=study,
        source=source,
        raising=study.raising.motion,
        verdict=verdict(study),
        tables={"naturalness_other_activities": None, **tables(study)},
        below_paper=less_than_paper(study),
        images={name: image_address(content) for name, content in pictures.items()},
        animation=_animation(study, robot, frames),
    )


def _chains(study: CaseStudy, robot: Robot, frames: Sequence[str]) -> dict[str, FloatArray]:
    """Origins of the frames, shape (n_frames, n_points, 3), by the label of the motion."""
    raising = study.raising
    n_frames = 61
    chosen = np.linspace(0, 1000, n_frames).round().astype(int)
    positions = {
        name: raising.predictions[name].positions[chosen] for name in (BSPLINES, PAPER, OURS)
    }
    positions["the person"] = raising.motion.time_normalised(n_frames)
    return {name: robot.frame_positions(q, frames) for name, q in positions.items()}


def _curve(comparison: Comparison) -> dict[str, tuple[float, float]]:
    """The planner from ρ = 0 to ∞."""
    methods = [name for name in comparison.results if name.startswith("planned")]
    labels = {name: name.removeprefix("planned, ") for name in methods}
    labels[planned(DEFAULT_RHO)] += " (default)"
    labels[EXPECTED] = "ρ = ∞"
    return {label: _place(comparison, name) for name, label in labels.items()}


def _place(comparison: Comparison, name: str) -> tuple[float, float]:
    """Effort as a multiple of that of B-splines (median), and error in path [deg]."""
    return comparison.effort_ratio(name), float(np.rad2deg(comparison.rms(name, "path")))


def _animation(study: CaseStudy, robot: Robot, frames: Sequence[str]) -> dict[str, Any]:
    chains = _chains(study, robot, frames)
    return {
        "duration": study.raising.motion.duration,
        "chains": [[name, np.round(chain, 4).tolist()] for name, chain in chains.items()],
    }
