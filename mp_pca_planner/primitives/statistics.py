# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the demonstrations say about a request: weights, pace and duration to expect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, frozen_array
from ..exceptions import PrimitiveFileError
from .regression import Elsewhere, Kernel, Mixture, Regression, WaySizes, choose_kernels

# Of more demonstrations, so many are asked, evenly spread: the time to choose a kernel grows
# with the cube of their number.
_MOST_ASKED = 300

# Variances of shapes grow with the distance from start to goal: small motions are straighter. With
# powers of 0 and 1 errors in benchmarks/naturalness.py are larger.
_GROWTH_OF_SHAPES = 0.5

# Expected durations stay within this many standard deviations of the demonstrated ones.
_MOST_DEVIATIONS = 3.0

# Power of the distance from start to goal with which durations grow, and how sure that is before
# the demonstrations are heard. It is usual that longer ways take longer, but not in proportion; a
# few demonstrations, or ways that are all as long, don't tell.
_DURATION_POWER, _POWER_DEVIATION = 0.5, 0.25

# Deviation that a request may have even in a direction in which the demonstrations don't
# vary, 1 degree (or 17 mm, or 1.7 % of the duration): keeps the in-span score finite.
_FLOOR_DEVIATION = np.deg2rad(1.0)


@dataclass(frozen=True, eq=False)
class Conditional:
    """What is expected of a motion with given end points.

    Attributes
    ----------
    weights : array, shape (n_weights,)
        Expected weights ŵ.
    covariance : array, shape (n_weights, n_weights)
        Their covariance Λ, positive definite.
    precision : array, shape (n_weights, n_weights)
        Λ⁻¹.
    pace : array, shape (n_pace,)
        Expected pace, see :mod:`.pace`; zero: even.
    duration : float
        The duration asked for, or else the expected one [s].
    in_span_score : float
        How far outside the demonstrations the request lies: the Mahalanobis distance of its
        end points (and duration, if given), divided by the square root of their number;
        about 1 for a request like the demonstrations.
    """

    weights: FloatArray
    covariance: FloatArray
    precision: FloatArray
    pace: FloatArray
    duration: float
    in_span_score: float


