# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Gaussian-process regression on requests."""

import numpy as np
import pytest

from mp_pca_planner.primitives.regression import (
    PLAIN_MEAN,
    Kernel,
    Regression,
    _left_out_errors,
    choose_kernel,
)

RNG = np.random.default_rng(5)
X = RNG.normal(size=(14, 3))
Y = X @ RNG.normal(size=(3, 2)) + 0.3 * RNG.normal(size=(14, 2))
KERNELS = [Kernel(0.0, 0.3, 10.0), Kernel(1.0, 0.1, 0.0), Kernel(2.0, 3.0, 1.0), PLAIN_MEAN]


def posterior_mean(x, y, request, kernel, origin, spread):
    """The textbook formula, written out."""
    a, b = (x - origin) / spread, (request - origin) / spread

    def k(u, v):
        similar = u @ v
        if kernel.inverse_length:
            similar = np.exp(-0.5 * kernel.inverse_length**2 * np.sum((u - v) ** 2))
        return similar + kernel.constant

    gram = np.array([[k(u, v) for v in a] for u in a]) + kernel.noise * np.eye(len(a))
    return np.array([k(b, u) for u in a]) @ np.linalg.solve(gram, y)


def origin_and_spread(x):
    origin = x.mean(axis=0)
    return origin, np.sqrt(np.sum((x - origin) ** 2) / len(x))


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_prediction_is_the_mean_of_the_posterior(kernel):
    request = np.array([0.3, -0.5, 1.0])
    found = Regression(X, kernel).shares(request) @ Y
    expected = posterior_mean(X, Y, request, kernel, *origin_and_spread(X))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("kernel", KERNELS)
def test_what_is_left_out_is_predicted_by_the_others(kernel):
    # Origin and unit are those of the whole set, as in the closed form.
    found = Regression(X, kernel).left_out(Y)
    for i in range(len(X)):
        keep = np.arange(len(X)) != i
        guess = posterior_mean(X[keep], Y[keep], X[i], kernel, *origin_and_spread(X))
        np.testing.assert_allclose(found[i], Y[i] - guess, rtol=1e-4, atol=1e-5)


def test_errors_of_all_kernels_are_those_of_leaving_one_out():
    for kernel, squared, freedom in _left_out_errors(X, Y):
        expected = np.sum(Regression(X, kernel).left_out(Y) ** 2, axis=1)
        np.testing.assert_allclose(squared, expected, rtol=1e-4)
        assert -1e-9 <= freedom <= len(X)


def test_the_plain_mean_is_the_mean_everywhere():
    found = Regression(X, PLAIN_MEAN).shares(np.full(3, 9.0)) @ Y
    np.testing.assert_allclose(found, Y.mean(axis=0), rtol=1e-2, atol=1e-3)


def test_what_can_be_predicted_is_and_noise_is_not():
    x = np.random.default_rng(4).normal(size=(40, 2))
    noise = np.random.default_rng(6).normal(size=(40, 3))
    waves = np.sin(2.0 * x[:, :1])
    errors = {}
    for name, y in (("linear", x[:, :1] * 2.0), ("waves", waves), ("noise", noise)):
        left = Regression(x, choose_kernel(x, y)).left_out(y)
        errors[name] = np.mean(left**2) / np.mean(y**2)
    assert errors["linear"] < 0.01
    assert errors["waves"] < 0.2
    assert 0.9 < errors["noise"] < 1.15


def test_nothing_in_common_is_not_made_up():
    """Where outputs scatter about zero, zero is predicted and not their accidental mean."""
    y = np.random.default_rng(8).normal(size=(30, 5))
    x = np.random.default_rng(9).normal(size=(30, 2))
    found = Regression(x, choose_kernel(x, y)).shares(x.mean(axis=0)) @ y
    assert np.abs(found).max() < np.abs(y.mean(axis=0)).max()


@pytest.mark.parametrize("n", [1, 2])
def test_of_one_or_two_the_mean_is_taken(n):
    assert choose_kernel(X[:n], Y[:n]) == PLAIN_MEAN


def test_requests_that_never_vary_predict_the_mean():
    same = np.ones((8, 2))
    kernel = choose_kernel(same, np.arange(8.0)[:, None] + 20.0)
    found = Regression(same, kernel).shares(np.ones(2)) @ (np.arange(8.0) + 20.0)
    assert found == pytest.approx(23.5, rel=0.1)
