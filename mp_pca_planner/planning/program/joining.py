# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Expected motions: segments with expected weights, joined without optimisation.

The boundary parts form the quintic spline of least jerk through the targets (de Boor, "A Practical
Guide to Splines", 1978: one banded system).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ...motion.goal import JointState
from ...motion.validation import LimitCheck
from ..motion import Motion
from ..request import Request
from ..time_scaling import slowdown
from .bases import MotionBasis


def expected_motion(
    request: Request,
    bases: Sequence[MotionBasis],
    durations: Sequence[float],
    share: float = 1.0,
) -> tuple[Motion, ...]:
    """The expected motion of a request.

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
    ends = [request.start, request.goal]
    if not request.is_single:
        ends = _passing_states(request, durations, share)
    return tuple(
        Motion(here, there, float(duration), basis.tables.basis, basis.expected)
        for (here, there), duration, basis in zip(pairwise(ends), durations, bases, strict=True)
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
        factor = slowdown(LimitCheck((violation,)))
        for i in group:
            longer[i] = max(longer[i], durations[i] * factor)
    return longer
