# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The motion bases for a request, from the narrowest to the widest.

All components of the primitive come first. Fewer components would keep motions nearer to the
demonstrations, but naturalness does so at a lower effort (benchmarks/families.py). Components with
B-splines follow, whose motions may be unlike the demonstrations, then B-splines alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import block_diag

from ..arrays import FloatArray
from ..primitives.basis import Basis, BSplineBasis, SumBasis
from ..primitives.conditional_model import ConditionalDistribution
from ..primitives.primitive import MovementPrimitive
from .constraints import LimitTables
from .starts import StartPoint, WarmStarts
from .unknowns import QuadratureTables

# Usual magnitude of the correction by B-splines [rad or m]; larger if the primitive fits worse.
_USUAL_CORRECTION = 0.02


@dataclass(frozen=True, eq=False)
class MotionBasis:
    """A basis of motions and the distribution of its weights.

    Attributes
    ----------
    tables : QuadratureTables
        The basis at the quadrature nodes.
    limit_tables : LimitTables
        The basis on the grid on which limits are kept.
    expected : array, shape (n_weights,)
        Expected weights ŵ.
    precision : array, shape (n_weights, n_weights), or None
        Λ⁻¹; None without a prediction.
    n_components : int
        Number of principal components, the first of the weights.
    starts : callable
        Returns an iterator of the weights to start from, made as they are needed; the expected ones
        come first, but near a path.
    is_detour : bool
        Whether the expected weights are those of a motion along a collision-free path.
    """

    tables: QuadratureTables
    limit_tables: LimitTables
    expected: FloatArray
    precision: FloatArray | None
    n_components: int
    starts: Callable[[], Iterator[StartPoint]]
    is_detour: bool = False

    @property
    def basis(self) -> Basis:
        """The basis."""
        return self.tables.basis

    @property
    def is_corrected(self) -> bool:
        """Whether the basis includes B-splines."""
        return self.n_components < self.expected.size


def component_basis(
    tables: QuadratureTables,
    limit_tables: LimitTables,
    primitive: MovementPrimitive,
    expected: ConditionalDistribution,
    ends: FloatArray,
    warm_starts: WarmStarts | None = None,
) -> MotionBasis:
    """The principal components of a primitive.

    Parameters
    ----------
    tables, limit_tables
        Of its basis.
    primitive : MovementPrimitive
        The primitive.
    expected : ConditionalDistribution
        Prediction for the request.
    ends : array, shape (2 * n_joints,)
        Start and goal positions.
    warm_starts : WarmStarts, optional
        Starts from similar motions; the weights of the demonstrations unless given.
    """

    def starts() -> Iterator[StartPoint]:
        yield StartPoint(expected.weights)
        yield StartPoint(np.zeros_like(expected.weights))
        known = warm_starts
        if known is None:
            own = primitive.boundary_states[:, [0, 3]].reshape(len(primitive.weights), -1)
            known = WarmStarts(own, primitive.weights)
        yield from known.nearest(ends)

    return MotionBasis(
        tables, limit_tables, expected.weights, expected.precision, primitive.n_components, starts
    )


def corrected_basis(narrow: MotionBasis, primitive: MovementPrimitive, n_nodes: int) -> MotionBasis:
    """The components with B-splines of every joint added."""
    usual = max(float(np.sqrt(np.mean(primitive.fit_residual**2))), _USUAL_CORRECTION)
    splines = BSplineBasis(primitive.n_joints)
    tables = QuadratureTables(SumBasis(narrow.basis, splines, usual), n_nodes)
    correction = np.zeros(splines.n_weights)
    assert narrow.precision is not None
    return MotionBasis(
        tables,
        LimitTables(tables),
        np.append(narrow.expected, correction),
        block_diag(narrow.precision, np.eye(splines.n_weights) / usual**2),
        narrow.n_components,
        lambda: (StartPoint(np.append(start.unknowns, correction)) for start in narrow.starts()),
    )


def spline_basis(tables: QuadratureTables, limit_tables: LimitTables) -> MotionBasis:
    """B-splines alone, without a prediction."""
    zero = np.zeros(tables.basis.n_weights)
    return MotionBasis(tables, limit_tables, zero, None, 0, partial(iter, [StartPoint(zero)]))


def fixed_basis(tables: QuadratureTables) -> MotionBasis:
    """The basis of a motion without weights."""
    return MotionBasis(tables, LimitTables(tables), tables.basis.scales, None, 0, partial(iter, ()))
