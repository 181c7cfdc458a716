# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The made-up motions against the arm's limits and against what is known of people's motions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.files import config_file
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.recordings.synthetic import (
    continuous_recording,
    generate_motions,
)
from mp_pca_planner.robot.model import Robot

ROBOT = Robot.from_file(config_file("human_arm.urdf"))
LIMITS = ROBOT.limits()
MANY = generate_motions(200, seed=1)


def derivatives(motion: Demonstration) -> tuple[np.ndarray, np.ndarray]:
    v = np.gradient(motion.positions, motion.times, axis=0, edge_order=2)
    return v, np.gradient(v, motion.times, axis=0, edge_order=2)


def test_the_seed_alone_decides_the_motions_however_many_there_are() -> None:
    few, more, other = generate_motions(2, 9), generate_motions(6, 9), generate_motions(2, 5)
    for motion, same in zip(few, more, strict=False):
        np.testing.assert_array_equal(motion.positions, same.positions)
    first, another = few[1].positions, other[1].positions
    assert first.shape != another.shape or not np.allclose(first, another)
    one, again = (continuous_recording(few, seed=7) for _ in range(2))
    np.testing.assert_array_equal(one.positions, again.positions)


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32))
def test_motions_stay_within_all_limits_of_the_arm(seed: int) -> None:
    motion = generate_motions(1, seed)[0]
    v, a = derivatives(motion)
    tau = ROBOT.inverse_dynamics(motion.positions, v, a)
    assert np.all(motion.positions > LIMITS.lower)
    assert np.all(motion.positions < LIMITS.upper)
    assert np.all(np.abs(v) < LIMITS.velocity)
    assert np.all(np.abs(tau) < LIMITS.effort)


def test_recording_holds_every_motion_where_it_says() -> None:
    motions = MANY[:6]
    recording = continuous_recording(motions, seed=3)
    assert recording.motion_spans.shape == (6, 2)
    assert recording.return_spans.shape == (5, 2)
    for motion, (start, end) in zip(motions, recording.motion_spans, strict=True):
        assert end - start == pytest.approx(motion.duration)
        inside = (recording.times >= start) & (recording.times <= end)
        for measured, true in zip(recording.positions.T, motion.positions.T, strict=True):
            expected = np.interp(recording.times[inside] - start, motion.times, true)
            # Five standard deviations of the sensor's noise, and a little tremor.
            np.testing.assert_allclose(measured[inside], expected, atol=6e-3)


def test_no_motions_are_refused() -> None:
    with pytest.raises(RecordingError, match="at least 1, got 0"):
        generate_motions(0, 0)
