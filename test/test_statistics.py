# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What is expected of a request."""

import numpy as np
import pytest
from arm import arm_demonstrations, arm_primitive

from mp_pca_planner.exceptions import PrimitiveFileError
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.cross_validation import expected_motion
from mp_pca_planner.primitives.differences import FINE_PHASES, differences
from mp_pca_planner.primitives.regression import PLAIN_MEAN, Kernel
from mp_pca_planner.primitives.statistics import (
    RequestStatistics,
    asked_demonstrations,
    find_kernels,
    kernels_of_version_2,
)
from mp_pca_planner.recordings.demonstration import Demonstration


def kernels(*kernel):
    """The same kernel for the shape, the pace and the duration."""
    return np.array([[which, 1.0, *kernel] for which in range(3)])


MEAN = kernels(*PLAIN_MEAN)


def statistics(rows=MEAN, n=6, activities=None):
    """One joint, two weights, a pace of one number; of one activity unless given."""
    rng = np.random.default_rng(1)
    requests = np.column_stack([rng.normal(size=(n, 2)), np.log(rng.uniform(0.5, 1.5, size=n))])
    weights, paces = rng.normal(size=(n, 2)), rng.normal(size=(n, 1))
    common = np.array([3.0, -1.0])
    activities = np.zeros(n) if activities is None else activities
    return RequestStatistics(requests, weights, weights, common, paces, paces, rows, activities)


def test_with_the_plain_mean_any_request_is_expected_alike():
    found = [statistics().condition(np.array([q]), np.array([-q]), t) for q, t in ((0, 1), (5, 2))]
    np.testing.assert_allclose(found[0].weights, found[1].weights, atol=0.02)
    np.testing.assert_allclose(found[0].pace, found[1].pace, atol=0.02)


def test_a_duration_that_is_given_is_kept():
    assert statistics().condition(np.zeros(1), np.zeros(1), 3.25).duration == 3.25


def test_an_expected_duration_is_one_like_those_demonstrated():
    requests = np.column_stack([np.linspace(0, 1, 9), np.linspace(0, 2, 9), np.linspace(0, 1, 9)])
    weights, paces = np.zeros((9, 0)), np.zeros((9, 1))
    rows = kernels(*Kernel(0.0, 0.03, 0.0))
    found = RequestStatistics(
        requests, weights, weights, np.zeros(0), paces, paces, rows, np.zeros(9)
    )
    inside = found.condition(np.array([0.75]), np.array([1.5])).duration
    assert inside == pytest.approx(np.exp(0.75), rel=0.05)
    far = found.condition(np.array([1e3]), np.array([2e3])).duration
    assert far <= np.exp(0.5 + 3.0 * requests[:, 2].std(ddof=1)) * (1 + 1e-9)


def timed(starts, goals, durations):
    """Statistics of straight motions, which know of nothing but durations."""
    requests = np.column_stack([starts, goals, np.log(durations)])
    n = len(requests)
    nothing = np.zeros((n, 0))
    rows = find_kernels(requests, np.zeros((n, 2, 0)), np.zeros((n, 5)), np.zeros(n))
    return RequestStatistics(
        requests,
        nothing,
        nothing,
        np.zeros(0),
        np.zeros((n, 1)),
        np.zeros((n, 1)),
        rows,
        np.zeros(n),
    )


def test_longer_ways_are_expected_to_take_longer_wherever_they_are():
    rng = np.random.default_rng(3)
    starts, goals = rng.normal(size=(2, 30, 2))
    ways = np.linalg.norm(goals - starts, axis=1)
    found = timed(starts, goals, 0.6 * ways**0.6)
    for way, angle in rng.uniform(0.7, 3.0, size=(20, 2)):
        start = rng.normal(3.0, size=2)
        goal = start + way * np.array([np.cos(angle), np.sin(angle)])
        expected = found.condition(start, goal).duration
        assert expected == pytest.approx(0.6 * way**0.6, rel=0.1)


def test_a_few_ways_that_are_all_as_long_do_not_tell_how_durations_grow():
    angles = np.linspace(0.0, np.pi, 4)
    goals = np.column_stack([np.cos(angles), np.sin(angles)])
    found = timed(np.zeros((4, 2)), goals, [0.5, 0.9, 0.6, 1.2])
    usual, twice = (found.condition(np.zeros(2), k * goals[1]).duration for k in (1.0, 2.0))
    assert 1.2 < twice / usual < 1.6  # about the square root of 2, which is usual


@pytest.mark.parametrize("goals", [[[0.0, 0.0]] * 3, [[1.0, 0.0]] * 3])
def test_ways_to_nowhere_and_equal_durations_are_no_trouble(goals):
    found = timed(np.zeros((3, 2)), np.array(goals), np.full(3, 0.8))
    for goal in (np.zeros(2), np.ones(2)):
        assert found.condition(np.zeros(2), goal).duration == pytest.approx(0.8)


def test_the_covariance_is_that_of_predictions_of_motions_left_out():
    found = statistics(n=400)
    # With the plain mean and independent weights of variance 1, that of the weights themselves.
    covariance = found.condition(np.zeros(1), np.zeros(1)).covariance
    np.testing.assert_allclose(covariance, np.eye(2), atol=0.2)
    assert np.all(np.linalg.eigvalsh(covariance) > 0.0)


