# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The bases of a segment, from the narrowest to the widest, and those along paths.

All components of the primitive come first. Fewer components would keep motions nearer to the
demonstrations, but naturalness does so at a lower effort. Components with
B-splines follow, whose motions may be unlike the demonstrations, then B-splines alone. Where a
collision-free path is known, B-splines lead the primitive's motion along it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ...arrays import FloatArray
from ...lazy import LazyModule
from ...motion.goal import JointState
from ...motion.interpolation import quintics
from ...primitives.basis import BSplineBasis, SumBasis
from ...primitives.primitive import MovementPrimitive
from ..motion import Motion, Tables
from ..options import PlannerOptions
from ..request import Request, RequestSegment

linalg = LazyModule("scipy.linalg")

N_WIDTHS = 3
"""Number of bases of a segment, see :func:`segment_basis`."""

# Number of starts from demonstrations with similar ends.
_N_NEAREST = 3

NEAR_EXPECTED = 0.1
"""From this naturalness on, motions stay near the expected one.

One start is enough then, and the first attempt has only those limits in the program that the
expected motion comes near, none if it keeps them.
"""

MIN_NATURALNESS = 0.005
"""Least weight ρ of deviations from a path. Without it, the program takes too many passes."""

# Usual magnitude of the correction by B-splines [rad or m]; larger if the primitive fits worse.
_USUAL_CORRECTION = 0.02
# Control points of each joint's B-splines along paths, their deviation with the cost of naturalness
# [rad or m], and the phases between the ends at which they are fitted.
_N_CONTROL_POINTS, _PATH_SPREAD = 6, 0.3
_PATH_PHASES: FloatArray = np.linspace(0.0, 1.0, 80)[1:-1]
# Primitives whose tables stay in memory, those used last.
_N_KEPT_TABLES = 500


@dataclass(frozen=True, eq=False)
class MotionBasis:
    """A basis of motions and the distribution of its weights.

    Attributes
    ----------
    tables : Tables
        The basis at the quadrature nodes and on the grid of the limits.
    expected : array, shape (n_weights,)
        Expected weights ŵ.
    precision : array, shape (n_weights, n_weights), or None
        Λ⁻¹; None without a prediction.
    n_components : int
        Number of principal components, the first of the weights; others are of B-splines.
    starts : tuple of array
        Weights to start from; the expected ones come first.
    is_detour : bool
        Whether the expected weights are those of a motion along a collision-free path.
    """

    tables: Tables
    expected: FloatArray
    precision: FloatArray | None
    n_components: int
    starts: tuple[FloatArray, ...]
    is_detour: bool = False

    def motion(
        self,
        start: JointState,
        goal: JointState,
        duration: float,
        weights: FloatArray | None = None,
    ) -> Motion:
        """A motion with this basis, the expected one unless weights are given."""
        weights = self.expected if weights is None else weights
        return Motion(start, goal, float(duration), self.tables.basis, weights)


@lru_cache(_N_KEPT_TABLES)
def tables_of(primitive: MovementPrimitive) -> Tables:
    """The tables of a primitive's basis, without time scaling."""
    return Tables(primitive.basis)


@lru_cache(8)
def _spline_tables(n_joints: int) -> Tables:
    return Tables(BSplineBasis(n_joints))


