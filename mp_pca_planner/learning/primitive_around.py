# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Primitives around refined motions.

The mean shape of a primitive is displaced so that it predicts the refined motion for its end
points; components and the conditional model are kept, so nearby requests give similar motions.
Gains of a control law are kept; its error bound is removed, because it holds for another motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..control.law import with_gains_only
from ..exceptions import LearningError
from ..primitives.basis import end_vanishing_coefficients, legendre_values
from ..primitives.boundary import boundary_values, hermite_functions
from ..primitives.pace import PacedBasis
from ..primitives.primitive import MovementPrimitive
from .refined_motion import RefinedMotion

_N_PHASES = 201


def primitive_around(
    primitive: MovementPrimitive,
    motion: RefinedMotion,
    name: str,
    provenance: Mapping[str, Any],
) -> MovementPrimitive:
    """Make a primitive of a refined motion.

    Parameters
    ----------
    primitive : MovementPrimitive
        The primitive of the original motion.
    motion : RefinedMotion
        The refined motion, of one segment.
    name : str
        Name of the new primitive.
    provenance : mapping
        Facts on its origin, of JSON types; the name of the original primitive is added.

    Returns
    -------
    family : MovementPrimitive
        Of the same joints, coupling and degree. Its `fit_residual` is an upper bound.

    Raises
    ------
    LearningError
        If the motion has several segments.
    """
    if len(motion.segments) != 1:
        raise LearningError(
            f"a primitive is made of one motion, got a sequence of {len(motion.segments)}: "
            "keep its segments one by one"
        )
    (segment,) = motion.segments
    start, goal = segment.start.positions, segment.goal.positions
    slower = motion.duration / segment.duration
    requests = primitive.model.requests.copy()
    requests[:, -1] += np.log(slower)
    model = replace(primitive.model, requests=requests)
    expected = model.predict(start, goal, motion.duration)
    beyond = np.tensordot(expected.weights, primitive.component_coefficients, axes=1)
    mean = _shape_coefficients(motion, primitive, expected.pace) - beyond
    moved = mean - primitive.mean_coefficients
    distance = np.sqrt(
        np.mean(legendre_values(moved, np.linspace(0.0, 1.0, _N_PHASES)) ** 2, axis=0)
    )
    return replace(
        primitive,
        name=name,
        metadata=with_gains_only(primitive.metadata)
        | {"refined_from": {"name": primitive.name, **provenance}},
        mean_coefficients=mean,
        durations=primitive.durations * slower,
        # The triangle inequality: the old residual, and the displacement of the mean.
        fit_residual=primitive.fit_residual + distance,
        model=model,
        statistics=None,
    )


def _shape_coefficients(
    motion: RefinedMotion, primitive: MovementPrimitive, pace: FloatArray
) -> FloatArray:
    """Legendre coefficients, in aligned phase, of a motion less its boundary part.

    Returns
    -------
    coefficients : array, shape (n_joints, degree + 1)
        [rad or m].
    """
    (segment,) = motion.segments
    phases = np.linspace(0.0, 1.0, _N_PHASES)
    aligned = phases
    if np.any(pace):
        aligned = PacedBasis(primitive.basis, np.zeros(primitive.n_joints), pace).aligned_phases(
            phases
        )
    q, _, _ = motion.evaluate(phases * motion.duration)
    ends = [(x.positions, x.velocities, x.accelerations) for x in (segment.start, segment.goal)]
    boundary = boundary_values(ends[0], ends[1], motion.duration)
    shape = q - hermite_functions(aligned) @ boundary
    admissible = end_vanishing_coefficients(primitive.degree)
    weights, *_ = np.linalg.lstsq(legendre_values(admissible, aligned), shape, rcond=None)
    return np.asarray(weights.T @ admissible)
