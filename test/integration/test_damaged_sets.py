# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Damaged sets of recordings with known truth; the benchmark has more of them."""

from __future__ import annotations

from pathlib import Path

import pytest
from campaigns.damaged_sets import judge


@pytest.mark.parametrize(
    "name",
    [
        "clean",
        "clock back by 2 s in a motion",
        "clock back by 0.3 s in a motion",
        "gap in a motion",
        "gap in each motion of a recording",
        "joint jumps in a motion",
        "each is one motion without rests",
        "noise of 1 degree at 500 Hz",
        "noise of 1 degree, late messages",
        "one in degrees",
        "copy in another format",
        "part of another, which comes first",
        "copy at another rate",
        "copy with noise",
        "one is mirrored",
        "one has two joints exchanged",
        "one is five times as slow",
        "one mirrored, one backwards",
    ],
)
def test_no_half_is_learned_no_good_recording_rejected_and_the_foreign_named(
    name: str, tmp_path: Path
) -> None:
    found = judge(name, tmp_path)
    assert found.is_right, found
    assert not found.false_alarms, found
