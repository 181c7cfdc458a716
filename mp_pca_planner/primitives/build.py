# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Building of movement primitives from demonstrations.

Five steps, each finished before the next begins. The first two are :meth:`.MotionStatistics.of`,
the others :func:`build_from_statistics`:

1. :func:`.arc_length_warp` gives all motions the same timing;
2. :class:`.MotionStatistics` has their shapes, time scalings and ends, in a few numbers each;
3. :func:`.fit_shapes` finds the principal components of the shapes;
4. :meth:`.ConditionalModel.fit` learns to predict weights, time scaling and duration;
5. :class:`.MovementPrimitive` checks and holds the result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import FloatArray, as_list, check_choice, check_number, float_array, unique_names
from ..exceptions import PrimitiveError, RecordingError, shown, unknown_name
from ..recordings.demonstration import TIME_COLUMNS, Demonstration, other_unit_of_time
from ..recordings.segmentation import ABSURD_EXTENT
from .basis import MAX_DEGREE, N_END_CONDITIONS
from .in_span import request_precision
from .motion_statistics import MotionStatistics, shape_functions, shape_smoother, thinned
from .pca import angle_shares, fit_shapes
from .prediction import ConditionalModel, left_out_errors
from .primitive import COUPLINGS, MovementPrimitive
from .timing import ALIGNMENTS


@dataclass(frozen=True)
class PrimitiveOptions:
    """Options of building a primitive.

    Attributes
    ----------
    coupling : {'joint', 'arm'}
        One PCA per joint, as in [P], or one of all joints stacked: far fewer weights.
    n_components : int or None
        Components to keep (per joint for coupling 'joint'); None: as few as reach `variance`.
    variance : float
        Share of the variance that the components kept must explain, if their number is not given.
    n_phases : int
        Samples of a time-normalised demonstration.
    degree : int
        Degree of the polynomials that carry mean and components.
    align : {'linear', 'arc_length'}
        Whether equal shares of the time or of the path are compared, see :func:`.arc_length_warp`.

    Raises
    ------
    PrimitiveError
        If an option is unknown or out of its range.
    """

    coupling: str = "arm"
    n_components: int | None = None
    variance: float = 0.99
    n_phases: int = 101
    degree: int = 15
    align: str = "arc_length"

    def __post_init__(self) -> None:
        check_choice(self.coupling, "coupling", PrimitiveError, COUPLINGS)
        if self.n_components is not None:
            check_number(self.n_components, "components", PrimitiveError, 1, is_whole=True)
        check_number(self.variance, "variance", PrimitiveError, 1e-9, 1.0)
        what, low = "degree (of which the ends take six conditions)", N_END_CONDITIONS
        check_number(self.degree, what, PrimitiveError, low, MAX_DEGREE, is_whole=True)
        what, low = "phases (at least twice the degree)", 2 * self.degree
        check_number(self.n_phases, what, PrimitiveError, low, 10_000, is_whole=True)
        check_choice(self.align, "align", PrimitiveError, ALIGNMENTS)


_DEFAULTS = PrimitiveOptions()

