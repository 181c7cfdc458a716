# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the demonstrations expect of a request, by Gaussian-process regression.

A prediction is a sum of what the demonstrations did, each with a share that depends on how the
request relates to theirs (Rasmussen and Williams, "Gaussian Processes for Machine Learning",
2006, chapter 2). Its prior mean is zero: what the demonstrations don't tell is not made up.

How smooth, how noisy, and how far common to all the outputs are can't be told from a few
demonstrations, and neither whether the way back is the way there gone backwards (waving), or
mirrored at the straight line (circles). So no kernel is chosen: predictions of many are
averaged, each as probable as it finds the demonstrations when it is told the others (there,
section 5.4.2; Gelfand's and Dey's pseudo-Bayes factor, 1994).

Demonstrations left out alone tell nothing of activities that were never shown. Where several were
shown, kernels that find whole ones left out are averaged, too: those count where a request is
farther from the demonstrations than they are from each other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray

# The kernels averaged, in units of the demonstrations' spread and of the variance of what depends
# on the request. With more or finer ones, errors in benchmarks/naturalness.py hardly move.
_INVERSE_LENGTHS = (0.0, 1.0, 2.0)
_NOISES = (0.02, 0.2, 2.0)
_REVERSALS = (-0.8, 0.0, 0.8)
_CONSTANT = 10.0
# Noise beside which nothing depends on the request.
_NOTHING_BUT_NOISE = 1e6
# Power of the densities of demonstrations left out: they are not independent, for each is told of
# all others. With 1 paces are predicted worse, with 0.3 shapes.
_TEMPER = 0.7
# The most probable kernels that have this share together are kept.
_KEPT = 0.9
_FEWEST = 3
# Mean square of the distances from start to goal that is added to their squares, so that there is
# variance where a motion ends where it starts.
_NO_WAY = 0.09
# Square of a distance between requests, in their spread, below which they count as the same.
_SAME = 1e-6


class Kernel(NamedTuple):
    """Prior of the outputs at two requests x and y that are d apart: k(x, y).

    Attributes
    ----------
    inverse_length : float
        1/ℓ of (1 + r + r²/3) exp(−r) with r = √5 d/ℓ, in units of the spread of the requests,
        their RMS distance from the mean; 0: linear, xᵀy.
    noise : float
        Variance of what the request does not tell.
    constant : float
        Added to k: variance of what is common to all.
    reversal : float
        Correlation of a motion with the one that goes back, reversed in time, from −1 to 1.
    growth : float
        Power of the distance from start to goal with which outputs grow, deviations but not the
        linear kernel: 0.5 for variances that grow with the distance.
    """

    inverse_length: float
    noise: float
    constant: float
    reversal: float = 0.0
    growth: float = 0.0


Mixture = Sequence[tuple[float, Kernel]]
"""Kernels and their probabilities."""


class Elsewhere(NamedTuple):
    """What to average where a request is unlike the demonstrations.

    Attributes
    ----------
    mixture : sequence of (float, Kernel)
        Probabilities and priors.
    activities : array, shape (n_demonstrations,)
        A number for the activity of each demonstration, of two at least.
    """

    mixture: Mixture
    activities: FloatArray


NOTHING = Kernel(0.0, _NOTHING_BUT_NOISE, 0.0)
"""The kernel that predicts zero whatever is asked: before the demonstrations are heard as probable
as all others together, so that a few of them don't make up much."""

PLAIN_MEAN = Kernel(0.0, _NOTHING_BUT_NOISE, _NOTHING_BUT_NOISE * 1000.0)
"""The kernel that predicts the mean of the demonstrations whatever is asked."""


