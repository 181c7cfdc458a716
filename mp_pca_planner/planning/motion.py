# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A continuous motion, q(s) = h(s) + μ(s) + Σ wₖ φₖ(s) with its duration, and its cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from ..arrays import FloatArray, float_array
from ..exceptions import GoalError
from ..motion.goal import JointState
from ..motion.interpolation import boundary_values, hermite_functions, quintics
from ..primitives.basis import Basis
from ..robot.model import Robot
from .objectives import Nodes, Objective

N_RATES = 4
"""Positions, velocities, accelerations and jerks."""
N_NODES = 28
"""Usual number of quadrature nodes."""
# With six nodes in each piece of a spline, the error of the integral is at most 0.02 %, even for
# strongly oscillating motions (benchmarks/planning_speed.py).
_MIN_NODES_PER_PIECE = 6
# Points of the grid of the limits. Peaks of accelerations are bounded to about 0.1 %.
N_LIMIT_POINTS = 150
# Distance of the first and last point from the ends of the motion, as a share of the duration.
_INSIDE = 1e-6
# Share of Chebyshev's points in the grid, 0 to 1; the rest is even. Polynomials change fastest near
# their ends. With this share, 150 points bound motions as tightly as 200 even ones.
_CHEBYSHEV = 0.35


class Tables:
    """Tables of a basis.

    Parameters
    ----------
    basis : Basis
        The basis of shapes.
    n_nodes : int
        Gauss–Legendre nodes in all, shared evenly by the smooth pieces of the basis; at least
        six in each piece.

    Attributes
    ----------
    n_nodes : int
        Number of nodes.
    phases : array, shape (n_nodes,)
        Phases of the nodes.
    quadrature : array, shape (n_nodes,)
        Quadrature weights; they add up to 1.
    hermite : array, shape (4, n_nodes + 2, 6)
        Quintic Hermite functions and their first three derivatives by phase, at phase 0, at the
        nodes and at phase 1.
    values : array, shape (4, n_nodes + 2, n_joints, 1 + n_weights)
        The same of the mean shape and the basis functions.
    """

    def __init__(self, basis: Basis, n_nodes: int = N_NODES) -> None:
        edges = basis.breakpoints
        per_piece = max(int(np.ceil(n_nodes / (len(edges) - 1))), _MIN_NODES_PER_PIECE)
        x, w = _gauss_legendre(per_piece)
        widths = np.diff(edges)[:, None]
        inside = (edges[:-1, None] + widths * (x + 1.0) / 2.0).ravel()
        phases = np.concatenate([[0.0], inside, [1.0]])
        self.basis, self.phases, self.n_nodes = basis, inside, inside.size
        self.quadrature = (widths * w / 2.0).ravel()
        self.hermite = hermite_tables(phases.tobytes())
        self.values = basis.tables(phases, N_RATES - 1)
        self._on_grid: dict[int, FloatArray] = {}

    def on_grid(
        self, orders: NDArray[np.intp], joints: NDArray[np.intp]
    ) -> tuple[FloatArray, FloatArray]:
        """Bounds of the peaks of states around the points of the grid, see :func:`limit_phases`.

        The tables are computed when limits become constraints, because those of a basis with its
        own time scaling are never used by another request.

        Parameters
        ----------
        orders, joints : array of int, shape (n_rows,)
            Order of the derivative of each state, and its joint.

        Returns
        -------
        hermite : array, shape (n_rows, n_points, 6)
            Hermite functions, or their derivatives.
        shapes : array, shape (n_rows, n_points, 1 + n_weights)
            The mean shape and the basis functions, or their derivatives.
        """
        phases, highest = limit_phases(), int(orders.max())
        if highest not in self._on_grid:
            self._on_grid[highest] = _peaks(self.basis.tables(phases, highest), phases)
        return _hermite_peaks(phases.tobytes())[orders], self._on_grid[highest][orders, :, joints]

    def from_nodes(self) -> FloatArray:
        """Matrix from values at the nodes to the same bounds, shape (n_points, n_nodes)."""
        edges = self.basis.breakpoints
        return _interpolation(self.phases.tobytes(), edges.tobytes(), limit_phases().tobytes())


@lru_cache(maxsize=1)
def limit_phases() -> FloatArray:
    """Phases at which limits are constraints, denser near the ends, shape (n_points,)."""
    even = np.linspace(0.0, 1.0, N_LIMIT_POINTS)
    chebyshev = 0.5 - 0.5 * np.cos(np.pi * even)
    # Just inside the ends: only jerks are free there, and they are often largest there.
    return np.clip(even + _CHEBYSHEV * (chebyshev - even), _INSIDE, 1.0 - _INSIDE)


def _peaks(values: FloatArray, phases: FloatArray) -> FloatArray:
    """Values at points, shape (n, n_points, ...), as bounds of peaks between them.

    A parabola whose largest value at three points is the middle one has its vertex within half a
    step of that, and rises above it by at most |second derivative| · step² / 8. This is linear in
    the values; it lowers least values as much.
    """
    steps = np.diff(phases).reshape(-1, *(1,) * (values.ndim - 2))
    before, after = steps[:-1], steps[1:]
    slopes = values[:, 1:] - values[:, :-1]
    slopes /= steps
    bend = slopes[:, 1:] - slopes[:, :-1]
    bend *= np.maximum(before, after) ** 2 / (4.0 * (before + after))
    peaks = values.copy()
    peaks[:, 1:-1] -= bend
    return peaks