class RequestStatistics:
    """Requests (q0, qT, log T) that the demonstrations answer, and how they do.

    Parameters
    ----------
    requests : array, shape (n_demonstrations, 2 n_joints + 1)
        q0, qT [rad or m] and log T of each.
    weights : array, shape (n_demonstrations, n_weights)
        Weights of each.
    reversed_weights : array, shape (n_demonstrations, n_weights)
        Weights of each, if it were gone backwards.
    common_weights : array, shape (n_weights,)
        Weights that come nearest to the mean shape: what is added to those of each to tell its
        shape from minimum-jerk rather than from the mean.
    paces, reversed_paces : array, shape (n_demonstrations, n_pace)
        Pace of each, and if it were gone backwards.
    kernels : array, shape (n_kernels, 7)
        What the regressions average over, row by row: 0, 1 or 2 for that of the shape, the pace or
        the duration, the probability, and the entries of the :class:`.Kernel`; of several
        activities, also 3 or 4 for that of the shape or the pace elsewhere, see
        :class:`.Elsewhere`.
    activities : array, shape (n_demonstrations,)
        A number for the activity of each.

    Attributes
    ----------
    mean : array, shape (2 n_joints + 1,)
        Mean request.
    covariance : array, shape (2 n_joints + 1, 2 n_joints + 1)
        Covariance of the requests (zero for a single demonstration).
    """

    def __init__(
        self,
        requests: FloatArray,
        weights: FloatArray,
        reversed_weights: FloatArray,
        common_weights: FloatArray,
        paces: FloatArray,
        reversed_paces: FloatArray,
        kernels: FloatArray,
        activities: FloatArray,
    ) -> None:
        self.kernels = frozen_array(
            kernels, (None, 2 + len(Kernel._fields)), "kernels", PrimitiveFileError
        )
        asked = asked_demonstrations(len(requests))
        shape, pace, duration, *others = _mixtures(self.kernels, activities[asked])
        elsewhere: list[Elsewhere | None] = [
            Elsewhere(mixture, activities[asked]) for mixture in others
        ] or [None, None]
        self.mean = requests.mean(axis=0)
        centred = requests - self.mean
        self.covariance = centred.T @ centred / max(len(requests) - 1, 1)
        self._common_weights = common_weights
        self._shape = Regression(
            requests[asked],
            weights[asked] + common_weights,
            reversed_weights[asked] + common_weights,
            shape,
            elsewhere[0],
        )
        self._pace = Regression(
            requests[asked], paces[asked], reversed_paces[asked], pace, elsewhere[1]
        )
        self._usual_duration = _UsualDuration(requests[asked])
        log_durations = requests[asked, -1:] - self._usual_duration.logarithm(requests[asked, :-1])
        self._duration = Regression(requests[asked, :-1], log_durations, log_durations, duration)
        self._weight_covariance = _covariance(self._shape.left_out)
        self._weight_precision = np.asarray(np.linalg.inv(self._weight_covariance))
        sizes = (self.mean.size - 1, self.mean.size)
        self._request_precision = {size: self._inverse_covariance(size) for size in sizes}

    def condition(
        self, start: FloatArray, goal: FloatArray, duration: float | None = None
    ) -> Conditional:
        """Condition on a request.

        Parameters
        ----------
        start, goal : array, shape (n_joints,)
            End points [rad or m].
        duration : float, optional
            Duration [s]; the expected one unless given.
        """
        ends = np.concatenate([start, goal])
        if duration is None:
            usual = self._usual_duration.logarithm(ends) + self._duration.predict(ends)
            # A request far away must not make a motion of hours out of a linear trend.
            reach = _MOST_DEVIATIONS * np.sqrt(self.covariance[-1, -1])
            expected = self.mean[-1] + np.clip(usual[0] - self.mean[-1], -reach, reach)
            score = self._score(ends)
            duration = float(np.exp(expected))
            request = np.append(ends, expected)
        else:
            request = np.append(ends, np.log(duration))
            score = self._score(request)
        weights = self._shape.predict(request) - self._common_weights
        pace = self._pace.predict(request)
        return Conditional(
            weights, self._weight_covariance, self._weight_precision, pace, duration, score
        )

    def request_precision(self, size: int) -> FloatArray:
        """Inverse of the covariance of the first entries of requests, as scores use it.

        Parameters
        ----------
        size : int
            Number of entries: 2 n_joints for the end points, one more for the duration, too.
        """
        return self._request_precision[size]

    def _inverse_covariance(self, size: int) -> FloatArray:
        variance = self.covariance[:size, :size] + _FLOOR_DEVIATION**2 * np.eye(size)
        return np.asarray(np.linalg.inv(variance))

    def _score(self, given: FloatArray) -> float:
        """Distance of the first entries of a request from the demonstrated ones."""
        deviation = given - self.mean[: given.size]
        distance = deviation @ self._request_precision[given.size] @ deviation
        return float(np.sqrt(distance / given.size))


class _UsualDuration:
    """Durations as a power of the distance from start to goal.

    Parameters
    ----------
    requests : array, shape (n_demonstrations, 2 n_joints + 1)
        q0, qT [rad or m] and log T of each.
    """

    def __init__(self, requests: FloatArray) -> None:
        self._size_of = WaySizes(requests)
        self._mean, self._power = float(requests[:, -1].mean()), 0.0
        sizes, durations = np.log(self._size_of(requests)), requests[:, -1] - self._mean
        self._mean_size = float(sizes.mean())
        sizes -= self._mean_size
        # Bayesian regression with one coefficient, whose prior is a normal distribution.
        told = float(sizes @ sizes)
        power = float(sizes @ durations) / told if told > 0.0 else 0.0
        errors = durations - power * sizes
        variance = float(errors @ errors) / max(len(requests) - 2, 1)
        prior = variance / _POWER_DEVIATION**2
        if told + prior > 0.0:
            power = (told * power + prior * _DURATION_POWER) / (told + prior)
            self._power = min(max(power, 0.0), 1.0)

    def logarithm(self, ends: FloatArray) -> FloatArray:
        """Of the usual duration [s] between start and goal, shape (..., 1)."""
        grown = self._power * (np.log(self._size_of(ends)) - self._mean_size)
        return np.asarray(self._mean + grown[..., None])


