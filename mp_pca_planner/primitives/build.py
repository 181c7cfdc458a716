# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Building of movement primitives from demonstrations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray, check_type
from ..exceptions import PrimitiveError, shown
from ..recordings.demonstration import Demonstration
from ..recordings.segmentation import SegmentationOptions
from ..rows import empty_rows, row_blocks, row_mean
from .in_span import request_precision
from .motion_sources import MotionSources
from .motion_statistics import MotionStatistics, shape_functions, shape_smoother
from .options import PrimitiveOptions as PrimitiveOptions
from .pca import components_for_share, fit_components, largest_signs
from .prediction import ConditionalModel, left_out_squares
from .primitive import MovementPrimitive

_DEFAULTS = PrimitiveOptions()

# Motions of a smaller range [rad or m] are standstill with noise.
_MIN_EXTENT = 1e-6
# Motions of a larger range are probably in degrees, as in recordings.
_ABSURD_EXTENT = SegmentationOptions().absurd_extent


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
        Options of the primitive.
    metadata :
        Further metadata to store, of JSON types (for example repairs of the recordings).

    Raises
    ------
    PrimitiveError
        If there is no demonstration, something else is among them, they have different joints, or
        nothing moves.
    """
    check_type(name, "the name of a primitive", PrimitiveError, str)
    others = demonstrations if isinstance(demonstrations, Sequence) else [demonstrations]
    for one in others:
        if isinstance(one, np.ndarray | list | tuple):
            raise PrimitiveError(
                f"primitive '{name}' can't be built: arrays need times=, the times of their "
                "samples [s]; joint_names= names their columns"
            )
        if not isinstance(one, Demonstration):
            raise PrimitiveError(
                f"primitive '{name}' can't be built: {shown(one)} is not a demonstration; "
                "load_demonstrations reads recordings"
            )
    if not demonstrations:
        raise PrimitiveError(f"primitive '{name}' can't be built: there is no demonstration")
    return build_from_statistics(
        MotionStatistics.of(demonstrations, options), name, options, metadata
    )


def demonstrations_of(
    positions: Sequence[ArrayLike],
    times: ArrayLike | Sequence[ArrayLike],
    joint_names: Sequence[str] | None = None,
) -> list[Demonstration]:
    """Demonstrations from arrays, see :meth:`.MovementPrimitive.fit`."""
    motions = list(positions)
    is_shared = bool(np.isscalar(next(iter(times), 0.0)))  # type: ignore[arg-type]
    own_times: list[Any] = [times] * len(motions)
    if not is_shared:
        own_times = list(times)  # type: ignore[arg-type]
    if len(own_times) != len(motions):
        raise PrimitiveError(
            f"there are {len(motions)} motions, but {len(own_times)} arrays of times: give one for "
            "each, or one for all"
        )
    names = joint_names or [f"joint{j + 1}" for j in range(np.shape(motions[0])[-1])]
    found = [
        Demonstration.from_arrays(names, t, q, recording=f"motion {k}")
        for k, (t, q) in enumerate(zip(own_times, motions, strict=True), start=1)
    ]
    for motion in found:
        extents = np.ptp(motion.positions, axis=0)
        if extents.max() > _ABSURD_EXTENT:
            raise PrimitiveError(
                f"joint '{names[extents.argmax()]}' moves over {extents.max():.3g} rad (or m) in "
                f"{motion.recording}, and over {_ABSURD_EXTENT:g} is absurd: positions must be in "
                "radians (or m); numpy.deg2rad converts degrees"
            )
    return found


def options_to_update(primitive: MovementPrimitive) -> PrimitiveOptions:
    """The options that a primitive was built with, if its demonstrations can change.

    Raises
    ------
    PrimitiveError
        If its demonstrations can't change, with the reason.
    """
    why = f"primitive '{primitive.name}' can't be updated: "
    if primitive.statistics is None:
        raise PrimitiveError(
            f"{why}it holds no statistics of its demonstrations, because it was refined or built "
            "by an older release; build it again from the recordings"
        )
    stored = dict(primitive.metadata.get("options", {}))
    try:
        for key in ("components", "phases"):
            stored[f"n_{key}"] = stored.pop(key)
        return PrimitiveOptions(**stored)
    except (KeyError, TypeError):
        raise PrimitiveError(f"{why}its metadata lacks the options it was built with") from None


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
        Statistics of the demonstrations, made with the same options.
    name, options, metadata :
        See :func:`build_primitive`.

    Raises
    ------
    PrimitiveError
        If nothing moves.
    """
    if statistics.extents.max() < _MIN_EXTENT:
        raise PrimitiveError(f"primitive '{name}' can't be built: no joint moves in any motion")
    shapes = statistics.shapes
    directions, explained_variance = _fit_directions(shapes, options)
    mean = row_mean(shapes)
    smoother = shape_smoother(options.degree, options.n_phases)
    _, legendre_coefficients = shape_functions(options.degree, options.n_phases)
    legendre_coefficients = smoother @ legendre_coefficients
    return MovementPrimitive(
        name=name,
        joint_names=statistics.joint_names,
        coupling=options.coupling,
        metadata=_facts(statistics, options) | dict(metadata or {}),
        mean_coefficients=mean @ legendre_coefficients,
        component_coefficients=directions @ legendre_coefficients,
        explained_variance=explained_variance,
        total_variance=_total_variance(shapes, statistics.shape_remainders),
        boundary_states=statistics.boundary_states,
        durations=statistics.durations,
        warps=statistics.warps,
        **_reproduced(statistics, mean, directions, smoother, options.n_phases),
        model=_fit_model(statistics, mean, directions),
        statistics=statistics,
    )


