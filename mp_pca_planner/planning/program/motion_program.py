# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The nonlinear program of a motion: terms and constraints of its segments, stacked.

The unknowns of neighbours meet at their target: its position if it is a pose, its velocity and
acceleration unless the motion stops there, and the time at which it is passed. With passing times
as unknowns, fixed sums of durations need no constraint.

The solver enforces limits at the points of a grid, and clearances of pairs of links that collided
before. The validator checks the motion on a denser grid. If it finds a violation, constraints are
refined, and the solver continues from its last solution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from operator import attrgetter, is_

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...motion.goal import JointState
from ..motion import Motion
from ..request import Request
from .constraints import Clearance, Constraint, Findings, Linear
from .segment import END_SCALES, LOG_DURATION_SCALE, SegmentProgram


@dataclass(frozen=True, eq=False)
class Junction:
    """The start or a target: the state and time that adjacent segments share.

    Attributes
    ----------
    state : JointState
        Initial value of the state.
    time : float
        Initial value of the passing time [s].
    unit : float
        A typical duration [s], the unit of changes of times and derivatives.
    orders : tuple of int
        Orders of the derivatives that are unknowns; 0 is the position.
    time_is_free : bool
        Whether the time is an unknown.
    fixed_state : JointState or None
        The fixed part of the state, derivatives 0 where free; None if the position is free.
    """

    state: JointState
    time: float
    unit: float
    orders: tuple[int, ...]
    time_is_free: bool
    fixed_state: JointState | None

    @property
    def size(self) -> int:
        """Number of unknowns: those of the derivatives, then the time."""
        return len(self.orders) * self.state.positions.size + self.time_is_free

    def at(self, x: FloatArray) -> tuple[JointState, float]:
        """State and time [s]."""
        values, n = [*self.state.values], self.state.positions.size
        for k, order in enumerate(self.orders):
            unit = END_SCALES[order] / self.unit**order
            values[order] = values[order] + unit * x[k * n : (k + 1) * n]
        time = self.time + self.time_unit * float(x[-1]) if self.time_is_free else self.time
        return JointState(self.state.joint_names, *values), time

    @property
    def time_unit(self) -> float:
        """Usual change of the time [s]."""
        return LOG_DURATION_SCALE * self.unit


def junctions_of(request: Request, initial: Sequence[Motion]) -> tuple[Junction, ...]:
    """The junctions of a request, with initial values of a motion."""
    ends = np.cumsum([0.0, *map(attrgetter("duration"), initial)])
    start = initial[0].start
    found = [Junction(start, 0.0, 1.0, (), False, start)]
    for group, _ in request.groups:
        for i in group:
            segment, goal = request.segments[i], initial[i].goal
            orders = (*([] if segment.pose is None else [0]), *([] if segment.stops else [1, 2]))
            unit = float(np.diff(ends[i : i + 3]).mean())
            fixed: JointState | None = goal
            if orders:
                fixed = None if 0 in orders else JointState(goal.joint_names, goal.positions)
            found.append(Junction(goal, float(ends[i + 1]), unit, orders, i != group[-1], fixed))
    return tuple(found)


