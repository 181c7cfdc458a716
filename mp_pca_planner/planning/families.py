# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The families of motions among which a request is served, from the narrowest to the widest.

The components of the primitive come first, all of them: with fewer, motions are nearer to the
demonstrations, but naturalness brings them there for less effort (benchmarks/families.py). What
can't be done with them may be possible with B-splines added to them, at the price of what leaves
the demonstrations, and what can be done with B-splines alone is done with them in the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from ..arrays import FloatArray
from ..primitives.basis import Basis, BSplineBasis, SumBasis
from ..primitives.conditional_model import ConditionalDistribution
from ..primitives.primitive import MovementPrimitive
from .compiler import QuadratureTables
from .constraints import LimitTables
from .starts import Practice, Start

# What correcting splines may usually add [rad or m], unless the primitive itself is less exact.
_USUAL_CORRECTION = 0.02


@dataclass(frozen=True, eq=False)
class Family:
    """A basis and what is expected of its weights.

    Attributes
    ----------
    tables : QuadratureTables
        The basis at the quadrature nodes.
    limit_tables : LimitTables
        The basis on the grid on which limits are kept.
    expected : array, shape (n_weights,)
        Expected weights ŵ.
    precision : array, shape (n_weights, n_weights), or None
        Λ⁻¹; None where nothing is expected.
    starts : tuple of Start
        Weights to start from, the expected ones first.
    n_components : int
        Number of principal components, the first of the weights.
    """

    tables: QuadratureTables
    limit_tables: LimitTables
    expected: FloatArray
    precision: FloatArray | None
    starts: tuple[Start, ...]
    n_components: int

    @property
    def basis(self) -> Basis:
        """The basis."""
        return self.tables.basis

    @property
    def is_corrected(self) -> bool:
        """Whether it reaches beyond the components."""
        return self.n_components < self.expected.size


def component_family(
    tables: QuadratureTables,
    limit_tables: LimitTables,
    primitive: MovementPrimitive,
    expected: ConditionalDistribution,
    ends: FloatArray,
    practice: Practice | None = None,
) -> Family:
    """The principal components of a primitive.

    Parameters
    ----------
    tables, limit_tables
        Of its basis.
    primitive : MovementPrimitive
        The primitive.
    expected : ConditionalDistribution
        What is expected of the request.
    ends : array, shape (2 * n_joints,)
        Start and goal positions.
    practice : Practice, optional
        What suited similar motions; the weights of the demonstrations unless given.
    """
    if practice is None:
        own = primitive.boundary_states[:, [0, 3]].reshape(len(primitive.weights), -1)
        practice = Practice(own, primitive.weights)
    mean = np.zeros_like(expected.weights)
    return Family(
        tables,
        limit_tables,
        expected.weights,
        expected.precision,
        (Start(expected.weights), Start(mean), *practice.nearest(ends)),
        primitive.n_components,
    )


def corrected_family(family: Family, primitive: MovementPrimitive, n_nodes: int) -> Family:
    """The components with B-splines of every joint added."""
    usual = max(float(np.sqrt(np.mean(primitive.fit_residual**2))), _USUAL_CORRECTION)
    splines = BSplineBasis(primitive.n_joints)
    tables = QuadratureTables(SumBasis(family.basis, splines, usual), n_nodes)
    correction = np.zeros(splines.n_weights)
    starts = tuple(Start(np.append(start.unknowns, correction)) for start in family.starts)
    assert family.precision is not None
    return Family(
        tables,
        LimitTables(tables),
        starts[0].unknowns,
        block_diag(family.precision, np.eye(splines.n_weights) / usual**2),
        starts,
        family.n_components,
    )


def spline_family(tables: QuadratureTables, limit_tables: LimitTables) -> Family:
    """B-splines alone, of which nothing is expected."""
    zero = np.zeros(tables.basis.n_weights)
    return Family(tables, limit_tables, zero, None, (Start(zero),), 0)


def fixed_family(tables: QuadratureTables) -> Family:
    """The one shape of a basis without weights."""
    return Family(tables, LimitTables(tables), tables.basis.scales, None, (), 0)
