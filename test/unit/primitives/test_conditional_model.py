# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Prediction of weights, time scaling and duration for a request."""

from itertools import product

import numpy as np
import pytest
from scipy.stats import norm
from support.arm import arm_demonstrations, arm_primitive

from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.primitives.differences import FINE_PHASES, expected_motion, path_difference
from mp_pca_planner.primitives.in_span import request_precision
from mp_pca_planner.primitives.motion_statistics import thinned
from mp_pca_planner.primitives.prediction import ConditionalModel
from mp_pca_planner.recordings.demonstration import Demonstration

# Of the second of two weights; it changes its sign where a motion is reversed in time.
SIGNS = np.array([1.0, -1.0])
STRAIGHT = np.array([3.0, -1.0])


def fit(requests, shapes, reversed_shapes=None, paces=None):
    """A model; outputs are the same in reversed time unless given."""
    n, size = shapes.shape
    used = thinned(requests)
    paces = np.zeros((n, 1)) if paces is None else paces
    return ConditionalModel.fit(
        requests[used],
        np.array([shapes, shapes if reversed_shapes is None else reversed_shapes])[:, used],
        STRAIGHT if size == 2 else np.zeros(size),
        paces[used],
        request_precision(requests),
    )


def predict(model, request):
    """Weights, less those of a straight motion."""
    n = request.size // 2
    found = model.predict(request[:n], request[n : 2 * n], float(np.exp(request[-1])))
    return found.weights - model.straight_weights


def swapped(x):
    return x[..., [2, 3, 0, 1, 4]]


def textbook(x, y, request):
    """Average of Gaussian processes, every covariance written out and every model fitted anew.

    Hyperparameters are those that the module documents.
    """
    spread = np.sqrt(np.sum(x.var(axis=0)))
    mean_square = np.mean(np.sum((x - swapped(x)) ** 2, axis=1))

    def root(a):
        return (np.sum((a - swapped(a)) ** 2) / mean_square + 0.09) ** 0.25

    def similar(a, b, length):
        r = np.sqrt(5.0) * np.linalg.norm(a - b) / (length * spread)
        return 10.0 + (1.0 + r + r**2 / 3.0) * np.exp(-r)

    def prior(a, b, reversal, length, output):
        there, back = similar(a, b, length), similar(a, swapped(b), length)
        return there + SIGNS[output] * reversal * back

    def posterior(known, at, kernel, output):
        reversal, length, noise = kernel
        shared = reversal, length, output
        gram = np.array([[prior(x[i], x[j], *shared) for j in known] for i in known])
        cross = np.array([prior(at, x[j], *shared) for j in known])
        solved = np.linalg.solve(gram + noise * np.eye(len(known)), cross)
        scaled = y[known, output] / [root(x[i]) for i in known]
        variance = prior(at, at, *shared) + noise - solved @ cross
        return solved @ scaled, variance

    kernels = list(product((-0.8, 0.8), (0.4, 1.2), (0.02, 0.2, 2.0, 200.0)))
    scores, predictions = [], []
    for kernel in kernels:
        left, variances = np.empty_like(y), np.empty_like(y)
        for i, output in product(range(len(x)), range(2)):
            known = np.flatnonzero(np.arange(len(x)) != i)
            guess, variances[i, output] = posterior(known, x[i], kernel, output)
            left[i, output] = y[i, output] / root(x[i]) - guess
        scale = np.sum(left**2 / variances) / len(x)
        log_density = norm.logpdf(left, scale=np.sqrt(scale * variances)).sum()
        scores.append(log_density / 2.0)
        everything = np.arange(len(x))
        predictions.append([posterior(everything, request, kernel, k)[0] for k in (0, 1)])
    scaled = y / np.array([[root(a)] for a in x])
    gram = scaled @ scaled.T
    freedom = np.trace(gram) ** 2 / np.sum(gram**2)
    logs = freedom * np.array(scores)
    probabilities = np.exp(logs - logs.max()) / np.exp(logs - logs.max()).sum()
    return root(request) * (probabilities @ np.array(predictions))


def example(n=7):
    rng = np.random.default_rng(5)
    x = rng.normal(size=(n, 5))
    y = x @ rng.normal(size=(5, 2)) + 0.3 * rng.normal(size=(n, 2))
    return x, y


def test_predictions_are_averages_of_gaussian_processes():
    x, y = example()
    request = np.array([0.3, -0.5, 1.0, 0.2, -0.4])
    found = predict(fit(x, y, y * SIGNS), request)
    np.testing.assert_allclose(found, textbook(x, y, request), rtol=1e-8)


def test_a_motion_is_predicted_backwards_on_the_way_back():
    """All demonstrations of one loop, half of them backwards: the last one's twin tells it."""
    demonstrations = arm_demonstrations(8, 3)
    backwards = [reversed_in_time(d) for d in demonstrations]
    primitive = build_primitive([*demonstrations, *backwards[:-1]], "x")
    motion = backwards[-1]
    truth = motion.time_normalised(FINE_PHASES.size)
    ends = *motion.positions[[0, -1]], motion.duration
    alone = expected_motion(build_primitive(demonstrations[:-1], "y"), *ends)
    path = path_difference(expected_motion(primitive, *ends), truth)
    assert path < 0.5 * path_difference(alone, truth)