@lru_cache(maxsize=64)
def hermite_tables(phases: bytes) -> FloatArray:
    """Quintic Hermite functions and their first three derivatives, shape (4, n_phases, 6)."""
    return np.array([hermite_functions(np.frombuffer(phases), d) for d in range(N_RATES)])


@lru_cache(maxsize=64)
def _gauss_legendre(n_nodes: int) -> tuple[FloatArray, FloatArray]:
    return legendre.leggauss(n_nodes)


@lru_cache(maxsize=16)
def _hermite_peaks(phases: bytes) -> FloatArray:
    return _peaks(hermite_tables(phases), np.frombuffer(phases))


@lru_cache(maxsize=16)
def _interpolation(nodes: bytes, breakpoints: bytes, points: bytes) -> FloatArray:
    """Matrix from values at nodes to those of the polynomials through them, piece by piece.

    To bounds of peaks, see :func:`_peaks`.
    """
    # Imported late for a fast start of the node.
    from scipy.interpolate import BarycentricInterpolator

    known, edges, asked = (np.frombuffer(x) for x in (nodes, breakpoints, points))
    matrix = np.zeros((asked.size, known.size))
    piece_of_node, piece_of_point = (np.searchsorted(edges[1:-1], x) for x in (known, asked))
    for piece in range(edges.size - 1):
        of_nodes = np.flatnonzero(piece_of_node == piece)
        of_points = np.flatnonzero(piece_of_point == piece)
        lagrange = BarycentricInterpolator(known[of_nodes], np.eye(of_nodes.size))
        matrix[np.ix_(of_points, of_nodes)] = lagrange(asked[of_points])
    return np.asarray(_peaks(matrix[None], asked)[0])


@dataclass(frozen=True, eq=False)
class Motion:
    """A continuous motion between two states.

    Attributes
    ----------
    start, goal : JointState
        States at the ends, of the same n_joints joints.
    duration : float
        Duration T [s].
    basis : Basis
        The basis of shapes.
    weights : array, shape (n_weights,)
        Weights of its functions.
    """

    start: JointState
    goal: JointState
    duration: float
    basis: Basis
    weights: FloatArray

    @cached_property
    def boundary(self) -> FloatArray:
        """Boundary values with respect to phase, shape (6, n_joints)."""
        return boundary_values(self.start.values, self.goal.values, self.duration)

    def evaluate(self, times: FloatArray) -> FloatArray:
        """Positions, velocities and accelerations.

        Parameters
        ----------
        times : array, shape (n_steps,)
            Times from 0 to `duration` [s].

        Returns
        -------
        states : array, shape (3, n_steps, n_joints)
            [rad or m], [/s], [/s²]. At the ends they equal those of `start` and `goal` exactly,
            because a controller rejects a final velocity of 1e-17.

        Raises
        ------
        GoalError
            If the times are not numbers.
        """
        times = float_array(times, "times [s]", GoalError, (None,))
        phases = np.clip(times / self.duration, 0.0, 1.0)
        states = self._at(phases)
        for phase, end in ((0.0, self.start), (1.0, self.goal)):
            states[:, phases == phase] = np.array(end.values)[:, None]
        return states

    def _at(self, phases: FloatArray) -> FloatArray:
        states = quintics(phases, self.boundary, 2)
        states += self.basis.shapes(self.weights, phases, 2)
        states[1] /= self.duration
        states[2] /= self.duration**2
        return states


def samples_of(motion: Motion, period: float) -> tuple[FloatArray, FloatArray]:
    """Evenly spaced times from 0 to the duration, at most `period` apart [s], and the states.

    Returns
    -------
    times : array, shape (n_steps,)
        [s].
    states : array, shape (3, n_steps, n_joints)
        See :meth:`Motion.evaluate`.
    """
    n_steps = max(math.ceil(motion.duration / period - 1e-9), 1)
    phases = np.linspace(0.0, 1.0, n_steps + 1)
    states = motion._at(phases)
    for i, end in ((0, motion.start), (-1, motion.goal)):
        states[:, i] = end.values
    return motion.duration * phases, states


def rank_of(cost: float) -> float:
    """The cost in a ranking: a cost that is not a number counts as infinite."""
    return float("inf") if np.isnan(cost) else cost


def cost_of(
    robot: Robot,
    motion: Motion,
    tables: Tables,
    objectives: Sequence[tuple[float, Objective]],
) -> float:
    """Weighted sum of the objectives of a motion on the tables of its basis."""
    q, v, a, jerk = node_states(motion, tables)[:, 1:-1]
    tau = robot.inverse_dynamics(q, v, a)
    nodes = Nodes(robot, q, v, a, jerk, tau, motion.start.positions, motion.goal.positions)
    squares = sum(
        weight * np.sum(objective(nodes).values ** 2, axis=1) for weight, objective in objectives
    )
    return float(0.5 * motion.duration * tables.quadrature @ squares)


def node_states(motion: Motion, tables: Tables) -> FloatArray:
    """Positions to jerks at the start, the nodes and the goal, shape (4, n_nodes + 2, n_joints)."""
    shapes = tables.values @ np.concatenate([[1.0], motion.weights])
    by_phase = tables.hermite @ motion.boundary + shapes
    return np.asarray(by_phase / motion.duration ** np.arange(4.0)[:, None, None])