def left_out_errors(statistics: MotionStatistics, n_phases: int) -> tuple[float, float]:
    """RMS errors in path of motions that are left out [rad or m].

    From their prediction by the others, and from the minimum-jerk motion between their ends. At
    most 200 motions are left out; the first error is NaN for a single motion.
    """
    used = statistics.thinned()
    shapes, remainders = used.both_shapes(), used.shape_remainders.sum(axis=1)
    straight = np.sum(shapes[0] ** 2, axis=1)
    squares = np.full(straight.shape, np.nan)
    if len(straight) > 1:
        labels = [motion.label for motion in used.motions]
        squares = left_out_squares(used.requests(), shapes, labels=labels)
    scale = n_phases * len(statistics.joint_names)
    predicted, straight = (np.sqrt((x + remainders).mean() / scale) for x in (squares, straight))
    return float(predicted), float(straight)


def _reproduced(
    statistics: MotionStatistics,
    mean: FloatArray,
    directions: FloatArray,
    smoother: FloatArray,
    n_phases: int,
) -> dict[str, FloatArray]:
    """Weights of the demonstrations, and the RMS of what they leave of each joint, smoothed."""
    sizes = {"weights": len(directions), "fit_residual": len(mean)}
    n_motions = len(statistics.durations)
    arrays = empty_rows(n_motions, {name: (np.float64, (n,)) for name, n in sizes.items()})
    for part, rows in zip(statistics.blocks(), row_blocks(*arrays.values()), strict=True):
        weights, residual = rows
        weights[:] = _project(part.shapes - mean, directions)
        left = part.shapes - (mean + np.tensordot(weights, directions, axes=1)) @ smoother
        squares = np.sum(left**2, axis=2) + part.shape_remainders
        residual[:] = np.sqrt(squares / n_phases)
    return arrays


def _facts(statistics: MotionStatistics, options: PrimitiveOptions) -> dict[str, Any]:
    """Metadata of a primitive, of JSON types."""
    angles = statistics.angles
    total = _total_variance(angles, statistics.angle_remainders)
    # Shares of the first four components of the joint angles over time: [P], Table 2.
    shares = {
        name: (fit_components(angles[:, joint]).explained_variance[:4] / total[joint]).tolist()
        for joint, name in enumerate(statistics.joint_names)
    }
    return {
        "options": {key.removeprefix("n_"): value for key, value in asdict(options).items()},
        "angle_variance_ratio": shares,
        "demonstrations": MotionSources(statistics.sources, as_facts=True),
    }


def _fit_model(
    statistics: MotionStatistics, mean: FloatArray, directions: FloatArray
) -> ConditionalModel:
    """Regress the weights, time scalings and durations on the requests."""
    n_components, n_joints, n_functions = directions.shape
    rows = directions.reshape(n_components, n_joints * n_functions)  # there may be no component
    fitted, straight = statistics.thinned(), -rows @ mean.ravel()
    labels = [motion.label for motion in fitted.motions]
    return ConditionalModel.fit(
        fitted.requests(),
        fitted.both_shapes() @ rows.T,
        straight,
        fitted.paces,
        labels,
        request_precision(statistics.requests()),
    )


def _project(shapes: FloatArray, directions: FloatArray) -> FloatArray:
    """Weights of shapes of shape (..., n_joints, n_functions)."""
    return np.tensordot(shapes, directions, axes=((-2, -1), (1, 2)))


def _fit_directions(shapes: FloatArray, options: PrimitiveOptions) -> tuple[FloatArray, FloatArray]:
    """Principal components of the shapes, and the variances that they explain.

    Parameters
    ----------
    shapes : array, shape (n_demonstrations, n_joints, n_functions)
        Coefficients of the shapes.

    Returns
    -------
    directions : array, shape (n_components, n_joints, n_functions)
        Coefficients of the components.
    explained_variance : array, shape (n_components,)
        Their variances.
    """
    n, n_joints, n_functions = shapes.shape
    values, _ = shape_functions(options.degree, options.n_phases)
    together = n_joints if options.coupling == "arm" else 1
    directions, variances = [], []
    for first in range(0, n_joints, together):
        block = slice(first, first + together)
        # Distances between coefficients equal those between samples.
        components = fit_components(shapes[:, block].reshape(n, -1))
        kept = options.n_components or components_for_share(components, options.variance)
        found = components.components[:kept].reshape(-1, together, n_functions)
        directions.append(np.zeros((len(found), n_joints, n_functions)))
        directions[-1][:, block] = found * largest_signs(found @ values.T)
        variances.append(components.explained_variance[:kept])
    return np.concatenate(directions), np.concatenate(variances)


def _total_variance(coefficients: FloatArray, remainders: FloatArray) -> FloatArray:
    """Variance of curves about their mean polynomial, shape (n_joints,).

    Parameters
    ----------
    coefficients : array, shape (n_demonstrations, n_joints, n_functions)
        Of the polynomials.
    remainders : array, shape (n_demonstrations, n_joints)
        Sums of squares of the residuals of the coefficients.
    """
    mean = row_mean(coefficients)
    squares = np.zeros(len(mean))
    for some, left in row_blocks(coefficients, remainders):
        squares += np.sum((some - mean) ** 2, axis=(0, 2)) + left.sum(axis=0)
    return squares / max(len(coefficients) - 1, 1)
