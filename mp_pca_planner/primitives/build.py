# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Building of movement primitives from demonstrations.

Five steps, each finished before the next begins. The first two are :meth:`.MotionStatistics.of`,
which recordings can take one by one, the others :func:`build_from_statistics`:

1. :func:`.align` gives all motions the same timing;
2. :class:`.MotionStatistics` has their shapes, time scalings and ends, in a few numbers each;
3. :func:`.fit_shapes` finds the principal components of the shapes;
4. :meth:`.ConditionalModel.fit` learns to predict weights, time scaling and duration;
5. :class:`.MovementPrimitive` checks and holds the result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import check_type
from ..exceptions import PrimitiveError, shown
from ..recordings.demonstration import Demonstration
from ..recordings.segmentation import ABSURD_EXTENT
from .in_span import request_precision
from .motion_sources import MotionSources
from .motion_statistics import MotionStatistics, shape_functions, shape_smoother
from .options import PrimitiveOptions as PrimitiveOptions
from .pace import reversed_paces
from .pca import angle_shares, fit_shapes
from .prediction import ConditionalModel, left_out_squares
from .primitive import MovementPrimitive

_DEFAULTS = PrimitiveOptions()

# Motions of a smaller range [rad or m] are standstill with noise.
_MIN_EXTENT = 1e-6


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
    try:
        is_shared = bool(np.isscalar(next(iter(times), 0.0)))  # type: ignore[arg-type]
    except TypeError:
        raise PrimitiveError(
            f"times must be the times of the samples [s], got {shown(times)}: "
            "times=0.01 * numpy.arange(n_samples) if they are 0.01 s apart"
        ) from None
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
        if extents.max() > ABSURD_EXTENT:
            raise PrimitiveError(
                f"joint '{names[extents.argmax()]}' moves over {extents.max():.3g} rad (or m) in "
                f"{motion.recording}, and over {ABSURD_EXTENT:g} is absurd: positions must be in "
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
    facts: dict[str, Any] = {
        "options": {key.removeprefix("n_"): value for key, value in asdict(options).items()},
        "angle_variance_ratio": angle_shares(statistics),
    }
    found = fit_shapes(statistics, options)
    # The prediction is fitted to some of the motions, and knows the spread of all requests.
    some, rows = statistics.thinned(), found.directions.reshape(-1, found.mean.size)
    model = ConditionalModel.fit(
        some.requests(),
        some.both_shapes() @ rows.T,
        -rows @ found.mean.ravel(),
        np.array([some.paces, reversed_paces(some.paces)]),
        MotionSources(some.sources).labels(),
        request_precision(statistics.requests()),
    )
    _, series = shape_functions(options.degree, options.n_phases)
    series = shape_smoother(options.degree, options.n_phases) @ series
    facts["demonstrations"] = MotionSources(statistics.sources, as_facts=True)
    return MovementPrimitive(
        name=name,
        joint_names=statistics.joint_names,
        coupling=options.coupling,
        metadata=facts | dict(metadata or {}),
        mean_coefficients=found.mean @ series,
        component_coefficients=found.directions @ series,
        explained_variance=found.explained_variance,
        total_variance=found.total_variance,
        weights=found.weights,
        boundary_states=statistics.boundary_states,
        durations=statistics.durations,
        warps=statistics.warps,
        fit_residual=found.fit_residual,
        model=model,
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
