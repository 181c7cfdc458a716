# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings that are far from all others, made by changing one of ten."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.motion_kinds import generate_kinds

from mp_pca_planner.primitives.build import PrimitiveOptions
from mp_pca_planner.primitives.foreign import foreign_recordings
from mp_pca_planner.primitives.motion_statistics import MotionStatistics
from mp_pca_planner.recordings.demonstration import Demonstration

OPTIONS = PrimitiveOptions()


def named(
    change: Callable[[Demonstration], Demonstration], n: int = 10, *, changed: str = "r3"
) -> dict[str, str]:
    motions = [
        replace(motion, recording=f"r{i // 4}", start_time=float(i))
        for i, motion in enumerate(generate_kinds(4 * n, 1, 12))
    ]
    given = [change(motion) if motion.recording == changed else motion for motion in motions]
    found = foreign_recordings(MotionStatistics.of(given, OPTIONS), OPTIONS.n_phases)
    return dict(found)


def moved(motion: Demonstration, signs: list[int], offset: list[float]) -> Demonstration:
    curves = {
        "positions": motion.positions * signs + offset,
        "velocities": motion.velocities * signs,
        "accelerations": motion.accelerations * signs,
    }
    return replace(motion, **curves)


def exchanged(motion: Demonstration, order: list[int]) -> Demonstration:
    names = ("positions", "velocities", "accelerations")
    return replace(motion, **{name: getattr(motion, name)[:, order] for name in names})


def backwards(motion: Demonstration) -> Demonstration:
    return replace(
        motion,
        positions=motion.positions[::-1],
        velocities=-motion.velocities[::-1],
        accelerations=motion.accelerations[::-1],
    )


def test_recordings_of_one_task_are_near_each_other() -> None:
    assert named(lambda motion: motion) == {}


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda m: moved(m, [1, -1, 1, 1], [0.0] * 4), "the opposite sign of 'shoulder2'"),
        (lambda m: moved(m, [1] * 4, [0.0, 0.0, 0.0, 0.5]), "'elbow' is shifted by -0."),
        (backwards, "played backwards"),
        (lambda m: exchanged(m, [0, 3, 2, 1]), "'shoulder2' and 'elbow' are exchanged"),
        (lambda m: moved(m, [1, 1, 1, 3], [0.0] * 4), "times as far"),
    ],
    ids=["mirrored", "offset", "backwards", "exchanged", "three times"],
)
def test_a_changed_recording_is_named_with_what_makes_it_fit(
    change: Callable[[Demonstration], Demonstration], cause: str
) -> None:
    found = named(change)
    assert found.keys() == {"r3"}
    assert "times as far from those of the others as is usual" in found["r3"]
    assert cause in found["r3"]


def test_a_clock_at_another_rate_is_named() -> None:
    def slow(motion: Demonstration) -> Demonstration:
        rates = {
            "velocities": motion.velocities / 8.0,
            "accelerations": motion.accelerations / 64.0,
        }
        return replace(motion, times=8.0 * motion.times, **rates)

    found = named(slow)
    assert found.keys() == {"r3"} and "times as long as those of the others" in found["r3"]


def test_a_copy_with_noise_is_named_among_few_recordings() -> None:
    motions = [replace(m, recording=f"r{i}") for i, m in enumerate(generate_kinds(3, 1, 12))]
    positions = motions[1].positions + np.random.default_rng(1).normal(
        0.0, 1e-4, motions[1].positions.shape
    )
    motions.append(replace(motions[1], positions=positions, recording="again"))
    found = foreign_recordings(MotionStatistics.of(motions, OPTIONS), OPTIONS.n_phases)
    ((name, reason),) = found
    assert name == "again" and "from one of 'r1': a copy counts twice" in reason


def test_few_recordings_do_not_show_what_is_usual() -> None:
    assert named(backwards, 3, changed="r1") == {}