class Regression:
    """Predictions from demonstrations, averaged over kernels.

    Parameters
    ----------
    inputs : array, shape (n_demonstrations, n_inputs)
        Requests that the demonstrations answer: start, goal, and what stays the same on the way
        back.
    outputs : array, shape (n_demonstrations, n_outputs)
        What they answer.
    reversed_outputs : array, shape (n_demonstrations, n_outputs)
        What they would answer if they went back, reversed in time.
    mixture : sequence of (float, Kernel)
        Probabilities and priors.
    elsewhere : Elsewhere, optional
        The same for requests that are unlike the demonstrations. Both are averaged, as probable as
        it is that an activity is asked for that was shown, or another one.

    Attributes
    ----------
    left_out : array, shape (n_demonstrations, n_outputs)
        Outputs minus what the other demonstrations predict.
    """

    def __init__(
        self,
        inputs: FloatArray,
        outputs: FloatArray,
        reversed_outputs: FloatArray,
        mixture: Mixture,
        elsewhere: Elsewhere | None = None,
    ) -> None:
        mixtures = [mixture] if elsewhere is None else [mixture, elsewhere.mixture]
        self._inputs = _Inputs(inputs)
        # What stays the same on the way back, and what changes its sign, are told apart.
        parts = np.array([outputs + reversed_outputs, outputs - reversed_outputs]) / 2.0
        signs = np.array([1.0, -1.0])[:, None, None]
        squared_distances = self._inputs.squared_distances()
        n, size = outputs.shape
        left_out = np.zeros((len(mixtures), n, size))
        self._linear = np.zeros((len(mixtures), inputs.shape[1] + 1, size))
        # By inverse length and growth: shares of what is similar to the request, of what is
        # similar to its way back, and of all; by mixture.
        self._shares: dict[tuple[float, float], FloatArray] = {}
        for which, probability, kernel in (
            (which, *pair) for which, pairs in enumerate(mixtures) for pair in pairs
        ):
            grown = self._inputs.sizes[:, None] ** kernel.growth
            there, back = self._inputs.grams(squared_distances, kernel)
            constants = kernel.constant * (1.0 + signs * kernel.reversal)
            gram = there + signs * kernel.reversal * back + constants + kernel.noise * np.eye(n)
            inverse = np.linalg.inv(gram)
            found = probability * inverse @ (parts / grown)
            precision = np.diagonal(inverse, axis1=1, axis2=2)[:, :, None]
            left_out[which] += grown * np.sum(found / precision, axis=0)
            ways = np.array([found[0] + found[1], kernel.reversal * (found[0] - found[1])])
            key = kernel.inverse_length, kernel.growth
            shares = self._shares.setdefault(key, np.zeros((len(mixtures), 2 * n + 1, size)))
            shares[which, -1] += np.sum(constants * found, axis=(0, 1))
            if kernel.inverse_length == 0.0:
                self._linear[which] += self._inputs.linear_terms(ways / grown, kernel.reversal)
            else:
                shares[which, :-1] += ways.reshape(2 * n, size)
        self._familiarity = None
        self.left_out = left_out[0]
        if elsewhere is not None:
            self._familiarity = _Familiarity(squared_distances[0], elsewhere.activities)
            familiar = self._familiarity.left_out[:, None]
            self.left_out = familiar * left_out[0] + (1.0 - familiar) * left_out[1]

    def predict(self, request: FloatArray) -> FloatArray:
        """What is expected of a request of shape (n_inputs,), shape (n_outputs,)."""
        scaled, squared, size = self._inputs.relate(request)
        found = np.append(scaled, 1.0) @ self._linear
        for (inverse_length, growth), shares in self._shares.items():
            if inverse_length:
                similar = _similarity(inverse_length, squared).ravel()
                found += size**growth * (similar @ shares[:, :-1] + shares[:, -1])
            else:
                found += size**growth * shares[:, -1]
        if self._familiarity is None:
            return np.asarray(found[0])
        familiar = self._familiarity.of(squared[0].min())
        return np.asarray(familiar * found[0] + (1.0 - familiar) * found[1])


class _Familiarity:
    """How probable it is that an activity is asked for that was shown.

    That follows from the distance of a request from the nearest demonstration, by how far
    demonstrations are from the nearest other one, and from the nearest of another activity: by
    linear discriminant analysis of the logarithms, where neither is more frequent (Hastie,
    Tibshirani and Friedman, "The Elements of Statistical Learning", 2009, section 4.3).

    Parameters
    ----------
    squared_distances : array, shape (n_demonstrations, n_demonstrations)
        Between the demonstrations, in their spread.
    activities : array, shape (n_demonstrations,)
        A number for the activity of each, of two at least.

    Attributes
    ----------
    left_out : array, shape (n_demonstrations,)
        Of each demonstration, told of the others.
    """

    def __init__(self, squared_distances: FloatArray, activities: FloatArray) -> None:
        same_activity = activities[:, None] == activities
        one, other = (
            np.where(excluded, np.inf, squared_distances).min(axis=1)
            for excluded in (np.eye(len(activities), dtype=bool), same_activity)
        )
        logarithms = np.log(np.array([one, other]) + _SAME)
        means = logarithms.mean(axis=1)
        self._middle = float(means.mean())
        self._slope = float(np.diff(means)[0] / max(logarithms.var(axis=1).mean(), _SAME))
        self.left_out = self.of(one)

    def of(self, squared_distance: FloatArray) -> FloatArray:
        """Of requests, given the squares of their distances from the nearest demonstration."""
        further = np.log(squared_distance + _SAME) - self._middle
        # The logistic function, which exponentials might overflow.
        return np.asarray(0.5 - 0.5 * np.tanh(0.5 * self._slope * further))