# Arrays whose ends are faster than this share of their peak speed are cut while they move.
_MAX_END_SPEED = 0.2
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
        If the name is not a text, there is no demonstration, they have different joints, or
        nothing moves.
    """
    if not isinstance(name, str):
        raise PrimitiveError(f"the name of a primitive must be a str, got {shown(name)}")
    if not demonstrations:
        raise PrimitiveError(f"primitive '{name}' can't be built: there is no demonstration")
    return build_from_statistics(
        MotionStatistics.of(demonstrations, options), name, options, metadata
    )


def as_demonstrations(
    given: Any,
    times: ArrayLike | Sequence[ArrayLike] | None,
    joint_names: Sequence[str] | None = None,
) -> tuple[list[Demonstration], list[str]]:
    """Demonstrations of what :meth:`.MovementPrimitive.fit` accepts, and what to warn of."""
    what = (
        "demonstrations must be a list: mp.load_demonstrations reads recordings and tables, and "
        "list(motions.values()) makes one of a dict"
    )
    motions = given if isinstance(given, list) else as_list(given, what, PrimitiveError)
    if times is not None:
        if _has_columns(given) or np.ndim(motions[0] if motions else 0) == 1:
            raise PrimitiveError(
                "one array of shape (samples, joints) is one motion: give a list, [array]"
            )
        return _of_arrays(motions, times, joint_names)
    for motion in motions:
        if not isinstance(motion, Demonstration):
            raise PrimitiveError(
                f"a {type(motion).__name__} is not a demonstration: mp.load_demonstrations reads "
                "recordings, and arrays need times=, the times of their samples [s]"
            )
    return motions, []


def _of_arrays(
    motions: list[Any], times: Any, joint_names: Sequence[str] | None
) -> tuple[list[Demonstration], list[str]]:
    """Demonstrations of the positions of motions and their times, and what to warn of."""
    what = "times must be the times of the samples [s], such as 0.01 * numpy.arange(n_samples)"
    given_times = as_list(times, what, PrimitiveError)
    if not given_times or np.ndim(given_times[0]) == 0:
        given_times = [times] * len(motions)
    if len(given_times) != len(motions):
        raise PrimitiveError(
            f"there are {len(motions)} motions, but {len(given_times)} arrays of times: give one "
            "for each, or one for all"
        )
    if joint_names is not None:
        joint_names = unique_names(joint_names, "joint_names", PrimitiveError)
    if motions and all(map(_has_columns, motions)):
        joint_names = joint_names or _joints_of(motions[0])
        motions = [_chosen_columns(q, joint_names, k) for k, q in enumerate(motions, start=1)]
    demonstrations, notes = list[Demonstration](), list[str]()
    for k, (t, positions) in enumerate(zip(given_times, motions, strict=True), start=1):
        where = f"motion {k}"
        q = float_array(positions, f"positions of '{where}'", RecordingError)
        names = joint_names or [f"joint{j}" for j in range(1, 1 + (q.shape or (0,))[-1])]
        motion = Demonstration.of_samples(names, t, q, where)
        extents = np.ptp(motion.positions, axis=0)
        if extents.max() > ABSURD_EXTENT:
            raise PrimitiveError(
                f"joint '{names[extents.argmax()]}' moves over {extents.max():.3g} rad (or m) in "
                f"{where}, and over {ABSURD_EXTENT:g} is absurd: positions must be in radians (or "
                "m); numpy.deg2rad converts degrees"
            )
        demonstrations.append(motion)
        notes.append(other_unit_of_time(where, np.asarray(t, float)))
    return demonstrations, [*[*filter(None, notes)][:1], *_moving_ends(demonstrations)]


def _has_columns(value: Any) -> bool:
    """Whether a value is a table with named columns, such as a DataFrame."""
    columns = getattr(value, "columns", None)
    return columns is not None and not callable(columns)


def _joints_of(table: Any) -> list[str]:
    """Names of the joints of a table: of all its columns."""
    names = list(table.columns)
    for name in names:
        if isinstance(name, str) and name.lower() in TIME_COLUMNS:
            raise PrimitiveError(
                f"the column '{name}' of motion 1 is not a joint: pass times=[d['{name}'] for d in "
                "motions], and name the joints with joint_names=[…]"
            )
    return names


def _chosen_columns(table: Any, names: Sequence[str], k: int) -> FloatArray:
    valid = list(table.columns)
    for name in names:
        if name not in valid:
            raise PrimitiveError(f"motion {k}: {unknown_name('column', name, map(str, valid))}")
    return np.column_stack([np.asarray(table[name]) for name in names])


def _moving_ends(motions: Sequence[Demonstration]) -> list[str]:
    """A sentence on motions that are cut while they move; none if there are no such motions."""
    moving = {}
    for motion in motions:
        # Over a twentieth of the motion, in which noise of some milliradians changes little.
        n = max(1, len(motion.times) // 20)
        steps = (
            motion.positions[n] - motion.positions[0],
            motion.positions[-1] - motion.positions[-1 - n],
        )
        speed = max(map(np.linalg.norm, steps)) / motion.times[n]
        share = speed / max(np.linalg.norm(motion.velocities, axis=1).max(), 1e-12)
        if share > _MAX_END_SPEED:
            moving[motion.recording] = share
    if not moving:
        return []
    first, share = next(iter(moving.items()))
    return [
        f"{len(moving)} of {len(motions)} motions begin or end while they move ('{first}' at "
        f"{share:.0%} of its peak speed), or they are noisy: arrays are neither cut at rests nor "
        "smoothed; give smooth motions from rest to rest"
    ]


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
    mean, directions, explained, total, weights, residual = fit_shapes(statistics, options)
    angles = angle_shares(statistics)
    # The prediction is fitted to some of the motions, and knows the spread of all requests.
    requests = statistics.requests()
    used, rows = thinned(requests), directions.reshape(-1, mean.size)
    shapes = statistics.shapes[used]
    # The functions of the shapes are alternately even and odd in reversed time.
    both = np.array([shapes, shapes * (-1.0) ** np.arange(shapes.shape[2])])
    shapes = both.reshape(2, len(used), -1)
    precision = request_precision(requests)
    # Whole shapes are predicted, so the number of components makes no difference.
    remainders = statistics.shape_remainders[used].sum(axis=1)
    n_values = options.n_phases * len(statistics.joint_names)
    left_out, straight = left_out_errors(requests[used], shapes, remainders, n_values)
    model = ConditionalModel.fit(
        requests[used], shapes @ rows.T, -rows @ mean.ravel(), statistics.paces[used], precision
    )
    facts: dict[str, Any] = {
        "options": {
            "coupling": options.coupling,
            "components": options.n_components,
            "variance": options.variance,
            "phases": options.n_phases,
            "degree": options.degree,
            "align": options.align,
        },
        "left_out_error": left_out,
        "minimum_jerk_error": straight,
        "angle_variance_ratio": angles,
        "demonstrations": list(statistics.sources),
    }
    _, series = shape_functions(options.degree, options.n_phases)
    series = shape_smoother(options.degree, options.n_phases) @ series
    return MovementPrimitive(
        name=name,
        joint_names=statistics.joint_names,
        coupling=options.coupling,
        metadata=facts | dict(metadata or {}),
        mean_coefficients=mean @ series,
        component_coefficients=directions @ series,
        explained_variance=explained,
        total_variance=total,
        weights=weights,
        boundary_states=statistics.boundary_states,
        durations=statistics.durations,
        warps=statistics.warps,
        fit_residual=residual,
        model=model,
    )
