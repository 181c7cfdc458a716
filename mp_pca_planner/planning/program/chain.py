# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The unknowns that the segments of a motion share.

The unknowns of neighbours meet at their target: its position if it is a pose, its velocity and
acceleration unless the motion stops there, and the time at which it is passed. With passing times
as unknowns, fixed sums of durations need no constraint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...arrays import FloatArray
from ...motion.goal import JointState
from ..motion import Motion
from ..request import Request
from .segment import SegmentProgram
from .unknowns import END_SCALES, LOG_DURATION_SCALE


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
    """

    state: JointState
    time: float
    unit: float = 1.0
    orders: tuple[int, ...] = ()
    time_is_free: bool = False

    @property
    def fixed_state(self) -> JointState | None:
        """The fixed part of the state, derivatives 0 where free; None if the position is free."""
        if 0 in self.orders:
            return None
        return (
            JointState(self.state.joint_names, self.state.positions) if self.orders else self.state
        )

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
    durations = np.array([motion.duration for motion in initial])
    ends = np.cumsum(durations)
    last_of_groups = [group[-1] for group, _ in request.groups]
    found = [Junction(initial[0].start, 0.0)]
    for i, (motion, segment) in enumerate(zip(initial, request.segments, strict=True)):
        orders = (*([] if segment.pose is None else [0]), *([] if segment.stops else [1, 2]))
        unit = float(durations[i : i + 2].mean())
        is_free = i not in last_of_groups
        found.append(Junction(motion.goal, float(ends[i]), unit, orders, is_free))
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
            if not self._segments[i].unknowns.accepts(ended - began):
                return None
            parts.append(self._part(i, x, ended - began))
        return parts

    def _part(self, i: int, x: FloatArray, duration: float) -> tuple[FloatArray, FloatArray]:
        unknowns, n = self._segments[i].unknowns, self._segments[i].unknowns.n_joints
        m, own, where = unknowns.n_weights, self._own[i], self.slices[i]
        local = np.zeros(unknowns.scales.size)
        jacobian = np.zeros((unknowns.scales.size, where.stop - where.start))
        local[:m] = x[own]
        jacobian[:m, own.start - where.start : own.stop - where.start] = np.eye(m)
        row = m
        for side, sign in ((0, -1.0), (1, 1.0)):
            junction = self._junctions[i + side]
            column = self._where[i + side].start - where.start
            for order in junction.orders:
                factor = (unknowns.duration / junction.unit) ** order
                local[row : row + n] = factor * x[where][column : column + n]
                jacobian[row : row + n, column : column + n] = factor * np.eye(n)
                row, column = row + n, column + n
            if junction.time_is_free:
                local[-1] = unknowns.log_duration_unknown(duration)
                by_time = 1.0 / (duration * unknowns.log_duration_slope(local))
                jacobian[-1, column] = sign * by_time * junction.time_unit
        return local, jacobian
