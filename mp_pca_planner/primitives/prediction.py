# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions that a primitive predicts for a request, as trajectories."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray, check_number
from ..exceptions import GoalError
from ..input_limits import INPUT_LIMITS
from ..motion.goal import StateLike, joint_positions
from ..motion.trajectory import Trajectory
from .boundary import boundary_values, quintics

if TYPE_CHECKING:
    from .conditional_model import ConditionalDistribution
    from .primitive import MovementPrimitive

_MAX_DRAWS = 10_000


def expected_motion(
    primitive: MovementPrimitive, start: StateLike, goal: StateLike, duration: float | None = None
) -> Trajectory:
    """The motion that a primitive expects from rest to rest.

    Limits of a robot are not considered: the planner does that.

    Parameters
    ----------
    primitive : MovementPrimitive
        Any primitive.
    start, goal : JointState, mapping or array, shape (n_joints,)
        End points [rad or m]. Joints that the goal doesn't name keep their position.
    duration : float, optional
        Duration [s]; the expected one unless given.

    Raises
    ------
    GoalError
        If an end point is none of these or not finite, or the duration is out of its range.
    """
    ends, expected = _request(primitive, start, goal, duration)
    return _motion(primitive, ends, expected, expected.weights)


def drawn_motions(
    primitive: MovementPrimitive, n: int, start: StateLike, goal: StateLike, seed: int = 0
) -> list[Trajectory]:
    """Draw motions from the conditional distribution of a request.

    Weights are drawn; duration and time scaling are the expected ones.

    Parameters
    ----------
    primitive : MovementPrimitive
        Any primitive.
    n : int
        Number of motions.
    start, goal : JointState, mapping or array, shape (n_joints,)
        End points [rad or m]. Joints that the goal doesn't name keep their position.
    seed : int
        Seed of the random numbers.

    Raises
    ------
    GoalError
        If an end point is none of these or not finite, or `n` or `seed` is no whole number of at
        least 0; at most 10,000 motions.
    """
    check_number(n, "the number of motions", GoalError, 0, is_whole=True)
    if n > _MAX_DRAWS:
        raise GoalError(f"at most {_MAX_DRAWS} motions are drawn at once, got {n}")
    check_number(seed, "the seed", GoalError, 0, is_whole=True)
    ends, expected = _request(primitive, start, goal, None)
    rng = np.random.default_rng(seed)
    draws = rng.multivariate_normal(expected.weights, expected.variance * expected.covariance, n)
    return [_motion(primitive, ends, expected, weights) for weights in draws]


def _request(
    primitive: MovementPrimitive, start: StateLike, goal: StateLike, duration: float | None
) -> tuple[FloatArray, ConditionalDistribution]:
    """End points, shape (2, n_joints), and the prediction for them."""
    first = joint_positions(start, primitive.joint_names, "the start")
    last = joint_positions(goal, primitive.joint_names, "the goal", first)
    for position in (*first.tolist(), *last.tolist()):
        limit = INPUT_LIMITS.position
        check_number(position, "a position of the start or the goal", GoalError, -limit, limit)
    if duration is not None:
        check_number(duration, "the duration [s]", GoalError, 1e-3, INPUT_LIMITS.duration)
    expected = primitive.model.predict(first, last, duration)
    longest = INPUT_LIMITS.duration
    check_number(expected.duration, "the predicted duration [s]", GoalError, 0.0, longest)
    return np.array([first, last]), expected


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
