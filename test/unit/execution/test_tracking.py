# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Where on its motion a robot is, against places and rates that the tests know."""

from __future__ import annotations

import numpy as np
import pytest
from support.dense import minimum_jerk_motion, spline

from mp_pca_planner.execution.tracking.estimation import Progress, locate
from mp_pca_planner.execution.tracking.measured import MeasuredSamples
from mp_pca_planner.execution.tracking.published_motion import PublishedMotion

DURATION, NOW = 2.0, 11.0
MOTION = PublishedMotion(
    minimum_jerk_motion(("a", "b", "c"), [0.0, 0.0, 0.0], [1.0, -0.7, 0.4], DURATION), 10.0
)
PATH = spline(MOTION.trajectory)
PLACES = np.linspace(0.5, 1.5, 6)
# Rate, and its change [1/s].
CONSTANT = [(1.0, 0.0), (0.5, 0.0), (0.1, 0.0), (0.0, 0.0)]
CHANGING = [(0.7, -1.0), (0.5, 0.8)]


def located(times, positions, prior):
    return locate(prior, MeasuredSamples(times, positions), NOW)


def track(place, rate, change=0.0, noise=0.0, prior=None):
    """What is located of a robot that was there, measured every 8 ms."""
    times = NOW - np.arange(0.3, -1e-9, -0.008)
    since = times - NOW
    places = np.clip(place + rate * since + 0.5 * change * since**2, 0.0, DURATION)
    random = np.random.default_rng(round(1e3 * place))
    positions = PATH(places) + noise * random.normal(size=(len(times), 3))
    prior = prior or Progress(MOTION, NOW - 0.05, place - 0.05 * rate, min(rate + 0.1, 1.0))
    return located(times, positions, prior)


def errors(rates, noise):
    """The largest errors of the place [s] and of the rate."""
    found = [
        (abs(one.place - place), abs(one.rate - rate))
        for place in PLACES
        for rate, change in rates
        for one in [track(place, rate, change, noise)]
    ]
    return np.max(found, axis=0)


@pytest.mark.parametrize(
    ("rates", "noise", "precision"),
    [
        (CONSTANT[:1], 0.0, (1e-9, 1e-9)),
        (CONSTANT, 0.0, (1.5e-4, 0.005)),
        (CONSTANT, 1e-4, (3e-4, 0.01)),
        (CONSTANT, 1e-3, (2e-3, 0.06)),
        (CHANGING, 0.0, (6e-4, 0.03)),
        (CHANGING, 1e-3, (2.5e-3, 0.08)),
    ],
)
def test_place_and_rate_are_found_to_a_stated_precision(rates, noise, precision):
    assert (errors(rates, noise) <= precision).all()


def test_change_of_the_rate_has_the_right_sign_and_size():
    for rate, change in CHANGING:
        for place in PLACES:
            assert track(place, rate, change, 1e-5).change == pytest.approx(change, abs=0.4)


@pytest.mark.parametrize("prior", [0.1, 0.5, 1.9])
@pytest.mark.parametrize("place", [0.6, 1.0, 1.4])
def test_held_robot_is_found_whatever_was_believed_before(place, prior):
    found = track(place, 0.0, noise=1e-4, prior=Progress(MOTION, NOW, prior, 1.0))
    assert found.place == pytest.approx(place, abs=2e-3)
    assert found.rate == pytest.approx(0.0, abs=0.05)


def test_what_was_known_counts_where_nothing_was_measured():
    prior = Progress(MOTION, NOW - 0.1, 0.5, 0.8)
    found = located(np.empty(0), np.empty((0, 3)), prior)
    assert (found.time, found.place, found.rate) == (NOW, pytest.approx(0.58), 0.8)


def test_silent_robot_goes_on_at_its_last_rate_however_often_it_is_located():
    times = NOW - np.arange(0.3, -1e-9, -0.008)
    beside = 3e-4 * np.sin(20.0 * times)[:, None]  # as a load in motion
    samples = MeasuredSamples(times, PATH(0.5 + times - NOW) + beside)
    first = later = locate(Progress(MOTION, NOW, 0.5), samples, NOW)
    for since in np.arange(0.05, 0.51, 0.05):
        later = locate(later, samples, NOW + since)
    assert later.rate == first.rate
    assert later.place == pytest.approx(0.5 + 0.5 * first.rate, abs=5e-3)


@pytest.mark.parametrize("place", [0.0, DURATION])
def test_what_was_known_counts_where_the_motion_does_not_move(place):
    times = NOW - np.arange(0.3, -1e-9, -0.008)
    rest = PublishedMotion(MOTION.trajectory, NOW - place)
    positions = np.tile(PATH(place), (len(times), 1))
    found = located(times, positions, Progress(rest, NOW, place, 0.0))
    assert (found.place, found.rate) == (pytest.approx(place, abs=1e-6), pytest.approx(0, abs=1e-6))


@pytest.mark.parametrize("age", [1e3, 1e6, 1e9, 1e20])
@pytest.mark.parametrize("n_new", [0, 1, 3])
def test_states_of_other_times_locate_a_robot_that_is_held_anyhow(age, n_new):
    """Clocks may jump; nothing may raise in the thread that stops the robot."""
    for seed in range(20):
        times = np.full(20, NOW - age * np.random.default_rng(seed).uniform(0.5, 1.0))
        times[len(times) - n_new :] = NOW
        positions = np.tile(PATH(1.0), (len(times), 1))
        found = located(times, positions, Progress(MOTION, NOW, 1.0, 0.0))
        assert np.isfinite([found.place, found.rate, found.error]).all()


def test_error_is_the_distance_from_the_path_less_the_noise():
    times = NOW - np.arange(0.3, -1e-9, -0.008)
    normal = np.array([0.7, 1.0, 0.0]) / np.sqrt(1.49)  # to the path, a straight line
    positions = PATH(1.0 + times - NOW) + 0.05 * normal
    noise = 1e-3 * np.random.default_rng(0).normal(size=positions.shape)
    prior = Progress(MOTION, NOW, 1.0)
    away = located(times, positions, prior).error
    assert away == pytest.approx(0.05 * normal.max(), rel=0.02)
    assert located(times, positions + noise, prior).error == pytest.approx(away, abs=3e-3)


def test_robot_that_is_slowed_down_stops_and_does_not_turn_back():
    slowed = Progress(MOTION, 0.0, 1.0, rate=0.5, change=-1.0)
    assert slowed.at(0.3) == pytest.approx(1.0 + 0.5 * 0.3 - 0.5 * 0.3**2)
    assert slowed.at(0.5) == slowed.at(0.9) == pytest.approx(1.125)
    assert slowed.at(-0.1) == pytest.approx(1.0 - 0.05 - 0.005)
