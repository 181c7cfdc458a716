# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the demonstrations expect of a request, by Gaussian-process regression.

A prediction is a sum of what the demonstrations did, each with a share that depends on how the
request relates to theirs (Rasmussen and Williams, "Gaussian Processes for Machine Learning",
2006, chapter 2). Its prior mean is zero: what the demonstrations don't tell is not made up. How
smooth, how noisy, and how far common to all the outputs are is chosen by leaving each
demonstration out (there, section 5.4.2).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray

# The kernels tried, in units of the demonstrations' spread and of the variance of what depends
# on the request.
_INVERSE_LENGTHS = (0.0, 0.5, 1.0, 2.0)
_NOISES = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
_CONSTANTS = (0.0, 0.1, 1.0, 10.0, 100.0, 1000.0)
# Noise beside which nothing depends on the request, and constants relative to it: from nothing
# at all to the plain mean.
_NOTHING_BUT_NOISE = 1e6
_SHARES_OF_MEAN = (0.0, 0.03, 0.1, 0.3, 1.0, 10.0, 1000.0)
# The stiffest kernel whose error exceeds the least by no more than this many standard errors of
# the difference is taken: with 0 predictions of a few motions were worse than minimum-jerk ones,
# with 1 much of what is gained was given away.
_STANDARD_ERRORS = 0.5
_FEWEST = 3


class Kernel(NamedTuple):
    """Prior of the outputs at two requests x and y that are d apart: k(x, y).

    Attributes
    ----------
    inverse_length : float
        1/ℓ of exp(−d²/2ℓ²), in units of the spread of the requests, their RMS distance from the
        mean; 0: linear, xᵀy.
    noise : float
        Variance of what the request does not tell.
    constant : float
        Added to k: variance of what is common to all.
    """

    inverse_length: float
    noise: float
    constant: float


PLAIN_MEAN = Kernel(0.0, _NOTHING_BUT_NOISE, _NOTHING_BUT_NOISE * 1000.0)
"""The kernel that predicts the mean of the demonstrations whatever is asked."""


class Regression:
    """Shares of the demonstrations in what is expected of a request.

    Parameters
    ----------
    inputs : array, shape (n_demonstrations, n_inputs)
        Requests that the demonstrations answer.
    kernel : Kernel
        The prior.
    """

    def __init__(self, inputs: FloatArray, kernel: Kernel) -> None:
        self._mean = inputs.mean(axis=0)
        deviations = inputs - self._mean
        # A spread of zero: all requests are the same, and any unit will do.
        self._spread = float(np.sqrt(np.sum(deviations**2) / len(inputs))) or 1.0
        self._scaled = deviations / self._spread
        self._kernel = kernel
        gram = _gram(self._scaled, self._scaled, kernel.inverse_length)
        self._inverse = np.linalg.inv(gram + kernel.constant + kernel.noise * np.eye(len(inputs)))

    def shares(self, request: FloatArray) -> FloatArray:
        """Share of each demonstration in the prediction for a request, shape (n,)."""
        scaled = ((request - self._mean) / self._spread)[None]
        similar = _gram(scaled, self._scaled, self._kernel.inverse_length)[0]
        return np.asarray((similar + self._kernel.constant) @ self._inverse)

    def left_out(self, outputs: FloatArray) -> FloatArray:
        """Outputs minus what the other demonstrations predict, shape (n, n_outputs)."""
        return np.asarray((self._inverse @ outputs) / np.diag(self._inverse)[:, None])


def choose_kernel(inputs: FloatArray, outputs: FloatArray) -> Kernel:
    """Choose the kernel by leave-one-out error.

    Parameters
    ----------
    inputs : array, shape (n_demonstrations, n_inputs)
        Requests.
    outputs : array, shape (n_demonstrations, n_outputs)
        What to predict; their squared differences, summed, are the error.
    """
    n = len(inputs)
    if n < _FEWEST or not np.any(outputs):
        return PLAIN_MEAN
    kernels, errors, freedom = [], [], []
    for kernel, squared, used in _left_out_errors(inputs, outputs):
        kernels.append(kernel)
        errors.append(squared)
        freedom.append(used)
    excess = np.array(errors) - errors[int(np.argmin(np.mean(errors, axis=1)))]
    allowed = _STANDARD_ERRORS * excess.std(axis=1, ddof=1) / np.sqrt(n)
    good = np.flatnonzero(excess.mean(axis=1) <= allowed)
    return kernels[int(good[np.argmin(np.array(freedom)[good])])]


def _left_out_errors(
    inputs: FloatArray, outputs: FloatArray
) -> Iterator[tuple[Kernel, FloatArray, float]]:
    """Every kernel, its squared error for each demonstration, and its degrees of freedom."""
    deviations = inputs - inputs.mean(axis=0)
    spread = float(np.sqrt(np.sum(deviations**2) / len(inputs))) or 1.0
    scaled = deviations / spread
    families: list[tuple[float, float, tuple[float, ...]]] = [
        (inverse_length, constant, _NOISES)
        for inverse_length in _INVERSE_LENGTHS
        for constant in _CONSTANTS
    ]
    families += [
        (0.0, _NOTHING_BUT_NOISE * share, (_NOTHING_BUT_NOISE,)) for share in _SHARES_OF_MEAN
    ]
    for inverse_length, constant, noises in families:
        gram = _gram(scaled, scaled, inverse_length) + constant
        values, vectors = np.linalg.eigh(gram)
        values = np.maximum(values, 0.0)
        projected = vectors.T @ outputs
        for noise_variance in noises:
            inverse = 1.0 / (values + noise_variance)
            residual = (vectors * inverse) @ projected
            residual /= (vectors**2 @ inverse)[:, None]
            yield (
                Kernel(inverse_length, noise_variance, constant),
                np.sum(residual**2, axis=1),
                float(values @ inverse),
            )


def _gram(x: FloatArray, y: FloatArray, inverse_length: float) -> FloatArray:
    if inverse_length == 0.0:
        return np.asarray(x @ y.T)
    squared = np.sum((x[:, None] - y[None]) ** 2, axis=2)
    return np.asarray(np.exp(-0.5 * inverse_length**2 * squared))
