# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The animation: real time, every motion, and the arm where it was."""

from pathlib import Path

import numpy as np
import pytest

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.plotting.arm import ANIMATION_PAUSE, ANIMATION_RATE, at_frames, write_animation

pytest.importorskip("matplotlib", reason="matplotlib is not installed")


def swing(n_frames: int, turn: float = 1.5) -> np.ndarray:
    """An arm of two links that turns forward from hanging, shape (n_frames, 3, 3)."""
    angles = np.linspace(0.0, turn, n_frames)[:, None] * [0.0, 1.0, 1.0]
    lengths = np.array([0.0, 0.25, 0.5])
    return np.stack([lengths * np.sin(angles), 0 * angles, -lengths * np.cos(angles)], -1)


def blue(frame: np.ndarray) -> np.ndarray:
    """Rows and columns of the pixels of the robot's arm, shape (n, 2)."""
    return np.argwhere(np.abs(frame[:, :, :3].astype(int) - [0, 0x72, 0xB2]).max(axis=2) < 8)


def test_positions_at_frames_are_those_of_the_motion() -> None:
    times = np.array([2.0, 2.3, 3.0])
    found = at_frames(times, np.column_stack([times, 5.0 - 2.0 * times]))
    frames = np.linspace(2.0, 3.0, round(ANIMATION_RATE) + 1)
    np.testing.assert_allclose(found, np.column_stack([frames, 5.0 - 2.0 * frames]))


def test_animation_lasts_as_long_as_its_motions_and_pauses(tmp_path: Path) -> None:
    from PIL import Image, ImageSequence

    path = tmp_path / "a.gif"
    write_animation(path, [swing(9), swing(14)], [swing(20), swing(11)])
    with Image.open(path) as image:
        frames = [
            (f.info["duration"], np.array(f.convert("RGB"))) for f in ImageSequence.Iterator(image)
        ]
    n_frames = 14 + 20 + 11 + 5 * ANIMATION_PAUSE
    assert sum(duration for duration, _ in frames) == pytest.approx(1e3 * n_frames / ANIMATION_RATE)
    assert len(blue(frames[0][1])) == 0
    # At the end, the hand is in front of the shoulder, and the arm is level but for 0.07 rad.
    rows, columns = blue(frames[-1][1]).T
    assert np.ptp(columns) > 0.5 * frames[-1][1].shape[1] / 1.3
    assert np.ptp(rows[columns > np.median(columns)]) < 0.5 * np.ptp(columns)


def test_existing_animation_is_kept_unless_forced(tmp_path: Path) -> None:
    path = tmp_path / "a.gif"
    path.write_text("precious", encoding="utf-8")
    with pytest.raises(PlannerError, match="exists already"):
        write_animation(path, [swing(2)], [swing(2)])
    assert path.read_text(encoding="utf-8") == "precious"
    write_animation(path, [swing(2)], [swing(2)], force=True)
    assert path.read_bytes().startswith(b"GIF89a")
