# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Kinds of motions, or one primitive of all."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from support.motion_kinds import generate_kinds

from mp_pca_planner.primitives.build import PrimitiveOptions
from mp_pca_planner.primitives.build_library import library_content
from mp_pca_planner.primitives.in_span import in_span_score, left_out_scores, request_precision
from mp_pca_planner.primitives.kinds import KindOptions, choose_kinds, find_kinds
from mp_pca_planner.primitives.motion_statistics import MotionStatistics
from mp_pca_planner.primitives.prediction import ConditionalModel, left_out_squares
from mp_pca_planner.primitives.timing import reversed_paces
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.synthetic import bell

OPTIONS = PrimitiveOptions()
N_PHASES = OPTIONS.n_phases


def statistics(motions: list[Demonstration]) -> MotionStatistics:
    return MotionStatistics.of(motions, OPTIONS)


def on_either_side(n: int) -> MotionStatistics:
    """Motions with the same ends and durations that pass an obstacle on either side."""
    motions = []
    for i, motion in enumerate(generate_kinds(n, 1, 4)):
        detour = 0.8 * (-1.0) ** i * bell(motion.times[:, None] / motion.duration, 0.5)
        curve = CubicSpline(motion.times, motion.positions + detour)
        motions.append(Demonstration.of_curve(motion.joint_names, curve, motion.times, f"{i}"))
    return statistics(motions)


def test_kinds_that_a_request_does_not_tell_apart_are_one_primitive():
    made = on_either_side(40)
    found = find_kinds(made, N_PHASES, KindOptions(tolerance=np.inf))
    assert set(found.assigned[::2]) != set(found.assigned[1::2])
    kinds, errors = choose_kinds(made, N_PHASES, KindOptions(tolerance=np.inf))
    assert errors.known < errors.pooled < errors.chosen
    assert errors.one_is_best
    assert not kinds.assigned.any()
    assert kinds.explained_by.all()
    assert len(library_content(made, OPTIONS).primitives) == 1


def test_kinds_that_a_request_tells_apart_are_kept():
    kinds, errors = choose_kinds(statistics(generate_kinds(200, 20, 0)), N_PHASES, KindOptions())
    assert errors.n_kinds == kinds.assigned.max() + 1 > 15
    assert errors.chosen < errors.pooled
    assert errors.chosen == pytest.approx(errors.known, rel=0.05)


def test_the_choice_does_not_depend_on_the_order_of_the_motions():
    made = statistics(generate_kinds(60, 6, 1))
    _, errors = choose_kinds(made, N_PHASES, KindOptions())
    order = np.random.default_rng(0).permutation(60)
    _, other = choose_kinds(made.chosen(order), N_PHASES, KindOptions())
    assert other.chosen == pytest.approx(errors.chosen)
    assert other.pooled == pytest.approx(errors.pooled)


@pytest.mark.parametrize("n_labels", [1, 3])
def test_left_out_squares_of_others_are_those_of_the_model(n_labels):
    made = statistics(generate_kinds(24, 3, 0))
    requests, shapes = made.requests(), made.both_shapes()
    used, labels = np.arange(1, 24, 2), [f"{i % n_labels}" for i in range(12)]
    straight = np.zeros(shapes.shape[2])
    paces = np.array([made.paces[used], reversed_paces(made.paces[used])])
    precision = request_precision(requests[used])
    given = requests[used], shapes[:, used], straight, paces, labels, precision
    model, n = ConditionalModel.fit(*given), requests.shape[1] // 2
    squares = left_out_squares(requests, shapes, used, labels)
    for i in range(0, 24, 2):
        expected = model.predict(requests[i, :n], requests[i, n:-1], made.durations[i])
        error = np.sum((expected.weights - shapes[0, i]) ** 2)
        assert squares[i] == pytest.approx(error)


def test_left_out_scores_are_those_of_primitives_of_the_others():
    requests, used = statistics(generate_kinds(12, 2, 0)).requests(), np.arange(0, 12, 2)
    for i, score in enumerate(left_out_scores(requests, used)):
        others = requests[[j for j in used if j != i]]
        precision = request_precision(others)
        assert score == pytest.approx(in_span_score(requests[i], others.mean(axis=0), precision))
    assert left_out_scores(requests, used[:1])[0] == np.inf