def choose_kernels(
    inputs: FloatArray,
    even: FloatArray,
    odd: FloatArray,
    growth: float = 0.0,
    activities: FloatArray | None = None,
) -> list[tuple[float, Kernel]]:
    """Find how probable kernels are by what they predict of demonstrations left out.

    Parameters
    ----------
    inputs : array, shape (n_demonstrations, n_inputs)
        Requests.
    even, odd : array, shape (n_demonstrations, any)
        Outputs that keep their sign, and such that change it, if a motion is reversed in time;
        their squared differences, summed, are the error.
    growth : float
        Of all kernels.
    activities : array, shape (n_demonstrations,), optional
        Numbers of activities that are left out one by one; by default each demonstration is.

    Returns
    -------
    mixture : list of (float, Kernel)
        The most probable kernels first.
    """
    n = len(inputs)
    outputs = np.hstack([even, odd])
    if n < _FEWEST or not np.any(outputs):
        return [(1.0, PLAIN_MEAN)]
    squares = outputs @ outputs.T
    # As many independent outputs as these correlated ones are worth.
    freedom = np.trace(squares) ** 2 / np.sum(squares**2)
    kernels, scores = zip(*_scores(inputs, even, odd, growth, activities), strict=True)
    logarithms = _TEMPER * freedom * np.array(scores)
    logarithms[kernels.index(NOTHING)] += np.log(len(kernels) - 1)
    probabilities = np.exp(logarithms - logarithms.max())
    probabilities /= probabilities.sum()
    order = np.argsort(-probabilities, kind="stable")
    enough = int(np.searchsorted(np.cumsum(probabilities[order]), _KEPT)) + 1
    kept = order[:enough]
    total = probabilities[kept].sum()
    return [(float(probabilities[i] / total), kernels[i]) for i in kept]


def _scores(
    inputs: FloatArray,
    even: FloatArray,
    odd: FloatArray,
    growth: float,
    activities: FloatArray | None = None,
) -> Iterator[tuple[Kernel, float]]:
    """Every kernel and the logarithm of the density it gives to each output, left out.

    That is for one independent output, less what is the same for all kernels. The variance of
    what depends on the request is the one that makes it highest.
    """
    related = _Inputs(inputs)
    grown = related.sizes[:, None] ** growth
    parts = even / grown, odd / grown
    shares = np.array([even.shape[1], odd.shape[1]]) / (even.shape[1] + odd.shape[1])
    n = len(inputs)
    yield NOTHING, -0.5 * n * float(np.log(np.mean(sum(np.sum(x**2, axis=1) for x in parts))))
    squared_distances = related.squared_distances()
    groups = None
    if activities is not None:
        groups = [np.flatnonzero(activities == activity) for activity in np.unique(activities)]
    for inverse_length in _INVERSE_LENGTHS:
        spectra = {}
        for reversal in _REVERSALS:
            kernel = Kernel(inverse_length, 0.0, _CONSTANT, reversal, growth)
            there, back = related.grams(squared_distances, kernel)
            gram = there + reversal * back + kernel.constant * (1.0 + reversal)
            spectra[reversal] = np.linalg.eigh(gram)
        for reversal, noise in product(_REVERSALS, _NOISES):
            errors, log_precision = np.zeros(n), 0.0
            for sign, part, share in zip((1.0, -1.0), parts, shares, strict=True):
                values, vectors = spectra[sign * reversal]
                roots = vectors / np.sqrt(np.maximum(values, 0.0) + noise)
                residuals, variances = _left_out(roots, part, groups)
                errors += np.sum(residuals**2, axis=1) / variances
                log_precision -= share * float(np.sum(np.log(variances)))
            score = 0.5 * (log_precision - n * float(np.log(np.mean(errors))))
            yield Kernel(inverse_length, noise, _CONSTANT, reversal, growth), score


def _left_out(
    roots: FloatArray, outputs: FloatArray, groups: Sequence[NDArray[np.intp]] | None
) -> tuple[FloatArray, FloatArray]:
    """Outputs minus what the other groups predict, and the variances of that.

    Without refitting (Rasmussen and Williams, equations 5.10 to 5.12, with blocks of the inverse
    covariance for its entries).

    Parameters
    ----------
    roots : array, shape (n_demonstrations, n_demonstrations)
        The inverse of the covariance is this, times its transpose.
    outputs : array, shape (n_demonstrations, n_outputs)
        What is predicted.
    groups : sequence of arrays of int, optional
        Demonstrations that are left out together; by default each alone.
    """
    residuals = roots @ (roots.T @ outputs)
    if groups is None:
        variances = 1.0 / np.sum(roots**2, axis=1)
        return residuals * variances[:, None], variances
    variances = np.empty(len(roots))
    for group in groups:
        covariance = np.linalg.inv(roots[group] @ roots[group].T)
        residuals[group] = covariance @ residuals[group]
        variances[group] = np.diag(covariance)
    return residuals, variances


