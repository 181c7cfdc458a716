# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Settings of attempts: what is chosen for one attempt; with the request, all that is compiled.

The first attempt at a request begins with its expected motion: segments with expected weights,
joined without optimisation. The boundary parts form the quintic spline of least jerk through the
targets (de Boor, "A Practical Guide to Splines", 1978: one banded system).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ...motion.goal import JointState
from ...motion.validation import LimitCheck
from ..context import Context
from ..motion import Motion, cost_of, node_states, rank_of
from ..objectives import Objective, time
from ..options import FREE, SHORTEST, SolverOptions
from ..request import Request
from ..solver import TINY
from ..time_scaling import least_stretch, slowdown
from .bases import MotionBasis

SCALING_MARGIN = 1.02
"""Factor on the duration at which the expected motion just keeps the limits at the nodes.

It is for the peaks between them.
"""

MAX_STRETCH = 10.0
"""Largest factor of a free duration where an attempt does not meet the limits."""

# Cost of the planner's objectives as a share of that of time, for the shortest duration.
_SHARE_IN_SHORTEST = 1e-3


@dataclass(frozen=True, eq=False)
class Setting:
    """Settings of an attempt.

    Attributes
    ----------
    bases : tuple of MotionBasis
        The bases of the segments.
    initial : tuple of Motion
        The expected motion, with its duration.
    naturalness : float
        Naturalness weight ρ.
    objectives : tuple of (float, Objective)
        Running costs and their weights.
    solver : SolverOptions
        Options of the solver.
    width : int
        Number of the basis, from the narrowest, see :meth:`.BasisStore.basis`.
    is_timed : bool
        Whether the duration of a single segment is an unknown.
    is_shortest : bool
        Whether the shortest duration is searched.
    """

    bases: tuple[MotionBasis, ...]
    initial: tuple[Motion, ...]
    naturalness: float
    objectives: tuple[tuple[float, Objective], ...]
    solver: SolverOptions = SolverOptions()
    width: int = 0
    is_timed: bool = False
    is_shortest: bool = False

    @property
    def duration(self) -> float:
        """Duration of the expected motion [s]."""
        return sum(motion.duration for motion in self.initial)


def first_setting(
    context: Context, request: Request, basis: MotionBasis, width: int = 0, *, shortest: bool
) -> Setting:
    """The setting of the first attempt at one segment, from the expected motion.

    A free duration is longer than expected if the motion exceeds limits otherwise, with a margin
    unless it is an unknown of the program, which keeps the limits itself.

    Parameters
    ----------
    context, request
        Of the planner; the request.
    basis : MotionBasis
        The basis of the segment.
    width : int
        Its number, see :meth:`.BasisStore.basis`.
    shortest : bool
        Whether the shortest duration is searched. The planner's objectives count little then: they
        choose among motions of one duration.
    """
    options, usual = context.options, request.duration
    is_timed = shortest or (request.duration_is_free and request.timing == FREE)
    expected = Motion(request.start, request.goal, usual, basis.tables.basis, basis.expected)
    if request.duration_is_free:
        margin = 1.0 if is_timed else SCALING_MARGIN
        states = node_states(expected, basis.tables)
        stretch = margin * least_stretch(context.robot, context.limits, states)
        if 1.0 < stretch <= min(MAX_STRETCH, context.longest / usual):
            expected = replace(expected, duration=usual * stretch)
    setting = Setting(
        (basis,),
        (expected,),
        request.naturalness,
        options.objectives,
        width=width,
        is_timed=is_timed,
    )
    if not shortest:
        return setting
    cost = cost_of(context.robot, expected, basis.tables, options.objectives)
    share = _SHARE_IN_SHORTEST * expected.duration / max(cost, TINY)
    others = [(share * weight, objective) for weight, objective in options.objectives]
    objectives = ((1.0, time), *others)
    return replace(setting, naturalness=0.0, objectives=objectives, is_shortest=True)


def expected_setting(context: Context, request: Request) -> Setting:
    """The setting of the first attempt at a request of one segment, with its narrowest basis."""
    shortest = request.duration_is_free and request.timing == SHORTEST
    basis = context.bases.basis(request.segments[0], request.naturalness, shortest=shortest)
    return first_setting(context, request, basis, shortest=shortest)


def expected_cost(context: Context, request: Request) -> float:
    """The objective of the expected motion of one segment, in the duration that limits allow.

    Near the demonstrations, it is within some percent of the cost of the motion that is planned.
    """
    setting = expected_setting(context, request)
    motion, tables = setting.initial[0], setting.bases[0].tables
    return rank_of(cost_of(context.robot, motion, tables, setting.objectives))


def lasting(setting: Setting, duration: float) -> Setting:
    """The setting with the expected motion of a given duration."""
    basis, motion = setting.bases[0], setting.initial[0]
    initial = Motion(motion.start, motion.goal, duration, basis.tables.basis, basis.expected)
    return replace(setting, initial=(initial,), is_timed=False)


def joined_motion(
    request: Request,
    bases: Sequence[MotionBasis],
    durations: Sequence[float],
    share: float = 1.0,
) -> tuple[Motion, ...]:
    """The expected motion of a sequence.

    Parameters
    ----------
    request : Request
        The request.
    bases : sequence of MotionBasis
        The bases of the segments.
    durations : sequence of float
        Durations of the segments [s].
    share : float
        Factor of the velocities and accelerations at targets that are passed.
    """
    ends = pairwise(_passing_states(request, durations, share))
    return tuple(
        Motion(here, there, float(duration), basis.tables.basis, basis.expected)
        for (here, there), duration, basis in zip(ends, durations, bases, strict=True)
    )


def _passing_states(request: Request, durations: Sequence[float], share: float) -> list[JointState]:
    """States at the start and at the targets, by splines between rests."""
    # Imported here, because the import is slow and a node may never need it.
    from scipy.interpolate import make_interp_spline

    segments, first = request.segments, request.start
    times = np.concatenate([[0.0], np.cumsum(durations)])
    places = np.array([first.positions, *(segment.goal.positions for segment in segments)])
    rest, rates = np.zeros_like(first.positions), np.zeros((2, *places.shape))
    rates[:, 0] = first.velocities, first.accelerations
    stops = np.flatnonzero([segment.stops for segment in segments])
    for i, j in pairwise([0, *(stops + 1)]):
        spline = make_interp_spline(
            times[i : j + 1],
            places[i : j + 1],
            k=5,
            bc_type=([(1, rates[0, i]), (2, rates[1, i])], [(1, rest), (2, rest)]),
        )
        for d in (1, 2):
            rates[d - 1, i + 1 : j] = share * spline.derivative(d)(times[i + 1 : j])
    return [JointState(first.joint_names, q, v, a) for q, v, a in zip(places, *rates, strict=True)]


def stretched(
    request: Request, check: LimitCheck, durations: Sequence[float], most: float
) -> list[float]:
    """Longer durations of the free groups in which a limit is violated.

    Parameters
    ----------
    request : Request
        The request.
    check : LimitCheck
        Check of the motion with these durations.
    durations : sequence of float
        The durations of the segments [s].
    most : float
        Largest factor on the predicted durations.
    """
    ends, longer = np.cumsum(durations), list(durations)
    for violation in check.violations:
        segment = min(int(np.searchsorted(ends, violation.time)), len(durations) - 1)
        group, is_fixed = next(one for one in request.groups if segment in one[0])
        if is_fixed or durations[segment] > most * request.segments[segment].duration:
            continue
        factor = slowdown([violation])
        for i in group:
            longer[i] = max(longer[i], durations[i] * factor)
    return longer