def find_kernels(
    requests: FloatArray, shapes: FloatArray, aligned_phases: FloatArray, activities: FloatArray
) -> FloatArray:
    """Find how probable kernels are by what they predict of demonstrations left out.

    For requests elsewhere, by what they predict of activities left out, if there are several. For
    durations that makes no difference.

    Parameters
    ----------
    requests : array, shape (n_demonstrations, 2 n_joints + 1)
        q0, qT [rad or m] and log T of each.
    shapes : array, shape (n_demonstrations, n_joints, n_functions)
        Coefficients of the shapes in orthonormal functions, the first of which is even about the
        middle of the motion, the second odd, and so on.
    aligned_phases : array, shape (n_demonstrations, n_shares)
        Aligned phases at evenly spaced shares of the duration, less those shares.
    activities : array, shape (n_demonstrations,)
        A number for the activity of each.

    Returns
    -------
    kernels : array, shape (n_kernels, 7)
        As :class:`RequestStatistics` takes them.
    """
    asked = asked_demonstrations(len(requests))
    requests, shapes, phases = requests[asked], shapes[asked], aligned_phases[asked]
    even, odd = (shapes[:, :, k::2].reshape(len(asked), -1) for k in (0, 1))
    backwards = -phases[:, ::-1]
    log_durations = requests[:, -1:] - _UsualDuration(requests).logarithm(requests[:, :-1])
    shape = requests, even, odd, _GROWTH_OF_SHAPES
    pace = requests, (phases + backwards) / 2.0, (phases - backwards) / 2.0, 0.0
    mixtures = [
        choose_kernels(*shape),
        choose_kernels(*pace),
        choose_kernels(requests[:, :-1], log_durations, np.zeros((len(asked), 0))),
    ]
    if np.any(np.diff(activities[asked])):
        mixtures += [choose_kernels(*x, activities[asked]) for x in (shape, pace)]
    return np.array(
        [
            [which, probability, *kernel]
            for which, mixture in enumerate(mixtures)
            for probability, kernel in mixture
        ]
    )


def _mixtures(kernels: FloatArray, activities: FloatArray) -> list[Mixture]:
    """The kernels of each regression, given the activities of the demonstrations asked."""
    which, probability, inverse_length, noise, constant, reversal, growth = kernels.T
    regressions = range(5 if np.any(np.diff(activities)) else 3)
    if (
        not np.array_equal(np.unique(which), regressions)
        or not np.allclose([probability[which == k].sum() for k in regressions], 1.0)
        or np.any(np.array([probability, inverse_length, constant, growth]) < 0.0)
        or np.any(noise <= 0.0)
        or np.any(np.abs(reversal) > 1.0)
    ):
        raise PrimitiveFileError(
            "kernels must belong to the shape (0), the pace (1) and the duration (2), of several "
            "activities also to the shape (3) and the pace (4) elsewhere, with probabilities that "
            "sum to 1, reversals from -1 to 1, positive noise, and nothing else negative: "
            f"{kernels.tolist()}"
        )
    return [
        [(row[1], Kernel(*row[2:])) for row in kernels[which == k].tolist()] for k in regressions
    ]


def kernels_of_version_2(kernels: FloatArray) -> FloatArray:
    """Kernels of a primitive file of the format version 2, which has one for each regression.

    Inverse lengths were those of squared exponentials: other kernels expect a little else.

    Parameters
    ----------
    kernels : array, shape (3, 3)
        Inverse length, noise and constant of each.

    Raises
    ------
    PrimitiveFileError
        If they have another shape.
    """
    kernels = frozen_array(kernels, (3, 3), "kernels", PrimitiveFileError)
    return np.column_stack([np.arange(3.0), np.ones(3), kernels, np.zeros((3, 2))])


def asked_demonstrations(n_demonstrations: int) -> list[int]:
    """Indices of those that are asked, evenly spread."""
    n = min(n_demonstrations, _MOST_ASKED)
    return [i * n_demonstrations // n for i in range(n)]


def _covariance(errors: FloatArray) -> FloatArray:
    """Covariance of errors about zero, shrunk to its diagonal the more the fewer there are."""
    n, size = errors.shape
    if size == 0:
        return np.zeros((0, 0))
    covariance = errors.T @ errors / n
    diagonal = np.diag(np.diag(covariance))
    shrunk = (n * covariance + size * diagonal) / (n + size)
    floor = 1e-6 * float(diagonal.max())
    return np.asarray(shrunk + max(floor, 1e-12) * np.eye(size))