class Chain:
    """The unknowns of several segments between junctions.

    These are the weights of the first segment, the first target, the weights of the second segment,
    and so on.

    Parameters
    ----------
    junctions : sequence of Junction
        The start and the targets.
    segments : sequence of SegmentProgram
        The segments, with the free rows and the free durations of the junctions.

    Attributes
    ----------
    slices : tuple of slice
        The unknowns on which each segment depends.
    start : array, shape (n,)
        Unknowns of the expected weights and of the initial junctions.
    """

    def __init__(self, junctions: Sequence[Junction], segments: Sequence[SegmentProgram]) -> None:
        self._junctions, self._segments = junctions, segments
        self._where, self._own, at = [slice(0, 0)], list[slice](), 0
        for junction, segment in zip(junctions[1:], segments, strict=True):
            first = at + segment.unknowns.n_weights
            self._own.append(slice(at, first))
            self._where.append(slice(first, first + junction.size))
            at = first + junction.size
        befores = self._where[:-1]
        self.slices = tuple(
            slice(before.start, after.stop)
            for before, after in zip(befores, self._where[1:], strict=True)
        )
        self.start = np.zeros(at)
        for own, segment in zip(self._own, segments, strict=True):
            self.start[own] = segment.expected[: segment.unknowns.n_weights]

    def states(self, x: FloatArray) -> list[tuple[JointState, float]]:
        """States and times of the junctions, see :meth:`Junction.at`."""
        pairs = zip(self._junctions, self._where, strict=True)
        return [junction.at(x[where]) for junction, where in pairs]

    def weights(self, x: FloatArray) -> list[FloatArray]:
        """Weights of the segments."""
        pairs = zip(self._own, self._segments, strict=True)
        return [x[own] * segment.unknowns.scales[: own.stop - own.start] for own, segment in pairs]

    def parts(self, x: FloatArray) -> list[tuple[FloatArray, FloatArray]] | None:
        """Each segment's unknowns, and their derivatives by its slice of x.

        None if a duration is out of range.
        """
        parts = []
        for i, ((_, began), (_, ended)) in enumerate(pairwise(self.states(x))):
            unknowns, own, where = self._segments[i].unknowns, self._own[i], self.slices[i]
            n, row = unknowns.n_joints, unknowns.n_weights
            if not unknowns.accepts(ended - began):
                return None
            local = np.zeros(unknowns.scales.size)
            jacobian = np.zeros((local.size, where.stop - where.start))
            local[:row] = x[own]
            jacobian[:row, own.start - where.start : own.stop - where.start] = np.eye(row)
            for side, sign in ((0, -1.0), (1, 1.0)):
                junction = self._junctions[i + side]
                column = self._where[i + side].start - where.start
                for order in junction.orders:
                    factor = (unknowns.duration / junction.unit) ** order
                    local[row : row + n] = factor * x[where][column : column + n]
                    jacobian[row : row + n, column : column + n] = factor * np.eye(n)
                    row, column = row + n, column + n
                if junction.time_is_free:
                    local[-1] = unknowns.log_duration_unknown(ended - began)
                    by_time = 1.0 / ((ended - began) * unknowns.log_duration_slope(local))
                    jacobian[-1, column] = sign * by_time * junction.time_unit
            parts.append((local, jacobian))
        return parts


