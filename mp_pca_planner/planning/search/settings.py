# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""First settings of attempts."""

from __future__ import annotations

from dataclasses import replace

from ..context import Context
from ..motion import Motion
from ..objectives import Time
from ..options import FREE
from ..program.bases import MotionBasis
from ..program.costs import cost_of, node_states
from ..program.joining import expected_motion
from ..program.setting import Setting
from ..request import Request
from ..solver.quadratic import TINY
from ..time_scaling import least_stretch


def first_setting(context: Context, request: Request, width: int = 0, *, shortest: bool) -> Setting:
    """The setting of the first attempt at one segment.

    Parameters
    ----------
    context, request
        Of the planner; the request.
    width : int
        Number of the basis, see :meth:`.BasisStore.basis`.
    shortest : bool
        Whether the shortest duration is searched.
    """
    options = context.options
    basis = setting_basis(context, request, width, shortest=shortest)
    is_timed = shortest or (request.duration_is_free and options.timing == FREE)
    duration = request.duration
    if request.duration_is_free:
        duration = scaled_duration(context, request, basis, is_timed=is_timed)
    initial = expected_motion(request, [basis], [duration])
    setting = Setting(
        (basis,), initial, options.naturalness, options.objectives, options.solver, width, is_timed
    )
    return as_shortest(context, setting) if shortest else setting


def setting_basis(context: Context, request: Request, width: int, *, shortest: bool) -> MotionBasis:
    """A basis of one segment, with several starts unless motions stay near the expected one."""
    has_starts = shortest or context.options.naturalness < context.options.search.near_expected
    return context.bases.basis(request.segments[0], width, has_starts=has_starts)


def sequence_setting(
    context: Context, bases: tuple[MotionBasis, ...], joined: tuple[Motion, ...]
) -> Setting:
    """The setting of a motion through several targets, from one that is joined."""
    options = context.options
    return Setting(bases, joined, options.naturalness, options.objectives, options.solver)


def as_shortest(context: Context, setting: Setting) -> Setting:
    """The setting of the search for the shortest duration.

    The planner's objectives count little: they choose among motions of one duration.
    """
    options, tables, initial = context.options, setting.bases[0].tables, setting.initial[0]
    cost = cost_of(context.robot, initial, tables, options.objectives)
    share = options.search.share_in_shortest * initial.duration / max(cost, TINY)
    others = [(share * weight, objective) for weight, objective in options.objectives]
    objectives = ((1.0, Time()), *others)
    return replace(setting, naturalness=0.0, objectives=objectives, is_timed=True, is_shortest=True)


def scaled_duration(
    context: Context, request: Request, basis: MotionBasis, *, is_timed: bool
) -> float:
    """The expected duration, longer if the expected motion exceeds limits otherwise [s].

    With a margin, unless it is an unknown of the program, which keeps the limits itself.
    """
    usual, search = request.duration, context.options.search
    states = node_states(expected_motion(request, [basis], [usual])[0], basis.tables)
    margin = 1.0 if is_timed else search.scaling_margin
    stretch = margin * least_stretch(context.robot, context.limits, states)
    most = min(search.max_stretch, context.longest / usual)
    return usual * stretch if 1.0 < stretch <= most else usual
