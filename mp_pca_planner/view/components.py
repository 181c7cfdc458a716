# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The mean motion of a primitive, bent by its components."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray
from ..primitives.boundary import boundary_values, hermite_functions
from ..primitives.primitive import MovementPrimitive
from .motion import ShownMotion

N_PHASES = 101
"""Number of configurations of a bent motion."""


def bent_motion(primitive: MovementPrimitive, deviations: ArrayLike) -> ShownMotion:
    """The mean motion between the mean ends of the demonstrations, bent by components.

    Parameters
    ----------
    primitive : MovementPrimitive
        Any primitive.
    deviations : array, shape (n_components,)
        Weight of each component in standard deviations of the demonstrations.
    """
    phases = np.linspace(0.0, 1.0, N_PHASES)
    rest = np.zeros(primitive.n_joints)
    duration = float(np.median(primitive.durations))
    start, goal = (primitive.boundary_states[:, k].mean(axis=0) for k in (0, 3))
    boundary = boundary_values((start, rest, rest), (goal, rest, rest), duration)
    weights = np.asarray(deviations) * np.sqrt(primitive.explained_variance)
    positions = hermite_functions(phases) @ boundary + primitive.basis.shape(weights, phases)
    return ShownMotion("Components", duration * phases, positions)


def component_names(primitive: MovementPrimitive) -> list[str]:
    """A name for each component; one of a single joint is named after it."""
    if primitive.coupling == "arm":
        return [f"{k}" for k in range(1, primitive.n_components + 1)]
    counts: dict[str, int] = {}
    names = []
    for joint in primitive.joint_of_component:
        name = primitive.joint_names[joint]
        counts[name] = counts.get(name, 0) + 1
        names.append(f"{name} {counts[name]}")
    return names


def variance_shares(primitive: MovementPrimitive) -> FloatArray:
    """Share of the whole variance that each component explains, shape (n_components,)."""
    return np.asarray(primitive.explained_variance / primitive.total_variance.sum())
