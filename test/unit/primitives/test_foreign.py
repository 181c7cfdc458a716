# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings that are far from all others, made by changing one of ten."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from motion_kinds import generate_kinds

from mp_pca_planner.primitives.foreign import foreign_recordings
from mp_pca_planner.primitives.motion_statistics import MotionStatistics
from mp_pca_planner.primitives.options import PrimitiveOptions
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
    return {one.recording: one.reason for one in found}


def moved(motion: Demonstration, signs: list[int], offset: list[float]) -> Demonstration:
    curves = {
        "positions": motion.positions * signs + offset,
        "velocities": motion.velocities * signs,
        "accelerations": motion.accelerations * signs,
    }
    return replace(motion, **curves)


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
    ],
    ids=["mirrored", "offset", "backwards"],
)
def test_a_changed_recording_is_named_with_what_makes_it_fit(
    change: Callable[[Demonstration], Demonstration], cause: str
) -> None:
    found = named(change)
    assert found.keys() == {"r3"}
    assert "times as far from those of the others as is usual" in found["r3"]
    assert cause in found["r3"]


def test_few_recordings_do_not_show_what_is_usual() -> None:
    assert named(backwards, 3, changed="r1") == {}
