# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Primitives from the front door: fit, predict, sample, save and load."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.arm import arm_demonstrations, arm_primitive, file_bytes

from mp_pca_planner.exceptions import GoalError
from mp_pca_planner.motion.interpolation import hermite_functions
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.primitive import MovementPrimitive
from mp_pca_planner.recordings.recording_set import RecordingSet


def request():
    return arm_primitive().boundary_states[0, [0, 3]]


@pytest.mark.parametrize("wrapped", [False, True])
def test_fit_gives_what_the_builder_gives(wrapped):
    options = PrimitiveOptions(coupling="joint", n_components=2, align="linear")
    built = build_primitive(arm_demonstrations(), "reach", options)
    demonstrations = arm_demonstrations()
    one: Any = SimpleNamespace(motions=demonstrations)
    given = RecordingSet([one]) if wrapped else demonstrations
    fitted = MovementPrimitive.fit(
        given, name="reach", coupling="joint", components=2, align="linear"
    )
    assert file_bytes(fitted) == file_bytes(built)


@pytest.mark.parametrize("duration", [None, 1.5])
def test_predicted_motion_goes_from_rest_to_rest_along_the_expected_path(duration):
    start, goal = request()
    motion = arm_primitive().predict(start, goal, duration)
    np.testing.assert_array_equal(motion.positions[[0, -1]], [start, goal])
    assert not motion.velocities[[0, -1]].any()
    expected = arm_primitive().model.predict(start, goal, duration)
    assert motion.duration == pytest.approx(duration or expected.duration)
    basis = arm_primitive().paced_basis(start, goal, expected.pace)
    phases = motion.times / motion.duration
    path = start + hermite_functions(phases)[:, 3:4] * (goal - start)
    np.testing.assert_allclose(
        motion.positions, path + basis.shape(expected.weights, phases), atol=1e-12
    )
    slope = np.gradient(motion.positions, motion.times, axis=0, edge_order=2)
    np.testing.assert_allclose(slope, motion.velocities, atol=2e-2)


def test_full_turns_of_continuous_joints_lead_to_the_demonstrated_start():
    start, goal = request()
    turns = 2.0 * np.pi * np.array([3.0, -2.0, 1.0, 0.0])
    continuous = np.array([True, True, False, True])
    found = arm_primitive().model.turned(start + turns, goal + turns, continuous)
    left = np.where(continuous, 0.0, turns)
    np.testing.assert_allclose(found, [start + left, goal + left], atol=1e-12)


def test_draws_scatter_about_the_expected_motion_as_the_covariance_states():
    start, goal = request()
    draws = np.array([m.positions for m in arm_primitive().sample(400, start, goal, seed=1)])
    expected = arm_primitive().predict(start, goal)
    spread = draws.std(axis=0)
    assert np.all(np.abs(draws.mean(axis=0) - expected.positions) <= 4.0 * spread / 20.0 + 1e-12)
    model = arm_primitive().model.predict(start, goal)
    basis = arm_primitive().paced_basis(start, goal, model.pace)
    functions = basis.functions(expected.times / expected.duration)
    covariance = model.variance * model.covariance
    variance = np.einsum("sjk,kl,sjl->sj", functions, covariance, functions)
    np.testing.assert_allclose(spread[20:-20], np.sqrt(variance[20:-20]), rtol=0.2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.0], [0.0] * 4), "the start must be one position"),
        (([0.0] * 4, [np.nan] * 4), "goal.* is nan"),
        (([0.0] * 4, [0.1] * 4, -1.0), "from 0.001 to 600, got -1.0"),
    ],
)
def test_a_wrong_request_is_refused(arguments, message):
    with pytest.raises(GoalError, match=message):
        arm_primitive().predict(*arguments)


def test_in_span_score_of_a_request_is_that_of_its_prediction():
    primitive = arm_primitive()
    first, last = primitive.boundary_states[0, [0, 3]]
    score = primitive.in_span_score(first, last)
    assert score == primitive.model.predict(first, last).in_span_score < 3.0
    assert primitive.in_span_score(first, last + 3.0) > 3.0
    assert primitive.in_span_score(first, last, 0.02) > score


def test_a_primitive_says_how_well_it_predicts():
    assert "% nearer than minimum-jerk motions (" in str(arm_primitive())
