# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Gaussian-process regression on requests."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from mp_pca_planner.primitives.regression import (
    NOTHING,
    PLAIN_MEAN,
    Elsewhere,
    Kernel,
    Regression,
    _scores,
    choose_kernels,
)

RNG = np.random.default_rng(5)
# Two joints and a duration; two outputs, of which the second changes its sign on the way back.
X = RNG.normal(size=(9, 5))
Y = X @ RNG.normal(size=(5, 2)) + 0.3 * RNG.normal(size=(9, 2))
SIGNS = np.array([1.0, -1.0])
KERNELS = [
    Kernel(0.0, 0.3, 10.0),
    Kernel(1.0, 0.1, 0.0),
    Kernel(2.0, 3.0, 1.0, 0.8),
    Kernel(0.0, 0.1, 1.0, -0.5),
    Kernel(1.5, 0.1, 1.0, -0.8, 0.5),
    Kernel(0.0, 0.1, 2.0, 0.3, 1.0),
    PLAIN_MEAN,
]


def reversed_requests(x):
    return x[..., [2, 3, 0, 1, 4]]


def prior(a, b, kernel, x):
    """Covariance of both outputs at requests a and b, written out, shape (2,) (diagonal)."""
    origin, spread = x.mean(axis=0), np.sqrt(np.sum(x.var(axis=0)))
    if kernel.inverse_length == 0.0 and kernel.reversal:
        origin = (origin + reversed_requests(origin)) / 2.0

    def similar(u, v):
        if kernel.inverse_length:
            ratio = np.sqrt(5.0) * np.linalg.norm(u - v) / spread * kernel.inverse_length
            return size(a) * size(b) * (1.0 + ratio + ratio**2 / 3.0) * np.exp(-ratio)
        return (u - origin) @ (v - origin) / spread**2

    def size(u):
        way = np.sum((u[2:4] - u[:2]) ** 2)
        return (way / np.mean(np.sum((x[:, 2:4] - x[:, :2]) ** 2, axis=1)) + 0.09) ** (
            kernel.growth / 2.0
        )

    one_way = similar(a, b) + kernel.constant * size(a) * size(b)
    back = similar(a, reversed_requests(b)) + kernel.constant * size(a) * size(b)
    return one_way + kernel.reversal * SIGNS * back, kernel.noise * size(a) ** 2


def covariance(x, kernel, output, units):
    gram = np.array([[prior(a, b, kernel, units)[0][output] for b in x] for a in x])
    return gram + np.diag([prior(a, a, kernel, units)[1] for a in x])


def posterior_mean(x, y, request, kernel, units):
    """The textbook formula, output by output."""
    found = []
    for output in range(2):
        shares = np.array([prior(request, a, kernel, units)[0][output] for a in x])
        found.append(shares @ np.linalg.solve(covariance(x, kernel, output, units), y[:, output]))
    return np.array(found)


def regression(x, y, *kernels):
    return Regression(x, y, y * SIGNS, [(1.0 / len(kernels), kernel) for kernel in kernels])


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_prediction_is_the_mean_of_the_posterior(kernel):
    request = np.array([0.3, -0.5, 1.0, 0.2, -0.4])
    found = regression(X, Y, kernel).predict(request)
    np.testing.assert_allclose(
        found, posterior_mean(X, Y, request, kernel, X), rtol=1e-5, atol=1e-6
    )


@pytest.mark.parametrize("kernel", KERNELS)
def test_what_is_left_out_is_predicted_by_the_others(kernel):
    # Origin and units are those of the whole set, as in the closed form.
    found = regression(X, Y, kernel).left_out
    for i in range(len(X)):
        keep = np.arange(len(X)) != i
        guess = posterior_mean(X[keep], Y[keep], X[i], kernel, X)
        np.testing.assert_allclose(found[i], Y[i] - guess, rtol=1e-4, atol=1e-5)


def test_predictions_of_several_kernels_are_averaged():
    request = np.array([0.3, -0.5, 1.0, 0.2, -0.4])
    both, first, second = (
        regression(X, Y, *some) for some in (KERNELS[3:5], KERNELS[3:4], KERNELS[4:5])
    )
    mean = (first.predict(request) + second.predict(request)) / 2.0
    np.testing.assert_allclose(both.predict(request), mean, rtol=1e-9)
    np.testing.assert_allclose(both.left_out, (first.left_out + second.left_out) / 2.0, rtol=1e-9)


def test_the_farther_a_request_the_more_count_kernels_for_elsewhere():
    activities = np.array([0, 1, 1, 0, 0, 2, 2, 2, 2.0])
    here, there = ([(1.0, kernel)] for kernel in KERNELS[1:3])
    both = Regression(X, Y, Y * SIGNS, here, Elsewhere(there, activities))
    one, other = (Regression(X, Y, Y * SIGNS, mixture) for mixture in (here, there))
    np.testing.assert_allclose(both.predict(X[2]), one.predict(X[2]), atol=0.01)
    np.testing.assert_allclose(both.predict(X[2] + 1e9), other.predict(X[2] + 1e9), rtol=1e-6)
    # As probable as distances like these are among those of demonstrations from others.
    distances = np.linalg.norm(X[:, None] - X, axis=2)
    nearest, unlike = (
        np.log(np.where(out, np.inf, distances).min(axis=1))
        for out in (np.eye(len(X), dtype=bool), activities[:, None] == activities)
    )
    deviation = np.sqrt((nearest.var() + unlike.var()) / 2.0)
    densities = [norm.pdf(nearest, x.mean(), deviation) for x in (nearest, unlike)]
    share = (densities[0] / sum(densities))[:, None]
    expected = share * one.left_out + (1.0 - share) * other.left_out
    np.testing.assert_allclose(both.left_out, expected, rtol=1e-3)


