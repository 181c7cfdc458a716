# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Differences of demonstrations from their predictions, and leave-one-out errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PrimitiveError, quote_names
from ..motion.interpolation import hermite_functions
from ..recordings.demonstration import Demonstration
from .build import PrimitiveOptions, build_primitive
from .primitive import MovementPrimitive
from .timing import arc_length_warp, own_phases

FINE_PHASES = np.linspace(0.0, 1.0, 1001)
"""Evenly spaced shares of the duration at which motions are compared."""

PHASES = FINE_PHASES[::10]
"""A tenth of them, for paths and figures, which need fewer."""

MEASURES = ("time", "aligned", "path")
"""RMS differences over phases and joints: at equal shares of the time; at each instant of the
motion after the best warp of the prediction; at equal shares of the path. Only the first depends on
the timing."""


def differences(prediction: FloatArray, truth: FloatArray) -> FloatArray:
    """RMS differences of a prediction from a motion.

    Parameters
    ----------
    prediction, truth : array, shape (1001, n_joints)
        Positions at the fine phases [rad or m].

    Returns
    -------
    differences : array, shape (3,)
        By the `MEASURES`, in the same order [rad or m].
    """
    return np.array(
        [
            np.sqrt(np.mean((prediction[::10] - truth[::10]) ** 2)),
            _after_alignment(prediction[::2], truth[::10]),
            path_difference(prediction, truth),
        ]
    )


def path_difference(first: FloatArray, second: FloatArray) -> float:
    """RMS difference of two motions at equal shares of the path [rad or m].

    Each has the shape (1001, n_joints), at the fine phases.
    """
    return float(np.sqrt(np.mean((by_way(first) - by_way(second)) ** 2)))


def by_way(positions: FloatArray) -> FloatArray:
    """Positions along the path with the timing of a minimum-jerk motion.

    Parameters
    ----------
    positions : array, shape (1001, n_joints)
        A motion at the fine phases [rad or m].

    Returns
    -------
    positions : array, shape (101, n_joints)
        See :func:`.arc_length_warp`.
    """
    own = own_phases(arc_length_warp(positions), PHASES)
    return np.column_stack([np.interp(own, FINE_PHASES, x) for x in positions.T])


def _after_alignment(prediction: FloatArray, truth: FloatArray) -> float:
    """Least RMS difference over monotone matches of both ends, by dynamic programming."""
    squares = np.mean((truth[:, None] - prediction[None]) ** 2, axis=2)
    sums = np.full(len(prediction), np.inf)
    sums[0] = squares[0, 0]
    for row in squares[1:]:
        sums = row + np.minimum.accumulate(sums)
    return float(np.sqrt(sums[-1] / len(truth)))


@dataclass(frozen=True, eq=False)
class HeldOutErrors:
    """Differences between motions and the predictions of primitives of the others.

    All predictions are from rest to rest and use the end points and the duration only, as a
    planner does.

    Attributes
    ----------
    minimum_jerk, mean_shape, expected : array, shape (n_motions, 3)
        :func:`.differences` of each motion from the boundary part alone, from the mean shape at
        an even time scaling, and from the expected weights and time scaling [rad or m].
    """

    minimum_jerk: FloatArray
    mean_shape: FloatArray
    expected: FloatArray

    def rms(self) -> FloatArray:
        """RMS over all motions by prediction and measure, shape (3, 3) [rad or m]."""
        errors = np.array([self.minimum_jerk, self.mean_shape, self.expected])
        return np.asarray(np.sqrt(np.mean(errors**2, axis=1)))


def leave_one_out(
    motions: Sequence[Demonstration],
    options: PrimitiveOptions,
    left_out: Sequence[int] | None = None,
) -> HeldOutErrors:
    """Predict each motion by a primitive that is built from the others.

    Parameters
    ----------
    motions :
        Motions of the same joints, at least two.
    options :
        Options of the primitives.
    left_out :
        Indices of the motions to leave out and predict; all by default.

    Raises
    ------
    PrimitiveError
        If fewer than two are given, or no primitive can be built from those that are left.
    """
    rows = np.array(
        [
            _errors(motions[i], [*motions[:i], *motions[i + 1 :]], options)
            for i in (range(len(motions)) if left_out is None else left_out)
        ]
    )
    return HeldOutErrors(*rows.transpose(1, 0, 2))


def _errors(
    motion: Demonstration, others: Sequence[Demonstration], options: PrimitiveOptions
) -> FloatArray:
    primitive = build_primitive(others, "others", options)
    start, goal = motion.positions[[0, -1]]
    straight = minimum_jerk_motion(start, goal)
    mean = primitive.basis.shape(np.zeros(primitive.n_components), FINE_PHASES)
    truth = motion.time_normalised(FINE_PHASES.size)
    predictions = (
        straight,
        straight + mean,
        expected_motion(primitive, start, goal, motion.duration),
    )
    return np.array([differences(x, truth) for x in predictions])


def prediction_errors(primitive: MovementPrimitive, motions: Sequence[Demonstration]) -> FloatArray:
    """Path errors of predicted motions, see :meth:`.MovementPrimitive.errors`."""
    errors = []
    for motion in motions:
        if motion.joint_names != primitive.joint_names:
            raise PrimitiveError(
                f"a motion of '{motion.recording}' has the joints "
                f"{quote_names(motion.joint_names)}, not those of primitive '{primitive.name}', "
                f"{quote_names(primitive.joint_names)}, in this order"
            )
        truth = motion.time_normalised(FINE_PHASES.size)
        start, goal = motion.positions[[0, -1]]
        expected = expected_motion(primitive, start, goal, motion.duration)
        errors.append(path_difference(expected, truth))
    return np.array(errors)


def minimum_jerk_motion(start: FloatArray, goal: FloatArray) -> FloatArray:
    """The minimum-jerk motion between two positions at the fine phases, (1001, n_joints)."""
    return np.asarray(start + hermite_functions(FINE_PHASES)[:, 3:4] * (goal - start))


def expected_motion(
    primitive: MovementPrimitive, start: FloatArray, goal: FloatArray, duration: float
) -> FloatArray:
    """The prediction of a primitive for a request, at the fine phases, (1001, n_joints)."""
    expected = primitive.model.predict(start, goal, duration)
    basis = primitive.paced_basis(start, goal, expected.pace)
    return minimum_jerk_motion(start, goal) + basis.shape(expected.weights, FINE_PHASES)
