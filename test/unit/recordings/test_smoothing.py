# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.recordings.recording import Samples
from mp_pca_planner.recordings.segmentation import CUTOFF, MAX_RATE, MIN_RATE, smooth


def sine(times: FloatArray, frequency: float, order: int = 0) -> FloatArray:
    """A sine, or a derivative of it, as the positions of one joint."""
    omega = 2 * np.pi * frequency
    return (omega**order * np.sin(omega * times + order * np.pi / 2))[:, None]


@pytest.mark.parametrize("rate", [100.0, 500.0, 1000.0])
def test_slow_motion_keeps_its_course_and_derivatives(rate: float) -> None:
    times = np.arange(0.0, 4.0, 1 / rate)
    result = smooth(Samples(times, sine(times, 0.5)), rate)
    inner = slice(len(result.times) // 8, -len(result.times) // 8)
    for order, values in enumerate((result.positions, result.velocities, result.accelerations)):
        exact = sine(result.times, 0.5, order)
        np.testing.assert_allclose(values[inner], exact[inner], atol=2e-3 * np.abs(exact).max())


def test_noise_over_the_cutoff_is_taken_out() -> None:
    times = np.arange(0.0, 4.0, 0.002)
    hum = 0.01 * sine(times, 6 * CUTOFF)
    result = smooth(Samples(times, sine(times, 0.5) + hum), 500.0)
    inner = slice(100, -100)
    left = result.positions[inner] - sine(result.times[inner], 0.5)
    assert np.abs(left).max() < 0.1 * np.abs(hum).max()


@pytest.mark.parametrize(
    ("rate", "expected"), [(10.0, MIN_RATE), (120.0, 120.0), (1000.0, MAX_RATE)]
)
def test_rate_of_the_result_is_that_of_the_recording_within_bounds(
    rate: float, expected: float
) -> None:
    times = np.arange(0.0, 3.0, 1 / rate)
    result = smooth(Samples(times, sine(times, 0.5)), rate)
    assert result.rate == pytest.approx(expected, rel=0.01)
    assert np.ptp(np.diff(result.times)) < 1e-9
    assert result.times[[0, -1]] == pytest.approx(times[[0, -1]])


@pytest.mark.parametrize("rate", [10.0, 100.0])
def test_samples_that_come_in_bursts_make_no_overshoot(rate: float) -> None:
    times = np.arange(0.0, 4.0, 1 / rate)
    times[1::2] = times[::2] + 1e-5
    noise = np.random.default_rng(0).normal(scale=1e-3, size=(times.size, 1))
    result = smooth(Samples(times, sine(times, 0.25) + noise), rate)
    assert np.abs(result.positions - sine(result.times, 0.25)).max() < 0.05
    assert np.abs(result.velocities).max() < 5.0
