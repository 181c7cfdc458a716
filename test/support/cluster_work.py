# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the workers of the test cluster are given to do: quick to import."""

import os
import signal
from collections.abc import Sequence
from pathlib import Path

from mp_pca_planner.primitives.build import PrimitiveOptions
from mp_pca_planner.primitives.motion_statistics import MotionStatistics


def die_once(motions: Sequence, marker: Path) -> MotionStatistics:
    """Die while a recording is read, the first time."""
    if motions[0].recording == "5" and not marker.exists():
        marker.write_text(str(os.getpid()), encoding="utf-8")
        os.kill(os.getpid(), signal.SIGKILL)
    return MotionStatistics.of(motions, PrimitiveOptions())


def die_of_three(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def kill(process: int) -> None:
    os.kill(process, signal.SIGKILL)


def fail(number: int) -> int:
    raise ArithmeticError(f"no {number}")
