# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Which of two motions a robot follows whose messages may be lost."""

import numpy as np
import pytest

from mp_pca_planner.execution.tracking.estimation import Progress, ServoModel
from mp_pca_planner.execution.tracking.following import Conclusion, Observation, Publication
from mp_pca_planner.execution.tracking.measured import MeasuredSamples
from mp_pca_planner.execution.tracking.published_motion import PublishedMotion, hold
from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.motion.trajectory import Trajectory

NAMES, NOW = ("a", "b"), 10.0


def conclusion(
    distance: float,
    place: float,
    noise: float = 0.0,
    *,
    is_over: bool = True,
    load: float = 0.0,
    offset: float = 0.0,
) -> Conclusion:
    """For motions that are this far apart, and a robot at rest at this share of that distance."""
    held = [
        PublishedMotion(hold(NAMES, np.array([end, 0.0])), began)
        for end, began in ((0.0, 1.0), (distance, 2.0))
    ]
    if not is_over:  # half way
        ends, rest = np.array([[0.0, 0.0], [2.0 * distance, 0.0]]), np.zeros((2, 2))
        held[1] = PublishedMotion(
            Trajectory(NAMES, [0.0, 2.0 * (NOW - 2.0)], ends, rest, rest), 2.0
        )
    old, new = (Progress(motion, NOW, NOW - motion.began) for motion in held)
    publication = Publication(held[1], new, old, 2.0)
    position = np.array([place * distance, 0.0])
    samples = MeasuredSamples(np.array([NOW]), position[None])
    seen = Observation(JointState(NAMES, position), True, samples)
    found = Progress(held[1], NOW, NOW - 2.0)
    servo = ServoModel(2)
    servo.load, servo.offset = np.array([load, 0.0]), np.array([offset, 0.0])
    servo.noise = noise
    return publication.confirm(found, seen, servo)


@pytest.mark.parametrize("distance", [3e-4, 4.3e-4, 1e-3, 1e-2])
def test_robot_at_rest_on_the_old_motion_has_not_taken_the_new_one(distance: float) -> None:
    assert conclusion(distance, place=0.02) is Conclusion.REFUSED


@pytest.mark.parametrize("distance", [3e-4, 4.3e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("place", [0.6, 1.0, 1.2])
def test_robot_at_rest_near_the_new_motion_may_have_taken_it(distance: float, place: float) -> None:
    assert conclusion(distance, place) is not Conclusion.REFUSED


@pytest.mark.parametrize("place", [0.0, 1.0])
@pytest.mark.parametrize("error", [-5e-5, 5e-5])
def test_offset_of_a_motion_does_not_hide_where_a_robot_rests(place: float, error: float) -> None:
    """The last accelerations are in the offset, or the load has changed since the last rest."""
    for load, offset in ((0.0, error), (error, 0.0)):
        is_refused = conclusion(2.5e-4, place, load=load, offset=offset) is Conclusion.REFUSED
        assert is_refused == (place == 0.0)


def test_robot_that_has_not_begun_to_move_may_have_taken_the_new_motion() -> None:
    assert conclusion(3e-4, place=0.02, is_over=False) is not Conclusion.REFUSED


def test_distances_within_the_noise_say_nothing() -> None:
    assert conclusion(3e-4, place=0.02, noise=1e-4) is not Conclusion.REFUSED


def test_silent_robot_is_not_said_to_have_refused_a_motion() -> None:
    rates = np.array([[1.0, 0.0], [1.0004, 0.0]])
    old, new = (
        PublishedMotion(
            Trajectory(NAMES, [0.0, 2.0], [[0.0, 0.0], 2.0 * v], [v, v], np.zeros((2, 2))),
            NOW - 0.5,
        )
        for v in rates
    )
    at = [Progress(one, NOW, 0.5) for one in (old, new)]
    publication = Publication(new, at[1], at[0], NOW - 0.5)
    position = 0.5 * rates[1]
    samples = MeasuredSamples(np.array([NOW]), position[None])
    seen = Observation(JointState(NAMES, position), False, samples)
    request = seen, ServoModel(2)
    first = publication.confirm(Progress(new, NOW, 0.5), *request)
    assert first is not Conclusion.REFUSED
    # While it is silent, its place is extrapolated with an error.
    later = Progress(new, NOW + 0.3, 0.9, 1.0)
    assert publication.confirm(later, *request) == first
    publication.concluded = (0.0, first)
    assert publication.confirm(later, *request) is Conclusion.REFUSED
