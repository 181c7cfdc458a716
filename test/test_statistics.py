# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What is expected of a request."""

import numpy as np
import pytest
from arm import arm_demonstrations, arm_primitive

from mp_pca_planner.exceptions import PrimitiveFileError
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.regression import PLAIN_MEAN
from mp_pca_planner.primitives.statistics import (
    RequestStatistics,
    asked_demonstrations,
    choose_kernels,
)


def statistics(kernel=PLAIN_MEAN, n=6):
    """One joint, two weights, a pace of one number."""
    rng = np.random.default_rng(1)
    requests = np.column_stack([rng.normal(size=(n, 2)), np.log(rng.uniform(0.5, 1.5, size=n))])
    weights, paces = rng.normal(size=(n, 2)), rng.normal(size=(n, 1))
    return RequestStatistics(requests, weights, np.array([3.0, -1.0]), paces, [kernel] * 3)


def test_with_the_plain_mean_any_request_is_expected_alike():
    found = [statistics().condition(np.array([q]), np.array([-q]), t) for q, t in ((0, 1), (5, 2))]
    np.testing.assert_allclose(found[0].weights, found[1].weights, atol=0.02)
    np.testing.assert_allclose(found[0].pace, found[1].pace, atol=0.02)


def test_a_duration_that_is_given_is_kept():
    assert statistics().condition(np.zeros(1), np.zeros(1), 3.25).duration == 3.25


def test_an_expected_duration_is_one_like_those_demonstrated():
    requests = np.column_stack([np.linspace(0, 1, 9), np.linspace(0, 2, 9), np.linspace(0, 1, 9)])
    kernels = [(0.0, 0.03, 0.0)] * 3
    found = RequestStatistics(
        requests, np.zeros((9, 0)), np.zeros(0), np.zeros((9, 1)), np.array(kernels)
    )
    inside = found.condition(np.array([0.75]), np.array([1.5])).duration
    assert inside == pytest.approx(np.exp(0.75), rel=0.05)
    far = found.condition(np.array([1e3]), np.array([2e3])).duration
    assert far <= np.exp(0.5 + 3.0 * requests[:, 2].std(ddof=1)) * (1 + 1e-9)


def test_the_covariance_is_that_of_predictions_of_motions_left_out():
    found = statistics(n=400)
    # With the plain mean and independent weights of variance 1, that of the weights themselves.
    covariance = found.condition(np.zeros(1), np.zeros(1)).covariance
    np.testing.assert_allclose(covariance, np.eye(2), atol=0.2)
    assert np.all(np.linalg.eigvalsh(covariance) > 0.0)


def test_the_in_span_score_is_about_one_inside_and_grows_outside():
    primitive = arm_primitive()
    ends = primitive.boundary_states[:, [0, 3]]
    scores = [primitive.statistics.condition(start, goal).in_span_score for start, goal in ends]
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.2
    start, goal = ends.mean(axis=0)
    assert primitive.statistics.condition(start, goal).in_span_score < 1e-9
    far = [primitive.statistics.condition(start, goal + d).in_span_score for d in (1.0, 2.0, 4.0)]
    assert far[0] < far[1] < far[2] and far[2] > 3.0


def test_expected_weights_of_held_out_motions_are_no_worse_than_the_mean():
    demonstrations = arm_demonstrations(30, 11)
    expected, plain = [], []
    for i in range(0, 30, 3):
        rest = [d for j, d in enumerate(demonstrations) if j != i]
        options = PrimitiveOptions(n_components=4)
        primitive = build_primitive(rest, "rest", options)
        held_out = build_primitive([*rest, demonstrations[i]], "all", options)
        target = held_out.basis.shape(held_out.weights[-1], np.linspace(0, 1, 50))
        motion = demonstrations[i]
        guess = primitive.statistics.condition(
            motion.positions[0], motion.positions[-1], motion.duration
        ).weights
        for weights, errors in ((guess, expected), (np.zeros(4), plain)):
            shape = primitive.basis.shape(weights, np.linspace(0, 1, 50))
            errors.append(np.mean((shape - target) ** 2))
    assert np.mean(expected) <= np.mean(plain)


@pytest.mark.parametrize("n", [1, 2])
def test_one_or_two_demonstrations_give_their_mean(n):
    requests = np.column_stack([np.arange(2.0 * n).reshape(n, 2), np.full(n, np.log(0.5))])
    kernels = choose_kernels(requests, np.full((n, 4), 3.0), np.zeros((n, 5)))
    found = RequestStatistics(
        requests, np.full((n, 1), 3.0), np.zeros(1), np.zeros((n, 1)), kernels
    ).condition(np.array([7.0]), np.array([8.0]))
    assert found.weights == pytest.approx([3.0], rel=1e-2)
    assert found.duration == pytest.approx(0.5)
    assert np.isfinite(found.in_span_score)


def test_of_many_demonstrations_some_are_asked_evenly_spread():
    assert asked_demonstrations(7) == list(range(7))
    asked = asked_demonstrations(1000)
    assert len(asked) == len(set(asked)) == 300
    assert asked[0] == 0 and max(np.diff(asked)) <= 4


@pytest.mark.parametrize("kernel", [(0.0, 0.0, 1.0), (-1.0, 1.0, 1.0), (0.0, np.nan, 1.0)])
def test_kernels_that_make_no_sense_are_refused(kernel):
    with pytest.raises(PrimitiveFileError, match="kernels"):
        statistics(kernel)
