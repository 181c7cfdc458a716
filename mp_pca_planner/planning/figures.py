# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Figures of a plan: scores, corrections, and the reason for the choice of primitives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..motion.goal import Goal
from .context import Context
from .motion import Motion
from .program.bases import MotionBasis
from .requests.resolve import in_span_score, predict
from .search.candidate import Candidate
from .search.search import Outcome


def selection_reason(goal: Goal, outcome: Outcome) -> str:
    """The reason for the choice of the primitives."""
    request = outcome.best.request
    if goal.primitive is not None:
        return f"the goal names '{goal.primitive}'"
    if not request.is_single:
        segments = request.segments
        reasons = [
            one.selection.reason(one.primitive.name, {one.primitive.name: None}) for one in segments
        ]
        return "; ".join(dict.fromkeys(reasons))
    solved = {
        one.request.segments[0].primitive.name: one.solution.cost if one.is_valid else None
        for one in outcome.found
        if one.request.goal is request.goal
    }
    segment = request.segments[0]
    return segment.selection.reason(segment.primitive.name, solved)


def novelty(context: Context, best: Candidate) -> float:
    """The score of the request; for poses, of the configurations that were found."""
    request = best.request
    if request.is_single and request.pose is None:
        return request.segments[0].expected.in_span_score
    is_fixed = request.is_single and not request.duration_is_free
    return max(
        in_span_score(
            context, segment, motion.start, motion.goal, motion.duration if is_fixed else None
        )
        for segment, motion in zip(request.segments, best.motions, strict=True)
    )


def expected_error(context: Context, best: Candidate) -> float:
    """The largest error that the primitives expect of their predictions."""
    errors = []
    for segment, motion in zip(best.request.segments, best.motions, strict=True):
        moved = replace(segment, start=motion.start)
        expected = predict(context, moved, motion.goal, motion.duration)
        errors.append(segment.primitive.expected_error(expected))
    return max(errors)


def is_corrected(basis: MotionBasis) -> bool:
    """Whether the basis includes B-splines."""
    return basis.n_components < basis.expected.size


def correction(basis: MotionBasis, motion: Motion) -> float:
    """RMS of the correction that B-splines add to components [rad or m]."""
    if not is_corrected(basis):
        return 0.0
    shape = basis.tables.basis.shape
    only = np.where(np.arange(basis.expected.size) < basis.n_components, 0.0, 1.0)
    phases = np.linspace(0.0, 1.0, 101)
    added = shape(only * motion.weights, phases) - shape(0.0 * only, phases)
    return float(np.sqrt(np.mean(added**2)))


def deviation_score(best: Candidate) -> float:
    """RMS deviation of the components' weights from the expected ones, in standard deviations."""
    found = []
    for basis, motion in zip(best.bases, best.motions, strict=True):
        if n := basis.n_components:
            assert basis.precision is not None
            off = motion.weights[:n] - basis.expected[:n]
            found.append(float(np.sqrt(off @ basis.precision[:n, :n] @ off / n)))
    return max(found, default=float("nan"))