def reversed_in_time(motion):
    return Demonstration(
        motion.joint_names,
        motion.times[-1] - motion.times[::-1],
        motion.positions[::-1],
        -motion.velocities[::-1],
        motion.accelerations[::-1],
        recording=motion.recording,
        start_time=motion.start_time,
        end_time=motion.end_time,
    )


def timed(starts, goals, durations):
    """A model of straight motions."""
    requests = np.column_stack([starts, goals, np.log(durations)])
    return fit(requests, np.zeros((len(requests), 0)))


def test_an_expected_duration_is_one_like_those_demonstrated():
    x = np.linspace(0.0, 1.0, 9)[:, None]
    model = timed(x, 2.0 * x, np.exp(x))
    inside = model.predict(np.array([0.75]), np.array([1.5])).duration
    assert inside == pytest.approx(np.exp(0.75), rel=0.05)
    far = model.predict(np.array([1e3]), np.array([2e3])).duration
    assert far <= np.exp(0.5 + 3.0 * x.std()) * (1 + 1e-9)


@pytest.mark.parametrize("exponent", [0.0, 0.5])
def test_the_data_say_whether_durations_grow_with_the_distance(exponent):
    rng = np.random.default_rng(3)
    starts, goals = rng.normal(size=(2, 30, 2))
    lengths = np.linalg.norm(goals - starts, axis=1)
    model = timed(starts, goals, lengths**exponent * np.exp(0.05 * rng.normal(size=30)))
    short, long = (model.predict(np.zeros(2), np.array([x, 0.0])).duration for x in (0.5, 3.0))
    assert long / short == pytest.approx(6.0**exponent, rel=0.25)


@pytest.mark.parametrize("goals", [[[0.0, 0.0]] * 3, [[1.0, 0.0]] * 3])
def test_motions_to_nowhere_and_equal_requests_are_no_trouble(goals):
    model = timed(np.zeros((3, 2)), np.array(goals), np.full(3, 0.8))
    for goal in (np.zeros(2), np.ones(2)):
        assert model.predict(np.zeros(2), goal).duration == pytest.approx(0.8)


@pytest.mark.parametrize("n", [3, 400])
def test_errors_of_new_motions_are_as_large_as_predicted(n):
    """Noise can't be predicted: what is left is its variance of 1, widened as Student's t is."""
    rng = np.random.default_rng(1)
    squares, predicted = [], []
    for _ in range(1 if n > 100 else 60):
        requests = rng.normal(size=(n + 20, 3))
        requests[:, 1] += 8.0  # motions of about one size
        model = fit(requests[20:], rng.normal(size=(n, 2)))
        for request in requests[:20]:
            found = model.predict(request[:1], request[1:2])
            squares.append(np.mean((rng.normal(size=2) - found.weights + STRAIGHT) ** 2))
            predicted.append(found.variance * np.trace(found.covariance) / 2.0)
    assert 0.3 < np.mean(squares) / np.mean(predicted) < 1.3


def test_more_than_200_demonstrations_are_thinned_out():
    rng = np.random.default_rng(6)
    x, y = rng.normal(size=(401, 3)), rng.normal(size=(401, 2))
    kept = x[:, 0].argsort()[::3]
    for order in (np.arange(401), rng.permutation(401)):
        thinned = fit(x[order], y[order])
        np.testing.assert_array_equal(thinned.requests, x[kept])
        np.testing.assert_allclose(
            thinned.shape_coefficients, fit(x[kept], y[kept]).shape_coefficients, rtol=1e-9
        )


@pytest.mark.parametrize("duration", [None, 0.6])
def test_the_in_span_score_is_a_mahalanobis_distance(duration):
    """Two more requests that scatter equally in all directions are the prior."""
    primitive = arm_primitive()
    states, n = primitive.boundary_states, len(primitive.durations)
    x = np.column_stack([states[:, 0], states[:, 3], np.log(primitive.durations)])
    request = np.append(x[3, :-1] + 0.2, np.log(0.6))
    scatter = np.cov(x, rowvar=False)
    prior = np.eye(9) * np.trace(scatter) / 9
    covariance = ((n - 1) * scatter + 2 * prior) / (n + 1) * (1 + 1 / n)
    covariance += np.deg2rad(1.0) ** 2 * np.eye(9)
    given = slice(0, 8 if duration is None else 9)
    deviation = (request - x.mean(axis=0))[given]
    squared = deviation @ np.linalg.solve(covariance[given, given], deviation)
    found = primitive.model.predict(request[:4], request[4:8], duration).in_span_score
    assert found == pytest.approx(np.sqrt(squared / deviation.size))


def test_errors_are_expected_to_be_larger_far_from_the_demonstrations():
    model = fit(*example(20))
    near, far = (model.predict(*np.split(model.requests[0, :4] + x, 2)) for x in (0.0, 8.0))
    assert far.variance > 4.0 * near.variance
    # The naturalness of a plan doesn't depend on how far its request is.
    np.testing.assert_array_equal(far.covariance, near.covariance)