@pytest.mark.parametrize("activities", [None, np.array([0, 1, 1, 0, 0, 2, 2, 2, 2.0])])
def test_scores_are_densities_of_what_is_left_out(activities):
    """Up to a constant, and with the variance that makes them highest, as the textbook has it."""
    groups = np.arange(len(X)) if activities is None else activities
    found, expected = [], []
    for kernel, score in _scores(X, Y[:, :1], Y[:, 1:], 0.5, activities):
        if kernel == NOTHING or kernel.noise > 1.0:
            continue
        errors = []
        for output in range(2):
            whole = covariance(X, kernel, output, X)
            for i in range(len(X)):
                keep = groups != groups[i]
                shares = np.linalg.solve(whole[np.ix_(keep, keep)], whole[keep, i])
                variance = whole[i, i] - shares @ whole[keep, i]
                errors.append((Y[i, output] - shares @ Y[keep, output], variance))
        residuals, variances = np.array(errors).T
        scale = np.mean(residuals**2 / variances)
        logarithms = [
            multivariate_normal.logpdf(r, cov=scale * v)
            for r, v in zip(residuals, variances, strict=True)
        ]
        found.append(score)
        expected.append(sum(logarithms) / 2.0)
    assert len(found) == 18
    np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-6, atol=1e-9)


def test_the_plain_mean_is_the_mean_everywhere_and_nothing_is_zero():
    far = np.full(5, 9.0)
    mean = Regression(X, Y, Y, [(1.0, PLAIN_MEAN)]).predict(far)
    np.testing.assert_allclose(mean, Y.mean(axis=0), rtol=1e-2, atol=1e-3)
    np.testing.assert_allclose(regression(X, Y, NOTHING).predict(far), 0.0, atol=1e-3)


def shares_left(x, even, odd):
    """Mean square of what is left of outputs left out, as a share of theirs."""
    signs = np.repeat(SIGNS, [even.shape[1], odd.shape[1]])
    y = np.hstack([even, odd])
    left = Regression(x, y, y * signs, choose_kernels(x, even, odd)).left_out
    return np.mean(left**2) / np.mean(y**2)


def test_what_can_be_predicted_is_and_noise_is_not():
    x = np.random.default_rng(4).normal(size=(40, 2))
    noise = np.random.default_rng(6).normal(size=(40, 3))
    nothing = np.zeros((40, 0))
    assert shares_left(x, x[:, :1] * 2.0, nothing) < 0.01
    assert shares_left(x, np.sin(2.0 * x[:, :1]), nothing) < 0.2
    assert 0.9 < shares_left(x, noise, nothing) < 1.1


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_ways_back_are_told_by_ways_there(sign):
    """Each motion and one that retraces it, or mirrors it, teach each other, and others don't."""
    rng = np.random.default_rng(7)
    starts, goals = rng.normal(size=(2, 10, 7))
    there = np.hstack([starts, goals])
    x = np.vstack([there, np.hstack([goals, starts])])
    even, odd = rng.normal(size=(2, 10, 6))
    found = shares_left(x, np.vstack([even, sign * even]), np.vstack([odd, -sign * odd]))
    assert found < 0.3
    assert shares_left(there, even, odd) > 0.9


def test_nothing_in_common_is_not_made_up():
    """Where outputs scatter about zero, zero is predicted and not their accidental mean."""
    y = np.random.default_rng(8).normal(size=(30, 5))
    x = np.random.default_rng(9).normal(size=(30, 2))
    mixture = choose_kernels(x, y, np.zeros((30, 0)))
    found = Regression(x, y, y, mixture).predict(x.mean(axis=0))
    assert np.abs(found).max() < 0.5 * np.abs(y.mean(axis=0)).max()


def test_probabilities_sum_to_one():
    for n in (3, 5, 9):
        mixture = choose_kernels(X[:n], Y[:n, :1], Y[:n, 1:], 0.5)
        assert sum(probability for probability, _ in mixture) == pytest.approx(1.0)
        assert all(probability > 0.0 for probability, _ in mixture)


@pytest.mark.parametrize("n", [1, 2])
def test_of_one_or_two_the_mean_is_taken(n):
    assert choose_kernels(X[:n], Y[:n, :1], Y[:n, 1:]) == [(1.0, PLAIN_MEAN)]


def test_requests_that_never_vary_predict_the_mean():
    same = np.ones((8, 2))
    y = np.arange(8.0)[:, None] + 20.0
    found = Regression(same, y, y, choose_kernels(same, y, np.zeros((8, 0)))).predict(np.ones(2))
    assert found == pytest.approx([23.5], rel=0.1)