def segment_basis(
    options: PlannerOptions, request: Request, segment: RequestSegment, width: int = 0
) -> MotionBasis:
    """A basis of a segment.

    Parameters
    ----------
    options : PlannerOptions
        Options of planning.
    request : Request
        The request. Motions of a sequence have no time scaling. Where a single motion may be far
        from the expected one, or is to be the shortest, its basis has several starts.
    segment : RequestSegment
        The segment.
    width : int
        Below `N_WIDTHS`. 0: the components of the primitive (B-splines alone if the options say
        so); 1: with B-splines of every joint added; 2: B-splines alone, without a prediction.
    """
    primitive, expected = segment.primitive, segment.expected
    if width == 2 or options.basis == "bspline":
        tables = _spline_tables(primitive.n_joints)
        zero = np.zeros(tables.basis.n_weights)
        return MotionBasis(tables, zero, None, 0, (zero,))
    ends = segment.start.positions, segment.goal.positions
    if not request.mode and expected.pace.any():
        # The basis of a motion with its own time scaling is not known in advance.
        tables = Tables(primitive.paced_basis(*ends, expected.pace))
    else:
        tables = tables_of(primitive)
    starts = [expected.weights]
    if not request.mode and (request.is_shortest or request.naturalness < NEAR_EXPECTED):
        starts.append(np.zeros_like(expected.weights))
        known = primitive.boundary_states[:, [0, 3]].reshape(len(primitive.weights), -1)
        distances = np.sum((known - np.concatenate(ends)) ** 2, axis=1)
        starts += list(primitive.weights[np.argsort(distances, kind="stable")[:_N_NEAREST]])
    weights, precision = expected.weights, expected.precision
    if width == 1:
        usual = max(float(np.sqrt(np.mean(primitive.fit_residual**2))), _USUAL_CORRECTION)
        splines = BSplineBasis(primitive.n_joints)
        tables = Tables(SumBasis(tables.basis, splines, usual))
        none = np.zeros(splines.n_weights)
        weights, *starts = (np.append(x, none) for x in (weights, *starts))
        precision = linalg.block_diag(precision, np.eye(none.size) / usual**2)
    return MotionBasis(tables, weights, precision, expected.weights.size, tuple(starts))


def basis_along(segment: RequestSegment, path: FloatArray, naturalness: float) -> MotionBasis:
    """The components and B-splines; a path takes the place of the prediction.

    Parameters
    ----------
    segment : RequestSegment
        The segment.
    path : array, shape (n_points, n_joints)
        Points with straight lines between them.
    naturalness : float
        ρ of the motion.
    """
    tables, fit = _path_tables(segment.primitive)
    natural, s = segment.expected, _PATH_PHASES
    n_components = natural.weights.size
    n_splines = tables.basis.n_weights - n_components
    weights = np.append(natural.weights, np.zeros(n_splines))
    line = Motion(segment.start, segment.goal, segment.duration, tables.basis, weights)
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    # Minimum jerk along the path.
    along = lengths[-1] * (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5)
    points = np.stack([np.interp(along, lengths, q) for q in path.T], axis=1)
    off = points - line.evaluate(s * line.duration)[0]
    weights = np.append(natural.weights, (fit @ off).T.ravel())
    # The path is no demonstration: it counts as little at any naturalness.
    share = MIN_NATURALNESS / max(naturalness, MIN_NATURALNESS)
    of_path = np.eye(n_splines) * (share / _PATH_SPREAD**2)
    precision = linalg.block_diag(natural.precision, of_path)
    return MotionBasis(tables, weights, precision, n_components, (weights,), is_detour=True)


def rates_along(segment: RequestSegment, basis: MotionBasis) -> FloatArray:
    """Derivatives by phase of the expected motion along a path.

    Velocities, accelerations and jerks, shape (3, n_phases, n_joints).
    """
    s = np.append(0.0, np.append(_PATH_PHASES, 1.0))
    line = basis.motion(segment.start, segment.goal, segment.duration)
    shapes = basis.tables.basis.shapes(basis.expected, s, 3)
    return np.asarray((quintics(s, line.boundary, 3) + shapes)[1:])


@lru_cache(64)
def _path_tables(primitive: MovementPrimitive) -> tuple[Tables, FloatArray]:
    """The basis of a primitive's motions along paths, and the fit of its B-splines to points.

    The fit has the shape (n_control_points, n_phases). All joints have the same splines.
    """
    splines = BSplineBasis(primitive.n_joints, _N_CONTROL_POINTS)
    basis = SumBasis(primitive.basis, splines, _PATH_SPREAD)
    fit = np.linalg.pinv(splines.functions(_PATH_PHASES)[:, 0, :_N_CONTROL_POINTS])
    return Tables(basis), np.asarray(fit)