def test_the_in_span_score_is_about_one_inside_and_grows_outside():
    primitive = arm_primitive()
    ends = primitive.boundary_states[:, [0, 3]]
    scores = [primitive.model.predict(start, goal).in_span_score for start, goal in ends]
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.2
    start, goal = ends.mean(axis=0)
    assert primitive.model.predict(start, goal).in_span_score < 1e-9
    far = [primitive.model.predict(start, goal + d).in_span_score for d in (1.0, 2.0, 4.0)]
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
        guess = primitive.model.predict(
            motion.positions[0], motion.positions[-1], motion.duration
        ).weights
        for weights, errors in ((guess, expected), (np.zeros(4), plain)):
            shape = primitive.basis.shape(weights, np.linspace(0, 1, 50))
            errors.append(np.mean((shape - target) ** 2))
    assert np.mean(expected) <= np.mean(plain)


def test_what_activities_shown_do_is_expected_of_them_rather_than_of_others():
    """Activities whose shapes have nothing in common, at ends that partly overlap."""
    rng = np.random.default_rng(2)
    labels = np.repeat(np.arange(8.0), 10)
    n = labels.size
    requests = rng.normal(size=(8, 5))[labels.astype(int)] + 0.3 * rng.normal(size=(n, 5))
    shapes = rng.normal(size=(8, 2, 4))[labels.astype(int)] + 0.1 * rng.normal(size=(n, 2, 4))
    weights = shapes.reshape(n, 8)
    backwards = weights * np.tile([1.0, -1.0], 4)

    def error(taught, told, activities):
        no_pace = np.zeros((np.sum(taught), 5))
        arguments = requests[taught], shapes[taught], no_pace, activities[taught]
        found = RequestStatistics(
            requests[taught],
            weights[taught],
            backwards[taught],
            np.zeros(8),
            no_pace,
            no_pace,
            find_kernels(*arguments),
            activities[taught],
        )
        expected = [found.condition(q[:2], q[2:4], np.exp(q[4])).weights for q in requests[told]]
        return np.mean((expected - weights[told]) ** 2) / np.mean(weights[told] ** 2)

    def errors(activities):
        """Of activities that were not shown, and of motions of those that were."""
        shown = np.arange(n) % 5 > 0
        others = [error(labels != k, labels == k, activities) for k in range(8)]
        return np.mean(others), error(shown, ~shown, activities)

    others, like = errors(labels)
    others_untold, _ = errors(np.zeros(n))
    # 1 is the error of expecting nothing.
    assert others - 1.0 < 0.5 * (others_untold - 1.0)
    assert like < 0.5


@pytest.mark.parametrize("n", [1, 2])
def test_one_or_two_demonstrations_give_their_mean(n):
    requests = np.column_stack([np.arange(2.0 * n).reshape(n, 2), np.full(n, np.log(0.5))])
    rows = find_kernels(requests, np.full((n, 1, 4), 3.0), np.zeros((n, 5)), np.zeros(n))
    weights, paces = np.full((n, 1), 3.0), np.zeros((n, 1))
    found = RequestStatistics(
        requests, weights, weights, np.zeros(1), paces, paces, rows, np.zeros(n)
    ).condition(np.array([7.0]), np.array([8.0]))
    assert found.weights == pytest.approx([3.0], rel=1e-2)
    assert found.duration == pytest.approx(0.5)
    assert np.isfinite(found.in_span_score)


def test_of_many_demonstrations_some_are_asked_evenly_spread():
    assert asked_demonstrations(7) == list(range(7))
    asked = asked_demonstrations(1000)
    assert len(asked) == len(set(asked)) == 300
    assert asked[0] == 0 and max(np.diff(asked)) <= 4


@pytest.mark.parametrize(
    "rows",
    [
        kernels(0.0, 0.0, 1.0, 0.0, 0.0),
        kernels(-1.0, 1.0, 1.0, 0.0, 0.0),
        kernels(0.0, 1.0, 1.0, 1.1, 0.0),
        kernels(0.0, np.nan, 1.0, 0.0, 0.0),
        MEAN * np.array([1, 0.5, 1, 1, 1, 1, 1]),
        MEAN[:2],
        MEAN[:, :5],
    ],
)
def test_kernels_that_make_no_sense_are_refused(rows):
    with pytest.raises(PrimitiveFileError, match="kernels"):
        statistics(rows)


def test_elsewhere_has_kernels_where_there_are_several_activities():
    elsewhere = np.vstack([MEAN, MEAN[:2] + np.array([3.0, 0, 0, 0, 0, 0, 0])])
    for rows, activities in ((elsewhere, np.arange(6.0)), (MEAN, np.ones(6))):
        statistics(rows, activities=activities)
    for rows, activities in ((MEAN, np.arange(6.0)), (elsewhere, np.ones(6))):
        with pytest.raises(PrimitiveFileError, match="several activities also"):
            statistics(rows, activities=activities)


def test_kernels_of_version_2_are_one_for_each_regression_that_knows_no_way_back():
    found = kernels_of_version_2(np.array([[1.0, 2.0, 3.0]] * 3))
    np.testing.assert_array_equal(found, kernels(1.0, 2.0, 3.0, 0.0, 0.0))
    with pytest.raises(PrimitiveFileError, match="kernels"):
        kernels_of_version_2(np.ones((2, 3)))


def test_a_motion_is_expected_backwards_on_the_way_back():
    """All demonstrations of one loop, half of them backwards: the last one's twin tells it."""
    demonstrations = arm_demonstrations(8, 3)
    backwards = [gone_backwards(d) for d in demonstrations]
    primitive = build_primitive([*demonstrations, *backwards[:-1]], "x")
    motion = backwards[-1]
    found = expected_motion(primitive, motion)
    truth = motion.time_normalised(FINE_PHASES.size)
    alone = expected_motion(build_primitive(demonstrations[:-1], "y"), motion)
    (_, _, path), (_, _, path_alone) = differences(found, truth), differences(alone, truth)
    assert path < 0.5 * path_alone


def gone_backwards(motion):
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
