# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Demonstrations → movement primitive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PrimitiveError
from ..recordings.demonstration import Demonstration
from .conditional_model import ConditionalModel
from .motion_statistics import MotionStatistics, shape_functions
from .options import PrimitiveOptions as PrimitiveOptions
from .pace import fit_paces
from .pca import components_for_share, fit_components
from .primitive import MovementPrimitive

_DEFAULTS = PrimitiveOptions()


def build_primitive(
    demonstrations: Sequence[Demonstration],
    name: str,
    options: PrimitiveOptions = _DEFAULTS,
    metadata: Mapping[str, Any] | None = None,
) -> MovementPrimitive:
    """Learn a movement primitive.

    Parameters
    ----------
    demonstrations :
        Motions of the same joints in the same order, at least one.
    name :
        Name of the primitive.
    options :
        How to build it.
    metadata :
        More to keep with it, of JSON types (for example repairs of the recordings).

    Raises
    ------
    PrimitiveError
        If there is no demonstration, they have different joints, or nothing moves.
    """
    if not demonstrations:
        raise PrimitiveError(f"primitive '{name}' can't be built: there is no demonstration")
    return build_from_statistics(
        MotionStatistics.of(demonstrations, options), name, options, metadata
    )


def build_from_statistics(
    statistics: MotionStatistics,
    name: str,
    options: PrimitiveOptions,
    metadata: Mapping[str, Any] | None = None,
) -> MovementPrimitive:
    """Learn a movement primitive from the statistics of its demonstrations.

    Parameters
    ----------
    statistics :
        What is known of the demonstrations, made with the same options.
    name, options, metadata :
        See :func:`build_primitive`.

    Raises
    ------
    PrimitiveError
        If nothing moves.
    """
    motions, moments = statistics.motions, statistics.moments
    if max(motion.extent for motion in motions) < 1e-6:
        raise PrimitiveError(f"primitive '{name}' can't be built: no joint moves in any motion")
    directions, explained_variance = _fit_directions(statistics, options)
    mean = moments.mean[statistics.shapes].reshape(directions.shape[1:])
    shapes = np.array([motion.shape for motion in motions])
    straight_weights = -_project(mean, directions)
    weights = _project(shapes, directions) + straight_weights
    left = shapes - mean - np.tensordot(weights, directions, axes=1)
    remainders = np.array([motion.shape_remainder for motion in motions])
    boundary_states = np.array([motion.boundary_state for motion in motions])
    durations = np.array([motion.duration for motion in motions])
    _, legendre_coefficients = shape_functions(options.degree, options.n_phases)
    warps = np.array([motion.warp for motion in motions])
    # The functions of the shapes are even and odd in turn.
    reversed_shapes = shapes * (-1.0) ** np.arange(shapes.shape[2])
    model = ConditionalModel.fit(
        np.column_stack([boundary_states[:, 0], boundary_states[:, 3], np.log(durations)]),
        _project(shapes, directions),
        _project(reversed_shapes, directions),
        straight_weights,
        fit_paces(warps),
        [motion.label for motion in motions],
    )
    facts = {
        "options": {
            "coupling": options.coupling,
            "components": options.n_components,
            "variance": options.variance,
            "phases": options.n_phases,
            "degree": options.degree,
            "align": options.align,
        },
        "angle_variance_ratio": _angle_variance_ratio(statistics),
        "demonstrations": [
            {
                "recording": motion.recording,
                "label": motion.label,
                "start_time_s": motion.start_time,
                "end_time_s": motion.end_time,
                "checksum": motion.checksum,
            }
            for motion in motions
        ],
    }
    return MovementPrimitive(
        name,
        statistics.joint_names,
        options.coupling,
        {**facts, **(metadata or {})},
        mean @ legendre_coefficients,
        directions @ legendre_coefficients,
        explained_variance,
        _total_variance(moments.variances[statistics.shapes].reshape(mean.shape), remainders),
        weights,
        boundary_states,
        durations,
        warps,
        np.sqrt((np.sum(left**2, axis=2) + remainders) / options.n_phases),
        model,
    )


def _project(shapes: FloatArray, directions: FloatArray) -> FloatArray:
    """Weights of shapes of shape (..., n_joints, n_functions)."""
    return np.tensordot(shapes, directions, axes=((-2, -1), (1, 2)))


def _fit_directions(
    statistics: MotionStatistics, options: PrimitiveOptions
) -> tuple[FloatArray, FloatArray]:
    """Principal components of the shapes, and the variances that they explain.

    Returns
    -------
    directions : array, shape (n_components, n_joints, n_functions)
        Coefficients of the components.
    explained_variance : array, shape (n_components,)
        Their variances.
    """
    n_joints, n_functions = statistics.motions[0].shape.shape
    shapes = statistics.moments.select(statistics.shapes)
    values, _ = shape_functions(options.degree, options.n_phases)
    together = n_joints if options.coupling == "arm" else 1
    directions, variances = [], []
    for first in range(0, n_joints, together):
        # As samples, whose distances are the same, so that signs are chosen by what is seen.
        block = shapes.select(slice(first * n_functions, (first + together) * n_functions))
        components = fit_components(block.transform(_blocks(values.T, together)))
        kept = options.n_components or components_for_share(components, options.variance)
        components = components.truncated(kept)
        found = np.zeros((len(components.components), n_joints, n_functions))
        found[:, first : first + together] = (
            components.components.reshape(-1, together, options.n_phases) @ values
        )
        directions.append(found)
        variances.append(components.explained_variance)
    return np.concatenate(directions), np.concatenate(variances)


def _blocks(matrix: FloatArray, n: int) -> FloatArray:
    """A matrix n times along the diagonal."""
    return np.asarray(np.kron(np.eye(n), matrix), dtype=np.float64)


def _total_variance(variances: FloatArray, remainders: FloatArray) -> FloatArray:
    """Variance of curves about their mean polynomial, shape (n_joints,).

    Parameters
    ----------
    variances : array, shape (n_joints, n_functions)
        Variances of their coefficients.
    remainders : array, shape (n_demonstrations, n_joints)
        Squares of what the coefficients leave.
    """
    return np.asarray(variances.sum(axis=1) + remainders.sum(axis=0) / max(len(remainders) - 1, 1))


def _angle_variance_ratio(statistics: MotionStatistics) -> dict[str, list[float]]:
    """Shares of the first four components of the joint angles over time: [P], Table 2."""
    remainders = np.array([motion.angle_remainder for motion in statistics.motions])
    ratios = {}
    for joint, name in enumerate(statistics.joint_names):
        angles = statistics.moments.select(statistics.angles(joint))
        explained = fit_components(angles).explained_variance[:4]
        total = _total_variance(angles.variances[None], remainders[:, [joint]])
        ratios[name] = [float(share) for share in explained / total]
    return ratios
