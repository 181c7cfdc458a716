# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import csv
from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.bags import reaching

from mp_pca_planner.arrays import FloatArray
from mp_pca_planner.exceptions import RecordingError
from mp_pca_planner.recordings.load import load_recordings
from mp_pca_planner.recordings.options import MIN_REST, LoadOptions
from mp_pca_planner.recordings.recording import Samples
from mp_pca_planner.recordings.segmentation import (
    SmoothPiece,
    find_motions,
    joint_speed,
    smooth,
    speed_thresholds,
)


def smoothed(positions: FloatArray, rate: float = 100.0) -> SmoothPiece:
    return smooth(Samples(np.arange(len(positions)) / rate, positions), rate)


def motions_in(positions: FloatArray, rate: float = 100.0) -> list[tuple[float, float]]:
    """Start and end [s] of each motion."""
    piece = smoothed(positions, rate)
    thresholds = speed_thresholds(joint_speed(piece.velocities))
    spans = find_motions(piece, thresholds, MIN_REST, valleys=True)
    return [(float(piece.times[a]), float(piece.times[b])) for a, b in spans]


def passing(via: FloatArray, seconds: float, dip: float, rate: float = 100.0) -> FloatArray:
    """Go through via points, slowing down to a share of the peak speed at each inner one."""
    steps = round(seconds * rate)
    pace = dip + (1.0 - dip) * np.sin(np.linspace(0.0, np.pi, steps)) ** 2
    share = np.cumsum(pace) / pace.sum()
    parts = [a + share[:, None] * (b - a) for a, b in pairwise(via)]
    still = round(rate)
    return np.concatenate([np.tile(via[0], (still, 1)), *parts, np.tile(via[-1], (still, 1))])


@settings(max_examples=30)
@given(scale=st.floats(1e-2, 1e2), n=st.integers(1, 5))
def test_scale_of_the_joints_does_not_matter(scale: float, n: int) -> None:
    goals = [0.0, *((-1.0) ** i for i in range(n))]
    np.testing.assert_allclose(motions_in(scale * reaching(goals)), motions_in(reaching(goals)))


@given(seed=st.integers(0, 1000), noise=st.sampled_from([1e-4, 1e-3, 3e-3]))
def test_sensor_noise_makes_no_motions(seed: int, noise: float) -> None:
    clean = reaching([0, 1, -0.5])
    noisy = clean + np.random.default_rng(seed).normal(scale=noise, size=clean.shape)
    np.testing.assert_allclose(motions_in(noisy), motions_in(clean), atol=0.4)


def test_short_rest_in_a_motion_that_goes_on_does_not_cut() -> None:
    via = np.array([[0.0, 0.0], [1.0, 0.5], [2.0, 1.0]])
    assert len(motions_in(passing(via, 1.0, dip=0.25))) == 1


def test_turning_back_without_a_stop_cuts() -> None:
    via = np.array([[0.0, 0.0], [1.0, 0.1], [0.0, 0.2], [1.0, 0.3]])
    found = motions_in(passing(via, 0.8, dip=0.25))
    assert len(found) == 3
    np.testing.assert_allclose([start for start, _ in found[1:]], [1.8, 2.6], atol=0.06)


def test_a_robot_that_settles_slowly_without_noise_rests() -> None:
    rate, lag = 100.0, 0.12  # of the servos [s]
    command = reaching([0, 1, -0.5, 0.7], rest=3.0)
    settling = np.empty_like(command)
    settling[0] = command[0]
    for k in range(1, len(command)):
        settling[k] = settling[k - 1] + (command[k] - settling[k - 1]) / (1.0 + lag * rate)
    found = motions_in(settling)
    assert len(found) == 3
    # The exact exponential falls for seconds; 1 % of it remains after 4.6 times the lag.
    assert max(end - start for start, end in found) < 1.0 + 5.0 * lag


def test_slow_sampling_is_cut_at_rests_only() -> None:
    via = np.array([[0.0, 0.0], [1.0, 0.1], [0.0, 0.2]])
    assert len(motions_in(passing(via, 1.5, dip=0.1, rate=10.0), rate=10.0)) == 1
    slow = reaching([0, 1, 0], rate=10.0)
    np.testing.assert_allclose(motions_in(slow, rate=10.0), [(1, 2), (3, 4)], atol=0.3)


@pytest.mark.parametrize(("name", "value"), [("min_rest", np.nan), ("cut", "x")])
def test_senseless_options_are_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(RecordingError, match=name.replace("cut", "kind of cuts")):
        LoadOptions(**{name: value})
    with pytest.raises(RecordingError, match="are for --segment auto: remove them"):
        LoadOptions(min_rest=1.0, segment="none")


def overlap_over_union(a: tuple[float, float], b: tuple[float, float]) -> float:
    overlap = min(a[1], b[1]) - max(a[0], b[0])
    return max(0.0, overlap) / (max(a[1], b[1]) - min(a[0], b[0]))


def test_motions_of_people_are_found_by_their_joint_angles(shared_data: Path) -> None:
    """The reference was cut by hand-path speed; compared is what begins and ends slowly in it."""
    wanted = defaultdict(list)
    n_all = 0
    with (shared_data / "human_arm" / "motions.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            n_all += 1
            slow = max(float(row["start_speed_m_s"]), float(row["end_speed_m_s"]))
            if slow <= 0.25 * float(row["peak_speed_m_s"]):
                span = float(row["start_time_s"]), float(row["end_time_s"])
                wanted[row["recording"]].append(span)
    reports = load_recordings([shared_data / "human_arm" / "joint_states"]).reports
    found = {
        report.name: [(m.start_time, m.end_time) for m in report.motions] for report in reports
    }
    hits = [
        max(overlap_over_union(span, other) for other in found[name]) > 0.5
        for name, spans in wanted.items()
        for span in spans
    ]
    assert len(hits) == 81
    assert sum(hits) >= 0.8 * len(hits)
    assert sum(map(len, found.values())) <= 1.2 * n_all
