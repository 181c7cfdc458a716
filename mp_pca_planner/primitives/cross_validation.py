# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Leave-one-out errors of predicted motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..exceptions import PrimitiveError, quote_names
from ..motion.interpolation import hermite_functions
from ..recordings.demonstration import Demonstration
from .build import build_primitive
from .differences import FINE_PHASES, by_way, differences
from .options import PrimitiveOptions
from .primitive import MovementPrimitive


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
    straight = minimum_jerk_motion(motion)
    mean = primitive.basis.shape(np.zeros(primitive.n_components), FINE_PHASES)
    truth = motion.time_normalised(FINE_PHASES.size)
    predictions = (straight, straight + mean, expected_motion(primitive, motion))
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
        difference = by_way(expected_motion(primitive, motion)) - by_way(truth)
        errors.append(np.sqrt(np.mean(difference**2)))
    return np.array(errors)


def minimum_jerk_motion(motion: Demonstration) -> FloatArray:
    """The minimum-jerk motion between the ends of a motion, at the fine phases."""
    start, goal = motion.positions[[0, -1]]
    return np.asarray(start + hermite_functions(FINE_PHASES)[:, 3:4] * (goal - start))


def expected_motion(primitive: MovementPrimitive, motion: Demonstration) -> FloatArray:
    """The prediction of a primitive between the ends of a motion, at the fine phases."""
    start, goal = motion.positions[[0, -1]]
    expected = primitive.model.predict(start, goal, motion.duration)
    basis = primitive.paced_basis(start, goal, expected.pace)
    return minimum_jerk_motion(motion) + basis.shape(expected.weights, FINE_PHASES)
