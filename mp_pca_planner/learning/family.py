# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A refined motion becomes a primitive: a family of motions around it.

The family's mean shape is moved so that the refined motion is what it expects for its end
points; components, covariances, paces and what they say of requests are carried over. So near
by it expects motions like the refined one. Gains of a control law are carried over, too; the
bound on its errors is not, which holds for another motion.
"""

from __future__ import annotations

from collections.abc import Mapping
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
# Rounds, and the distance [rad or m], to which a family expects what it is made around.
_MOST_ROUNDS = 50
_NEAR = 1e-9


def family_around(
    primitive: MovementPrimitive,
    motion: RefinedMotion,
    name: str,
    provenance: Mapping[str, Any],
) -> MovementPrimitive:
    """Make a primitive of a refined motion.

    Parameters
    ----------
    primitive : MovementPrimitive
        What the original motion was made from.
    motion : RefinedMotion
        The refined motion, of one segment.
    name : str
        Name of the new primitive.
    provenance : mapping
        What to keep of where it comes from, of JSON types; the names of the primitive it was
        made from and of the new metadata are added.

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
    arrays = primitive.arrays() | {
        "durations": primitive.durations * (motion.duration / segment.duration)
    }
    metadata = with_gains_only(primitive.metadata) | {
        "refined_from": {"name": primitive.name, **provenance}
    }

    def moved_to(mean: FloatArray) -> MovementPrimitive:
        content = arrays | {"mean_coefficients": mean}
        return MovementPrimitive(name, primitive.joint_names, primitive.coupling, content, metadata)

    family = moved_to(primitive.mean_coefficients)
    pace = family.statistics.condition(start, goal, motion.duration).pace
    wanted = _shape_coefficients(motion, family, pace)
    for _ in range(_MOST_ROUNDS):
        # What the family expects beyond its mean depends on the mean, but less than one to one.
        expected = family.statistics.condition(start, goal, motion.duration).weights
        beyond = np.tensordot(expected, family.component_coefficients, axes=1)
        missed = wanted - beyond - family.mean_coefficients
        family = moved_to(family.mean_coefficients + missed)
        if np.abs(missed).max() < _NEAR:
            break
    moved = family.mean_coefficients - primitive.mean_coefficients
    phases = np.linspace(0.0, 1.0, _N_PHASES)
    distance = np.sqrt(np.mean(legendre_values(moved, phases) ** 2, axis=0))
    # The triangle inequality: what was left over, and how far the family was moved.
    arrays["fit_residual"] = primitive.fit_residual + distance
    return moved_to(family.mean_coefficients)


def _shape_coefficients(
    motion: RefinedMotion, family: MovementPrimitive, pace: FloatArray
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
        aligned = PacedBasis(family.basis, np.zeros(family.n_joints), pace).aligned_phases(phases)
    q, _, _ = motion.evaluate(phases * motion.duration)
    ends = [(x.positions, x.velocities, x.accelerations) for x in (segment.start, segment.goal)]
    boundary = boundary_values(ends[0], ends[1], motion.duration)
    shape = q - hermite_functions(aligned) @ boundary
    admissible = end_vanishing_coefficients(family.degree)
    weights, *_ = np.linalg.lstsq(legendre_values(admissible, aligned), shape, rcond=None)
    return np.asarray(weights.T @ admissible)