def _similarity(inverse_length: float, squared_distances: FloatArray) -> FloatArray:
    """Matérn's covariance of smoothness 5/2 (Rasmussen and Williams, equation 4.17).

    Smoother ones overshoot between and beyond demonstrations: with squared exponentials activities
    of which none was shown are expected worse, and motions left out no better.
    """
    scaled = np.sqrt(5.0 * squared_distances) * inverse_length
    return np.asarray((1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled))


class WaySizes:
    """Distances from start to goal in units of the usual one, bounded from below.

    Parameters
    ----------
    requests : array, shape (n_demonstrations, n_entries)
        Start, goal, and perhaps one entry more of each: the usual ones.
    """

    def __init__(self, requests: FloatArray) -> None:
        self._n_joints = requests.shape[1] // 2
        self._usual_square = float(np.mean(self._squared_ways(requests))) or 1.0

    def __call__(self, requests: FloatArray) -> FloatArray:
        """Of requests of shape (..., n_entries), shape (...)."""
        return np.asarray(np.sqrt(self._squared_ways(requests) / self._usual_square + _NO_WAY))

    def _squared_ways(self, requests: FloatArray) -> FloatArray:
        n = self._n_joints
        return np.asarray(np.sum((requests[..., n : 2 * n] - requests[..., :n]) ** 2, axis=-1))


class _Inputs:
    """Requests, in units of their spread, and those of the ways back.

    Parameters
    ----------
    inputs : array, shape (n_demonstrations, n_inputs)
        See :class:`Regression`.

    Attributes
    ----------
    sizes : array, shape (n_demonstrations,)
        Distances from start to goal in units of the usual one, bounded from below.
    """

    def __init__(self, inputs: FloatArray) -> None:
        self._n_joints = inputs.shape[1] // 2
        self._mean = inputs.mean(axis=0)
        # A spread of zero: all requests are the same, and any unit will do.
        self._spread = float(np.sqrt(np.sum(inputs.var(axis=0)))) or 1.0
        there_and_back = np.array([inputs, self._reversed(inputs)])
        self._scaled = (there_and_back - self._mean) / self._spread
        # Of the linear kernels that know the way back, which is as far from it as the way there.
        self._centre = (self._reversed(self._mean) - self._mean) / (2.0 * self._spread)
        self._size_of = WaySizes(inputs)
        self.sizes = self._size_of(inputs)

    def squared_distances(self) -> FloatArray:
        """Of each demonstration from each and from the way back of each, shape (2, n, n)."""
        there = self._scaled[0]
        return np.array([np.sum((there[:, None] - x) ** 2, axis=2) for x in self._scaled])

    def grams(self, squared_distances: FloatArray, kernel: Kernel) -> tuple[FloatArray, FloatArray]:
        """Similarity of each demonstration with each and with the way back of each."""
        if kernel.inverse_length == 0.0:
            deviations = self._scaled - self._origin(kernel.reversal)
            there, back = deviations / self.sizes[:, None] ** kernel.growth
            return there @ there.T, there @ back.T
        there, back = _similarity(kernel.inverse_length, squared_distances)
        return there, back

    def linear_terms(self, ways: FloatArray, reversal: float) -> FloatArray:
        """What the linear kernel makes of a scaled request and 1, shape (n_inputs + 1, n_outputs).

        Parameters
        ----------
        ways : array, shape (2, n_demonstrations, n_outputs)
            What each contributes by its similarity, and by that of its way back.
        reversal : float
            Of the kernel.
        """
        origin = self._origin(reversal)
        slopes = np.tensordot(self._scaled - origin, ways, axes=((0, 1), (0, 1)))
        return np.concatenate([slopes, -(origin @ slopes)[None]])

    def relate(self, request: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """A scaled request, its squared distances from both ways of each, and its size."""
        scaled = (request - self._mean) / self._spread
        squared = np.sum((self._scaled - scaled) ** 2, axis=2)
        return scaled, squared, float(self._size_of(request))

    def _origin(self, reversal: float) -> FloatArray:
        return self._centre if reversal else np.zeros_like(self._centre)

    def _reversed(self, requests: FloatArray) -> FloatArray:
        n = self._n_joints
        starts, goals, rest = np.split(requests, [n, 2 * n], axis=-1)
        return np.concatenate([goals, starts, rest], axis=-1)
