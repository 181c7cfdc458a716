# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The bases of a segment, from the narrowest to the widest.

All components of the primitive come first. Fewer components would keep motions nearer to the
demonstrations, but naturalness does so at a lower effort (benchmarks/families.py). Components with
B-splines follow, whose motions may be unlike the demonstrations, then B-splines alone.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.linalg import block_diag

from ...primitives.basis import BSplineBasis, SumBasis
from ...primitives.primitive import MovementPrimitive
from ..options import PlannerOptions
from ..request import Segment
from .bases import N_NEAREST, MotionBasis
from .path_basis import PathFollower
from .tables import Tables


class BasisStore:
    """The bases of segments, with the tables that are the same for all requests.

    Parameters
    ----------
    options : PlannerOptions
        Options of planning.
    """

    def __init__(self, options: PlannerOptions) -> None:
        self._options = options
        self._tables = lru_cache(options.search.n_kept_tables)(
            lambda primitive: Tables(primitive.basis, options.n_nodes)
        )
        self.follower = lru_cache(64)(lambda primitive: PathFollower(primitive, options))
        self._splines = lru_cache(8)(
            lambda n_joints: Tables(BSplineBasis(n_joints), options.n_nodes)
        )

    @property
    def n_widths(self) -> int:
        """Number of bases of a segment."""
        return 1 if self._options.basis == "bspline" else 3

    def basis(
        self,
        segment: Segment,
        width: int = 0,
        *,
        is_paced: bool = True,
        has_starts: bool = False,
    ) -> MotionBasis:
        """A basis of a segment.

        Parameters
        ----------
        segment : Segment
            The segment.
        width : int
            0: the components of the primitive (B-splines alone if the options say so); 1: with
            B-splines of every joint added; 2: B-splines alone, without a prediction.
        is_paced : bool
            Whether motions have the time scaling that is predicted.
        has_starts : bool
            Whether there are starts beside the expected weights.
        """
        primitive = segment.primitive
        if width == 2 or self._options.basis == "bspline":
            zero = np.zeros(self._splines(primitive.n_joints).basis.n_weights)
            tables = self._splines(primitive.n_joints)
            return MotionBasis(tables, zero, None, 0, (zero,))
        components = self._components(segment, is_paced=is_paced, has_starts=has_starts)
        return components if width == 0 else self._corrected(components, primitive)

    def _components(self, segment: Segment, *, is_paced: bool, has_starts: bool) -> MotionBasis:
        """The principal components of the primitive."""
        primitive, expected = segment.primitive, segment.expected
        ends = segment.start.positions, segment.goal.positions
        if is_paced and expected.pace.any():
            # The basis of a motion with its own time scaling is not known in advance.
            tables = Tables(primitive.paced_basis(*ends, expected.pace), self._options.n_nodes)
        else:
            tables = self._tables(primitive)
        starts = [expected.weights]
        if has_starts:
            starts.append(np.zeros_like(expected.weights))
            known = primitive.boundary_states[:, [0, 3]].reshape(len(primitive.weights), -1)
            distances = np.sum((known - np.concatenate(ends)) ** 2, axis=1)
            nearest = np.argsort(distances, kind="stable")[:N_NEAREST]
            starts += list(primitive.weights[nearest])
        n_components = len(expected.weights)
        return MotionBasis(
            tables, expected.weights, expected.precision, n_components, tuple(starts)
        )

    def _corrected(self, narrow: MotionBasis, primitive: MovementPrimitive) -> MotionBasis:
        """The components with B-splines of every joint added."""
        usual = float(np.sqrt(np.mean(primitive.fit_residual**2)))
        usual = max(usual, self._options.search.usual_correction)
        splines = BSplineBasis(primitive.n_joints)
        tables = Tables(SumBasis(narrow.tables.basis, splines, usual), self._options.n_nodes)
        none = np.zeros(splines.n_weights)
        assert narrow.precision is not None
        return MotionBasis(
            tables,
            np.append(narrow.expected, none),
            block_diag(narrow.precision, np.eye(splines.n_weights) / usual**2),
            narrow.n_components,
            tuple(np.append(start, none) for start in narrow.starts),
        )
