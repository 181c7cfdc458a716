# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions that a primitive predicts for a request, as trajectories."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import FloatArray, frozen_array
from ..exceptions import GoalError
from ..motion.trajectory import Trajectory
from .boundary import boundary_values, quintics

if TYPE_CHECKING:
    from .conditional_model import ConditionalDistribution
    from .primitive import MovementPrimitive


def expected_motion(
    primitive: MovementPrimitive,
    start: ArrayLike,
    goal: ArrayLike,
    duration: float | None = None,
) -> Trajectory:
    """The motion that a primitive expects from rest to rest.

    Limits of a robot are not considered: the planner does that.

    Parameters
    ----------
    primitive : MovementPrimitive
        Any primitive.
    start, goal : array, shape (n_joints,)
        End points [rad or m].
    duration : float, optional
        Duration [s]; the expected one unless given.

    Raises
    ------
    GoalError
        If an end point has another shape or is not finite, or the duration is not positive.
    """
    ends, expected = _request(primitive, start, goal, duration)
    return _motion(primitive, ends, expected, expected.weights)


def drawn_motions(
    primitive: MovementPrimitive, n: int, start: ArrayLike, goal: ArrayLike, seed: int = 0
) -> list[Trajectory]:
    """Draw motions from the conditional distribution of a request.

    Weights are drawn; duration and time scaling are the expected ones.

    Parameters
    ----------
    primitive : MovementPrimitive
        Any primitive.
    n : int
        Number of motions.
    start, goal : array, shape (n_joints,)
        End points [rad or m].
    seed : int
        Seed of the random numbers.

    Raises
    ------
    GoalError
        If an end point has another shape or is not finite, or `n` is no number of motions.
    """
    if not isinstance(n, int) or n < 0:
        raise GoalError(f"the number of motions must be 0 or a positive integer, got {n!r:.80}")
    ends, expected = _request(primitive, start, goal, None)
    rng = np.random.default_rng(seed)
    draws = rng.multivariate_normal(expected.weights, expected.covariance, n)
    return [_motion(primitive, ends, expected, weights) for weights in draws]


def _request(
    primitive: MovementPrimitive, start: ArrayLike, goal: ArrayLike, duration: float | None
) -> tuple[FloatArray, ConditionalDistribution]:
    """End points, shape (2, n_joints), and the prediction for them."""
    shape = (primitive.n_joints,)
    ends = [
        frozen_array(x, shape, what, GoalError) for x, what in ((start, "start"), (goal, "goal"))
    ]
    if duration is not None and not (np.isfinite(duration) and duration > 0.0):
        raise GoalError(f"the duration must be a positive number of seconds, got {duration}")
    return np.array(ends), primitive.model.predict(ends[0], ends[1], duration)


def _motion(
    primitive: MovementPrimitive,
    ends: FloatArray,
    expected: ConditionalDistribution,
    weights: FloatArray,
    sample_period: float = 0.01,
) -> Trajectory:
    """A motion with points at most `sample_period` apart [s], as the planner's by default."""
    duration = expected.duration
    phases = np.linspace(0.0, 1.0, max(int(np.ceil(duration / sample_period)), 1) + 1)
    rest = np.zeros(primitive.n_joints)
    boundary = boundary_values((ends[0], rest, rest), (ends[1], rest, rest), duration)
    shapes = primitive.paced_basis(ends[0], ends[1], expected.pace).shapes(weights, phases, 2)
    q, v, a = (quintics(phases, boundary, 2) + shapes) / duration ** np.arange(3.0)[:, None, None]
    # A controller refuses a final velocity of 1e-17.
    q[[0, -1]], v[[0, -1]], a[[0, -1]] = ends, 0.0, 0.0
    return Trajectory(primitive.joint_names, duration * phases, q, v, a)


def nearest_demonstrations(primitive: MovementPrimitive, ends: FloatArray) -> NDArray[np.intp]:
    """Indices of the demonstrations by the distance of their ends from given ones.

    Parameters
    ----------
    primitive : MovementPrimitive
        The primitive.
    ends : array, shape (2, n_joints)
        Start and goal [rad or m]; distances are in units of the demonstrations' spread.
    """
    own = primitive.boundary_states[:, [0, 3]]
    spread = own.std(axis=0) + 1e-3  # bounds the weight of a joint that never moved
    return np.argsort(np.sum(((own - ends) / spread) ** 2, axis=(1, 2)))
