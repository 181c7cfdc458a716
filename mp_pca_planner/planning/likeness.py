# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Naturalness and timing of a motion, by how much its request is like the demonstrations.

The prediction holds for requests like the demonstrations. There, motions are close to it and take
the predicted duration. For other requests, its error grows with the in-span score, and cost counts
more. What the options give is kept.
"""

from __future__ import annotations

from ..primitives.in_span import UNUSUAL_IN_SPAN_SCORE
from .options import AUTO, DEMONSTRATED, FREE, PlannerOptions

NATURAL = 1.0
"""Naturalness ρ of motions like the demonstrations."""
_POWER = 3


def naturalness_for(options: PlannerOptions, score: float) -> float:
    """Naturalness ρ: that of the options, else 1 up to a score of 3, (3 / score)³ above.

    Parameters
    ----------
    options : PlannerOptions
        The options.
    score : float
        In-span score of the request.
    """
    if options.naturalness is not None:
        return options.naturalness
    share = UNUSUAL_IN_SPAN_SCORE / max(score, UNUSUAL_IN_SPAN_SCORE)
    return float(NATURAL * share**_POWER)


def timing_for(options: PlannerOptions, score: float, *, is_detour: bool = False) -> str:
    """Timing: that of the options, else 'free' for scores above 3 and detours, else predicted.

    Parameters
    ----------
    options : PlannerOptions
        The options.
    score : float
        In-span score of the request.
    is_detour : bool
        Whether the motion follows a collision-free path, because the predicted one collides.
    """
    if options.timing != AUTO:
        return options.timing
    return FREE if is_detour or score > UNUSUAL_IN_SPAN_SCORE else DEMONSTRATED
