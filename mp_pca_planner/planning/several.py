# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions through several targets, joined to the second derivative.

Between targets, each segment is a motion q(s) = h(s) + μ(s) + Σ wₖ φₖ(s) of the primitive whose
demonstrations are nearest. *In real time*, nothing is optimised: the segments have the expected
weights and durations (see :mod:`.sequence_request`). *Optimal*: the weights, the velocities and
accelerations at the targets, and the passing times of all segments are optimised together. The cost
is the sum of the objectives and the naturalness of each segment: its distance from the segment
joined in real time, in standard deviations of the demonstrations (see :mod:`.chain`).
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

from .attempt import Attempt, attempt, checked
from .bases import MotionBasis
from .budget import Budget
from .fallback import Fallback, FallbackPlanner
from .plan import OPTIMAL, REAL_TIME, MotionSolution
from .problem import ChainProblem
from .request import Request
from .sequence_request import SequenceRequest, passing_phases
from .setup import Setup
from .single import BasisChooser
from .verdict import Planned


class SeveralPlanner:
    """Plans motions through several targets.

    Parameters
    ----------
    setup, fallback, chooser
        Components of the planner.
    """

    def __init__(self, setup: Setup, fallback: FallbackPlanner, chooser: BasisChooser) -> None:
        self._setup, self._fallback, self._chooser = setup, fallback, chooser

    def serve(self, request: SequenceRequest, mode: str, budget: Budget) -> Planned:
        """The best motion for a request.

        Parameters
        ----------
        request : SequenceRequest
            The request.
        mode : {'real_time', 'optimal'}
            Whether to optimise. If that finds no valid motion, the one joined in real time is
            returned; if that is not valid either, one that rests at each target.
        budget : Budget
            The time for it.
        """
        bases = self.bases(request)
        best = self._joined(request, bases, budget)
        improved = None
        if mode == OPTIMAL:
            improved = attempt(ChainProblem(self._setup, request, bases, best.motions), budget)
            if improved.is_valid:
                return Planned(improved, Fallback(), False, mode=OPTIMAL)
            unknown = MotionSolution.unknown(improved.solution.iterations)
            best = replace(best, solution=unknown)
        if best.is_valid:
            return Planned(best, Fallback(), False, mode=REAL_TIME, improved=improved)
        ran_out = budget.is_over()
        fallback = self._fallback.serve_sequence(request, best, budget)
        hint = self._fallback.hint
        return Planned(fallback.attempt or best, fallback, ran_out, mode=REAL_TIME, hint=hint)

    def bases(self, request: SequenceRequest) -> tuple[MotionBasis, ...]:
        """The basis of each segment."""
        bases = []
        for (here, there), selection in zip(
            pairwise(request.states), request.selections, strict=True
        ):
            first = selection.first
            segment = Request(
                selection, first.primitive, here, there, None, (), True, first.expected
            )
            bases.append(self._chooser.narrowest(segment, is_paced=False))
        return tuple(bases)

    def _joined(
        self, request: SequenceRequest, bases: tuple[MotionBasis, ...], budget: Budget
    ) -> Attempt:
        """Lengthen free durations, and lower passing velocities, until the limits are kept."""
        durations, best = list(request.durations), None
        search = self._setup.options.search
        for share in search.passing_shares:
            for _ in range(search.max_stretches):
                motions = request.concatenate(bases, durations, share)
                phases = passing_phases(durations)
                unknown = MotionSolution.unknown()
                found = checked(self._setup, request, bases, motions, unknown, phases)
                if best is None or found.violation < best.violation:
                    best = found
                if not found.check.violations or budget.is_over():
                    return best
                longer = request.stretched(found.check, durations, search.max_stretch)
                if longer == durations or sum(longer) > self._setup.longest:
                    break
                durations = longer
        assert best is not None
        return best
