# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Detours: motions that start from collision-free paths, where descent finds no motion.

The program lowers the cost within limits and clearances, as for any other motion.
"""

from __future__ import annotations

from dataclasses import replace

from ...arrays import FloatArray
from ..context import Context
from ..motion import Motion
from ..options import FREE, SHORTEST
from ..program.bases import MotionBasis
from ..program.setting import Setting
from ..request import Request
from ..time_scaling import kinematic_stretch, slowdown
from .budget import Budget
from .candidate import Candidate, attempt, checked
from .examine import examine
from .paths import corners_of, paths
from .settings import as_shortest, scaled_duration


def along_path(context: Context, request: Request, budget: Budget) -> Candidate | None:
    """The best motion of one segment along a collision-free path; None if there is no path.

    If it is not valid, it has the corners of the path, at which a slow motion may rest.
    """
    best, path = None, None
    ends = request.start.positions, request.goal.positions
    for found in paths(context, ends, budget):
        path = found if path is None else path
        tried = _near_path(context, request, found, budget)
        if best is None or tried.violation < best.violation:
            best = tried
        if best.is_valid or budget.is_over():
            break
    if best is None or path is None or best.is_valid:
        return best
    return replace(best, corners=corners_of(context, path))


def _near_path(context: Context, request: Request, path: FloatArray, budget: Budget) -> Candidate:
    """The motion of least cost near a path, or else the one along it."""
    options, segment = context.options, request.segments[0]
    follower = context.bases.follower(segment.primitive)
    basis, duration = follower.basis(segment, path), request.duration
    if request.duration_is_free:
        least = kinematic_stretch(context.limits, follower.rates(segment, basis))
        at_least = 0.0 if options.timing == FREE else duration
        least *= options.search.scaling_margin
        duration = min(max(at_least, least), context.longest)
        motion = _motion(request, basis, duration)
        slower = slowdown(examine(context, [motion], collides=False).check)
        duration = min(duration * slower, context.longest)
    if budget.is_over():
        return _along(context, request, basis, duration)
    setting = _setting(context, request, basis, duration)
    along = None
    for share in options.detours.shares_of_solving:
        found = _optimised(context, request, setting, budget.share(share))
        if found.is_valid:
            return found
        along = along or _along(context, request, basis, duration)
        if found.solution.converged or budget.is_over():
            break
        again = replace(basis, starts=(found.motions[0].weights,))
        setting = replace(
            setting,
            bases=(again,),
            initial=(_motion(request, again, found.duration),),
        )
    assert along is not None
    return min(found, along, key=lambda one: one.violation)


def _setting(context: Context, request: Request, basis: MotionBasis, duration: float) -> Setting:
    """The first setting near a path."""
    options = context.options
    solver = replace(
        options.solver, tolerance=options.detours.tolerance, first_radius=options.detours.radius
    )
    is_shortest = request.duration_is_free and options.timing == SHORTEST
    if is_shortest:
        duration = scaled_duration(context, request, basis, is_timed=True)
    setting = Setting(
        (basis,),
        (_motion(request, basis, duration),),
        max(options.naturalness, options.detours.min_naturalness),
        options.objectives,
        solver,
        is_timed=request.duration_is_free and options.timing == FREE,
    )
    return as_shortest(context, setting) if is_shortest else setting


def _optimised(context: Context, request: Request, setting: Setting, budget: Budget) -> Candidate:
    """The motion of least cost near a path, slower if it exceeds limits."""
    found = attempt(context, request, setting, budget)
    if not (found.check.violations and request.duration_is_free):
        return found
    # A little slower, the same path keeps the limits.
    duration = min(found.duration * slowdown(found.check), context.longest)
    motion = replace(found.motions[0], duration=duration)
    return checked(context, request, setting.bases, (motion,))


def _along(context: Context, request: Request, basis: MotionBasis, duration: float) -> Candidate:
    """The motion along a path, without optimisation."""
    return checked(context, request, (basis,), (_motion(request, basis, duration),))


def _motion(request: Request, basis: MotionBasis, duration: float) -> Motion:
    return Motion(request.start, request.goal, duration, basis.tables.basis, basis.expected)
