# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A request with its first setting, and what was found for it."""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter

from ..context import Context
from ..options import OPTIMAL, SHORTEST
from ..program.bases import MotionBasis
from ..program.joining import expected_motion, stretched
from ..program.setting import Setting
from ..request import Request
from .budget import Budget
from .candidate import Candidate, checked
from .settings import first_setting, sequence_setting


@dataclass(frozen=True, eq=False)
class Case:
    """A request, and what is known of its motions.

    Attributes
    ----------
    context : Context
        Of the planner.
    request : Request
        The request.
    optimises : bool
        Whether motions are optimised; otherwise segments are only joined.
    first : Setting
        The first setting.
    joined : Candidate or None
        The expected motion of several segments, within the limits if possible.
    tried : tuple of str
        Names of the stages that were tried.
    found : tuple of Candidate
        Their candidates.
    """

    context: Context
    request: Request
    optimises: bool
    first: Setting
    joined: Candidate | None
    tried: tuple[str, ...] = ()
    found: tuple[Candidate, ...] = ()


def first_case(context: Context, request: Request, mode: str, budget: Budget) -> Case:
    """A request before anything was tried.

    Parameters
    ----------
    context, request
        Of the planner; the request.
    mode : {'real_time', 'optimal'}
        Whether a motion through several targets is optimised.
    budget : Budget
        The time for joining segments.
    """
    if request.is_single:
        shortest = request.duration_is_free and context.options.timing == SHORTEST
        first = first_setting(context, request, shortest=shortest)
        return Case(context, request, True, first, None)
    bases = [context.bases.basis(segment, is_paced=False) for segment in request.segments]
    expected = _joined(context, request, tuple(bases), budget)
    first = sequence_setting(context, tuple(bases), expected.motions)
    return Case(context, request, mode == OPTIMAL, first, expected)


def _joined(
    context: Context, request: Request, bases: tuple[MotionBasis, ...], budget: Budget
) -> Candidate:
    """Lengthen free durations, and lower passing velocities, until the limits are kept."""
    search, durations = context.options.search, [one.duration for one in request.segments]
    found = list[Candidate]()
    for share in search.passing_shares:
        for _ in range(search.max_stretches):
            motions = expected_motion(request, bases, durations, share)
            found.append(checked(context, request, bases, motions))
            if not found[-1].check.violations or budget.is_over():
                return min(found, key=attrgetter("violation"))
            longer = stretched(request, found[-1].check, durations, search.max_stretch)
            if longer == durations or sum(longer) > context.longest:
                break
            durations = longer
    return min(found, key=attrgetter("violation"))
