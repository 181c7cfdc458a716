# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The program of a motion through several targets: a chain of programs that share unknowns.

Each segment is a program of its own (:mod:`.compiler`), whose boundary values and duration are
unknowns. In the chain the unknowns of neighbours meet at their target: its position if it is a
pose, its velocity and acceleration unless the motion stops there, and the time at which it is
passed. With passing times as unknowns, fixed sums of durations need no constraint. With coordinates
of the configurations that reach a pose, the pose needs no constraint.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..motion.goal import JointState
from .compiler import MotionProgram
from .conditions import PoseTarget
from .matrices import BlockMatrix, as_array
from .motion import Motion
from .program import Point, Program
from .sequence_request import SequenceRequest
from .unknowns import END_SCALES, LOG_DURATION_SCALE

# Steps of Newton's method from a configuration back to its pose, and the largest error left.
_MAX_RETURNS, _RETURNED = 20, 1e-10


class PoseChart:
    """Coordinates of the configurations near one that reach the same pose.

    Parameters
    ----------
    target : PoseTarget
        The pose.
    positions : array, shape (n_joints,)
        A configuration that reaches it.

    Attributes
    ----------
    size : int
        Number of coordinates.
    """

    def __init__(self, target: PoseTarget, positions: FloatArray) -> None:
        self._target, self._centre = target, positions
        _, singular, right = np.linalg.svd(target.error(positions)[1])
        rank = int(np.count_nonzero(singular > 1e-6 * singular[0]))
        self._across, self._along = right[:rank].T, END_SCALES[0] * right[rank:].T
        self.size = self._along.shape[1]

    def at(self, coordinates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The configuration and its derivative, shape (n_joints, size).

        Raises
        ------
        ArithmeticError
            If there is no such configuration nearby.
        """
        q = self._centre + self._along @ coordinates
        for _ in range(_MAX_RETURNS):
            error, rows = self._target.error(q)
            step, *_ = np.linalg.lstsq(rows @ self._across, error, rcond=None)
            if np.abs(error).max() <= _RETURNED:
                turned, *_ = np.linalg.lstsq(rows @ self._across, rows @ self._along, rcond=None)
                return q, self._along - self._across @ turned
            q = q - self._across @ step
        raise ArithmeticError(f"no configuration near {self._centre} reaches the pose")


@dataclass(frozen=True, eq=False)
class Junction:
    """The start or a target of a chain: the state and time that adjacent segments share.

    Attributes
    ----------
    state : JointState
        Initial value of the state.
    time : float
        Initial value of the passing time [s].
    unit : float
        A typical duration [s], the unit of changes of times and derivatives.
    moves : bool
        Whether velocity and acceleration are unknowns.
    time_is_free : bool
        Whether the time is an unknown.
    chart : PoseChart or None
        Coordinates of the position, if it is an unknown.
    """

    state: JointState
    time: float
    unit: float = 1.0
    moves: bool = False
    time_is_free: bool = False
    chart: PoseChart | None = None

    @property
    def fixed_state(self) -> JointState | None:
        """The fixed part of the state, derivatives 0 where free; None if the position is free."""
        if self.chart is not None:
            return None
        at_rest = JointState(self.state.joint_names, self.state.positions)
        return at_rest if self.moves else self.state

    @property
    def rows(self) -> list[int]:
        """Orders of the derivatives that are unknowns; 0 is the position."""
        return [0] * (self.chart is not None) + [1, 2] * self.moves

    @property
    def sizes(self) -> list[int]:
        """Number of unknowns of each of these derivatives."""
        n = self.state.positions.size
        own = [] if self.chart is None else [self.chart.size]
        return own + [n, n] * self.moves

    @property
    def size(self) -> int:
        """Number of unknowns: those of the derivatives, then the time."""
        return sum(self.sizes) + self.time_is_free

    def at(self, x: FloatArray) -> tuple[JointState, float, FloatArray]:
        """State, time [s], and the derivative of the positions by their coordinates."""
        state, n, first = self.state, self.state.positions.size, 0
        q, v, a, slope = state.positions, state.velocities, state.accelerations, np.zeros((n, 0))
        if self.chart is not None:
            first = self.chart.size
            q, slope = self.chart.at(x[:first])
        if self.moves:
            rates = x[first : first + 2 * n].reshape(2, n)
            v = v + END_SCALES[1] / self.unit * rates[0]
            a = a + END_SCALES[2] / self.unit**2 * rates[1]
        time = self.time + self.time_unit * float(x[-1]) if self.time_is_free else self.time
        return JointState(state.joint_names, q, v, a), time, slope

    @property
    def time_unit(self) -> float:
        """Usual change of the time [s]."""
        return LOG_DURATION_SCALE * self.unit


def junctions_of(request: SequenceRequest, joined: Sequence[Motion]) -> tuple[Junction, ...]:
    """The junctions of a request, with initial values of a motion joined without optimisation."""
    durations = np.array([motion.duration for motion in joined])
    ends = np.cumsum(durations)
    last_of_groups = {group[-1] for group, _ in request.groups}
    found = [Junction(joined[0].start, 0.0)]
    for i, (motion, target) in enumerate(zip(joined, request.targets, strict=True)):
        chart = None
        if isinstance(target, PoseTarget):
            chart = PoseChart(target, motion.goal.positions)
        found.append(
            Junction(
                motion.goal,
                float(ends[i]),
                float(durations[i : i + 2].mean()),
                not request.stops[i],
                i not in last_of_groups,
                chart,
            )
        )
    return tuple(found)


class ChainProgram:
    """Segments between junctions as one program (see :class:`.program.Program`).

    The unknowns are those of the first segment's weights, the first target, the second segment's
    weights, and so on.

    Parameters
    ----------
    junctions : sequence of Junction
        The start and the targets.
    programs : sequence of MotionProgram
        The segments, with the free rows and the free durations of the junctions.
    parts : sequence of Program
        The same with their inequalities.

    Attributes
    ----------
    lower, upper : array, shape (n_inequalities,)
        Bounds of the inequalities, segment after segment.
    """

    def __init__(
        self,
        junctions: Sequence[Junction],
        programs: Sequence[MotionProgram],
        parts: Sequence[Program],
    ) -> None:
        self._junctions, self._programs, self.parts = junctions, programs, parts
        self._where, self.slices, at = [slice(0, 0)], [], 0
        for junction, program in zip(junctions[1:], programs, strict=True):
            own = at + program.unknowns.n_weights
            self._where.append(slice(own, own + junction.size))
            self.slices.append(slice(self._where[-2].start, own + junction.size))
            at = own + junction.size
        self.size = at
        self.lower, self.upper = (
            np.concatenate([np.zeros(0), *(getattr(part, side) for part in parts)])
            for side in ("lower", "upper")
        )
        self.first = np.cumsum([0, *(part.lower.size for part in parts)])

    @property
    def start(self) -> FloatArray:
        """Unknowns of the expected weights and of the initial junctions."""
        x = np.zeros(self.size)
        for i, program in enumerate(self._programs):
            x[self._own(i)] = program.expected[: program.unknowns.n_weights]
        return x

    def _own(self, i: int) -> slice:
        """Slice of the weights of a segment in x."""
        return slice(self._where[i].stop, self._where[i + 1].start)

    def states(self, x: FloatArray) -> list[tuple[JointState, float, FloatArray]]:
        """States and times of the junctions, see :meth:`Junction.at`."""
        return [
            junction.at(x[where])
            for junction, where in zip(self._junctions, self._where, strict=True)
        ]

    def motions(self, x: FloatArray) -> tuple[Motion, ...]:
        """The segments that unknowns stand for."""
        motions = []
        for i, ((here, began, _), (there, ended, _)) in enumerate(pairwise(self.states(x))):
            unknowns, basis = self._programs[i].unknowns, self._programs[i].basis
            weights = x[self._own(i)] * unknowns.scales[: unknowns.n_weights]
            motions.append(Motion(here, there, ended - began, basis, weights))
        return tuple(motions)

    def locals(self, x: FloatArray) -> list[FloatArray]:
        """The unknowns of each segment."""
        pairs = enumerate(pairwise(self.states(x)))
        return [self._local(i, x, pair, pair[1][1] - pair[0][1])[0] for i, pair in pairs]

    def evaluate(self, x: FloatArray) -> Any:
        """Value and derivatives; the cost is NaN if a duration or a pose is out of range."""
        try:
            ends = self.states(x)
        except ArithmeticError:
            return NoPoint(self.lower.size)
        maps, points = [], []
        for i, pair in enumerate(pairwise(ends)):
            unknowns = self._programs[i].unknowns
            duration = pair[1][1] - pair[0][1]
            if not unknowns.accepts(duration):
                return NoPoint(self.lower.size)
            local, jacobian = self._local(i, x, pair, duration)
            maps.append(jacobian)
            points.append(self.parts[i].evaluate(local))
        return ChainAt(self, points, maps)

    def equalities_at(self, x: FloatArray) -> FloatArray:
        """No equalities: junctions are met by construction."""
        return np.zeros(0)

    def _local(
        self, i: int, x: FloatArray, ends: Sequence[tuple[Any, ...]], duration: float
    ) -> tuple[FloatArray, FloatArray]:
        """Unknowns of a segment, and their derivatives by its slice of x."""
        unknowns, n = self._programs[i].unknowns, self._junctions[0].state.positions.size
        m, own, where = unknowns.n_weights, self._own(i), self.slices[i]
        local = np.zeros(unknowns.scales.size)
        jacobian = np.zeros((unknowns.scales.size, where.stop - where.start))
        local[:m] = x[own]
        jacobian[:m, own.start - where.start : own.stop - where.start] = np.eye(m)
        row = m
        for side, sign in ((0, -1.0), (1, 1.0)):
            junction, (state, _, slope) = self._junctions[i + side], ends[side]
            column = self._where[i + side].start - where.start
            for order, size in zip(junction.rows, junction.sizes, strict=True):
                block = slice(row, row + n), slice(column, column + size)
                if order == 0:
                    local[block[0]] = (state.positions - junction.state.positions) / END_SCALES[0]
                    jacobian[block] = slope / END_SCALES[0]
                else:
                    factor = (unknowns.duration / junction.unit) ** order
                    local[block[0]] = factor * x[where][block[1]]
                    jacobian[block] = factor * np.eye(n)
                row, column = row + n, column + size
            if junction.time_is_free:
                local[-1] = unknowns.log_duration_unknown(duration)
                by_time = 1.0 / (duration * unknowns.log_duration_slope(local))
                jacobian[-1, column] = sign * by_time * junction.time_unit
        return local, jacobian


class NoPoint:
    """Unknowns without a motion: the cost is NaN, which the solver rejects."""

    def __init__(self, n_inequalities: int) -> None:
        self.cost = float("nan")
        self.inequalities, self.equalities = np.zeros(n_inequalities), np.zeros(0)


class ChainAt:
    """A chain at one x (see :class:`.program.ChainPoint`)."""

    def __init__(
        self, chain: ChainProgram, points: Sequence[Point], maps: Sequence[FloatArray]
    ) -> None:
        self._chain, self._points, self._maps = chain, points, maps
        self.cost = sum(point.cost for point in points)
        self.gradient = np.zeros(chain.size)
        for where, point, local in self._segments():
            self.gradient[where] += local.T @ point.gradient
        self.inequalities = np.concatenate([point.inequalities for point in points])
        self.equalities, self.equality_rows = np.zeros(0), np.zeros((0, chain.size))

    def _segments(self) -> Iterable[tuple[slice, Point, FloatArray]]:
        return zip(self._chain.slices, self._points, self._maps, strict=True)

    @cached_property
    def hessian(self) -> BlockMatrix:
        """The known part of the Hessian."""
        blocks = tuple(
            local.T @ as_array(point.hessian) @ local for _, point, local in self._segments()
        )
        return BlockMatrix(tuple(self._chain.slices), blocks)

    def inequality_rows(
        self, chosen: NDArray[np.intp], values: FloatArray | None = None
    ) -> FloatArray:
        """Derivatives of the chosen inequalities, shape (n_chosen, n)."""
        rows, first = np.zeros((chosen.size, self._chain.size)), self._chain.first
        for i, (where, point, local) in enumerate(self._segments()):
            own = (chosen >= first[i]) & (chosen < first[i + 1])
            if own.any():
                there = None if values is None else values[own]
                rows[own, where] = point.inequality_rows(chosen[own] - first[i], there) @ local
        return rows

    def inequalities_after(self, step: FloatArray) -> FloatArray:
        """Their linear prediction."""
        return np.concatenate(
            [
                point.inequalities_after(local @ step[where])
                for where, point, local in self._segments()
            ]
        )

    def lagrangian_gradients(
        self, sides: NDArray[np.intp], multipliers: FloatArray
    ) -> list[FloatArray]:
        """Each segment's part of the gradient of the Lagrangian."""
        signed = np.where(sides % 2, multipliers, -multipliers)
        parts, first = [], self._chain.first
        for i, (_, point, local) in enumerate(self._segments()):
            index = sides // 2 - first[i]
            own = (index >= 0) & (index < first[i + 1] - first[i])
            gradient = point.gradient
            if own.any():
                gradient = gradient + signed[own] @ point.inequality_rows(index[own])
            parts.append(np.asarray(gradient @ local))
        return parts
