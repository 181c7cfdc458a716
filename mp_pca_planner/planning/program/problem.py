# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The nonlinear program of a motion: terms and constraints of its segments, stacked.

The solver enforces limits at the points of a grid, and clearances of pairs of links that collided
before. The validator checks the motion on a denser grid. If it finds a violation, constraints are
refined, and the solver continues from its last solution.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from .chain import Chain
from .clearance import Clearance
from .constraints import Constraint, Findings, Linear
from .segment import SegmentProgram
from .targets import PoseTarget
from .terms import Term


class Problem:
    """A compiled request (see :class:`.program.Program`).

    Parameters
    ----------
    segments : sequence of SegmentProgram
        The segments with their running costs.
    terms : sequence of (sequence of Term)
        Further terms of each segment.
    constraints : sequence of (sequence of Constraint)
        The constraints of each segment.
    targets : sequence of (PoseTarget or None)
        The pose at the end of each segment, if its goal positions are unknowns.
    links : Chain or None
        What the unknowns of several segments share; None for one segment.
    starts : sequence of (array, shape (n,))
        Unknowns to start from, the cheapest first.

    Attributes
    ----------
    lower, upper : array, shape (n_inequalities,)
        Bounds of the inequalities, segment after segment.
    """

    def __init__(
        self,
        segments: Sequence[SegmentProgram],
        terms: Sequence[Sequence[Term]],
        constraints: Sequence[Sequence[Constraint]],
        targets: Sequence[PoseTarget | None],
        links: Chain | None,
        starts: Sequence[FloatArray],
    ) -> None:
        self.segments, self.terms, self.targets = segments, terms, targets
        self.constraints, self.links, self.starts = constraints, links, starts
        size = segments[0].unknowns.scales.size
        self.slices = (slice(0, size),) if links is None else links.slices
        flat = [one for part in constraints for one in part]
        self.lower = np.concatenate([np.zeros(0), *(one.lower for one in flat)])
        self.upper = np.concatenate([np.zeros(0), *(one.upper for one in flat)])
        self.has_clearances = any(one.lower.size for one in flat if isinstance(one, Clearance))

    def parts(self, x: FloatArray) -> Sequence[tuple[FloatArray, FloatArray | None]] | None:
        """Each segment's unknowns, and their derivatives by its slice of x (None: the identity).

        None if a duration is out of range.
        """
        return [(x, None)] if self.links is None else self.links.parts(x)

    def evaluate(self, x: FloatArray) -> Point:
        """Objective and constraints at x; the cost is NaN if there is no motion."""
        return Point(self, x, self.parts(x))

    def equalities_at(self, x: FloatArray) -> FloatArray:
        """Errors of the targets alone."""
        parts = self.parts(x)
        assert parts is not None
        found = zip(self.targets, parts, strict=True)
        errors = [target.errors(own) for target, (own, _) in found if target is not None]
        return np.concatenate([np.zeros(0), *errors])

    def refined(self, found: Sequence[Findings], violates: bool) -> Problem:
        """The problem with constraints refined after a check; itself if nothing was found.

        Parameters
        ----------
        found : sequence of Findings
            What was found in each segment.
        violates : bool
            Whether limits are violated.
        """
        refined = [
            [constraint.refined(one) for constraint in part]
            for part, one in zip(self.constraints, found, strict=True)
        ]
        if violates:
            # A limit that is violated in one segment is likely to be violated in others, too.
            longer = np.zeros(len(refined[0]), dtype=bool)
            for part, before in zip(refined, self.constraints, strict=True):
                sizes = zip(part, before, strict=True)
                longer |= [new.lower.size > old.lower.size for new, old in sizes]
            refined = [
                [one.everywhere() if more else one for one, more in zip(part, longer, strict=True)]
                for part in refined
            ]
        pairs = zip(
            chain.from_iterable(refined), chain.from_iterable(self.constraints), strict=True
        )
        is_same = all(new is old for new, old in pairs)
        return self if is_same else self.constrained(refined)

    def constrained(self, constraints: Sequence[Sequence[Constraint]]) -> Problem:
        """The same with other constraints."""
        return Problem(
            self.segments, self.terms, constraints, self.targets, self.links, self.starts
        )


class Point:
    """A problem at one x (see :class:`.program.Point`).

    Attributes
    ----------
    cost : float
        The objective; NaN if there is no motion.
    gradient : array, shape (n,)
        Its gradient.
    hessian : array, shape (n, n)
        The part of its Hessian that is known.
    inequalities : array, shape (n_inequalities,)
        Values of the constraints.
    equalities : array, shape (n_equalities,)
        Errors of the targets.
    equality_rows : array, shape (n_equalities, n)
        Their derivatives.
    """

    def __init__(
        self,
        problem: Problem,
        x: FloatArray,
        parts: Sequence[tuple[FloatArray, FloatArray | None]] | None,
    ) -> None:
        self.cost, self.gradient, self._size = 0.0, np.zeros(x.size), x.size
        self.inequalities, self.equalities = np.zeros(problem.lower.size), np.zeros(0)
        self.equality_rows = np.zeros((0, x.size))
        self._linear: list[tuple[slice, FloatArray | None, slice, Linear]] = []
        self.hessian = np.zeros((x.size, x.size))
        if parts is None:
            self.cost = float("nan")
            return
        first, errors, slopes = 0, [self.equalities], [self.equality_rows]
        for i, (own, by_x) in enumerate(parts):
            segment, where = problem.segments[i], problem.slices[i]
            course, (cost, gradient, hessian) = segment.at(own)
            for term in problem.terms[i]:
                more = term.at(course)
                cost, gradient = cost + more.cost, gradient + more.gradient
                hessian = hessian + more.hessian
            if by_x is not None:
                gradient, hessian = gradient @ by_x, by_x.T @ hessian @ by_x
            self.cost += cost
            self.gradient[where] += gradient
            self.hessian[where, where] += hessian
            for constraint in problem.constraints[i]:
                if constraint.lower.size:
                    at = constraint.at(course)
                    rows = slice(first, first + at.values.size)
                    self.inequalities[rows] = at.values
                    self._linear.append((where, by_x, rows, at))
                    first = rows.stop
            if (target := problem.targets[i]) is not None:
                missed, by_own = target.equations(own)
                errors.append(missed)
                slopes.append(np.zeros((missed.size, x.size)))
                slopes[-1][:, where] = by_own if by_x is None else by_own @ by_x
        self.equalities, self.equality_rows = np.concatenate(errors), np.concatenate(slopes)

    def inequality_rows(
        self, chosen: NDArray[np.intp], bounds: FloatArray | None = None
    ) -> FloatArray:
        """Derivatives of the chosen inequalities, shape (n_chosen, n)."""
        rows = np.zeros((chosen.size, self._size))
        for where, by_x, at_rows, at in self._linear:
            own = (chosen >= at_rows.start) & (chosen < at_rows.stop)
            if own.any():
                there = None if bounds is None else bounds[own]
                part = at.rows(chosen[own] - at_rows.start, there)
                rows[own, where] = part if by_x is None else part @ by_x
        return rows

    def inequalities_after(self, step: FloatArray) -> FloatArray:
        """Their linear prediction."""
        after = np.empty(self.inequalities.size)
        for where, by_x, rows, at in self._linear:
            after[rows] = at.after(step[where] if by_x is None else by_x @ step[where])
        return after