class MotionProgram:
    """A compiled request, a nonlinear program (see :mod:`.solver`).

    Parameters
    ----------
    segments : sequence of SegmentProgram
        The segments with their costs and targets.
    constraints : sequence of (sequence of Constraint)
        The constraints of each segment.
    links : Chain, optional
        What the unknowns of several segments share; none for one segment.
    starts : sequence of (array, shape (n,))
        Unknowns to start from, the cheapest first.

    Attributes
    ----------
    lower, upper : array, shape (n_inequalities,)
        Bounds of the inequalities, segment after segment; may be infinite.
    """

    def __init__(
        self,
        segments: Sequence[SegmentProgram],
        constraints: Sequence[Sequence[Constraint]],
        links: Chain | None = None,
        starts: Sequence[FloatArray] = (),
    ) -> None:
        self.segments, self.constraints = segments, constraints
        self.links, self.starts = links, starts
        size = segments[0].unknowns.scales.size
        self.slices = (slice(0, size),) if links is None else links.slices
        lower, upper, self.has_clearances = [np.zeros(0)], [np.zeros(0)], False
        for one in chain.from_iterable(constraints):
            lower.append(one.lower)
            upper.append(one.upper)
            self.has_clearances |= isinstance(one, Clearance) and one.lower.size > 0
        self.lower, self.upper = np.concatenate(lower), np.concatenate(upper)

    def parts(self, x: FloatArray) -> Sequence[tuple[FloatArray, FloatArray | None]] | None:
        """Each segment's unknowns, and their derivatives by its slice of x (None: the identity).

        None if a duration is out of range.
        """
        return [(x, None)] if self.links is None else self.links.parts(x)

    def evaluate(self, x: FloatArray) -> MotionPoint:
        """Objective and constraints at x; the cost is NaN if there is no motion."""
        parts, cost, gradient = self.parts(x), 0.0, np.zeros(x.size)
        hessian, inequalities = np.zeros((x.size, x.size)), np.zeros(self.lower.size)
        errors, slopes, linear, first = [np.zeros(0)], [np.zeros((0, x.size))], [], 0
        for i, (own, by_x) in enumerate(parts or ()):
            segment, where = self.segments[i], self.slices[i]
            course, (natural, pull) = segment.at(own), segment.naturalness(own)
            by_own, curved = course.gradient + pull, course.hessian + segment.precision
            if by_x is not None:
                by_own, curved = by_own @ by_x, by_x.T @ curved @ by_x
            cost += course.cost + natural
            gradient[where] += by_own
            hessian[where, where] += curved
            for constraint in self.constraints[i]:
                if constraint.lower.size:
                    at = constraint.at(course)
                    rows = slice(first, first + at.values.size)
                    inequalities[rows] = at.values
                    linear.append((where, by_x, rows, at))
                    first = rows.stop
            if segment.target is not None:
                missed, of_target = segment.target.equations(own)
                errors.append(missed)
                slopes.append(np.zeros((missed.size, x.size)))
                slopes[-1][:, where] = of_target if by_x is None else of_target @ by_x
        cost = float("nan") if parts is None else cost
        equalities, equality_rows = np.concatenate(errors), np.concatenate(slopes)
        return MotionPoint(
            cost,
            gradient,
            hessian,
            inequalities,
            self.lower,
            self.upper,
            equalities,
            equality_rows,
            tuple(linear),
        )

    def equalities_at(self, x: FloatArray) -> FloatArray:
        """Errors of the targets alone [m, rad]; infinite if there is no motion."""
        parts, errors = self.parts(x), [np.zeros(0)]
        if parts is None:
            return np.full(1, np.inf)
        for segment, (own, _) in zip(self.segments, parts, strict=True):
            if segment.target is not None:
                errors.append(segment.target.equations(own)[0])
        return np.concatenate(errors)

    def refined(self, found: Sequence[Findings], violates: bool) -> MotionProgram:
        """The program with constraints refined after a check; itself if nothing was found.

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
        for part, before in zip(refined, self.constraints, strict=True):
            if not all(map(is_, part, before)):
                return self.constrained(refined)
        return self

    def constrained(self, constraints: Sequence[Sequence[Constraint]]) -> MotionProgram:
        """The same with other constraints."""
        return MotionProgram(self.segments, constraints, self.links, self.starts)


@dataclass(frozen=True, eq=False)
class MotionPoint:
    """Everything about a program at one x of n unknowns.

    Attributes
    ----------
    cost : float
        The objective; NaN if there is no motion.
    gradient : array, shape (n,)
        Its gradient.
    hessian : array, shape (n, n)
        The part of its Hessian that is known: RᵀR of sums of squares, exact Hessians of quadratic
        terms. The solver estimates the rest, the curvature of the constraints included, from the
        gradients.
    inequalities : array, shape (n_inequalities,)
        Values of the constraints; there may be thousands.
    lower, upper : array, shape (n_inequalities,)
        Their bounds.
    equalities : array, shape (n_equalities,)
        Errors of the targets, fewer than unknowns.
    equality_rows : array, shape (n_equalities, n)
        Their derivatives.
    linear : tuple
        For each constraint that has values: the unknowns of its segment, their derivatives by these
        (None: the identity), the place of the values, and the values with their derivatives.
    """

    cost: float
    gradient: FloatArray
    hessian: FloatArray
    inequalities: FloatArray
    lower: FloatArray
    upper: FloatArray
    equalities: FloatArray
    equality_rows: FloatArray
    linear: tuple[tuple[slice, FloatArray | None, slice, Linear], ...]

    def inequality_rows(
        self, chosen: NDArray[np.intp], bounds: FloatArray | None = None
    ) -> FloatArray:
        """Derivatives of the chosen inequalities, shape (n_chosen, n).

        With bounds of them, shape (n_chosen,), derivatives such that steps within these bounds to
        first order are within them altogether, where a constraint can provide them.
        """
        rows = np.zeros((chosen.size, self.gradient.size))
        for where, by_x, at_rows, at in self.linear:
            own = (chosen >= at_rows.start) & (chosen < at_rows.stop)
            if own.any():
                there = None if bounds is None else bounds[own]
                part = at.rows(chosen[own] - at_rows.start, there)
                rows[own, where] = part if by_x is None else part @ by_x
        return rows

    def inequalities_after(self, step: FloatArray) -> FloatArray:
        """Prediction of all of them after a step, correct to first order."""
        after = np.empty(self.inequalities.size)
        for where, by_x, rows, at in self.linear:
            after[rows] = at.after(step[where] if by_x is None else by_x @ step[where])
        return after
