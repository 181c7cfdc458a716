# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Bases whose expected motion leads along a collision-free path.

B-splines lead the primitive's motion along the path.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from ...arrays import FloatArray
from ...primitives.basis import BSplineBasis, SumBasis
from ...primitives.boundary import quintics
from ...primitives.primitive import MovementPrimitive
from ..motion import Motion
from ..options import PlannerOptions
from ..request import Segment
from .bases import MotionBasis
from .tables import Tables


class PathFollower:
    """Motions of a primitive along paths.

    Parameters
    ----------
    primitive : MovementPrimitive
        The primitive.
    options : PlannerOptions
        Options of planning.
    """

    def __init__(self, primitive: MovementPrimitive, options: PlannerOptions) -> None:
        detours = options.detours
        least, self._spread = detours.min_naturalness, detours.spread
        # The path is no demonstration: it counts as little at any naturalness.
        self._share_of_path = least / max(options.naturalness, least)
        n = detours.n_control_points
        splines = BSplineBasis(primitive.n_joints, n)
        basis = SumBasis(primitive.basis, splines, detours.spread)
        self._tables, self._n_splines = Tables(basis, options.n_nodes), splines.n_weights
        self._phases = np.linspace(0.0, 1.0, detours.n_phases)[1:-1]
        # All joints have the same splines.
        self._fit = np.linalg.pinv(splines.functions(self._phases)[:, 0, :n])

    def basis(self, segment: Segment, path: FloatArray) -> MotionBasis:
        """The components and B-splines; the path takes the place of the prediction.

        Parameters
        ----------
        segment : Segment
            The segment.
        path : array, shape (n_points, n_joints)
            Points with straight lines between them.
        """
        natural, s = segment.expected, self._phases
        expected = np.append(natural.weights, np.zeros(self._n_splines))
        line = Motion(segment.start, segment.goal, segment.duration, self._tables.basis, expected)
        lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
        # Minimum jerk along the path.
        along = lengths[-1] * (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5)
        points = np.stack([np.interp(along, lengths, q) for q in path.T], axis=1)
        off = points - line.evaluate(s * line.duration)[0]
        weights = expected.copy()
        weights[natural.weights.size :] = (self._fit @ off).T.ravel()
        of_path = np.eye(self._n_splines) * (self._share_of_path / self._spread**2)
        precision = block_diag(natural.precision, of_path)
        n_components = natural.weights.size
        return MotionBasis(
            self._tables, weights, precision, n_components, (weights,), is_detour=True
        )

    def rates(self, segment: Segment, basis: MotionBasis) -> FloatArray:
        """Velocities, accelerations and jerks by phase, shape (3, n_phases, n_joints)."""
        s = np.append(0.0, np.append(self._phases, 1.0))
        line = Motion(
            segment.start, segment.goal, segment.duration, basis.tables.basis, basis.expected
        )
        shapes = basis.tables.basis.shapes(basis.expected, s, 3)
        return np.asarray((quintics(s, line.boundary, 3) + shapes)[1:])
